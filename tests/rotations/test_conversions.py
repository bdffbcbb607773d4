"""Quaternions, rotation vectors and 6D against SciPy and RoMa, where formulas tend to break."""

from collections.abc import Callable

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from torch import Tensor

from posecore.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    matrix_to_axis_angle,
    matrix_to_quaternion,
    matrix_to_rotation_6d,
    quaternion_multiply,
    quaternion_to_axis_angle,
    quaternion_to_matrix,
    rotation_6d_to_matrix,
)

EPS = np.finfo(np.float64).eps
ROUNDING = 16 * EPS
AXES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [1, 1, 0], [0, -1, 1], [1, 1, 1], [-1, 2, -3]]
)
AXES = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
# Also angles at which a series takes over, and half turns from both sides.
ANGLES = np.array(
    [0, 1e-300, 1e-30, 1e-12, 1e-7, 1.9e-4, 2.1e-4, 3.9e-4, 4.1e-4, 1e-2, 0.1, 1, 2, 3, 0, 0, 0, 0]
)
ANGLES[-4:] = np.pi - np.array([1e-3, 1e-7, 1e-12, 0])
VECTORS = np.concatenate([(AXES[:, None] * ANGLES[:, None]).reshape(-1, 3), np.zeros((1, 3))])
HARD = Rotation.from_rotvec(VECTORS).as_matrix()
RANDOM = Rotation.random(200, random_state=0).as_matrix()
MATRICES = np.concatenate([HARD, RANDOM])

numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
seeds = st.integers(0, 10**6)


def same_rotation(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(q - p).max(-1), np.abs(q + p).max(-1))


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


# Quaternion and matrix ------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1, 1e-300, 1e-150, 0.3, 1e150, 1e300])
def test_quaternion_to_matrix_like_scipy_at_any_length(scale: float) -> None:
    rotation = Rotation.random(100, random_state=1)
    R = quaternion_to_matrix(scale * wxyz(rotation))
    assert np.abs(R - rotation.as_matrix()).max() < ROUNDING


def test_quaternion_to_matrix_like_roma() -> None:
    q = wxyz(Rotation.random(100, random_state=2))
    expected = roma.unitquat_to_rotmat(torch.from_numpy(np.roll(q, -1, axis=-1)))
    assert np.abs(quaternion_to_matrix(q) - expected.numpy()).max() < ROUNDING


@pytest.mark.parametrize("matrices", [HARD, RANDOM], ids=["hard", "random"])
def test_matrix_to_quaternion_like_scipy_and_roma(matrices: np.ndarray) -> None:
    q = matrix_to_quaternion(matrices)
    assert same_rotation(q, wxyz(Rotation.from_matrix(matrices))).max() < ROUNDING
    theirs = roma.rotmat_to_unitquat(torch.from_numpy(matrices)).roll(1, -1).numpy()
    assert same_rotation(q, theirs).max() < ROUNDING
    assert np.abs(quaternion_to_matrix(q) - matrices).max() < ROUNDING
    assert (q[:, 0] >= 0).all()


@pytest.mark.parametrize(
    ("diagonal", "expected"),
    [((1, -1, -1), (0, 1, 0, 0)), ((-1, 1, -1), (0, 0, 1, 0)), ((-1, -1, 1), (0, 0, 0, 1))],
)
def test_half_turns_about_the_axes(diagonal: tuple, expected: tuple) -> None:
    assert np.array_equal(matrix_to_quaternion(np.diag(diagonal)), expected)
    assert np.allclose(matrix_to_axis_angle(np.diag(diagonal)), np.pi * np.array(expected[1:]))


@pytest.mark.parametrize("axis", AXES)
def test_half_turns_have_one_sign(axis: np.ndarray) -> None:
    R = 2 * np.outer(axis, axis) - np.eye(3)  # exactly symmetric, so that w is exactly 0
    q = matrix_to_quaternion(R)
    expected = axis * np.sign(axis[np.flatnonzero(axis)[0]])
    assert q[0] == 0
    assert np.abs(q[1:] - expected).max() < ROUNDING
    assert np.abs(quaternion_to_axis_angle(np.array([0, *-axis])) - np.pi * expected).max() < 1e-15


