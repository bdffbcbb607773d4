"""Chapter 5's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import normalize

from book.ch05_learnable_rotations import checks
from book.tools.checks import DONE
from posecore import rotations
from posecore.nets.rotation_heads import RotationHead

seeds = st.integers(0, 2**31 - 1)


def doubles(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def angle(a: Tensor, b: Tensor) -> float:
    """Between two directions of either sign, degrees."""
    return float(
        torch.rad2deg((normalize(a, dim=0) @ normalize(b, dim=0)).abs().clamp(max=1).acos())
    )


# 1. The nearest rotation --------------------------------------------------------------------------


def nearest_one_by_one(M: Any) -> Tensor:
    result = torch.zeros_like(M)
    for i, matrix in enumerate(M):
        U, _, Vh = torch.linalg.svd(matrix)
        if torch.linalg.det(U) * torch.linalg.det(Vh) < 0:
            U[:, 2] = -U[:, 2]
        result[i] = U @ Vh
    return result


def nearest_by_quaternions(M: Any) -> Tensor:
    """tr(R^T M) is a quadratic form of the quaternion (Horn 1987)."""
    basis = torch.eye(4, dtype=M.dtype)
    R_of = rotations.quaternion_to_matrix
    forms = M.new_zeros(len(M), 4, 4)
    for i in range(4):
        forms[:, i, i] = (R_of(basis[i]) * M).sum((1, 2))
    for i in range(4):
        for j in range(i):
            both = 2 * (R_of(basis[i] + basis[j]) * M).sum((1, 2))
            forms[:, i, j] = forms[:, j, i] = (both - forms[:, i, i] - forms[:, j, j]) / 2
    return R_of(torch.linalg.eigh(forms).eigenvectors[..., -1])


def nearest_with_reflections(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    return U @ Vh


def nearest_by_the_sign_of_det_M(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    U[:, :, 2] *= torch.linalg.det(M).sign()[:, None]
    return U @ Vh


def nearest_by_the_first_column(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    U[:, :, 0] *= torch.linalg.det(U @ Vh)[:, None]
    return U @ Vh


def nearest_by_a_turned_sign(M: Any) -> Tensor:
    R = nearest_with_reflections(M)
    return R * torch.linalg.det(R)[:, None, None]


def nearest_flipping_the_result(M: Any) -> Tensor:
    R = nearest_with_reflections(M)
    R[:, :, 2] *= torch.linalg.det(R)[:, None]
    return R


def nearest_for_all_or_none(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    if len(M) and torch.linalg.det(U @ Vh)[0] < 0:
        U[:, :, 2] *= -1
    return U @ Vh


def nearest_with_vh_for_v(M: Any) -> Tensor:
    U, _, V = torch.linalg.svd(M)
    U[:, :, 2] *= torch.linalg.det(U @ V)[:, None]
    return U @ V.mT


def nearest_by_gram_schmidt(M: Any) -> Tensor:
    return RotationHead("6d").decode(torch.cat([M[:, :, 0], M[:, :, 1]], -1))


def nearest_in_float32(M: Any) -> Tensor:
    return checks.nearest_rotation(M.float())


# 2. Its gradient ----------------------------------------------------------------------------------


def factors(M: Any, G: Any) -> tuple[Tensor, ...]:
    U, s, Vh = torch.linalg.svd(M)
    D = torch.diag(torch.tensor([1, 1, torch.linalg.det(U @ Vh)]).to(M))
    return U, s * D.diagonal(), D @ Vh, U.T @ G @ Vh.T @ D


def gradient_by_entries(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    Z = torch.zeros_like(M)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        Z[i, j] = (Y[i, j] - Y[j, i]) / (s[i] + s[j])
        Z[j, i] = -Z[i, j]
    return U @ Z @ DVh


def gradient_by_a_linear_system(M: Any, G: Any) -> Tensor:
    """(tr(P) I - P) omega = axial, as the library has it, solved without an SVD's derivative."""
    R = checks.nearest_rotation(M[None])[0]
    P = R.T @ M
    omega = torch.linalg.solve(P.trace() * torch.eye(3).to(P) - P, 2 * rotations.vee(R.T @ G))
    return R @ rotations.hat(omega)


