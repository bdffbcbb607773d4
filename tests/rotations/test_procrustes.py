"""The nearest rotation and its derivative, on every kind of matrix that could be trouble."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from torch import Tensor

from posecore.rotations import procrustes, special_procrustes

N = 40
U = torch.from_numpy(Rotation.random(N, random_state=1).as_matrix())
V = torch.from_numpy(Rotation.random(N, random_state=2).as_matrix())
NOISE = torch.randn(N, 3, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def with_values(*values: float) -> Tensor:
    """Matrices of given singular values; a negative last one makes their determinant negative."""
    return U * torch.tensor(values, dtype=torch.float64) @ V.mT


def by_numpy(M: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """The textbook formula in float64, and the singular values with the sign of the determinant."""
    left, s, right = np.linalg.svd(M.detach().double().numpy())
    sign = np.ones_like(s)
    sign[..., 2] = np.sign(np.linalg.det(left @ right))
    return left * sign[..., None, :] @ right, s * sign


def unique(M: Tensor) -> np.ndarray:
    """Which matrices have one nearest rotation, by far."""
    s = by_numpy(M)[1]
    return s[:, 1] + s[:, 2] > 0.1 * s[:, 0]


UNIQUE = {
    "random": NOISE,
    "rotations": U,
    "nearly rotations": U + 1e-12 * NOISE,
    "s_1 = s_2": with_values(2, 2, 0.5),
    "s_2 = s_3": with_values(2, 0.5, 0.5),
    "s_1 = s_2, negative": with_values(2, 2, -0.5),
    "rank two": with_values(2, 1, 0),
    "negative": with_values(3, 2, -1),
    "far apart": with_values(1, 1e-2, 1e-4),
    "nearly ambiguous": with_values(2, 1, -1 + 1e-6),
    "small integers": torch.round(NOISE)[unique(torch.round(NOISE))],
    "identity": torch.eye(3, dtype=torch.float64)[None],
    "a permutation": torch.eye(3, dtype=torch.float64)[None, [1, 2, 0]],
}
AMBIGUOUS = {
    "reflections": with_values(1, 1, -1),
    "minus the identity": -torch.eye(3, dtype=torch.float64)[None],
    "s_2 = -s_3": with_values(2, 1, -1),
    "rank one": with_values(1, 0, 0),
    "outer products": NOISE[:, :, :1] * NOISE[:, :1],
    "ones": torch.ones(1, 3, 3, dtype=torch.float64),
    "zero": torch.zeros(1, 3, 3, dtype=torch.float64),
}
FAMILIES = UNIQUE | AMBIGUOUS
DTYPES = [torch.float32, torch.float64]


@pytest.fixture(params=["lapack", "jacobi"])
def road(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Both ways to the decomposition, whatever the size of the batch."""
    monkeypatch.setattr(procrustes, "_SMALL_BATCH", 10**9 if request.param == "lapack" else -1)
    yield request.param


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("family", FAMILIES)
def test_is_a_rotation_and_none_is_nearer(family: str, dtype: torch.dtype, road: str) -> None:
    M = FAMILIES[family].to(dtype)
    eps = torch.finfo(dtype).eps
    R = special_procrustes(M)
    assert R.dtype == dtype
    R, M = R.double(), M.double()
    assert (R @ R.mT - torch.eye(3)).abs().max() < 32 * eps
    assert (torch.linalg.det(R) > 0).all()
    # |M - R|^2 = |M|^2 + 3 - 2 tr(R^T M), whose greatest value is the sum of the singular values.
    s = torch.from_numpy(by_numpy(M)[1])
    achieved = (R * M).sum((-2, -1))
    assert ((s.sum(-1) - achieved).abs() <= 32 * eps * s[:, 0]).all()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("family", UNIQUE)
