"""Errors on model points against brute force, and the stories that the errata tell about them."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.metrics import model_errors

K = np.array([[570.0, 0, 320], [0, 575, 240], [0, 0, 1]])
seeds = st.integers(0, 2**32 - 1)


def random_case(seed, batch=(), points=20):
    """Two poses a metre before the camera, and the model of a hand-sized object."""
    rng = np.random.default_rng(seed)
    count = int(np.prod(batch, dtype=int))
    R = [Rotation.random(count, random_state=rng).as_matrix().reshape(*batch, 3, 3) for _ in "12"]
    t = [rng.uniform(-0.1, 0.1, (*batch, 3)) + (0, 0, 1) for _ in "12"]
    return R[0], t[0], R[1], t[1], rng.normal(0, 0.05, (points, 3))


def posed(R, t, points):
    return np.array([R @ x + t for x in points])


def turn(axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(axis, float) * angle).as_matrix()
    return T


FOURFOLD = np.stack([turn((0, 0, 1), k * np.pi / 2) for k in range(4)])


@given(seeds)
def test_add_is_the_mean_distance_of_equal_points(seed):
    R_1, t_1, R_2, t_2, points = random_case(seed)
    pairs = zip(posed(R_1, t_1, points), posed(R_2, t_2, points), strict=True)
    gaps = [np.linalg.norm(a - b) for a, b in pairs]
    assert metrics.add(R_1, t_1, R_2, t_2, points) == pytest.approx(np.mean(gaps), rel=1e-12)


@given(seeds)
def test_add_s_is_the_mean_distance_to_the_nearest_point(seed):
    R_1, t_1, R_2, t_2, points = random_case(seed)
    distance = cdist(posed(R_2, t_2, points), posed(R_1, t_1, points))  # ground truth x estimate
    ours = metrics.add_s(R_1, t_1, R_2, t_2, points)
    assert ours == pytest.approx(distance.min(1).mean(), rel=1e-9)
    ours = metrics.add_s(R_1, t_1, R_2, t_2, points, direction="est_to_gt")
    assert ours == pytest.approx(distance.min(0).mean(), rel=1e-9)


def test_the_two_directions_of_add_s_differ():
    """A dense cluster and one far point: which way one looks decides."""
    points = np.concatenate([np.zeros((9, 3)), [[1.0, 0, 0]]])
    eye = np.eye(3)
    est, gt = np.zeros(3), np.array([1.0, 0, 0])
    forward = metrics.add_s(eye, est, eye, gt, points)
    backward = metrics.add_s(eye, est, eye, gt, points, direction="est_to_gt")
    assert forward == pytest.approx((9 * 0 + 1) / 10)
    assert backward == pytest.approx((9 * 1 + 0) / 10)


def test_add_s_of_matrices_that_are_no_rotations(rng):
    R_1, t_1, R_2, t_2, points = random_case(3, (4,))
    R_1 = R_1 + rng.normal(0, 0.01, R_1.shape)
    expected = [
        cdist(posed(R_2[i], t_2[i], points), posed(R_1[i], t_1[i], points)).min(1).mean()
        for i in range(4)
    ]
    np.testing.assert_allclose(metrics.add_s(R_1, t_1, R_2, t_2, points), expected, rtol=1e-12)


def test_add_s_takes_a_cloud_for_every_row():
    R_1, t_1, R_2, t_2, _ = random_case(3, (4,))
    clouds = np.random.default_rng(1).normal(0, 0.1, (4, 30, 3))
    expected = [metrics.add_s(*row) for row in zip(R_1, t_1, R_2, t_2, clouds, strict=True)]
    np.testing.assert_allclose(metrics.add_s(R_1, t_1, R_2, t_2, clouds), expected, rtol=1e-12)


@given(seeds)
def test_mssd_and_mspd_take_the_best_symmetry(seed):
    R_1, t_1, R_2, t_2, points = random_case(seed)
    surface, pixels = [], []
    for S in FOURFOLD:
        moved = posed(S[:3, :3], S[:3, 3], points)
        a, b = posed(R_1, t_1, points), posed(R_2, t_2, moved)
        surface.append(np.linalg.norm(a - b, axis=1).max())
        zero = np.zeros(3)
        uv = [cv2.projectPoints(x, zero, zero, K, None)[0][:, 0] for x in (a, b)]
        pixels.append(np.linalg.norm(uv[0] - uv[1], axis=1).max())
    assert metrics.mssd(R_1, t_1, R_2, t_2, points) == pytest.approx(surface[0], rel=1e-9)
    assert metrics.mssd(R_1, t_1, R_2, t_2, points, FOURFOLD) == pytest.approx(min(surface))
    assert metrics.mspd(K, R_1, t_1, R_2, t_2, points) == pytest.approx(pixels[0], rel=1e-9)
    assert metrics.mspd(K, R_1, t_1, R_2, t_2, points, FOURFOLD) == pytest.approx(min(pixels))


def test_symmetries_with_an_offset_axis():
    """A half turn about the line x = 5 cm moves the origin by 10 cm and is still no error."""
    S = turn((0, 0, 1), np.pi)
    S[:3, 3] = (0.1, 0, 0)
    R, t, _, _, points = random_case(5)
    symmetries = np.stack([np.eye(4), S])
    R_est, t_est = R @ S[:3, :3], R @ S[:3, 3] + t
    assert metrics.mssd(R_est, t_est, R, t, points, symmetries) == pytest.approx(0, abs=1e-12)
    assert metrics.mssd(R_est, t_est, R, t, points) > 0.1


@pytest.mark.parametrize(
    "points",
    [[[0, 0, 0]], [[0, 0, 0], [1, 0, 0]], [[x, x, 0] for x in range(5)], [[0, 0, 1]] * 6,
     [[x, y, 0] for x in range(3) for y in range(3)]],
    ids=["one point", "two points", "a line", "duplicates", "a plane"],
)  # fmt: skip
def test_mssd_of_models_without_a_volume(points):
    R_1, t_1, R_2, t_2, _ = random_case(8)
    points = np.array(points, float)
    gaps = np.linalg.norm(posed(R_1, t_1, points) - posed(R_2, t_2, points), axis=1)
    assert metrics.mssd(R_1, t_1, R_2, t_2, points) == pytest.approx(gaps.max(), rel=1e-12)


@given(seeds)
def test_projection_2d_is_opencvs(seed):
    R_1, t_1, R_2, t_2, points = random_case(seed)
    uv = [
        cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, None)[0][:, 0]
        for R, t in ((R_1, t_1), (R_2, t_2))
    ]
    expected = np.linalg.norm(uv[0] - uv[1], axis=1).mean()
    assert metrics.projection_2d(K, R_1, t_1, R_2, t_2, points) == pytest.approx(expected, rel=1e-7)


def test_an_estimate_behind_the_camera_is_infinitely_wrong():
    R, t, _, _, points = random_case(0)
    assert metrics.projection_2d(K, R, -t, R, t, points) == np.inf
    assert metrics.mspd(K, R, -t, R, t, points) == np.inf


@given(seeds)
def test_all_errors_of_a_perfect_estimate_are_zero(seed):
    R, t, _, _, points = random_case(seed, (2,))
    exact = dict(atol=1e-7)  # the square root of the rounding of a squared distance
    np.testing.assert_allclose(metrics.add(R, t, R, t, points), 0, **exact)
    np.testing.assert_allclose(metrics.add_s(R, t, R, t, points), 0, **exact)
    np.testing.assert_allclose(metrics.mssd(R, t, R, t, points, FOURFOLD), 0, **exact)
    np.testing.assert_allclose(metrics.mspd(K, R, t, R, t, points, FOURFOLD), 0, atol=1e-6)


@given(seeds)
def test_order_of_the_errors(seed):
    """ADD-S <= ADD <= MSSD without symmetries, by definition."""
    case = random_case(seed, (5,))
    add_s, add, mssd = (f(*case) for f in (metrics.add_s, metrics.add, metrics.mssd))
    assert (add_s <= add + 1e-12).all()
    assert (add <= mssd + 1e-12).all()


def test_batches_broadcast_and_pieces_do_not_matter(monkeypatch):
    R_1, t_1, R_2, t_2, points = random_case(2, (3, 4))
    functions = [metrics.add, metrics.add_s, metrics.mssd]
    functions += [lambda *a: metrics.projection_2d(K, *a), lambda *a: metrics.mspd(K, *a)]
    for function in functions:
        whole = function(R_1, t_1, R_2, t_2, points)
        assert whole.shape == (3, 4)
        single = function(R_1[1, 2], t_1[1, 2], R_2[1, 2], t_2[1, 2], points)
        assert single == pytest.approx(whole[1, 2], rel=1e-12)
        shared = function(R_1, t_1, R_2[0, 0], t_2[0, 0], points)
        row = function(R_1[2, 1], t_1[2, 1], R_2[0, 0], t_2[0, 0], points)
        assert row == pytest.approx(shared[2, 1], rel=1e-12)
        assert function(R_1[:0], t_1[:0], R_2[:0], t_2[:0], points).shape == (0, 4)
        with monkeypatch.context() as patch:
            patch.setattr(model_errors, "MAX_POINTS", 50)
            np.testing.assert_allclose(function(R_1, t_1, R_2, t_2, points), whole, rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [1, 30])
def test_the_order_of_searches_changes_no_distance(monkeypatch, dtype, count):
    case = [np.asarray(x, dtype) for x in random_case(5, (count,))]
    flat = case[4] * np.array([1, 1, 0], dtype)
    far = [*case[:3], case[3] + dtype(1e30), case[4]]
    for arguments in (case, [*case[:4], flat], [*case[:4], 0 * flat], far):
        plain = metrics.add_s(*arguments)
        with monkeypatch.context() as patch:
            patch.setattr(model_errors, "SORT_FROM", 1)
            np.testing.assert_array_equal(metrics.add_s(*arguments), plain)


def test_gradients_reach_the_pose():
    case = [torch.tensor(x) for x in random_case(4, (2,))]
    for x in case[:4]:
        x.requires_grad_()
    assert torch.autograd.gradcheck(metrics.add, case)
    assert torch.autograd.gradcheck(metrics.mssd, case)
    # The nearest points do not change under gradcheck's small steps. Rotations must stay rotations.
    moved = case[1].detach().clone().requires_grad_()
    fixed = [case[0].detach(), moved, case[2].detach(), case[3].detach(), case[4]]
    assert torch.autograd.gradcheck(metrics.add_s, fixed)


def test_a_hidden_point_spoils_no_gradient():
    """One estimate of two is behind the camera; the other one's gradient stays what it is."""
    R, t, R_gt, t_gt, points = (torch.tensor(x) for x in random_case(4, (2,)))
    t[1, 2] = -1
    inputs = [x.clone().requires_grad_() for x in (R, t, R_gt, t_gt, points)]
    alone = [x.clone().requires_grad_() for x in (R[0], t[0], R_gt[0], t_gt[0], points)]
    for function in (metrics.projection_2d, metrics.mspd):
        errors = function(K, *inputs)
        assert errors[1] == torch.inf
        gradients = torch.autograd.grad(errors[0], inputs)
        expected = torch.autograd.grad(function(K, *alone), alone)
        for gradient, other, x in zip(gradients, expected, inputs, strict=True):
            got = gradient[0] if x.ndim > other.ndim else gradient
            torch.testing.assert_close(got, other)