def test_float32_is_as_exact_as_float32() -> None:
    R = MATRICES.astype(np.float32)
    q = matrix_to_quaternion(R)
    assert q.dtype == np.float32
    assert np.abs(quaternion_to_matrix(q) - R).max() < 16 * np.finfo(np.float32).eps


@given(hnp.arrays(float, 4, elements=numbers))
def test_quaternion_and_its_negative_are_one_rotation(q: np.ndarray) -> None:
    if not q.any():
        q[0] = 1
    R = quaternion_to_matrix(q)
    assert np.array_equal(R, quaternion_to_matrix(-q))
    assert np.abs(R @ R.T - np.eye(3)).max() < ROUNDING
    unit = q / np.abs(q).max()  # whose squares do not vanish
    assert same_rotation(matrix_to_quaternion(R), unit / np.linalg.norm(unit)) < ROUNDING


@given(seeds)
def test_product_is_one_rotation_after_the_other(seed: int) -> None:
    rotations = Rotation.random(2, random_state=seed)
    p, q = wxyz(rotations)
    product = quaternion_multiply(p, q)
    assert (
        np.abs(quaternion_to_matrix(product) - (rotations[0] * rotations[1]).as_matrix()).max()
        < ROUNDING
    )
    theirs = roma.quat_product(*torch.from_numpy(np.roll([p, q], -1, axis=-1)))
    assert np.abs(product - np.roll(theirs.numpy(), 1)).max() < ROUNDING
    conjugate = q * [1, -1, -1, -1]
    assert np.abs(quaternion_multiply(q, conjugate) - [1, 0, 0, 0]).max() < ROUNDING


def test_product_broadcasts() -> None:
    p, q = np.random.default_rng(3).normal(size=(2, 5, 4))
    assert np.array_equal(
        quaternion_multiply(p, q[0]), quaternion_multiply(p, np.tile(q[0], (5, 1)))
    )


# Axis-angle -----------------------------------------------------------------------------------


def test_axis_angle_to_matrix_like_scipy_and_roma() -> None:
    R = axis_angle_to_matrix(VECTORS)
    assert np.abs(R - HARD).max() < ROUNDING
    theirs = roma.rotvec_to_rotmat(torch.from_numpy(VECTORS)).numpy()
    assert np.abs(R - theirs).max() < 2 * ROUNDING


@pytest.mark.parametrize("angle", [1e-150, 1e-9, 0.9e-4, 1.9e-4, 2.1e-4, 3.9e-4, 4.1e-4, 1e-3])
def test_small_rotations_keep_their_digits(angle: float) -> None:
    q = axis_angle_to_quaternion(angle * AXES)
    assert np.abs(q[:, 1:] / angle - np.sin(angle / 2) / angle * AXES).max() < ROUNDING
    assert np.abs(quaternion_to_axis_angle(q) / angle - AXES).max() < ROUNDING
    R = axis_angle_to_matrix(angle * AXES)
    skew = (R[:, 2, 1] - R[:, 1, 2]) / 2
    assert np.abs(skew / angle - np.sin(angle) / angle * AXES[:, 0]).max() < ROUNDING


def test_matrix_to_axis_angle_like_scipy() -> None:
    v = matrix_to_axis_angle(MATRICES)
    theirs = Rotation.from_matrix(MATRICES).as_rotvec()
    away = np.linalg.norm(theirs, axis=1) < np.pi - 1e-9  # half turns have two
    assert np.abs(v - theirs)[away].max() < 4 * ROUNDING
    assert np.abs(axis_angle_to_matrix(v) - MATRICES).max() < ROUNDING
    assert (np.linalg.norm(v, axis=1) <= np.pi * (1 + ROUNDING)).all()


@pytest.mark.parametrize("turns", [1, 2, 1000])
def test_whole_turns_do_nothing(turns: int) -> None:
    longer = AXES * (0.7 + 2 * np.pi * turns)
    assert (
        np.abs(axis_angle_to_matrix(longer) - axis_angle_to_matrix(0.7 * AXES)).max()
        < turns * 1e-14
    )


@given(hnp.arrays(float, 3, elements=numbers))
def test_axis_angle_to_quaternion_is_cosine_and_sine_of_half(v: np.ndarray) -> None:
    angle = np.linalg.norm(v)
    sine = np.sin(angle / 2) * v / angle if angle > 0 else np.zeros(3)
    q = axis_angle_to_quaternion(v)
    assert np.abs(q - [np.cos(angle / 2), *sine]).max() < ROUNDING * (1 + angle)
    assert np.abs(np.linalg.norm(q) - 1) < ROUNDING


