"""Distance, mean and samples of rotations against SciPy, brute force and their definitions."""

from collections.abc import Callable

import numpy as np
import pytest
import roma
import scipy.stats
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from posecore.rotations import (
    geodesic_distance,
    hat,
    is_rotation,
    mean_rotation,
    random_rotations,
    rotation_defect,
    vee,
)

ROUNDING = 16 * np.finfo(np.float64).eps
seeds = st.integers(0, 10**6)
vectors = hnp.arrays(float, (5, 3), elements=st.floats(-1e3, 1e3))

# Cross products -------------------------------------------------------------------------------


@given(vectors, vectors)
def test_hat_is_the_cross_product_and_vee_undoes_it(v: np.ndarray, x: np.ndarray) -> None:
    S = hat(v)
    assert np.array_equal(S, -S.mT)
    assert np.allclose((S @ x[..., None])[..., 0], np.cross(v, x), rtol=0, atol=1e-9)
    assert np.array_equal(vee(S), v)


@given(hnp.arrays(float, (3, 3), elements=st.floats(-1e3, 1e3)))
def test_vee_takes_the_skew_part(S: np.ndarray) -> None:
    assert np.allclose(hat(vee(S)), (S - S.T) / 2, rtol=0, atol=1e-12)


def test_hat_and_vee_are_linear_for_gradients() -> None:
    v = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    S = torch.randn(2, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(hat, v)
    assert torch.autograd.gradcheck(vee, S)


# Distance -------------------------------------------------------------------------------------


@given(seeds)
def test_distance_like_scipy_and_roma(seed: int) -> None:
    one, two = Rotation.random(2, random_state=seed)
    distance = geodesic_distance(one.as_matrix(), two.as_matrix())
    assert abs(distance - (one.inv() * two).magnitude()) < ROUNDING
    theirs = roma.rotmat_geodesic_distance(
        torch.from_numpy(one.as_matrix()), torch.from_numpy(two.as_matrix())
    )
    # RoMa takes an arc sine of the chord, whose derivative grows towards pi.
    assert abs(distance - theirs.item()) < ROUNDING * (1 + 1 / (np.pi - distance))


@given(seeds)
def test_distance_is_symmetric_invariant_and_a_metric(seed: int) -> None:
    A, B, C = Rotation.random(3, random_state=seed).as_matrix()
    distance = geodesic_distance(A, B)
    assert 0 <= distance <= np.pi
    assert abs(distance - geodesic_distance(B, A)) < ROUNDING
    assert abs(distance - geodesic_distance(C @ A, C @ B)) < ROUNDING
    assert abs(distance - geodesic_distance(A @ C, B @ C)) < ROUNDING
    assert distance <= geodesic_distance(A, C) + geodesic_distance(C, B) + ROUNDING
    assert geodesic_distance(A, A) < ROUNDING


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-9, 1e-6, 1e-3, 1, np.pi / 2, 3])
@pytest.mark.parametrize("from_pi", [False, True])
def test_distance_is_exact_at_both_ends(angle: float, from_pi: bool) -> None:
    expected = np.pi - angle if from_pi else angle
    for axis in np.random.default_rng(0).normal(size=(10, 3)):
        turn = Rotation.from_rotvec(expected * axis / np.linalg.norm(axis)).as_matrix()
        assert abs(geodesic_distance(np.eye(3), turn) - expected) < 4e-16 * max(1, 2 * expected)
        base = Rotation.random(random_state=1).as_matrix()
        assert abs(geodesic_distance(base, base @ turn) - expected) < ROUNDING


def test_distance_in_float32_does_not_lose_half_its_digits() -> None:
    # The arc cosine of the trace cannot see angles under 3e-4 in float32.
    turn = Rotation.from_rotvec([1e-5, 0, 0]).as_matrix().astype(np.float32)
    distance = geodesic_distance(np.eye(3, dtype=np.float32), turn)
    assert distance.dtype == np.float32
    assert abs(distance - 1e-5) < 1e-11


