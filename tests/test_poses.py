"""Poses against products and inverses of 4 x 4 matrices."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from posecore import poses

seeds = st.integers(0, 10**6)


def random_poses(seed: int, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(int(np.prod(batch)), rng=rng).as_matrix().reshape(*batch, 3, 3)
    return R, rng.uniform(-2, 2, size=(*batch, 3))


def matrix(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The 4 x 4 matrix of one pose, entry by entry."""
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]
        T[i, 3] = t[i]
    return T


def close(a: tuple, b: np.ndarray) -> bool:
    """A pose or a matrix like this 4 x 4 matrix, to rounding."""
    return np.abs(matrix(*a) - b).max() < 1e-14


@given(seeds)
def test_to_matrix_and_back(seed: int) -> None:
    R, t = random_poses(seed, 2, 3)
    T = poses.to_matrix(R, t)
    assert np.array_equal(T[1, 2], matrix(R[1, 2], t[1, 2]))
    R_back, t_back = poses.from_matrix(T)
    assert np.array_equal(R_back, R)
    assert np.array_equal(t_back, t)


@given(seeds)
def test_apply_with_a_scale_is_a_similarity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, t = rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    R, scale = Rotation.random(5, rng=rng).as_matrix(), rng.uniform(0.1, 3, 5)
    moved = poses.apply(R, t, points, scale)
    expected = [[s * r @ x + v for x in points] for s, r, v in zip(scale, R, t, strict=True)]
    assert np.abs(moved - np.array(expected)).max() < 1e-13
    assert poses.apply(R[0].astype("f4"), t[0].astype("f4"), points.astype("f4"), 2.0).dtype == "f4"


@given(seeds)
def test_apply_is_the_product_with_homogeneous_points(seed: int) -> None:
    R, t = random_poses(seed, 2)
    points = np.random.default_rng(seed).normal(size=(2, 5, 3))
    moved = poses.apply(R, t, points)
    for b in range(2):
        for n in range(5):
            expected = matrix(R[b], t[b]) @ [*points[b, n], 1]
            assert np.abs(moved[b, n] - expected[:3]).max() < 1e-14


@given(seeds)
def test_compose_is_the_product(seed: int) -> None:
    R, t = random_poses(seed, 2)
    composed = poses.compose(R[0], t[0], R[1], t[1])
    assert close(composed, matrix(R[0], t[0]) @ matrix(R[1], t[1]))


@given(seeds)
def test_invert_is_the_inverse(seed: int) -> None:
    R, t = random_poses(seed)
    assert close(poses.invert(R, t), np.linalg.inv(matrix(R, t)))


@given(seeds)
def test_relative_is_the_inverse_of_the_first_times_the_second(seed: int) -> None:
    R, t = random_poses(seed, 2)
    step = poses.relative(R[0], t[0], R[1], t[1])
    assert close(step, np.linalg.inv(matrix(R[0], t[0])) @ matrix(R[1], t[1]))
    assert close(poses.compose(R[0], t[0], *step), matrix(R[1], t[1]))


@given(seeds)
def test_laws_of_the_group(seed: int) -> None:
    (a, b, c) = zip(*random_poses(seed, 3), strict=True)
    identity = (np.eye(3), np.zeros(3))
    left = poses.compose(*poses.compose(*a, *b), *c)
    assert close(left, matrix(*poses.compose(*a, *poses.compose(*b, *c))))
    assert close(poses.compose(*a, *poses.invert(*a)), np.eye(4))
    assert close(poses.compose(*identity, *a), matrix(*a))
    assert close(poses.invert(*poses.invert(*a)), matrix(*a))
    assert close(poses.relative(*identity, *a), matrix(*a))


@given(seeds)
def test_one_after_the_other_is_the_composition(seed: int) -> None:
    (a, b) = zip(*random_poses(seed, 2), strict=True)
    points = np.random.default_rng(seed).normal(size=(4, 3))
    one_by_one = poses.apply(*a, poses.apply(*b, points))
    assert np.abs(one_by_one - poses.apply(*poses.compose(*a, *b), points)).max() < 1e-13
    assert np.abs(poses.apply(*poses.invert(*a), poses.apply(*a, points)) - points).max() < 1e-13
    lengths = np.linalg.norm(points[1:] - points[0], axis=1)
    moved = poses.apply(*a, points)
    assert np.abs(np.linalg.norm(moved[1:] - moved[0], axis=1) - lengths).max() < 1e-13


def test_a_known_pose() -> None:
    # A quarter turn about z, then 1 m along x.
    R, t = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 0, 0]
    assert poses.apply(R, t, [[1, 0, 0], [0, 2, 0]]).tolist() == [[1, 1, 0], [-1, 0, 0]]
    R_inv, t_inv = poses.invert(R, t)
    assert R_inv.tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert t_inv.tolist() == [0, 1, 0]


