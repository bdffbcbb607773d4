"""Matching and measuring whole tables of poses."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.metrics import PoseTable, evaluation

K = np.array([[570.0, 0, 320], [0, 575, 240], [0, 0, 1]])
HALF_TURN = np.diag([-1.0, -1, 1, 1])


def table(rows):
    """From rows (scene, image, object, score, x in metres, angle about z in degrees)."""
    scene, image, object_id, score, x, angle = map(np.array, zip(*rows, strict=True))
    n = len(rows)
    return PoseTable(
        scene, image, object_id,
        R=Rotation.from_euler("z", angle[:, None], degrees=True).as_matrix(),
        t=np.column_stack([x, np.zeros(n), np.ones(n)]),
        score=score.astype(float),
        time=np.full(n, -1.0),
    )  # fmt: skip


def empty():
    return table([(1, 1, 1, 1, 0.0, 0.0)])[:0]


def model(symmetric=False):
    points = np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    symmetries = np.stack([np.eye(4), HALF_TURN]) if symmetric else None
    size = np.full(3, 0.1)
    return evaluation.ObjectModel(points, 0.1 * np.sqrt(3), np.zeros(3), size, symmetries)


TRUTH = table([(1, 1, 7, 1, 0.0, 0.0), (1, 2, 7, 1, 0.0, 30.0), (1, 2, 8, 1, 0.3, 0.0)])


def test_the_surest_estimate_of_an_image_counts():
    estimates = table(
        [(1, 1, 7, 0.2, 0.0, 0.0), (1, 1, 7, 0.9, 0.5, 0.0), (1, 1, 7, 0.9, 0.1, 0.0),
         (1, 2, 9, 1.0, 0.0, 0.0), (2, 2, 7, 1.0, 0.0, 30.0), (1, 2, 8, 0.0, 0.3, 0.0)]
    )  # fmt: skip
    assert evaluation.match(estimates, TRUTH).tolist() == [1, -1, 5]
    assert evaluation.match(empty(), TRUTH).tolist() == [-1, -1, -1]
    assert evaluation.match(TRUTH, empty()).tolist() == []


def test_several_instances_are_assigned_to_the_nearest():
    truth = table([(1, 1, 7, 1, x, 0.0) for x in (0.0, 0.2, 0.4)])
    estimates = table(
        [(1, 1, 7, 0.9, 0.41, 0.0), (1, 1, 7, 0.8, 0.01, 0.0), (1, 1, 7, 0.1, 0.2, 0.0),
         (1, 1, 7, 0.7, 0.19, 0.0)]
    )  # fmt: skip
    assert evaluation.match(estimates, truth).tolist() == [1, 3, 0]  # the fourth surest is out
    assert evaluation.match(estimates[:2], truth).tolist() == [1, -1, 0]


@given(st.integers(0, 2**32 - 1))
def test_match_uses_no_estimate_twice(seed):
    rng = np.random.default_rng(seed)
    rows = [
        [(1, int(i), int(o), s, x, 0.0) for i, o, s, x in zip(*columns, strict=True)]
        for columns in [
            (rng.integers(0, 2, n), rng.integers(0, 3, n), rng.random(n), rng.random(n))
            for n in (12, 8)
        ]
    ]
    estimates, truth = map(table, rows)
    matched = evaluation.match(estimates, truth)
    used = matched[matched >= 0]
    assert len(set(used.tolist())) == len(used)
    np.testing.assert_array_equal(estimates.object_id[used], truth.object_id[matched >= 0])
    for key in set(zip(truth.image_id.tolist(), truth.object_id.tolist(), strict=True)):
        there = (truth.image_id == key[0]) & (truth.object_id == key[1])
        given_ = (estimates.image_id == key[0]) & (estimates.object_id == key[1])
        assert (matched[there] >= 0).sum() == min(there.sum(), given_.sum())


def test_errors_by_hand():
    """Object 7: one estimate 1 cm off, one pose missed. Object 8 has no model."""
    estimates = table([(1, 1, 7, 1, 0.01, 0.0), (1, 2, 8, 1, 0.3, 10.0)])
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, K)
    values = errors[7].values
    assert errors[7].found.tolist() == [True, False]
    for name in ("translation", "add", "mssd"):
        np.testing.assert_allclose(values[name], [0.01, np.inf], rtol=1e-9)
    np.testing.assert_allclose(values["rotation"], [0, np.inf], atol=1e-9)
    np.testing.assert_allclose(values["iou"], [9 / 11, -np.inf], rtol=1e-6)
    np.testing.assert_allclose(values["diameter"], 0.1 * np.sqrt(3))
    near, far = 570 * 0.01 / 0.95, 570 * 0.01 / 1.05  # the cube's two depths
    np.testing.assert_allclose(values["mspd"], [near, np.inf])
    np.testing.assert_allclose(values["projection"], [(near + far) / 2, np.inf])
    assert errors[7].precision == pytest.approx({0.25: 0.5, 0.5: 0.5, 0.75: 0.5})
    bare = errors[8].values
    assert "add" not in bare
    assert "iou" not in bare
    # About the viewing axis: a turn of 10 degrees is a roll of 10 degrees.
    np.testing.assert_allclose(np.rad2deg(bare["roll"]), [10], rtol=1e-9)
    np.testing.assert_allclose(np.rad2deg(bare["rotation"]), [10], rtol=1e-9)


def test_a_symmetric_object_is_measured_at_its_best_symmetry():
    truth = table([(1, 1, 7, 1, 0.0, 0.0)])
    estimates = table([(1, 1, 7, 1, 0.0, 185.0)])
    plain = evaluation.evaluate(estimates, truth, {7: model()})[7].values
    best = evaluation.evaluate(estimates, truth, {7: model(symmetric=True)})[7].values
    assert np.rad2deg(plain["rotation"]) == pytest.approx([175])
    assert np.rad2deg(best["rotation"]) == pytest.approx([5])
    assert np.rad2deg(best["roll"]) == pytest.approx([5])
    assert best["mssd"] < plain["mssd"] / 5
    assert best["add_or_s"] == best["add_s"]
    assert plain["add_or_s"] == plain["add"]


def test_matrices_that_are_no_rotations_get_no_angles():
    truth = table([(1, 1, 7, 1, 0.0, 0.0)])
    stretched = replace(truth, R=truth.R * 1.01)
    values = evaluation.evaluate(truth, stretched, {7: model()}, K)[7].values
    assert {"rotation", "yaw", "iou"}.isdisjoint(values)
    assert values["add"] == pytest.approx(np.sqrt(3) * 0.05 * 0.01)


def test_wrong_detections_lower_the_precision():
    """An estimate in an image without the object is no pose error, but a false detection."""
    estimates = table([(1, 1, 7, 0.5, 0.0, 0.0), (1, 5, 7, 0.9, 0.0, 0.0)])
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, objects=[7])
    assert list(errors) == [7]
    assert errors[7].precision[0.5] == pytest.approx(0.5 * 0.5)


def test_pooled_errors_keep_every_pose():
    estimates = table([(1, 1, 7, 1, 0.01, 0.0), (1, 2, 8, 1, 0.3, 10.0)])
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, K)
    together = evaluation.pool(list(errors.values()))
    assert together.found.tolist() == [True, False, True]
    assert len(together.values["translation"]) == 3
    assert len(together.values["add"]) == 2


def test_intrinsics_of_every_pose():
    estimates = table([(1, 1, 7, 1, 0.01, 0.0), (1, 2, 7, 1, 0.01, 30.0)])
    truth = TRUTH[:2]
    doubled = np.stack([K, K * [[2], [2], [1]]])
    values = evaluation.evaluate(estimates, truth, {7: model()}, doubled)[7].values
    single = [
        metrics.projection_2d(
            doubled[i], estimates.R[i], estimates.t[i], truth.R[i], truth.t[i], model().points
        )
        for i in range(2)
    ]
    np.testing.assert_allclose(values["projection"], single)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: evaluation.evaluate(TRUTH, empty(), {}), "ground_truth"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, objects=[7, 99]), "objects.*99"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, np.eye(4)), "K"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {7: model()}, np.zeros((3, 3))), "K"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()