def test_equals_the_textbook_formula(family: str, dtype: torch.dtype, road: str) -> None:
    M = UNIQUE[family].to(dtype)
    expected, s = by_numpy(M)
    condition = s[:, 0] / (s[:, 1] + s[:, 2])
    error = np.abs(special_procrustes(M).double().numpy() - expected).max((1, 2))
    # In float64 the textbook formula is no more exact than ours, and by LAPACK rather less.
    roundings = 32 if dtype == torch.float32 else 64
    assert (error <= roundings * torch.finfo(dtype).eps * condition).all()


@pytest.mark.parametrize("family", ["random", "negative", "rank two", "reflections", "rank one"])
def test_beats_random_and_neighbouring_rotations(family: str, road: str) -> None:
    M = FAMILIES[family][:10].numpy()
    R = special_procrustes(M)
    others = Rotation.random(5000, random_state=4).as_matrix()
    steps = np.random.default_rng(5).normal(
        scale=10.0 ** np.arange(-5, 0)[:, None, None], size=(5, 100, 3)
    )
    neighbours = Rotation.from_rotvec(steps.reshape(-1, 3)).as_matrix() @ R[:, None]
    best = np.linalg.norm(M - R, axis=(1, 2))
    assert (best <= np.linalg.norm(M - others[:, None], axis=(2, 3)).min(0) + 1e-14).all()
    assert (best <= np.linalg.norm(M[:, None] - neighbours, axis=(2, 3)).min(1) + 1e-14).all()


@pytest.mark.parametrize(
    ("dtype", "scale"),
    [(torch.float32, s) for s in (1e-41, 1e-30, 1e-20, 1e15, 5e37)]
    + [(torch.float64, s) for s in (1e-320, 1e-200, 1e15, 1e307)],
)
def test_scale_does_not_matter(dtype: torch.dtype, scale: float, road: str) -> None:
    M = (scale * FAMILIES["random"]).to(dtype)  # the smallest scales leave few digits of M
    expected, s = by_numpy(M.double() / M.double().abs().amax((1, 2), keepdim=True))
    condition = s[:, 0] / (s[:, 1] + s[:, 2])
    error = np.abs(special_procrustes(M).double().numpy() - expected).max((1, 2))
    assert (error <= 32 * torch.finfo(dtype).eps * condition).all()


def test_zero_gives_the_identity(road: str) -> None:
    assert np.array_equal(special_procrustes(np.zeros((2, 3, 3))), np.tile(np.eye(3), (2, 1, 1)))