def test_any_matrix_may_move_points() -> None:
    # Published ground truth may be off; a pose is applied as it is.
    R = 1.01 * np.eye(3)
    assert poses.apply(R, np.zeros(3), np.ones((1, 3))).tolist() == [[1.01, 1.01, 1.01]]
    assert poses.compose(R, np.zeros(3), R, np.ones(3))[1].tolist() == [1.01, 1.01, 1.01]


FUNCTIONS = [
    lambda R, t: poses.apply(R, t, t[..., None, :]),
    lambda R, t: poses.compose(R, t, R, t),
    poses.invert,
    lambda R, t: poses.relative(R, t, R, t),
    poses.to_matrix,
    lambda R, t: poses.from_matrix(poses.to_matrix(R, t)),
]


def flat(result: object) -> list:
    return list(result) if isinstance(result, tuple) else [result]


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arrays_and_tensors_give_the_same(function: Callable, dtype: type) -> None:
    R, t = (part.astype(dtype) for part in random_poses(0, 4))
    arrays = flat(function(R, t))
    tensors = flat(function(torch.from_numpy(R), torch.from_numpy(t)))
    for array, tensor in zip(arrays, tensors, strict=True):
        assert isinstance(array, np.ndarray)
        assert isinstance(tensor, torch.Tensor)
        assert array.dtype == dtype
        assert np.array_equal(array, tensor.numpy())


@pytest.mark.parametrize("function", FUNCTIONS)
def test_lists_are_float64_arrays(function: Callable) -> None:
    R, t = random_poses(1)

    class Listed(list):
        """A list that can still be indexed as the functions above need."""

        def __getitem__(self, index: object) -> object:
            return np.asarray(self)[index]

    for array in flat(function(Listed(R.tolist()), Listed(t.tolist()))):
        assert isinstance(array, np.ndarray)
        assert array.dtype == np.float64


def test_precision_is_that_of_the_widest_argument() -> None:
    R, t = random_poses(2)
    points = np.ones((2, 3), np.float32)
    assert poses.apply(R, t, points).dtype == np.float64
    assert poses.apply(R.astype(np.float32), t.astype(np.float32), points).dtype == np.float32
    mixed = poses.apply(torch.from_numpy(R).float(), t, points)
    assert isinstance(mixed, torch.Tensor)
    assert mixed.dtype == torch.float64


def test_batches_broadcast() -> None:
    R, t = random_poses(3, 4)
    points = np.random.default_rng(3).normal(size=(6, 3))
    moved = poses.apply(R, t, points)
    assert moved.shape == (4, 6, 3)
    # Not to the bit: how products are added up depends on the machine and on the number of rows.
    assert np.allclose(moved[2], poses.apply(R[2], t[2], points), rtol=0, atol=1e-14)
    R_ac, t_ac = poses.compose(R[:, None], t[:, None], R, t)
    assert R_ac.shape == (4, 4, 3, 3)
    assert np.allclose(t_ac[1, 2], R[1] @ t[2] + t[1], rtol=0, atol=1e-15)
    assert poses.to_matrix(R, t[0]).shape == (4, 4, 4)
    assert poses.to_matrix(R[0], t).shape == (4, 4, 4)
    assert poses.apply(R[:0], t[:0], points).shape == (0, 6, 3)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_gradients_are_those_of_finite_differences(function: Callable) -> None:
    R, t = (torch.from_numpy(part).requires_grad_() for part in random_poses(4, 2))
    assert torch.autograd.gradcheck(function, (R, t))


def test_the_arguments_are_left_as_they_were() -> None:
    R, t = random_poses(5, 3)
    before = R.copy(), t.copy()
    for function in FUNCTIONS:
        function(R, t)
    assert np.array_equal(R, before[0])
    assert np.array_equal(t, before[1])


R0, T0 = np.eye(3), np.zeros(3)
LAST_ROW = np.eye(4)
LAST_ROW[3, 3] = 2
BAD = [
    (lambda: poses.invert(1.01 * R0, T0), "R: .*special_procrustes"),
    (lambda: poses.invert(-R0, T0), "R: .*determinant -1"),
    (lambda: poses.invert(np.zeros((3, 3)), T0), "R: .*determinant 0"),
    (lambda: poses.relative(1.01 * R0, T0, R0, T0), "R_1: .*rotation"),
    (lambda: poses.from_matrix(LAST_ROW), r"T: .*\[0.0, 0.0, 0.0, 2.0\]"),
    (lambda: poses.from_matrix(np.stack([np.eye(4), np.ones((4, 4))])), "T: .*last row"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "complaint"), BAD)
def test_bad_input(call: Callable, complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + complaint):
        call()


# Twists -------------------------------------------------------------------------------------------


