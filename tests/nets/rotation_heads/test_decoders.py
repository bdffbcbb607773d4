"""Decoders: like the functions of rotations where those answer, and an answer everywhere else."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from posecore.nets.rotation_heads import (
    decode_6d,
    decode_axis_angle,
    decode_euler,
    decode_procrustes,
    decode_quaternion,
)
from posecore.nets.rotation_heads.decoders import full_precision

DECODERS = {
    decode_quaternion: 4,
    decode_6d: 6,
    decode_procrustes: 9,
    decode_axis_angle: 3,
    decode_euler: 3,
}
DTYPES = [torch.float32, torch.float64]
EPS = {dtype: torch.finfo(dtype).eps for dtype in DTYPES}
each_decoder = pytest.mark.parametrize("decode", DECODERS)
each_dtype = pytest.mark.parametrize("dtype", DTYPES)


def off(R: torch.Tensor) -> float:
    """How far from a rotation."""
    R = R.detach().double()
    defect = (R @ R.mT - torch.eye(3)).abs().max()
    return max(float(defect), float((torch.linalg.det(R) - 1).abs().max()))


def outputs(n: int, dtype: torch.dtype) -> torch.Tensor:
    """Random outputs, those of few different numbers, and of all sizes that the type has."""
    generator = torch.Generator().manual_seed(n)
    few = torch.randint(-1, 2, (400, n), generator=generator).double()
    many = torch.randn(400, n, generator=generator, dtype=torch.float64)
    mixed = torch.cat([few, many, many.round(), few + 1e-9 * many, torch.zeros(1, n)])
    number = torch.finfo(dtype)
    sizes = [1, 1e-3, 1e6, number.tiny, number.tiny / number.eps**2, number.max / 10]
    sizes += [1e19, 1e-20, 0.1 / number.eps]
    return torch.cat([mixed * size for size in sizes]).to(dtype)


@each_decoder
@each_dtype
def test_whatever_comes_is_a_rotation_with_a_finite_gradient(decode: Callable, dtype) -> None:
    x = outputs(DECODERS[decode], dtype).requires_grad_()
    R = decode(x)
    assert R.dtype == dtype and R.shape == (len(x), 3, 3)
    assert off(R) < 32 * EPS[dtype]
    weights = torch.arange(9.0, dtype=dtype).reshape(3, 3).sin()
    (grad,) = torch.autograd.grad((R * weights).sum(), x)
    assert torch.isfinite(grad).all()


@each_decoder
@each_dtype
def test_zeros_are_the_identity(decode: Callable, dtype) -> None:
    x = torch.zeros(2, DECODERS[decode], dtype=dtype)
    assert torch.equal(decode(x), torch.eye(3, dtype=dtype).expand(2, 3, 3))


@pytest.mark.parametrize(
    ("decode", "oracle"),
    [
        (decode_quaternion, lambda x: Rotation.from_quat(x, scalar_first=True)),
        (decode_axis_angle, Rotation.from_rotvec),
        (decode_euler, lambda x: Rotation.from_euler("YXZ", x)),
    ],
)
def test_like_scipy(decode: Callable, oracle: Callable) -> None:
    x = np.random.default_rng(0).normal(size=(100, DECODERS[decode]))
    assert np.abs(decode(x) - oracle(x).as_matrix()).max() < 16 * EPS[torch.float64]


def test_6d_is_the_q_of_a_qr_decomposition() -> None:
    x = np.random.default_rng(0).normal(size=(100, 6))
    Q, triangle = np.linalg.qr(x.reshape(100, 2, 3).swapaxes(1, 2))
    columns = Q * np.sign(np.diagonal(triangle, axis1=1, axis2=2))[:, None]
    R = decode_6d(x)
    assert np.abs(R[:, :, :2] - columns).max() < 1e-13
    assert np.abs(np.linalg.det(R) - 1).max() < 1e-14


def test_procrustes_is_nearer_than_any_other_rotation() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(50, 9))
    M = x.reshape(50, 1, 3, 3)
    others = Rotation.random(2000, random_state=0).as_matrix()
    found = np.linalg.norm(decode_procrustes(x)[:, None] - M, axis=(2, 3))
    assert (found <= np.linalg.norm(others - M, axis=(2, 3)) + 1e-12).all()


@pytest.mark.parametrize("decode", [decode_quaternion, decode_6d, decode_procrustes])
def test_the_size_of_the_outputs_does_not_count(decode: Callable) -> None:
    x = torch.randn(100, DECODERS[decode], generator=torch.Generator().manual_seed(0))
    R = decode(x.double())
    for size in (1e-20, 1e-3, 7, 1e30):
        assert (decode(x * size) - R).abs().max() < 64 * EPS[torch.float32]


def test_a_quaternion_and_its_negative_are_one_rotation() -> None:
    q = torch.randn(100, 4, generator=torch.Generator().manual_seed(0))
    assert torch.equal(decode_quaternion(q), decode_quaternion(-q))


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ([0, 0, 0, 0, 5, 0], [[1, 0, 0], [0, 1, 0]]),  # a first that is zero is x
        ([0, 0, 0, 3, 0, 0], [[1, 0, 0], [0, 1, 0]]),
        ([0, 0, 0, 1, 0, -2], [[1, 0, 0], [0, 0, -1]]),
        ([0, 7, 0, 0, 0, 0], [[0, 1, 0], [1, 0, 0]]),  # a second that is zero is the farthest axis
        ([2, 0, 0, -3, 0, 0], [[1, 0, 0], [0, 1, 0]]),  # as is one that is parallel
        ([0, 0, 4, 0, 0, 4], [[0, 0, 1], [1, 0, 0]]),
    ],
)
def test_6d_without_an_answer_of_its_own(columns: list, expected: list) -> None:
    x = torch.tensor(columns, dtype=torch.float64, requires_grad=True)
    R = decode_6d(x)
    assert torch.equal(R[:, :2].T, torch.tensor(expected, dtype=torch.float64))
    (grad,) = torch.autograd.grad(R.sum(), x)
    assert torch.isfinite(grad).all()


def test_angles_without_digits_are_clipped() -> None:
    x = torch.tensor([3e38, 0, 0], requires_grad=True)
    R = decode_axis_angle(x)
    assert torch.equal(R, decode_axis_angle(torch.tensor([2.0**23, 0, 0])))
    assert torch.equal(torch.autograd.grad(R.sum(), x)[0][:1], torch.zeros(1))


@each_decoder
def test_derivatives_are_those_of_finite_differences(decode: Callable) -> None:
    x = torch.randn(
        5, DECODERS[decode], dtype=torch.float64, generator=torch.Generator().manual_seed(3)
    )
    assert torch.autograd.gradcheck(decode, x.requires_grad_())


@each_decoder
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_is_decoded_in_full(decode: Callable, dtype) -> None:
    x = torch.randn(50, DECODERS[decode], generator=torch.Generator().manual_seed(0)).to(dtype)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        R = decode(x)
    assert R.dtype == torch.float32
    assert torch.equal(R, decode(x.float()))
    assert off(R) < 16 * EPS[torch.float32]
    assert full_precision(x).dtype == torch.float32
    assert full_precision(x.double()).dtype == torch.float64


@given(st.data(), st.sampled_from(list(DECODERS)))
def test_any_finite_numbers_are_a_rotation(data: st.DataObject, decode: Callable) -> None:
    x = data.draw(hnp.arrays(float, DECODERS[decode], elements=st.floats(-1e308, 1e308)))
    assert off(torch.from_numpy(decode(x))) < 32 * EPS[torch.float64]


@given(hnp.arrays(np.float32, 6, elements=st.sampled_from([0, 1, -1, 1e-7, 1e-30, 1e30, 1e-40])))
def test_6d_of_numbers_of_very_different_size(x: np.ndarray) -> None:
    leaf = torch.from_numpy(x).requires_grad_()
    R = decode_6d(leaf)
    assert off(R.detach()) < 32 * EPS[torch.float32]
    (grad,) = torch.autograd.grad((R * torch.arange(9.0).reshape(3, 3)).sum(), leaf)
    assert torch.isfinite(grad).all()