@pytest.mark.parametrize("angle", [1e-3, 0.5, 2, np.pi - 1e-3])
def test_distance_derivative_is_that_of_finite_differences(angle: float) -> None:
    turn = torch.from_numpy(Rotation.from_rotvec([0.6 * angle, 0, -0.8 * angle]).as_matrix())
    R = torch.from_numpy(Rotation.random(2, random_state=2).as_matrix())
    first, second = R.clone().requires_grad_(), (R @ turn).requires_grad_()
    assert torch.autograd.gradcheck(geodesic_distance, (first, second), eps=1e-7, atol=1e-6)


@pytest.mark.parametrize("turn", [np.eye(3), np.diag([1, -1, -1]), np.diag([-1, -1, 1])])
def test_distance_gradient_is_zero_at_both_ends(turn: np.ndarray) -> None:
    for base in (np.eye(3), np.eye(3)[[1, 2, 0]]):
        first = torch.from_numpy(base).requires_grad_()
        second = torch.from_numpy(base @ turn).requires_grad_()
        geodesic_distance(first, second).backward()
        assert torch.equal(first.grad, torch.zeros(3, 3, dtype=torch.float64))
        assert torch.equal(second.grad, torch.zeros(3, 3, dtype=torch.float64))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distance_gradient_is_finite_near_both_ends(dtype: torch.dtype) -> None:
    axis = np.array([0.6, 0, -0.8])
    near = np.concatenate([10.0 ** -np.arange(20), np.pi - 10.0 ** -np.arange(20)])
    base = Rotation.random(40, random_state=3)
    first = torch.from_numpy(base.as_matrix()).to(dtype).requires_grad_()
    second = (base * Rotation.from_rotvec(near[:, None] * axis)).as_matrix()
    geodesic_distance(first, torch.from_numpy(second).to(dtype)).sum().backward()
    assert torch.isfinite(first.grad).all()
    assert first.grad.abs().max() < 10


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distances_of_many_are_those_of_few(dtype: torch.dtype) -> None:
    axis = np.array([0.6, 0, -0.8])
    near = np.concatenate([10.0 ** -np.arange(300), np.pi - 10.0 ** -np.arange(300)])
    turns = Rotation.from_rotvec(near[:, None] * axis).as_matrix()
    one = random_rotations(2, 600, generator=4, dtype=dtype)
    two = torch.stack([random_rotations(600, generator=5, dtype=dtype), one[1]])
    two[1] @= torch.from_numpy(turns).to(dtype)
    together = geodesic_distance(one, two)
    pairs = zip(one.view(-1, 3, 3), two.view(-1, 3, 3), strict=True)
    apart = [geodesic_distance(a, b) for a, b in pairs]
    rounding = 4 * torch.finfo(dtype).eps
    assert torch.allclose(together, torch.stack(apart).view(2, 600), rtol=rounding, atol=0)
    taped = geodesic_distance(one.clone().requires_grad_(), two)
    assert torch.allclose(together, taped, rtol=rounding, atol=0)


def test_one_bad_matrix_among_many_is_refused() -> None:
    R = random_rotations(2, 600, generator=6).double()
    for bad in (-R[1, 99], 1.001 * R[1, 99], R[1, 99] + 1e-3, R[1, 99] * 0):
        other = R.clone()
        other[1, 99] = bad
        with pytest.raises(ValueError, match=r"^R_2: .* 1 of 1200 .*index \(1, 99\)"):
            geodesic_distance(R, other)
        with pytest.raises(ValueError, match=r"^R_1: .* 1 of 1200 .*index \(1, 99\)"):
            geodesic_distance(other, R)


def test_distance_broadcasts() -> None:
    R = Rotation.random(6, random_state=4).as_matrix()
    table = geodesic_distance(R[:, None], R)
    loop = [[(Rotation.from_matrix(A.T @ B)).magnitude() for B in R] for A in R]
    assert np.abs(table - loop).max() < ROUNDING
    assert geodesic_distance(R[:0], R[0]).shape == (0,)