def hat_4(twist: np.ndarray) -> np.ndarray:
    """The 4 x 4 matrix whose exponential is the pose; the translation's three numbers are first."""
    v, (a, b, c) = twist[:3], twist[3:]
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -c, b], [c, 0, -a], [-b, a, 0]]
    matrix[:3, 3] = v
    return matrix


def twists(seed: int, angle: float) -> np.ndarray:
    v, w = np.random.default_rng(seed).normal(size=(2, 3))
    return np.array([*v, *(angle * w / np.linalg.norm(w))])


ANGLES = [0, 1e-200, 1e-12, 1e-6, 1e-3, 0.5, 0.999, 1.001, 2.0, 3.0, math.pi - 1e-9]


@given(seeds, st.sampled_from([*ANGLES, 4.0, 2 * math.pi, 50.0]))
def test_the_exponential_is_that_of_the_matrix(seed: int, angle: float) -> None:
    twist = twists(seed, angle)
    np.testing.assert_allclose(
        poses.to_matrix(*poses.se3_exp(twist)), expm(hat_4(twist)), rtol=0, atol=3e-14 * (1 + angle)
    )


@given(seeds, st.sampled_from(ANGLES))
def test_the_logarithm_undoes_it(seed: int, angle: float) -> None:
    twist = twists(seed, angle)
    back = poses.se3_log(*poses.se3_exp(twist))
    np.testing.assert_allclose(back, twist, rtol=0, atol=2e-14)


@given(seeds)
def test_half_turns_and_all_poses_come_back(seed: int) -> None:
    R, t = random_poses(seed, 4)
    axis = R[0, 0]
    R[3] = 2 * np.outer(axis, axis) - np.eye(3)
    twist = poses.se3_log(R, t)
    assert (np.linalg.norm(twist[:, 3:], axis=-1) < math.pi + 1e-14).all()
    R_back, t_back = poses.se3_exp(twist)
    np.testing.assert_allclose(R_back, R, rtol=0, atol=1e-14)
    np.testing.assert_allclose(t_back, t, rtol=0, atol=1e-14)


def test_a_screw_by_hand() -> None:
    """A quarter turn about z while moving along x goes along a quarter of a circle."""
    length = math.pi / 2  # so the circle has the radius 1
    R, t = poses.se3_exp([length, 0, 0.5, 0, 0, math.pi / 2])
    np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(t, [1, 1, 0.5], atol=1e-15)
    R, t = poses.se3_exp([1, 2, 3, 0, 0, 0])
    assert np.array_equal(R, np.eye(3)) and t.tolist() == [1, 2, 3]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_twists_are_as_exact_as_their_numbers(dtype: type) -> None:
    """Where (a - sin a) / a^3 of the formula as it is written has no digit left."""
    for angle in np.geomspace(1e-6, 3.1, 30):
        exact = twists(1, angle)
        R, t = poses.se3_exp(exact.astype(dtype))
        T = expm(hat_4(exact.astype(dtype).astype(float)))
        assert np.abs(t - T[:3, 3]).max() < 8 * np.finfo(dtype).eps
        back = poses.se3_log(R, t)
        assert back.dtype == dtype
        assert np.abs(back - exact).max() < 100 * np.finfo(dtype).eps


def test_twists_have_gradients() -> None:
    twist = torch.from_numpy(np.stack([twists(i, a) for i, a in enumerate((0.01, 0.9, 1.1, 3))]))
    assert torch.autograd.gradcheck(poses.se3_exp, twist.requires_grad_())
    there_and_back = torch.autograd.functional.jacobian(
        lambda x: poses.se3_log(*poses.se3_exp(x)), twist[3].detach()
    )
    np.testing.assert_allclose(there_and_back, np.eye(6), rtol=0, atol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-9, math.pi - 1e-9, math.pi, 2 * math.pi])
def test_their_gradients_are_finite_at_zero_and_at_half_turns(angle: float) -> None:
    twist = torch.tensor([1.0, 2, 3, angle, 0, 0], dtype=torch.float64, requires_grad=True)
    R, t = poses.se3_exp(twist)
    (gradient,) = torch.autograd.grad(R.sum() + t.square().sum(), twist)
    assert gradient.isfinite().all()
    R, t = (x.detach().requires_grad_() for x in (R, t))
    for gradient in torch.autograd.grad(poses.se3_log(R, t).square().sum(), (R, t)):
        assert gradient.isfinite().all()


@pytest.mark.parametrize("twist", [[0, 0, 0, 1e160, 0, 0], [1e308, -1e308, 1e308, 3, 3, 3]])
def test_twists_that_are_too_large(twist: list[float]) -> None:
    with pytest.raises(ValueError, match="^twist: expected "):
        poses.se3_exp(twist)


def test_a_logarithm_of_no_rotation() -> None:
    with pytest.raises(ValueError, match="^R: expected rotation matrices"):
        poses.se3_log(2 * np.eye(3), np.zeros(3))
