"""Poses from pixels of unequal worth: the minimum, wild keypoints, covariances that are none."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from posecore.registration import pnp
from posecore.registration.weighted_pnp import uncertainty_pnp
from posecore.rotations import geodesic_distance

SEEDS = st.integers(0, 2**32 - 1)
K = np.array([[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]])


def picture(R, t, points, K=K):
    camera = points @ R.T + t
    return camera @ K[:2].T / camera[:, 2:]


def case(seed, count=9):
    """An object of 0.2 m one metre away: R, t, points, exact pixels, a generator."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=rng).as_matrix()
    points = rng.uniform(-0.1, 0.1, (count, 3))
    t = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.6, 1.5)])
    return R, t, points, picture(R, t, points), rng


def ellipses(rng, count, low=0.3, high=3.0):
    """Covariances whose standard deviations lie between two numbers of pixels."""
    turns = Rotation.from_euler("z", rng.uniform(-3, 3, (count, 1))).as_matrix()[:, :2, :2]
    variances = np.exp(rng.uniform(np.log(low), np.log(high), (count, 2))) ** 2
    return turns @ (variances[:, :, None] * turns.swapaxes(1, 2))


def drawn(rng, covariances):
    return np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(len(covariances), 2))
    )


def whitened(R, t, points, pixels, covariances):
    errors = picture(R, t, points) - pixels
    return np.linalg.solve(np.linalg.cholesky(covariances), errors[..., None]).ravel()


@given(seed=SEEDS, count=st.integers(6, 20), spread=st.sampled_from([1.0, 30.0]))
def test_exact_pixels_give_the_exact_pose_whatever_the_covariances(seed, count, spread):
    R, t, points, pixels, rng = case(seed, count)
    found = uncertainty_pnp(points, pixels, ellipses(rng, count, 0.1, 0.1 * spread), K)
    assert geodesic_distance(found.R, R) < 1e-6
    np.testing.assert_allclose(found.t, t, atol=1e-6)
    assert found.inliers.all() and found.reprojection_error < 1e-6


@given(seed=SEEDS, count=st.integers(6, 20), variance=st.sampled_from([1e-6, 1.0, 25.0, 1e8]))
def test_equal_covariances_are_no_covariances(seed, count, variance):
    _, _, points, pixels, rng = case(seed, count)
    pixels = pixels + rng.normal(size=pixels.shape)
    found = uncertainty_pnp(points, pixels, np.tile(variance * np.eye(2), (count, 1, 1)), K)
    plain = pnp(points, pixels, K)
    # OpenCV ends where the error no longer falls, which leaves half of the digits of the pose.
    assert geodesic_distance(found.R, plain.R) < 1e-4
    assert found.reprojection_error <= plain.reprojection_error * (1 + 1e-9)
    assert found.reprojection_error == pytest.approx(plain.reprojection_error, rel=1e-6)


