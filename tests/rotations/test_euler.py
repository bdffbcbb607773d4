"""Euler angles of all conventions against SciPy, at gimbal lock too."""

import itertools
import warnings
from collections.abc import Callable

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from posecore.rotations import euler_to_matrix, matrix_to_euler

LOWER = [
    "".join(axes)
    for axes in itertools.product("xyz", repeat=3)
    if axes[0] != axes[1] and axes[1] != axes[2]
]
CONVENTIONS = LOWER + [convention.upper() for convention in LOWER]
RANDOM = Rotation.random(100, random_state=0).as_matrix()
ROUNDING = 16 * np.finfo(np.float64).eps

conventions = st.sampled_from(CONVENTIONS)
angles3 = hnp.arrays(float, 3, elements=st.floats(-10, 10, allow_subnormal=False))


def locks(convention: str) -> list[float]:
    """The two second angles at which the first and third cannot be told apart."""
    return [0, np.pi] if convention[0] == convention[2] else [-np.pi / 2, np.pi / 2]


def test_there_are_twelve_of_each_kind() -> None:
    assert len(LOWER) == 12
    assert len(set(CONVENTIONS)) == 24


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_like_scipy(convention: str) -> None:
    angles = np.random.default_rng(1).uniform(-7, 7, size=(100, 3))
    expected = Rotation.from_euler(convention, angles).as_matrix()
    assert np.abs(euler_to_matrix(angles, convention) - expected).max() < ROUNDING
    theirs = Rotation.from_matrix(RANDOM).as_euler(convention)
    difference = matrix_to_euler(RANDOM, convention) - theirs
    # Near lock the first and third angle have fewer digits; the matrix has them all (see below).
    assert np.abs(np.sin(difference / 2)).max() < 1e-13


@pytest.mark.parametrize("convention", ["YXZ", "zyx", "ZXZ"])
def test_like_roma(convention: str) -> None:
    angles = np.random.default_rng(2).uniform(-3, 3, size=(3, 50))
    expected = roma.euler_to_rotmat(convention, list(torch.from_numpy(angles))).numpy()
    assert np.abs(euler_to_matrix(angles.T, convention) - expected).max() < ROUNDING


def test_head_angles_are_yaw_pitch_roll() -> None:
    yaw, pitch, roll = 0.3, -0.2, 0.1
    R = (
        Rotation.from_rotvec([0, yaw, 0])
        * Rotation.from_rotvec([pitch, 0, 0])
        * Rotation.from_rotvec([0, 0, roll])
    ).as_matrix()
    assert np.abs(euler_to_matrix([yaw, pitch, roll]) - R).max() < ROUNDING
    assert np.abs(matrix_to_euler(R) - [yaw, pitch, roll]).max() < ROUNDING


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("end", [0, 1])
def test_at_gimbal_lock_the_third_is_zero_and_the_matrix_is_kept(convention: str, end: int) -> None:
    first, third = np.random.default_rng(3).uniform(-3, 3, size=(2, 50))
    angles = np.stack([first, np.full(50, locks(convention)[end]), third], -1)
    R = euler_to_matrix(angles, convention)
    found = matrix_to_euler(R, convention)
    assert np.array_equal(found[:, 2], np.zeros(50))
    assert np.abs(found[:, 1] - angles[:, 1]).max() < ROUNDING
    assert np.abs(euler_to_matrix(found, convention) - R).max() < ROUNDING
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns of the lock
        theirs = Rotation.from_matrix(R).as_euler(convention)
    assert np.abs(np.sin((found - theirs) / 2)).max() < ROUNDING


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_near_gimbal_lock_the_matrix_is_kept(convention: str, dtype: type) -> None:
    distance = np.concatenate([10.0 ** -np.arange(1, 18), -(10.0 ** -np.arange(1, 18))])
    for lock in locks(convention):
        angles = np.stack([np.full(34, 0.4), lock + distance, np.full(34, -1.9)], -1)
        R = euler_to_matrix(angles, convention).astype(dtype)
        found = matrix_to_euler(R, convention)
        back = euler_to_matrix(found.astype(np.float64), convention)
        assert np.abs(back - R).max() < 32 * np.finfo(dtype).eps


@given(angles3, conventions)
def test_there_and_back_and_in_range(angles: np.ndarray, convention: str) -> None:
    R = euler_to_matrix(angles, convention)
    assert np.abs(R @ R.T - np.eye(3)).max() < ROUNDING
    found = matrix_to_euler(R, convention)
    assert np.abs(euler_to_matrix(found, convention) - R).max() < 2 * ROUNDING
    low, high = locks(convention)
    assert low - ROUNDING <= found[1] <= high + ROUNDING
    assert (np.abs(found[[0, 2]]) <= np.pi + ROUNDING).all()


@given(angles3, conventions)
def test_extrinsic_is_intrinsic_backwards(angles: np.ndarray, convention: str) -> None:
    backwards = convention[::-1].swapcase()
    R = euler_to_matrix(angles, convention)
    assert np.abs(R - euler_to_matrix(angles[::-1], backwards)).max() < ROUNDING


@pytest.mark.parametrize("convention", ["YXZ", "xyz", "ZXZ", "yzy"])
def test_derivatives_are_those_of_finite_differences(convention: str) -> None:
    second = np.mean(locks(convention)) + 0.3
    angles = torch.tensor(
        [[0.1, second, -2], [3, second, 0.4]], dtype=torch.float64, requires_grad=True
    )
    assert torch.autograd.gradcheck(lambda a: euler_to_matrix(a, convention), angles)
    there_and_back = lambda a: matrix_to_euler(euler_to_matrix(a, convention), convention)  # noqa: E731
    assert torch.autograd.gradcheck(there_and_back, angles)
    assert (there_and_back(angles) - angles).abs().max() < 1e-14


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_lock(convention: str, dtype: torch.dtype) -> None:
    exact = [np.eye(3), np.diag([1, -1, -1]), np.diag([-1, 1, -1]), np.diag([-1, -1, 1])]
    turned = [
        euler_to_matrix([a, lock, 0], convention) for a in (0.7, -2) for lock in locks(convention)
    ]
    R = torch.from_numpy(np.stack(exact + turned)).to(dtype).requires_grad_()
    out = matrix_to_euler(R, convention)
    (grad,) = torch.autograd.grad((out * torch.tensor([1.0, 2, 3])).sum(), R)
    assert torch.isfinite(grad).all()


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
def test_any_batch(batch: tuple) -> None:
    R = RANDOM[: int(np.prod(batch))].reshape(*batch, 3, 3)
    angles = matrix_to_euler(R)
    assert angles.shape == (*batch, 3)
    assert np.abs(euler_to_matrix(angles) - R).max(initial=0) < ROUNDING
    assert torch.equal(matrix_to_euler(torch.from_numpy(R)), torch.from_numpy(angles))
    assert matrix_to_euler(R.astype(np.float32)).dtype == np.float32


BAD = [
    *[
        (lambda c=c: euler_to_matrix(np.zeros(3), c), "convention")
        for c in ("", "XY", "XYZX", "XXY", "XYY", "XyZ", "abc", "123", "XY ", None, 7, ["X", "Y"])
    ],
    (lambda: matrix_to_euler(np.eye(3), "xxz"), "convention"),
    (lambda: matrix_to_euler(np.eye(3), "Zyx"), "convention"),
    (lambda: matrix_to_euler(2 * np.eye(3)), "R"),
    (lambda: matrix_to_euler(np.diag([1, 1, -1])), "R"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "name"), BAD)
def test_bad_input(call: Callable, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected .*, got "):
        call()