def gradient_by_differences(M: Any, G: Any) -> Tensor:
    steps = 1e-6 * torch.eye(9, dtype=M.dtype).reshape(9, 3, 3)
    after, before = checks.nearest_rotation(M + steps), checks.nearest_rotation(M - steps)
    return ((after - before) * G).sum((1, 2)).reshape(3, 3) / 2e-6


def gradient_by_autograd(M: Any, G: Any) -> Tensor:
    leaf = M.clone().requires_grad_()
    U, _, Vh = torch.linalg.svd(leaf)
    D = torch.diag(torch.tensor([1, 1, torch.linalg.det(U @ Vh)]).to(M))
    return torch.autograd.grad(U @ D @ Vh, leaf, G)[0]


def gradient_at_once(M: Any, G: Any, sign: float = 1.0, power: float = 1.0) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    sums = s[:, None] + sign * s
    sums.fill_diagonal_(1)
    return U @ ((Y - Y.T) / sums**power) @ DVh


def gradient_with_a_hole_on_the_diagonal(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s)) @ DVh


def gradient_with_differences_of_values(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G, sign=-1.0)


def gradient_undivided(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G, power=0.0)


def gradient_of_the_other_sign(M: Any, G: Any) -> Tensor:
    return -gradient_at_once(M, G)


def gradient_halved(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G) / 2


def gradient_without_the_sign_of_s(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    s = s.abs()
    sums = s[:, None] + s
    sums.fill_diagonal_(1)
    return U @ ((Y - Y.T) / sums) @ DVh


def gradient_without_the_determinant(M: Any, G: Any) -> Tensor:
    U, s, Vh = torch.linalg.svd(M)
    Y = U.T @ G @ Vh.T
    sums = s[:, None] + s
    sums.fill_diagonal_(1)
    return U @ ((Y - Y.T) / sums) @ Vh


def gradient_with_an_epsilon(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s + 1e-8)) @ DVh


def gradient_with_clamped_sums(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s).clamp(min=1e-3)) @ DVh


def gradient_of_zero_where_flat(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G) * (torch.linalg.det(M).abs() > 1e-9)


def gradient_passed_on(M: Any, G: Any) -> Tensor:
    return G


def gradient_that_projects(M: Any, G: Any) -> Tensor:
    R = checks.nearest_rotation(M[None])[0]
    return (G - R @ G.T @ R) / 2  # right at rotations, where s_i + s_j = 2


# 3. Six numbers -----------------------------------------------------------------------------------


