"""VSD beside a loop over pixels, and what its masks are."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore import metrics
from posecore.metrics.visible_surface import VSD_DELTA, VSD_TAUS
from tests.metrics import bop_loop

K = np.array([[40.0, 0, 3.2], [0, 45, 2.6], [0, 0, 1]])
SHAPE = (4, 6)


def depths(rng, hole=0.3):
    """Near one plane, so that masks and gaps are of all kinds; with holes."""
    near = 0.8 + rng.normal(0, 0.02, SHAPE)
    return np.where(rng.random(SHAPE) < hole, 0, near)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_vsd_is_that_of_the_loop(seed):
    rng = np.random.default_rng(seed)
    est, gt, test = depths(rng), depths(rng), depths(rng)
    diameter, delta = rng.uniform(0.02, 0.2), rng.uniform(0, 0.03)
    expected = bop_loop.vsd(est, gt, test, K, diameter, delta, VSD_TAUS)
    np.testing.assert_allclose(
        metrics.vsd(est, gt, test, K, diameter, delta), expected, atol=1e-9, rtol=0
    )


def test_a_batch_is_its_rows(rng):
    est, gt = (np.stack([depths(rng) for _ in range(6)]).reshape(3, 2, *SHAPE) for _ in range(2))
    test, diameter = depths(rng), rng.uniform(0.02, 0.2, (3, 1))
    together = metrics.vsd(est, gt, test, K, diameter)
    assert together.shape == (3, 2, 10)
    for i, j in np.ndindex(3, 2):
        alone = metrics.vsd(est[i, j], gt[i, j], test, K, diameter[i, 0])
        np.testing.assert_array_equal(together[i, j], alone)
    tensors = [torch.from_numpy(x) for x in (est, gt, test, K, diameter)]
    np.testing.assert_array_equal(metrics.vsd(*tensors).numpy(), together)


def test_a_crop_is_the_whole(rng):
    """Where neither model is counts nothing."""
    est, gt, test = (np.zeros((9, 12)) for _ in range(3))
    test[:] = 0.8
    est[3:7, 2:8], gt[3:7, 2:8] = depths(rng), depths(rng)
    whole = metrics.vsd(est, gt, test, K, 0.1)
    part = (slice(3, 7), slice(2, 8))
    moved = K - [[0, 0, 2], [0, 0, 3], [0, 0, 0]]
    np.testing.assert_allclose(metrics.vsd(est[part], gt[part], test[part], moved, 0.1), whole)


def test_by_hand():
    """A row of pixels on the axis' side: same, 2 cm off, surplus, missing; diameter 20 cm."""
    camera = np.diag([1e9, 1e9, 1.0])  # all rays along the axis
    gt = np.array([[1.0, 1.0, 0.0, 1.0]])
    est = np.array([[1.0, 1.02, 1.0, 0.0]])
    far = np.full((1, 4), 3.0)
    errors = metrics.vsd(est, gt, far, camera, 0.2, taus=[0.05, 0.0999, 0.1001])
    np.testing.assert_allclose(errors, [0.75, 0.75, 0.5])
    np.testing.assert_array_equal(metrics.vsd(gt, gt, far, camera, 0.2), np.zeros(10))
    nothing = np.zeros((1, 4))
    np.testing.assert_array_equal(metrics.vsd(nothing, gt, far, camera, 0.2), np.ones(10))
    np.testing.assert_array_equal(metrics.vsd(nothing, nothing, far, camera, 0.2), np.ones(10))


def test_what_is_hidden_is_not_compared():
    camera = np.diag([1e9, 1e9, 1.0])
    gt, est = np.array([[1.0, 1.0]]), np.array([[1.0, 1.3]])
    hidden = np.array([[2.0, 0.5]])  # something stands before the second pixel
    np.testing.assert_array_equal(metrics.vsd(est, gt, hidden, camera, 0.2), np.zeros(10))
    unknown = np.array([[2.0, 0.0]])  # the sensor saw nothing there: it counts as visible
    np.testing.assert_array_equal(metrics.vsd(est, gt, unknown, camera, 0.2), np.full(10, 0.5))


def test_an_estimate_behind_the_true_surface_is_not_hidden_by_it():
    """The sensor saw the object itself, 3 cm before the estimate: it is a near miss, no gap."""
    camera = np.diag([1e9, 1e9, 1.0])
    seen = np.full((1, 3), 1.0)
    assert not metrics.visible_surface(seen + 0.03, seen, camera).any()
    errors = metrics.vsd(seen + 0.03, seen, seen, camera, 0.2, taus=[0.1, 0.2])
    np.testing.assert_array_equal(errors, [1, 0])


def test_visible_surface():
    camera = np.diag([1e9, 1e9, 1.0])
    model = np.array([[1.0, 1.0, 1.0, 1.0, 0.0]])
    test = np.array([[1.0, 1.0 - VSD_DELTA + 1e-6, 1.0 - VSD_DELTA - 1e-6, 0.0, 1.0]])
    expected = [[True, True, False, True, False]]
    np.testing.assert_array_equal(metrics.visible_surface(model, test, camera), expected)


def test_distances_are_lengths_of_rays(rng):
    depth = rng.uniform(0.5, 2, SHAPE)
    depth[1, 2] = 0
    y, x = np.indices(SHAPE)
    points = np.stack([(x - 3.2) / 40 * depth, (y - 2.6) / 45 * depth, depth], -1)
    got = metrics.distance_image(depth, K)
    np.testing.assert_allclose(got, np.linalg.norm(points, axis=-1))
    assert got[1, 2] == 0 and (got[depth > 0] > depth[depth > 0]).all()


def test_the_distance_not_the_depth_is_compared():
    """At 45 degrees 1 cm of depth are 1.41 cm on the ray."""
    camera = np.array([[1.0, 0, -1.0], [0, 1, 0], [0, 0, 1]])
    gt = np.array([[1.0]])
    errors = metrics.vsd(gt + 0.01, gt, gt * 0, camera, 1.0, taus=[0.0141, 0.0142])
    np.testing.assert_array_equal(errors, [1, 0])


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"depth_est": -np.ones(SHAPE)}, "depth_est"),
        ({"depth_gt": -np.ones(SHAPE)}, "depth_gt"),
        ({"depth_test": -np.ones(SHAPE)}, "depth_test"),
        ({"K": np.zeros((3, 3))}, "K"),
        ({"diameter": 0.0}, "diameter"),
        ({"diameter": [0.1, -0.1]}, "diameter"),
        ({"delta": -0.01}, "delta"),
        ({"delta": None}, "delta"),
        ({"taus": [0.1, 0.0]}, "taus"),
        ({"taus": []}, "taus"),
    ],
)
def test_what_cannot_be_is_named(change, name):
    depth = np.ones(SHAPE)
    given = {"depth_est": depth, "depth_gt": depth, "depth_test": depth, "K": K, "diameter": 0.1}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        metrics.vsd(**given | change)


def test_the_others_name_it_too():
    with pytest.raises(ValueError, match="^depth: expected depths of at least 0, got -1"):
        metrics.distance_image(-np.ones(SHAPE), K)
    with pytest.raises(ValueError, match="^depth_model: expected"):
        metrics.visible_surface(-np.ones(SHAPE), np.ones(SHAPE), K)