def test_no_rows_are_no_errors():
    empty = random_case(0, (0,))
    assert metrics.add_s(*empty[:4], np.ones((0, 5, 3))).shape == (0,)


def test_float32_stays_float32():
    case = [torch.tensor(x, dtype=torch.float32) for x in random_case(4, (2,))]
    assert metrics.add(*case).dtype == metrics.add_s(*case).dtype == torch.float32


EYE, ZERO, ONE = np.eye(3), np.zeros(3), np.array([0.0, 0, 1])
CLOUD = np.ones((4, 3))


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.add_s(EYE, ZERO, EYE, ZERO, CLOUD, direction="both"), "direction"),
        (lambda: metrics.mssd(EYE, ZERO, EYE, ZERO, CLOUD, np.ones((1, 4, 4))), "symmetries"),
        (lambda: metrics.mspd(K, EYE, ONE, EYE, -ONE * 3, CLOUD), "t_gt"),
        (lambda: metrics.mspd(K * 0, EYE, ONE, EYE, ONE, CLOUD), "K"),
        (lambda: metrics.projection_2d(K, EYE, ONE, EYE, -ONE * 3, CLOUD), "t_gt.*4 points"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


def turns(count):
    return np.stack([turn((0, 0, 1), k * 2 * np.pi / count) for k in range(count)])


@pytest.mark.slow
@settings(max_examples=20)
@given(seeds, st.sampled_from(["near", "far", "behind"]))
def test_the_best_of_many_motions_is_that_of_all(seed, where):
    """Not all motions see all points; what is left out could not be the best."""
    R_1, t_1, R_2, t_2, points = random_case(seed, (3,), points=900)
    points *= (1, 1, 0.2)
    symmetries = turns(60)
    if where == "near":
        R_1 = R_2 @ symmetries[7, :3, :3] @ turn((1, 2, 3), 0.1)[:3, :3]
        t_1 = t_2 + 0.01
    elif where == "behind":
        t_1[1, 2] = -1
    each = [(R_2 @ S[:3, :3], t_2 + R_2 @ S[:3, 3]) for S in symmetries]
    for function in (metrics.mssd, lambda *a: metrics.mspd(K, *a)):
        expected = np.min([function(R_1, t_1, R, t, points) for R, t in each], axis=0)
        got = function(R_1, t_1, R_2, t_2, points, symmetries)
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_gradients_at_the_best_motion():
    case = [torch.tensor(x) for x in random_case(4, (2,))]
    symmetries = torch.tensor(turns(12))
    for x in case[:4]:
        x.requires_grad_()
    assert torch.autograd.gradcheck(lambda *a: metrics.mssd(*a, symmetries), case)
    assert torch.autograd.gradcheck(lambda *a: metrics.mspd(K, *a, symmetries), case, rtol=1e-2)


def test_symmetries_broadcast_and_float32_stays():
    R_1, t_1, R_2, t_2, points = random_case(2, (3, 4))
    whole = metrics.mspd(K, R_1, t_1, R_2[0, 0], t_2[0, 0], points, FOURFOLD)
    one = metrics.mspd(K, R_1[2, 1], t_1[2, 1], R_2[0, 0], t_2[0, 0], points, FOURFOLD)
    assert whole.shape == (3, 4) and whole[2, 1] == pytest.approx(one, rel=1e-12)
    small = [torch.tensor(x, dtype=torch.float32) for x in (R_1, t_1, R_2, t_2, points, FOURFOLD)]
    assert metrics.mssd(*small).dtype == torch.float32
    assert metrics.mssd(R_1[:0], t_1[:0], R_2[:0], t_2[:0], points, FOURFOLD).shape == (0, 4)


def test_a_truth_behind_the_camera_is_refused_with_symmetries_too():
    with pytest.raises(ValueError, match=r"^t_gt: .* got 4 points behind it"):
        metrics.mspd(K, np.eye(3), [0, 0, 1], np.eye(3), [0, 0, -3], np.ones((4, 3)), FOURFOLD)


def test_add_s_of_distances_that_overflow():
    eye, points = np.eye(3), np.random.default_rng(0).normal(size=(5, 3))
    assert metrics.add_s(eye, [1e300, 0, 0], eye, [0, 0, 0], points) > 1e200