@given(hnp.arrays(float, 4, elements=numbers))
def test_quaternion_to_axis_angle_like_scipy(q: np.ndarray) -> None:
    if not q.any():
        q[0] = 1
    v = quaternion_to_axis_angle(q)
    assert np.array_equal(v, quaternion_to_axis_angle(-q))
    assert np.linalg.norm(v) <= np.pi * (1 + ROUNDING)
    unit = q / np.abs(q).max()  # first, as squares of tiny numbers are 0
    unit /= np.linalg.norm(unit)
    assert same_rotation(axis_angle_to_quaternion(v), unit) < ROUNDING
    theirs = Rotation.from_quat(unit, scalar_first=True).as_rotvec()
    if np.linalg.norm(theirs) < 3.14:
        assert np.abs(v - theirs).max() < 4 * ROUNDING


@given(hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8, allow_subnormal=False)))
def test_axis_angle_there_and_back(v: np.ndarray) -> None:
    assert np.abs(matrix_to_axis_angle(axis_angle_to_matrix(v)) - v).max() < 4 * ROUNDING


# Six numbers ----------------------------------------------------------------------------------


def test_6d_has_columns() -> None:
    R = RANDOM[0]
    assert np.array_equal(matrix_to_rotation_6d(R), [*R[:, 0], *R[:, 1]])
    assert (
        np.abs(rotation_6d_to_matrix(matrix_to_rotation_6d(MATRICES)) - MATRICES).max() < ROUNDING
    )


@given(st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_6d_there_and_back(seed: int, n: int) -> None:
    R = Rotation.random(n, rng=np.random.default_rng(seed)).as_matrix()
    six = matrix_to_rotation_6d(R)
    assert np.array_equal(six, np.concatenate([R[..., 0], R[..., 1]], axis=-1))
    assert np.abs(rotation_6d_to_matrix(six) - R).max(initial=0) < ROUNDING


def test_6d_like_roma() -> None:
    six = np.random.default_rng(4).normal(size=(100, 6))
    theirs = roma.special_gramschmidt(torch.from_numpy(six).reshape(-1, 2, 3).mT).numpy()
    assert np.abs(rotation_6d_to_matrix(six) - theirs).max() < 1e-13


@given(
    hnp.arrays(float, 6, elements=st.floats(-1, 1, allow_subnormal=False)),
    st.sampled_from([1e-300, 1e-20, 1.0, 1e20, 1e300]),
)
def test_6d_keeps_the_first_and_the_side_of_the_second(six: np.ndarray, scale: float) -> None:
    first, second = six[:3], six[3:]
    if np.linalg.norm(np.cross(first, second)) < 1e-6:
        first[:], second[:] = [0, 1, 0], [0, 1, 1]
    R = rotation_6d_to_matrix(scale * six)
    assert np.abs(R.T @ R - np.eye(3)).max() < ROUNDING
    assert np.linalg.det(R) > 0
    assert np.abs(R[:, 0] - first / np.linalg.norm(first)).max() < ROUNDING
    assert R[:, 1] @ second > 0
    assert abs(R[:, 2] @ second) < ROUNDING / np.linalg.norm(np.cross(first, second))


@pytest.mark.parametrize("slant", [1e-3, 1e-7, 1e-12, 1e-13])
def test_6d_of_nearly_parallel_vectors_is_a_rotation(slant: float) -> None:
    R = rotation_6d_to_matrix(np.array([1, 2, 3, 1, 2, 3 + slant]))
    assert np.abs(R.T @ R - np.eye(3)).max() < ROUNDING


# Gradients ------------------------------------------------------------------------------------

POINTS = {
    quaternion_to_matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0.1, 0.2, -3, 0.4], [0, 0, 0, -2e-3]],
    quaternion_to_axis_angle: [
        [1, 0, 0, 0], [-2, 1e-9, 0, 0], [1, 0.9e-4, 0, 0], [1, 1.1e-4, 0, 0], [0.1, 0.2, 3, 0.4]
    ],
    axis_angle_to_quaternion: [[0, 0, 0], [1e-9, 0, 0], [1e-4, 2e-4, 0], [0, np.pi, 0], [1, 2, 30]],
    axis_angle_to_matrix: [[0, 0, 0], [1e-9, 0, 0], [1e-4, 2e-4, 0], [0, np.pi, 0], [1, 2, 30]],
    rotation_6d_to_matrix: [[1, 0, 0, 0, 1, 0], [1, 2, 3, 3, 2, 1], [0, 0, -2, 1e-2, 0, 1]],
}  # fmt: skip