@pytest.mark.slow
@given(seed=SEEDS)
@settings(max_examples=50)
def test_the_minimum_is_that_of_an_independent_solver(seed):
    R, t, points, pixels, rng = case(seed)
    covariances = ellipses(rng, len(points))
    pixels = pixels + drawn(rng, covariances)
    found = uncertainty_pnp(points, pixels, covariances, K)

    def errors(x):
        return whitened(
            Rotation.from_rotvec(x[:3]).as_matrix() @ R, t + x[3:], points, pixels, covariances
        )

    best = least_squares(errors, np.zeros(6), method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    reached = np.square(whitened(found.R, found.t, points, pixels, covariances)).sum()
    assert reached <= 2 * best.cost * (1 + 1e-9)
    # No small step leads further down: the gradient is zero by central differences.
    for axis in range(6):
        costs = []
        for step in (-1e-5, 1e-5):
            x = np.eye(6)[axis] * step
            R_near = Rotation.from_rotvec(x[:3]).as_matrix() @ found.R
            errors_near = whitened(R_near, found.t + x[3:], points, pixels, covariances)
            costs.append(np.square(errors_near).sum())
        assert min(costs) > reached
        assert abs(costs[1] - costs[0]) < 1e-2 * (max(costs) - reached)


@pytest.mark.slow
@given(seed=SEEDS, wild=st.integers(1, 4), behind=st.booleans())
def test_wild_keypoints_of_large_covariance_do_not_matter(seed, wild, behind):
    _, _, points, pixels, rng = case(seed, 10)
    covariances = np.tile(0.25 * np.eye(2), (10, 1, 1))
    pixels = pixels + 0.1 * rng.normal(size=pixels.shape)
    clean = uncertainty_pnp(points[wild:], pixels[wild:], covariances[wild:], K)
    far = rng.choice([-1, 1], (wild, 2)) * rng.uniform(200, 2000, (wild, 2))
    pixels[:wild] += far * (50 if behind else 1)
    covariances[:wild] = 1e12 * np.eye(2)
    found = uncertainty_pnp(points, pixels, covariances, K)
    assert geodesic_distance(found.R, clean.R) < 1e-4
    np.testing.assert_allclose(found.t, clean.t, atol=1e-4)


@pytest.mark.slow
def test_a_pose_is_better_for_knowing_the_covariances():
    with_them, without = [], []
    for seed in range(60):
        R, _, points, pixels, rng = case(seed)
        covariances = ellipses(rng, 9, 0.3, 10)
        pixels = pixels + drawn(rng, covariances)
        with_them.append(geodesic_distance(uncertainty_pnp(points, pixels, covariances, K).R, R))
        without.append(geodesic_distance(pnp(points, pixels, K).R, R))
    assert np.median(with_them) < 0.5 * np.median(without)


def test_a_direction_that_is_not_known_is_not_used():
    """Pixels that slid along the long axes of their ellipses are as good as exact ones."""
    R, _, points, pixels, rng = case(4)
    along = np.stack([np.cos(angles := rng.uniform(-3, 3, 9)), np.sin(angles)], -1)
    covariances = 1e-4 * np.eye(2) + 1e6 * along[:, :, None] * along[:, None]
    slid = pixels + rng.uniform(-2, 2, (9, 1)) * along
    found = uncertainty_pnp(points, slid, covariances, K)
    assert geodesic_distance(found.R, R) < 1e-4
    assert geodesic_distance(pnp(points, slid, K).R, R) > 5e-3


@pytest.mark.slow
@given(seed=SEEDS, exponent=st.integers(-5, 5), factor=st.sampled_from([1e-9, 1.0, 1e9]))
def test_units_do_not_matter(seed, exponent, factor):
    _, _, points, pixels, rng = case(seed)
    covariances = ellipses(rng, 9)
    pixels = pixels + drawn(rng, covariances)
    one = uncertainty_pnp(points, pixels, covariances, K)
    scale = 10.0**exponent
    other = uncertainty_pnp(scale * points, pixels, factor * covariances, K)
    assert geodesic_distance(one.R, other.R) < 1e-6
    np.testing.assert_allclose(other.t / scale, one.t, atol=1e-6)


@given(seed=SEEDS)
def test_flat_objects(seed):
    R, t, points, _, rng = case(seed, 8)
    points[:, 2] = 0
    points[:4] = [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]
    R = Rotation.from_euler("xyz", [*rng.uniform(0.3, 1, 2), rng.uniform(-3, 3)]).as_matrix()
    found = uncertainty_pnp(points, picture(R, t, points), ellipses(rng, 8), K)
    assert geodesic_distance(found.R, R) < 1e-5


@pytest.mark.parametrize("count", [4, 5])
def test_few_points_are_met_exactly(count):
    for seed in range(30):
        _, _, points, pixels, rng = case(seed, count)
        found = uncertainty_pnp(points, pixels, ellipses(rng, count), K)
        assert found.reprojection_error < 1e-5  # though another pose than ours may meet four


def test_kind_and_precision_of_the_input_come_back():
    R, _, points, pixels, rng = case(0)
    covariances = ellipses(rng, 9)
    one = uncertainty_pnp(points, pixels, covariances, K)
    assert isinstance(one.R, np.ndarray) and one.inliers.dtype == bool
    tensors = [torch.from_numpy(x).float() for x in (points, pixels, covariances, K)]
    other = uncertainty_pnp(*tensors)
    assert other.R.dtype == other.t.dtype == torch.float32 and other.inliers.dtype == torch.bool
    assert isinstance(other.reprojection_error, float)
    assert geodesic_distance(other.R.double().numpy(), R) < 1e-4
    lists = uncertainty_pnp(points.tolist(), pixels.tolist(), covariances.tolist(), K.tolist())
    np.testing.assert_array_equal(lists.R, one.R)
    again = uncertainty_pnp(points, pixels, covariances, K)
    np.testing.assert_array_equal(again.t, one.t)


def test_float32_may_leave_covariances_a_little_asymmetric():
    _, _, points, pixels, rng = case(1)
    covariances = ellipses(rng, 9)
    pixels = pixels + drawn(rng, covariances)
    bent = covariances.copy()
    bent[:, 0, 1] += 1e-7 * covariances.max((1, 2))
    one, other = (uncertainty_pnp(points, pixels, c, K) for c in (covariances, bent))
    np.testing.assert_allclose(one.R, other.R, atol=1e-5)


_, _, POINTS, PIXELS, RNG = case(0)
SIGMA = ellipses(RNG, 9)


def first(matrix):
    """The covariances with another one for the first point."""
    return np.concatenate([[matrix], SIGMA[1:]])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(points_3d=POINTS[:3], points_2d=PIXELS[:3], covariances=SIGMA[:3]), "points_3d:"),
        (dict(points_3d=np.full((9, 3), 0.3)), "points_3d:"),
        (dict(points_3d=np.linspace(0, 1, 9)[:, None] * [1, 2, 3]), "points_3d:"),
        (dict(points_2d=np.full((9, 2), 33.3)), "points_2d:"),
        (dict(covariances=0 * SIGMA), "covariances: expected positive definite"),
        (dict(covariances=-SIGMA), "covariances: expected positive definite"),
        (dict(covariances=first([[0, 0], [0, 0]])), "covariances: expected positive definite"),
        (dict(covariances=first([[1, 0], [0, 0]])), "covariances: expected positive definite"),
        (dict(covariances=first([[1, 1], [1, 1]])), "covariances: expected positive definite"),
        (dict(covariances=first([[1, 2], [2, 1]])), "covariances: expected positive definite"),
        (dict(covariances=first([[1, 0.1], [0, 1]])), "covariances: expected symmetric"),
        (dict(K=np.zeros((3, 3))), "K:"),
        (dict(K=2 * K), "K:"),
        (dict(K=K + [[0, 1, 0], [0, 0, 0], [0, 0, 0]]), "K: expected no skew"),
    ],
)
def test_bad_input_is_named(changes, named):
    arguments = dict(points_3d=POINTS, points_2d=PIXELS, covariances=SIGMA, K=K) | changes
    with pytest.raises(ValueError, match=f"^{named}"):
        uncertainty_pnp(**arguments)