# Mean -----------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 6))
def test_mean_like_scipy(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(0.3 * rng.normal(size=(n, 3))) * Rotation.random(rng=rng)
    weights = rng.uniform(0.1, 1, size=n)
    R = rotations.as_matrix()
    assert np.abs(mean_rotation(R) - rotations.mean().as_matrix()).max() < 1e-13
    expected = rotations.mean(weights).as_matrix()
    assert np.abs(mean_rotation(R, weights) - expected).max() < 1e-13
    assert np.abs(mean_rotation(R, 1.7e308 * weights) - expected).max() < 1e-13


def test_mean_beats_its_neighbours() -> None:
    rng = np.random.default_rng(5)
    R = Rotation.random(7, rng=rng).as_matrix()
    weights = rng.uniform(size=7)
    mean = mean_rotation(R, weights)

    def cost(candidates: np.ndarray) -> np.ndarray:
        return (weights * np.square(candidates[:, None] - R).sum((2, 3))).sum(1)

    steps = rng.normal(size=(500, 3)) * 10.0 ** -rng.uniform(0, 5, size=(500, 1))
    others = Rotation.from_rotvec(steps).as_matrix() @ mean
    everywhere = Rotation.random(2000, rng=rng).as_matrix()
    assert cost(mean[None]) <= min(cost(others).min(), cost(everywhere).min()) + 1e-13


def test_mean_of_copies_and_of_a_pair() -> None:
    R = Rotation.random(random_state=6)
    assert np.abs(mean_rotation(np.tile(R.as_matrix(), (4, 1, 1))) - R.as_matrix()).max() < 1e-15
    pair = (R * Rotation.from_rotvec([[0.4, 0, 0], [1.0, 0, 0]])).as_matrix()
    half_way = (R * Rotation.from_rotvec([0.7, 0, 0])).as_matrix()
    assert np.abs(mean_rotation(pair) - half_way).max() < ROUNDING


def test_mean_without_weight_is_left_out() -> None:
    R = Rotation.random(3, random_state=7).as_matrix()
    assert np.abs(mean_rotation(R, [1, 0, 1]) - mean_rotation(R[[0, 2]])).max() < ROUNDING


def test_mean_batches_and_gradient() -> None:
    R = Rotation.from_rotvec(np.random.default_rng(8).normal(size=(24, 3)) / 2).as_matrix()
    R = R.reshape(2, 3, 4, 3, 3)
    means = mean_rotation(R, np.ones((3, 4)))
    assert means.shape == (2, 3, 3, 3)
    assert np.abs(means - mean_rotation(R)).max() < ROUNDING
    assert np.abs(means[1, 2] - mean_rotation(R[1, 2])).max() < ROUNDING
    R = torch.from_numpy(R[0, 0]).requires_grad_()
    weights = torch.tensor([1.0, 2, 3, 4], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(mean_rotation, (R, weights), eps=1e-6, atol=1e-7)


AMBIGUOUS = {
    "half a turn": [[0, 0, 0], [np.pi, 0, 0]],
    "thirds of a turn": [[0, 0, 0], [0, 2 * np.pi / 3, 0], [0, -2 * np.pi / 3, 0]],
    "three half turns": [[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi]],
    "all half turns": [[0, 0, 0], [np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi]],
}


@pytest.mark.parametrize("case", AMBIGUOUS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_mean_that_is_not_unique_is_refused(case: str, dtype: type) -> None:
    base = Rotation.random(random_state=9)
    R = (base * Rotation.from_rotvec(AMBIGUOUS[case])).as_matrix().astype(dtype)
    with pytest.raises(ValueError, match=r"^R: .*one mean"):
        mean_rotation(R)
    weights = np.linspace(1, 2, len(R))
    assert is_rotation(mean_rotation(R, weights))  # the heavier one decides


# Samples --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [np.random.default_rng, torch.Generator().manual_seed])
def test_samples_are_uniform(kind: Callable) -> None:
    # The angle of a uniform rotation has the density (1 - cos a) / pi; its axis is uniform, so each
    # coordinate of the axis is uniform in [-1, 1]; and so is each entry of R (Archimedes).
    R = np.asarray(random_rotations(20000, generator=kind(10)))
    vectors = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vectors, axis=1)
    by_angle = scipy.stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi)
    assert by_angle.pvalue > 0.01
    uniform = scipy.stats.uniform(-1, 2).cdf
    for values in (*(vectors / angle[:, None]).T, *R.reshape(-1, 9).T):
        assert scipy.stats.kstest(values, uniform).pvalue > 0.001
    # The test can fail: uniform angles about a uniform axis are not uniform rotations.
    naive = np.random.default_rng(11).uniform(0, np.pi, size=20000)
    assert scipy.stats.kstest(naive, lambda a: (a - np.sin(a)) / np.pi).pvalue < 1e-10


@given(seeds, st.lists(st.integers(0, 4), max_size=3))
def test_samples_are_rotations_and_repeat_with_the_seed(seed: int, batch: list[int]) -> None:
    R = random_rotations(*batch, generator=seed)
    assert R.shape == (*batch, 3, 3)
    assert R.dtype == torch.get_default_dtype()
    assert (rotation_defect(R) < 2e-6).all()
    assert is_rotation(R).all()
    assert torch.equal(R, random_rotations(*batch, generator=seed))
    assert torch.equal(R, random_rotations(*batch, generator=torch.Generator().manual_seed(seed)))


def test_samples_are_of_the_generators_kind() -> None:
    array = random_rotations(2, generator=np.random.default_rng(0))
    assert isinstance(array, np.ndarray)
    assert array.dtype == np.float64
    assert np.array_equal(array, random_rotations(2, generator=np.random.default_rng(0)))
    single = random_rotations(generator=np.random.default_rng(0), dtype=torch.float32)
    assert single.shape == (3, 3)
    assert single.dtype == np.float32
    assert random_rotations(2, generator=0, dtype=torch.float64).dtype == torch.float64


def test_a_generator_moves_on() -> None:
    for generator in (np.random.default_rng(0), torch.Generator().manual_seed(0)):
        first = random_rotations(generator=generator)
        assert not np.allclose(first, random_rotations(generator=generator))


# Bad input ------------------------------------------------------------------------------------

EYES = np.tile(np.eye(3), (2, 1, 1))
BAD = [
    (lambda: geodesic_distance(2 * np.eye(3), np.eye(3)), "R_1: .*special_procrustes"),
    (lambda: geodesic_distance(np.eye(3), np.diag([1, 1, -1])), "R_2: .*determinant -1"),
    (lambda: geodesic_distance(np.eye(3), 1.001 * np.eye(3)), "R_2: .*rotation"),
    (lambda: mean_rotation(2 * EYES), "R: .*rotation"),
    (lambda: mean_rotation(EYES, [1, -1]), "weights: .*-1"),
    (lambda: mean_rotation(EYES, [0, 0]), "weights: .*not all 0"),
    (lambda: mean_rotation(EYES[None], [[0, 0]]), "weights: .*not all 0"),
    (lambda: random_rotations(-1, generator=0), "batch: .*at least 0"),
    (lambda: random_rotations(2.0, generator=0), "batch: .*integer"),
    (lambda: random_rotations((2, 3), generator=0), "batch: .*integer"),
    (lambda: random_rotations(2, generator=-1), "generator: .*between 0 and"),
    (lambda: random_rotations(2, generator="seed"), "generator: .*integer"),
    (lambda: random_rotations(2, generator=None), "generator: .*integer"),
    (lambda: random_rotations(2, generator=np.random.RandomState(0)), "generator: "),
]


@pytest.mark.parametrize(("call", "complaint"), BAD)
def test_bad_input(call: Callable, complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + complaint):
        call()