@pytest.mark.parametrize("function", POINTS, ids=lambda f: f.__name__)
def test_derivatives_are_those_of_finite_differences(function: Callable) -> None:
    x = torch.tensor(POINTS[function], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, x, eps=1e-6, atol=1e-6, rtol=1e-5)
    if len(x[0]) == 3:
        assert torch.autograd.gradgradcheck(function, x[:3], eps=1e-6, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("function", [matrix_to_quaternion, matrix_to_axis_angle])
def test_derivatives_of_a_matrix_are_those_along_the_group(function: Callable) -> None:
    # Off the group the formulas are free; along it the derivative is unique away from half turns.
    R = torch.from_numpy(np.concatenate([HARD[: len(ANGLES) - 4], RANDOM[:10]]))
    R = R[(R.diagonal(dim1=1, dim2=2).sum(1) > -0.98)]

    def along(omega: Tensor) -> Tensor:
        return function(R @ axis_angle_to_matrix(omega))

    omega = torch.zeros(len(R), 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(along, omega, eps=1e-6, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize(
    "function", [matrix_to_quaternion, matrix_to_axis_angle, matrix_to_rotation_6d]
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_everywhere(function: Callable, dtype: torch.dtype) -> None:
    R = torch.from_numpy(MATRICES).to(dtype).requires_grad_()
    out = function(R)
    (grad,) = torch.autograd.grad((out * torch.arange(1, out.shape[-1] + 1)).sum(), R)
    assert torch.isfinite(grad).all()
    assert grad.abs().max() < 10


def test_quaternion_gradient_is_finite_at_half_turns() -> None:
    q = torch.tensor([[0.0, 1, 0, 0], [0, 0, 0, 1], [-0.0, 0.6, -0.8, 0]], requires_grad=True)
    (grad,) = torch.autograd.grad(quaternion_to_axis_angle(q).sum(), q)
    assert torch.isfinite(grad).all()


# Bad input ------------------------------------------------------------------------------------

NO_ROTATION = np.diag([1, 1, 1.01])
BAD = [
    (lambda: quaternion_to_matrix([0, 0, 0, 0]), "q: .*not zero"),
    (lambda: quaternion_to_matrix([[1, 0, 0, 0], [0, 0, 0, 0]]), r"q: .*index \(1,\)"),
    (lambda: quaternion_to_axis_angle(np.zeros(4)), "q: .*not zero"),
    (lambda: quaternion_to_axis_angle(torch.zeros(2, 4)), r"q: .*index \(0,\)"),
    (lambda: axis_angle_to_matrix([1e200, 0, 0]), "axis_angle: .*finite"),
    (lambda: axis_angle_to_quaternion(torch.tensor([1e30, 0, 0])), "axis_angle: .*finite"),
    (lambda: matrix_to_quaternion(NO_ROTATION), "R: .*rotation"),
    (lambda: matrix_to_quaternion(-np.eye(3)), "R: .*determinant -1"),
    (lambda: matrix_to_axis_angle(NO_ROTATION), "R: .*special_procrustes"),
    (lambda: matrix_to_rotation_6d(np.stack([np.eye(3), NO_ROTATION])), r"R: .*index \(1,\)"),
    (lambda: rotation_6d_to_matrix(np.zeros(6)), "columns: .*not zero"),
    (lambda: rotation_6d_to_matrix([1, 2, 3, 0, 0, 0]), "columns: .*not zero"),
    (lambda: rotation_6d_to_matrix([1, 2, 3, 2, 4, 6]), "columns: .*not parallel"),
    (lambda: rotation_6d_to_matrix([[1, 0, 0, 0, 1, 0], [1, 2, 0, -1, -2, 0]]), r"columns: .*\(1,"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "complaint"), BAD)
def test_bad_input(call: Callable, complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + complaint):
        call()