@pytest.mark.parametrize("dtype", DTYPES)
def test_chunks_and_large_batches_change_nothing(
    dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    M = torch.cat(list(UNIQUE.values())).to(dtype)
    assert len(M) > procrustes._SMALL_BATCH  # so that this is Jacobi's road without help
    whole = special_procrustes(M)
    monkeypatch.setattr(procrustes, "_CHUNK", 7)
    # Vector instructions and their remainder may round differently.
    s = by_numpy(M)[1]
    difference = (whole - special_procrustes(M)).abs().numpy().max((1, 2))
    condition = s[:, 0] / (s[:, 1] + s[:, 2])
    assert (difference <= 32 * torch.finfo(dtype).eps * condition).all()


def test_jacobi_has_a_sweep_to_spare(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(6)
    M = torch.randn(5000, 3, 3, generator=generator, dtype=torch.float64)
    M[::2] *= 10 ** (-4 * torch.rand(2500, 1, 3, generator=generator, dtype=torch.float64))
    for dtype, sweeps in procrustes._SWEEPS.items():
        monkeypatch.setitem(procrustes._SWEEPS, dtype, sweeps - 1)
        expected, s = by_numpy(M.to(dtype))
        error = np.abs(special_procrustes(M.to(dtype)).double().numpy() - expected).max((1, 2))
        condition = s[:, 0] / (s[:, 1] + s[:, 2])
        assert (error <= 64 * torch.finfo(dtype).eps * condition).all()


@pytest.mark.parametrize("family", sorted(set(UNIQUE) - {"far apart", "nearly ambiguous"}))
def test_derivative_is_that_of_finite_differences(family: str, road: str) -> None:
    M = UNIQUE[family][:2].clone().requires_grad_()
    assert torch.autograd.gradcheck(special_procrustes, M, eps=1e-6, atol=1e-7, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["random", "rotations", "s_1 = s_2", "negative", "rank two"])
def test_second_derivative_is_that_of_finite_differences(family: str, road: str) -> None:
    M = UNIQUE[family][:2].clone().requires_grad_()
    assert torch.autograd.gradgradcheck(special_procrustes, M, eps=1e-6, atol=1e-6, rtol=1e-6)


def test_third_derivative_is_that_of_finite_differences() -> None:
    M = torch.eye(3, dtype=torch.float64).requires_grad_()

    def first_derivative(M: Tensor) -> Tensor:
        weights = torch.arange(9, dtype=torch.float64).reshape(3, 3) ** 2
        (grad,) = torch.autograd.grad((weights * special_procrustes(M)).sum(), M, create_graph=True)
        return grad

    assert torch.autograd.gradgradcheck(first_derivative, M, eps=1e-6, atol=1e-6, rtol=1e-6)


def directional(family: str) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """M, R, a direction dM, weights, and the derivative of the weighted sum of R along dM."""
    M = FAMILIES[family].clone().requires_grad_()
    generator = torch.Generator().manual_seed(7)
    dM = torch.randn(M.shape, generator=generator, dtype=M.dtype)
    weights = torch.randn(M.shape, generator=generator, dtype=M.dtype)
    R = special_procrustes(M)
    (grad,) = torch.autograd.grad((weights * R).sum(), M)
    return M.detach(), R.detach(), dM, weights, (grad * dM).sum((1, 2))


@pytest.mark.parametrize("family", UNIQUE)
def test_gradient_is_the_formula_with_singular_vectors(family: str, road: str) -> None:
    # dR = U W D V^T with W_ij = (X_ij - X_ji) / (s_i + s_j), X = U^T dM V D.
    M, _, dM, weights, got = directional(family)
    left, s, right_t = torch.linalg.svd(M)
    D = torch.ones_like(s)
    D[:, 2] = torch.linalg.det(left @ right_t).sign()
    s = s * D
    X = left.mT @ dM @ right_t.mT * D[:, None, :]
    sums = s[:, :, None] + s[:, None, :] + 1e9 * torch.eye(3)  # the diagonal of W is zero
    dR = left @ ((X - X.mT) / sums) @ (D[:, :, None] * right_t)
    tolerance = 1e-12 * s[:, 0] / (s[:, 1] + s[:, 2]) ** 2
    assert ((got - (weights * dR).sum((1, 2))).abs() <= tolerance).all()


@pytest.mark.parametrize("family", AMBIGUOUS)
def test_gradient_is_zero_only_along_what_is_ambiguous(family: str, road: str) -> None:
    # The same formula with the singular vectors of the rotation chosen; 0 / 0 counts as zero.
    M, R, dM, weights, got = directional(family)
    P = R.mT @ M
    torch.testing.assert_close(P, P.mT, rtol=0, atol=1e-14)
    s, right = torch.linalg.eigh(P)
    X = right.mT @ R.mT @ dM @ right
    sums = s[:, :, None] + s[:, None, :]
    known = (sums > 1e-13 * s[:, 2:, None]) & ~torch.eye(3, dtype=torch.bool)
    dR = R @ right @ torch.where(known, (X - X.mT) / sums, 0) @ right.mT
    tolerance = 1e-12 / s[:, 2].clamp_min(1e-9)
    assert ((got - (weights * dR).sum((1, 2))).abs() <= tolerance).all()


def test_what_is_ambiguous_has_no_gradient(road: str) -> None:
    # Turned about x, the rotations are all as near to this matrix: nothing pulls that way.
    M = torch.diag(torch.tensor([2.0, 1, -1], dtype=torch.float64)).requires_grad_()
    R = special_procrustes(M)
    weights = torch.arange(9, dtype=torch.float64).reshape(3, 3)
    (grad,) = torch.autograd.grad((weights * R).sum(), M)
    turn = R.detach().mT @ grad  # skew-symmetric
    assert turn[2, 1].abs() < 1e-15
    assert turn.abs().max() > 0.1


@pytest.mark.parametrize("scale", [1e-20, 1e-3, 1e15])
def test_gradient_is_inverse_to_the_scale(scale: float, road: str) -> None:
    M = UNIQUE["rotations"].float().requires_grad_()
    weights = NOISE.float()
    (unit,) = torch.autograd.grad((weights * special_procrustes(M)).sum(), M)
    scaled = (M.detach() * scale).requires_grad_()
    (grad,) = torch.autograd.grad((weights * special_procrustes(scaled)).sum(), scaled)
    torch.testing.assert_close(grad * scale, unit, rtol=1e-5, atol=1e-5)


def test_one_step_of_training_from_the_identity_stays_finite(road: str) -> None:
    # The plain derivative of the SVD is NaN here, where an autoencoder of rotations wants to be.
    M = torch.eye(3).requires_grad_()
    target = torch.from_numpy(Rotation.from_euler("z", 0.3).as_matrix()).float()
    (special_procrustes(M) - target).square().sum().backward()
    moved = special_procrustes(M.detach() - 0.1 * M.grad)
    assert (moved - target).norm() < (torch.eye(3) - target).norm()


finite32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
small_integers = st.integers(-2, 2).map(float)


@given(hnp.arrays(np.float32, (3, 3), elements=finite32 | small_integers), st.booleans())
def test_any_matrix_gives_a_rotation_and_a_finite_gradient(M: np.ndarray, jacobi: bool) -> None:
    decompose = procrustes._SMALL_BATCH
    procrustes._SMALL_BATCH = -1 if jacobi else 10
    try:
        leaf = torch.from_numpy(M).requires_grad_()
        R = special_procrustes(leaf)
        (grad,) = torch.autograd.grad((R * torch.arange(9.0).reshape(3, 3)).sum(), leaf)
    finally:
        procrustes._SMALL_BATCH = decompose
    assert (R @ R.T - torch.eye(3)).abs().max() < 4e-6
    assert torch.linalg.det(R) > 0
    assert torch.isfinite(grad).all()


@given(st.integers(0, 10**6))
def test_turns_with_the_matrix(seed: int) -> None:
    A, B = Rotation.random(2, random_state=seed).as_matrix()
    M = np.random.default_rng(seed).normal(size=(3, 3))
    _, s = by_numpy(torch.from_numpy(M))
    turned = special_procrustes(A @ M @ B)
    assert np.abs(turned - A @ special_procrustes(M) @ B).max() < 1e-14 * s[0] / (s[1] + s[2])


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,), (2, 0)])
def test_any_batch(batch: tuple[int, ...], road: str) -> None:
    M = np.random.default_rng(9).normal(size=(*batch, 3, 3))
    R = special_procrustes(M)
    assert isinstance(R, np.ndarray)
    assert R.shape == M.shape
    leaf = torch.from_numpy(M).requires_grad_()
    special_procrustes(leaf).sum().backward()
    assert leaf.grad.shape == M.shape


def test_views_are_read_as_they_are(road: str) -> None:
    M = NOISE.mT
    assert torch.equal(special_procrustes(M), special_procrustes(M.contiguous()))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_gives_float32(dtype: torch.dtype) -> None:
    M = NOISE.to(dtype).requires_grad_()
    R = special_procrustes(M)
    assert R.dtype == torch.float32
    torch.testing.assert_close(R, special_procrustes(M.float()))
    R.sum().backward()
    assert M.grad.dtype == dtype


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_autocast_changes_nothing(dtype: torch.dtype, road: str) -> None:
    weights = NOISE.float()
    M, cast = NOISE.to(dtype).requires_grad_(), NOISE.to(dtype).requires_grad_()
    R = special_procrustes(M)
    (weights * R).sum().backward()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        R_cast = special_procrustes(cast)
        (weights * R_cast).sum().backward()
    assert torch.equal(R_cast, R)
    assert torch.equal(cast.grad, M.grad)