def six_by_two_crosses(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_1, r_3 = normalize(a, dim=1), normalize(torch.linalg.cross(a, b), dim=1)
    return torch.stack([r_1, torch.linalg.cross(r_3, r_1), r_3], 2)


def six_without_leaning(x: Any) -> Tensor:
    r_1, r_2 = normalize(x[:, :3], dim=1), normalize(x[:, 3:], dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


def six_as_rows(x: Any) -> Tensor:
    return six_by_two_crosses(x).mT


def six_without_the_last_length(x: Any) -> Tensor:
    r_1, b = normalize(x[:, :3], dim=1), x[:, 3:]
    r_2 = b - (r_1 * b).sum(1, keepdim=True) * r_1
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


def six_by_a_long_first(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_1 = normalize(a, dim=1)
    r_2 = normalize(b - (a * b).sum(1, keepdim=True) * a, dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


def six_mirrored(x: Any) -> Tensor:
    return six_by_two_crosses(x) * torch.tensor([1, 1, -1])


def six_beginning_with_b(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_2 = normalize(b, dim=1)
    r_1 = normalize(a - (r_2 * a).sum(1, keepdim=True) * r_2, dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


def six_in_turns(x: Any) -> Tensor:
    return six_by_two_crosses(torch.cat([x[:, ::2], x[:, 1::2]], 1))


def six_cut_off(x: Any) -> Tensor:
    return six_by_two_crosses(x.detach())


def six_one_by_one(x: Any) -> Tensor:
    result = x.new_zeros(len(x), 3, 3)
    for i, numbers in enumerate(x):
        result[i] = six_by_two_crosses(numbers[None])[0]
    return result


def six_with_a_number_torn_out(x: Any) -> Tensor:
    result = x.new_zeros(len(x), 3, 3)
    for i, numbers in enumerate(x):
        r_1 = normalize(numbers[:3], dim=0)
        r_2 = normalize(numbers[3:] - float(r_1 @ numbers[3:]) * r_1, dim=0)
        result[i] = torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 1)
    return result


def six_with_a_gradient_of_its_own(x: Any) -> Tensor:
    return six_cut_off(x) * torch.ones(1, dtype=x.dtype, requires_grad=True)


def six_in_numpy(x: Any) -> np.ndarray:
    return six_by_two_crosses(x).detach().numpy()


def six_with_constants(x: Any) -> Tensor:
    columns = six_by_two_crosses(x)
    return columns @ torch.eye(3, dtype=torch.float64)  # fails on a network's float32


# 4. A representation with a hole ------------------------------------------------------------------


def hole_by_weights(R: Any, errors: Any) -> Tensor:
    """No threshold: what is spread evenly adds a multiple of I, and changes no eigenvector."""
    d = R[:, :, 2] * errors[:, None].clamp(max=0.5)
    return torch.linalg.svd(d, full_matrices=False)[2][0]


def hole_by_search(R: Any, errors: Any) -> Tensor:
    """The candidate direction within 15 degrees of which the errors are the largest."""
    candidates = R[::16, :, 2]
    near = (candidates @ R[:, :, 2].T).abs() > np.cos(np.deg2rad(15))
    value = torch.stack([errors[some].mean() for some in near])
    best = candidates[value.topk(4).indices]
    best = best * (best @ best[0]).sign()[:, None]
    return normalize(best.mean(0), dim=0)


def hole_by_weights_of_any_size(R: Any, errors: Any) -> Tensor:
    d = R[:, :, 2] * errors[:, None]
    return torch.linalg.svd(d, full_matrices=False)[2][0]


def hole_by_the_worst(R: Any, errors: Any) -> Tensor:
    return R[errors.argmax(), :, 2]


def hole_by_the_mean(R: Any, errors: Any) -> Tensor:
    worst = errors.topk(80).indices
    return normalize(R[worst, :, 2].mean(0), dim=0)


def hole_by_rows(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R.mT, errors)


def hole_of_the_x_axis(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R[:, :, [1, 2, 0]], errors)


def hole_by_the_rotation_axis(R: Any, errors: Any) -> Tensor:
    v = rotations.matrix_to_axis_angle(R[errors.topk(80).indices])
    return torch.linalg.eigh(v.T @ v).eigenvectors[:, -1]


def hole_by_the_smallest_eigenvalue(R: Any, errors: Any) -> Tensor:
    d = R[errors.topk(80).indices, :, 2]
    return torch.linalg.eigh(d.T @ d).eigenvectors[:, 0]


def hole_of_the_best(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R, -errors)


def hole_unscaled(R: Any, errors: Any) -> Tensor:
    return 7 * checks.hole_axis(R, errors)


def hole_along_y(R: Any, errors: Any) -> Tensor:
    return torch.tensor([0.0, 1, 0])


# 5. The mean of several predictions ---------------------------------------------------------------


def mean_by_the_library(numbers: Any, representation: str) -> Tensor:
    return rotations.mean_rotation(RotationHead(representation).decode(numbers))


def mean_by_quaternions(numbers: Any, representation: str) -> Tensor:
    """The first eigenvector knows no sign (Markley 2007)."""
    q = rotations.matrix_to_quaternion(RotationHead(representation).decode(numbers))
    return rotations.quaternion_to_matrix(torch.linalg.eigh(q.T @ q).eigenvectors[:, -1])


def mean_of_angles(numbers: Any, representation: str) -> Tensor:
    """Downhill from the first: the mean that minimises the sum of squared angles."""
    R = RotationHead(representation).decode(numbers)
    mean = R[0]
    for _ in range(30):
        step = rotations.matrix_to_axis_angle(mean.T @ R).mean(0)
        mean = mean @ rotations.axis_angle_to_matrix(step)
    return mean


def mean_of_quaternions_on_one_side(numbers: Any, representation: str) -> Tensor:
    q = rotations.matrix_to_quaternion(RotationHead(representation).decode(numbers))
    reference = rotations.matrix_to_quaternion(mean_by_the_library(numbers, representation))
    return rotations.quaternion_to_matrix((q * (q @ reference).sign()[:, None]).mean(0))


def mean_of_numbers(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers.mean(0))


def mean_of_unit_numbers(numbers: Any, representation: str) -> Tensor:
    if representation in ("quaternion", "6d", "procrustes"):
        numbers = normalize(numbers, dim=1)
    return mean_of_numbers(numbers, representation)


def mean_of_quaternions_as_long_as_they_are(numbers: Any, representation: str) -> Tensor:
    if representation == "quaternion":
        numbers = numbers * (numbers @ numbers[0]).sign()[:, None]
        return mean_of_numbers(numbers, representation)
    return mean_by_the_library(numbers, representation)


def mean_of_unit_matrices(numbers: Any, representation: str) -> Tensor:
    if representation == "procrustes":
        return mean_of_unit_numbers(numbers, representation)
    return mean_by_the_library(numbers, representation)


def mean_matrix(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers).mean(0)


def mean_by_the_first(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers)[0]


def mean_by_the_middle_one(numbers: Any, representation: str) -> Tensor:
    R = RotationHead(representation).decode(numbers)
    return min(R, key=lambda one: float(checks.spread(one, R)))


def mean_of_axis_angles(numbers: Any, representation: str) -> Tensor:
    R = RotationHead(representation).decode(numbers)
    return rotations.axis_angle_to_matrix(rotations.matrix_to_axis_angle(R).mean(0))


def mean_with_reflections(numbers: Any, representation: str) -> Tensor:
    U, _, Vh = torch.linalg.svd(RotationHead(representation).decode(numbers).mean(0))
    return U @ torch.diag(torch.tensor([1.0, 1, -1]).to(U)) @ Vh


def means_of_each(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers)


RIGHT = [
    ("nearest_rotation", nearest_one_by_one),
    ("nearest_rotation", nearest_by_quaternions),
    ("procrustes_gradient", gradient_by_entries),
    ("procrustes_gradient", gradient_by_a_linear_system),
    ("procrustes_gradient", gradient_by_differences),
    ("procrustes_gradient", gradient_with_an_epsilon),
    ("six_to_rotation", six_by_two_crosses),
    ("six_to_rotation", six_one_by_one),
    ("hole_axis", hole_by_weights),
    ("hole_axis", hole_by_search),
    ("mean_prediction", mean_by_the_library),
    ("mean_prediction", mean_by_quaternions),
    ("mean_prediction", mean_of_angles),
    ("mean_prediction", mean_of_quaternions_on_one_side),
]


@pytest.mark.parametrize(("exercise", "student"), RIGHT)
def test_another_way_to_be_right(exercise: str, student: Callable[..., Any]) -> None:
    answer = getattr(checks, f"check_{exercise}")(student)
    assert answer.status == DONE, answer.line


# The exercise, the wrong solution, the input that gives it away, and what the line says of it.
WRONG = [
    (
        "nearest_rotation",
        nearest_with_reflections,
        "a matrix that stretches and mirrors",
        "determinant -1",
    ),
    ("nearest_rotation", nearest_by_the_sign_of_det_M, "a matrix whose determinant is 0", "0"),
    (
        "nearest_rotation",
        nearest_by_the_first_column,
        "a matrix that stretches and mirrors",
        "distance",
    ),
    (
        "nearest_rotation",
        nearest_by_a_turned_sign,
        "a matrix that stretches and mirrors",
        "distance",
    ),
    ("nearest_rotation", nearest_flipping_the_result, "three matrices that mirror", "distance"),
    ("nearest_rotation", nearest_for_all_or_none, "four random matrices", "got"),
    ("nearest_rotation", nearest_with_vh_for_v, "two rotations", "got"),
    ("nearest_rotation", nearest_by_gram_schmidt, "three matrices that mirror", "distance"),
    ("nearest_rotation", nearest_in_float32, "a matrix that only stretches", "torch.float32"),
    (
        "procrustes_gradient",
        gradient_by_autograd,
        "the identity, whose singular values are equal",
        "got",
    ),
    ("procrustes_gradient", gradient_with_a_hole_on_the_diagonal, "a flat matrix, s_3 = 0", "nan"),
    (
        "procrustes_gradient",
        gradient_with_differences_of_values,
        "a matrix that only stretches",
        "got",
    ),
    ("procrustes_gradient", gradient_undivided, "a matrix that only stretches", "got"),
    ("procrustes_gradient", gradient_of_the_other_sign, "a matrix that only stretches", "got"),
    ("procrustes_gradient", gradient_halved, "a matrix that only stretches", "got"),
    ("procrustes_gradient", gradient_without_the_sign_of_s, "a matrix that mirrors", "got"),
    ("procrustes_gradient", gradient_without_the_determinant, "a matrix that mirrors", "got"),
    ("procrustes_gradient", gradient_passed_on, "a matrix that only stretches", "got"),
    ("procrustes_gradient", gradient_that_projects, "a matrix that only stretches", "got"),
    (
        "procrustes_gradient",
        gradient_with_clamped_sums,
        "a matrix nearer to a jump: s_2 + s_3 = 0.0005",
        "got",
    ),
    ("procrustes_gradient", gradient_of_zero_where_flat, "a flat matrix, s_3 = 0", "got"),
    ("six_to_rotation", six_without_leaning, "two vectors at 45 degrees", "got"),
    ("six_to_rotation", six_as_rows, "columns of three rotations", "got"),
    ("six_to_rotation", six_without_the_last_length, "a second vector of another length", "got"),
    ("six_to_rotation", six_by_a_long_first, "two vectors at 135 degrees", "got"),
    ("six_to_rotation", six_mirrored, "the first two columns", "got"),
    ("six_to_rotation", six_beginning_with_b, "two vectors at 45 degrees", "got"),
    ("six_to_rotation", six_in_turns, "the first two columns", "got"),
    ("six_to_rotation", six_cut_off, "numbers of a network, with a gradient", "no gradient"),
    (
        "six_to_rotation",
        six_with_a_number_torn_out,
        "numbers of a network, with a gradient",
        "not their gradient",
    ),
    (
        "six_to_rotation",
        six_with_a_gradient_of_its_own,
        "numbers of a network, with a gradient",
        "not their gradient",
    ),
    ("six_to_rotation", six_in_numpy, "the first two columns", "expected a tensor"),
    ("six_to_rotation", six_with_constants, "numbers in float32", "RuntimeError"),
    ("hole_axis", hole_by_the_worst, "a random axis, ten wrong labels", "degrees off"),
    ("hole_axis", hole_by_weights_of_any_size, "a random axis, ten wrong labels", "degrees off"),
    ("hole_axis", hole_by_the_mean, "an axis along z", "degrees off"),
    ("hole_axis", hole_by_rows, "an axis along y", "degrees off"),
    ("hole_axis", hole_of_the_x_axis, "an axis along y", "degrees off"),
    ("hole_axis", hole_by_the_rotation_axis, "an axis along y", "degrees off"),
    ("hole_axis", hole_by_the_smallest_eigenvalue, "an axis along y", "degrees off"),
    ("hole_axis", hole_of_the_best, "an axis along y", "degrees off"),
    ("hole_axis", hole_unscaled, "an axis along y", "length 7"),
    ("hole_axis", hole_along_y, "an axis along z", "degrees off"),
    ("mean_prediction", mean_of_numbers, "predictions near half a turn", "degrees"),
    ("mean_prediction", mean_of_unit_numbers, "predictions near half a turn", "degrees"),
    (
        "mean_prediction",
        mean_of_quaternions_as_long_as_they_are,
        "numbers of different lengths",
        "degrees",
    ),
    ("mean_prediction", mean_of_unit_matrices, "matrices that stretch", "degrees"),
    ("mean_prediction", mean_matrix, "predictions near the identity", "a matrix that stretches"),
    ("mean_prediction", mean_by_the_first, "predictions near the identity", "degrees"),
    ("mean_prediction", mean_by_the_middle_one, "predictions near the identity", "degrees"),
    ("mean_prediction", mean_of_axis_angles, "predictions near half a turn", "degrees"),
    ("mean_prediction", mean_with_reflections, "predictions near the identity", "mirrors"),
    ("mean_prediction", means_of_each, "predictions near the identity", "expected shape (3, 3)"),
]


@pytest.mark.parametrize(("exercise", "student", "words", "result"), WRONG)
def test_a_wrong_solution_is_caught(
    refused: Callable[..., str], exercise: str, student: Callable[..., Any], words: str, result: str
) -> None:
    line = refused(getattr(checks, f"check_{exercise}"), exercise, student, words)
    assert result in line, line


def test_every_exercise_has_wrong_solutions_and_two_hints() -> None:
    found = [name for name in vars(checks) if name.startswith("check_")]
    assert len(found) == 5
    for name in found:
        assert len(getattr(checks, name).hints) == 2
        assert sum(f"check_{exercise}" == name for exercise, *_ in WRONG) >= 3
        assert sum(f"check_{exercise}" == name for exercise, _ in RIGHT) >= 1


@given(seeds)
def test_no_rotation_is_nearer(seed: int) -> None:
    M = doubles(5, 3, 3, seed=seed)
    R = checks.nearest_rotation(M)
    assert rotations.is_rotation(R).all()
    others = rotations.random_rotations(200, 1, generator=seed, dtype=torch.float64)
    slightly = rotations.axis_angle_to_matrix(doubles(200, 5, 3, seed=seed + 1) / 100)
    best = torch.linalg.matrix_norm(M - R)
    assert (best <= torch.linalg.matrix_norm(M - others) + 1e-12).all()
    assert (best <= torch.linalg.matrix_norm(M - R @ slightly) + 1e-12).all()


@given(seeds, st.floats(0.1, 3), st.floats(-0.9, 1))
@settings(max_examples=30)
def test_the_gradient_is_that_of_finite_differences(seed: int, s_2: float, share: float) -> None:
    U, V = rotations.random_rotations(2, generator=seed, dtype=torch.float64)
    M = U @ torch.diag(torch.tensor([3.0, s_2, share * s_2]).double()) @ V.T
    G = doubles(3, 3, seed=seed)

    def loss(entries: np.ndarray) -> float:
        matrix = torch.from_numpy(entries).reshape(1, 3, 3)
        return float((nearest_one_by_one(matrix)[0] * G).sum())

    expected = approx_fprime(M.flatten().numpy(), loss, 1e-7).reshape(3, 3)
    tolerance = 1e-5 / (s_2 * (1 + share)) ** 2  # of the second derivative times the step
    found = checks.procrustes_gradient(M, G).numpy()
    assert np.allclose(found, expected, rtol=0, atol=max(tolerance, 1e-5))


@given(seeds)
def test_six_numbers_are_a_qr_decomposition(seed: int) -> None:
    x = doubles(1, 6, seed=seed)
    Q, triangle = np.linalg.qr(x.reshape(2, 3).T.numpy())
    columns = Q * np.sign(triangle.diagonal())
    expected = np.c_[columns, np.cross(*columns.T)]
    assert np.allclose(checks.six_to_rotation(x)[0].numpy(), expected, atol=1e-9)


def test_a_gradient_is_asked_of_the_copy_that_the_student_got() -> None:
    x = doubles(2, 6, seed=0).requires_grad_()
    assert checks._leaf(six_by_two_crosses(x)) is x
    assert checks._leaf(six_one_by_one(x)) is x


@given(seeds)
def test_five_numbers_say_a_rotation(seed: int) -> None:
    R = rotations.random_rotations(20, generator=seed, dtype=torch.float64)
    a = rotations.random_rotations(generator=seed + 1, dtype=torch.float64)[0]
    numbers = checks.to_five(R, a)
    assert numbers.shape == (20, 5)
    assert torch.allclose(checks.from_five(numbers, a), R, atol=1e-9)
    # A turn of the object about its z axis adds to the angle.
    turned = R @ rotations.axis_angle_to_matrix(torch.tensor([0, 0, 0.3]).double())
    angles = [torch.atan2(n[:, 4], n[:, 3]) for n in (numbers, checks.to_five(turned, a))]
    assert torch.allclose((angles[1] - angles[0]) % (2 * torch.pi), torch.tensor(0.3).double())


@given(seeds)
@settings(max_examples=5)
def test_the_hole_is_where_the_representation_has_it(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    a = torch.nn.functional.normalize(doubles(3, seed=seed), dim=0)
    R = rotations.random_rotations(4000, generator=generator, dtype=torch.float64)
    errors = checks.blurred_errors(R, a, generator)
    errors[:10] = torch.pi
    assert angle(checks.hole_axis(R, errors), a) < 6


@given(seeds, st.sampled_from(checks.REPRESENTATIONS))
@settings(max_examples=30)
def test_the_mean_is_that_of_scipy(seed: int, representation: str) -> None:
    generator = torch.Generator().manual_seed(seed)
    centre = rotations.random_rotations(generator=generator, dtype=torch.float64)
    numbers = checks.predictions(centre, 7, 0.5, representation, generator)
    R = RotationHead(representation).decode(numbers)
    mean = checks.mean_prediction(numbers, representation)
    assert np.allclose(mean.numpy(), Rotation.from_matrix(R.numpy()).mean().as_matrix())
    assert torch.allclose(checks.mean_prediction(numbers.flip(0), representation), mean)


@given(seeds, st.floats(0, 1.2))
@settings(max_examples=30)
def test_no_rotation_has_less_spread(seed: int, wide: float) -> None:
    R = rotations.axis_angle_to_matrix(wide * doubles(6, 3, seed=seed) / 3**0.5)
    least = checks.least_spread(R)
    for turn in doubles(10, 3, seed=seed + 1) / 10:
        other = rotations.mean_rotation(R) @ rotations.axis_angle_to_matrix(turn)
        assert least <= checks.spread(other, R) + 1e-9
    assert checks.spread(rotations.mean_rotation(R), R) <= 1.05 * least + 1e-9


@pytest.mark.parametrize("turn", [0, 0.03, 0.08, 0.3])
def test_the_open_exercise_is_judged_by_its_property(turn: float) -> None:
    """Whatever has hardly more spread than any other on all inputs is done."""

    def student(numbers: Any, representation: str) -> Tensor:
        mean = checks.mean_prediction(numbers, representation)
        # A single prediction has no spread of which there could be more.
        v = torch.tensor([turn if len(numbers) > 3 else 0, 0, 0], dtype=mean.dtype)
        return mean @ rotations.axis_angle_to_matrix(v)

    good = []
    rng = np.random.default_rng(checks.check_mean_prediction.seed)
    for _, numbers, name in checks.check_mean_prediction.inputs(rng):
        R = RotationHead(name).decode(numbers)
        got = checks.spread(student(numbers, name), R)
        good.append(got <= 1.05 * checks.least_spread(R) + 1e-5)
    assert (checks.check_mean_prediction(student).status == DONE) == all(good)