@pytest.mark.slow
@given(seed=SEEDS)
def test_nonsense_gives_a_pose_in_front_of_the_camera_or_a_value_error(seed):
    rng = np.random.default_rng(seed)
    count = rng.integers(4, 9)
    points = rng.integers(-1, 2, (count, 3)).astype(float)  # many alike, flat or on lines
    pixels = rng.integers(0, 4, (count, 2)) * 200.0
    try:
        found = uncertainty_pnp(points, pixels, ellipses(rng, count, 0.1, 1000), K)
    except ValueError:
        return
    np.testing.assert_allclose(found.R @ found.R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found.R) > 0 and np.isfinite(found.t).all()
    assert (points @ found.R.T + found.t)[:, 2].min() > 0
    assert np.isfinite(found.reprojection_error)


def test_a_start_with_a_point_behind_the_camera_is_refused(monkeypatch):
    plain = pnp(POINTS, PIXELS, K)
    monkeypatch.setattr(
        "posecore.registration.weighted_pnp.pnp",
        lambda *_: plain._replace(t=plain.t * [1, 1, 0]),
    )
    with pytest.raises(ValueError, match=r"^points_2d: expected the picture of an object in front"):
        uncertainty_pnp(POINTS, PIXELS, SIGMA, K)


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [0, 0.01, 0.05])
def test_nearly_flat_points_do_not_end_in_the_mirror_image(thickness):
    """The start fits plain pixels best, and may lie on the wrong side for the weighted ones."""
    for seed in range(100):
        _, _, points, _, rng = case(seed, 8)
        points = points * [1, 1, thickness]
        R, t = (
            Rotation.random(random_state=rng).as_matrix(),
            np.array([0, 0, rng.uniform(0.5, 1.2)]),
        )
        covariances = ellipses(rng, 8)
        pixels = picture(R, t, points) + drawn(rng, covariances)
        found = uncertainty_pnp(points, pixels, covariances, K)

        def errors(x, points=points, pixels=pixels, covariances=covariances):
            turned = Rotation.from_rotvec(x[:3]).as_matrix()
            return whitened(turned, x[3:], points, pixels, covariances)

        start = np.concatenate([Rotation.from_matrix(R).as_rotvec(), t])
        best = np.square(least_squares(errors, start, xtol=1e-14).fun).sum()
        cost = np.square(whitened(found.R, found.t, points, pixels, covariances)).sum()
        assert cost <= best * (1 + 1e-6), seed
