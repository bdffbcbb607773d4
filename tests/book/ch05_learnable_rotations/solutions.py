"""Chapter 5's exercises, solved as students would: rightly and wrongly."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from book.ch05_learnable_rotations import checks
from posecore import rotations
from posecore.nets.rotation_heads import RotationHead
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


# 1. The nearest rotation --------------------------------------------------------------------------


@right("nearest_rotation")
def nearest_one_by_one(M: Any) -> Tensor:
    result = torch.zeros_like(M)
    for i, matrix in enumerate(M):
        U, _, Vh = torch.linalg.svd(matrix)
        if torch.linalg.det(U) * torch.linalg.det(Vh) < 0:
            U[:, 2] = -U[:, 2]
        result[i] = U @ Vh
    return result


@right("nearest_rotation")
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


@wrong("nearest_rotation", "a matrix that stretches and mirrors", "determinant -1")
def nearest_with_reflections(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    return U @ Vh


@wrong("nearest_rotation", "a matrix whose determinant is 0", "0")
def nearest_by_the_sign_of_det_M(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    U[:, :, 2] *= torch.linalg.det(M).sign()[:, None]
    return U @ Vh


@wrong("nearest_rotation", "a matrix that stretches and mirrors", "distance")
def nearest_by_the_first_column(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    U[:, :, 0] *= torch.linalg.det(U @ Vh)[:, None]
    return U @ Vh


@wrong("nearest_rotation", "a matrix that stretches and mirrors", "distance")
def nearest_by_a_turned_sign(M: Any) -> Tensor:
    R = nearest_with_reflections(M)
    return R * torch.linalg.det(R)[:, None, None]


@wrong("nearest_rotation", "three matrices that mirror", "distance")
def nearest_flipping_the_result(M: Any) -> Tensor:
    R = nearest_with_reflections(M)
    R[:, :, 2] *= torch.linalg.det(R)[:, None]
    return R


@wrong("nearest_rotation", "four random matrices", "got")
def nearest_for_all_or_none(M: Any) -> Tensor:
    U, _, Vh = torch.linalg.svd(M)
    if len(M) and torch.linalg.det(U @ Vh)[0] < 0:
        U[:, :, 2] *= -1
    return U @ Vh


@wrong("nearest_rotation", "two rotations", "got")
def nearest_with_vh_for_v(M: Any) -> Tensor:
    U, _, V = torch.linalg.svd(M)
    U[:, :, 2] *= torch.linalg.det(U @ V)[:, None]
    return U @ V.mT


@wrong("nearest_rotation", "three matrices that mirror", "distance")
def nearest_by_gram_schmidt(M: Any) -> Tensor:
    return RotationHead("6d").decode(torch.cat([M[:, :, 0], M[:, :, 1]], -1))


@wrong("nearest_rotation", "a matrix that only stretches", "torch.float32")
def nearest_in_float32(M: Any) -> Tensor:
    return checks.nearest_rotation(M.float())


# 2. Its gradient ----------------------------------------------------------------------------------


def factors(M: Any, G: Any) -> tuple[Tensor, ...]:
    U, s, Vh = torch.linalg.svd(M)
    D = torch.diag(torch.tensor([1, 1, torch.linalg.det(U @ Vh)]).to(M))
    return U, s * D.diagonal(), D @ Vh, U.T @ G @ Vh.T @ D


@right("procrustes_gradient")
def gradient_by_entries(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    Z = torch.zeros_like(M)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        Z[i, j] = (Y[i, j] - Y[j, i]) / (s[i] + s[j])
        Z[j, i] = -Z[i, j]
    return U @ Z @ DVh


@right("procrustes_gradient")
def gradient_by_a_linear_system(M: Any, G: Any) -> Tensor:
    """(tr(P) I - P) omega = axial, as the library has it, solved without an SVD's derivative."""
    R = checks.nearest_rotation(M[None])[0]
    P = R.T @ M
    omega = torch.linalg.solve(P.trace() * torch.eye(3).to(P) - P, 2 * rotations.vee(R.T @ G))
    return R @ rotations.hat(omega)


@right("procrustes_gradient")
def gradient_by_differences(M: Any, G: Any) -> Tensor:
    steps = 1e-6 * torch.eye(9, dtype=M.dtype).reshape(9, 3, 3)
    after, before = checks.nearest_rotation(M + steps), checks.nearest_rotation(M - steps)
    return ((after - before) * G).sum((1, 2)).reshape(3, 3) / 2e-6


@wrong("procrustes_gradient", "the identity, whose singular values are equal", "got")
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


@wrong("procrustes_gradient", "a flat matrix, s_3 = 0", "nan")
def gradient_with_a_hole_on_the_diagonal(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s)) @ DVh


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_with_differences_of_values(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G, sign=-1.0)


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_undivided(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G, power=0.0)


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_of_the_other_sign(M: Any, G: Any) -> Tensor:
    return -gradient_at_once(M, G)


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_halved(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G) / 2


@wrong("procrustes_gradient", "a matrix that mirrors", "got")
def gradient_without_the_sign_of_s(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    s = s.abs()
    sums = s[:, None] + s
    sums.fill_diagonal_(1)
    return U @ ((Y - Y.T) / sums) @ DVh


@wrong("procrustes_gradient", "a matrix that mirrors", "got")
def gradient_without_the_determinant(M: Any, G: Any) -> Tensor:
    U, s, Vh = torch.linalg.svd(M)
    Y = U.T @ G @ Vh.T
    sums = s[:, None] + s
    sums.fill_diagonal_(1)
    return U @ ((Y - Y.T) / sums) @ Vh


@right("procrustes_gradient")
def gradient_with_an_epsilon(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s + 1e-8)) @ DVh


@wrong("procrustes_gradient", "a matrix nearer to a jump: s_2 + s_3 = 0.0005", "got")
def gradient_with_clamped_sums(M: Any, G: Any) -> Tensor:
    U, s, DVh, Y = factors(M, G)
    return U @ ((Y - Y.T) / (s[:, None] + s).clamp(min=1e-3)) @ DVh


@wrong("procrustes_gradient", "a flat matrix, s_3 = 0", "got")
def gradient_of_zero_where_flat(M: Any, G: Any) -> Tensor:
    return gradient_at_once(M, G) * (torch.linalg.det(M).abs() > 1e-9)


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_passed_on(M: Any, G: Any) -> Tensor:
    return G


@wrong("procrustes_gradient", "a matrix that only stretches", "got")
def gradient_that_projects(M: Any, G: Any) -> Tensor:
    R = checks.nearest_rotation(M[None])[0]
    return (G - R @ G.T @ R) / 2  # right at rotations, where s_i + s_j = 2


# 3. Six numbers -----------------------------------------------------------------------------------


@right("six_to_rotation")
def six_by_two_crosses(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_1, r_3 = normalize(a, dim=1), normalize(torch.linalg.cross(a, b), dim=1)
    return torch.stack([r_1, torch.linalg.cross(r_3, r_1), r_3], 2)


@wrong("six_to_rotation", "two vectors at 45 degrees", "got")
def six_without_leaning(x: Any) -> Tensor:
    r_1, r_2 = normalize(x[:, :3], dim=1), normalize(x[:, 3:], dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


@wrong("six_to_rotation", "columns of three rotations", "got")
def six_as_rows(x: Any) -> Tensor:
    return six_by_two_crosses(x).mT


@wrong("six_to_rotation", "a second vector of another length", "got")
def six_without_the_last_length(x: Any) -> Tensor:
    r_1, b = normalize(x[:, :3], dim=1), x[:, 3:]
    r_2 = b - (r_1 * b).sum(1, keepdim=True) * r_1
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


@wrong("six_to_rotation", "two vectors at 135 degrees", "got")
def six_by_a_long_first(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_1 = normalize(a, dim=1)
    r_2 = normalize(b - (a * b).sum(1, keepdim=True) * a, dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


@wrong("six_to_rotation", "the first two columns", "got")
def six_mirrored(x: Any) -> Tensor:
    return six_by_two_crosses(x) * torch.tensor([1, 1, -1])


@wrong("six_to_rotation", "two vectors at 45 degrees", "got")
def six_beginning_with_b(x: Any) -> Tensor:
    a, b = x[:, :3], x[:, 3:]
    r_2 = normalize(b, dim=1)
    r_1 = normalize(a - (r_2 * a).sum(1, keepdim=True) * r_2, dim=1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 2)


@wrong("six_to_rotation", "the first two columns", "got")
def six_in_turns(x: Any) -> Tensor:
    return six_by_two_crosses(torch.cat([x[:, ::2], x[:, 1::2]], 1))


@wrong("six_to_rotation", "numbers of a network, with a gradient", "no gradient")
def six_cut_off(x: Any) -> Tensor:
    return six_by_two_crosses(x.detach())


@right("six_to_rotation")
def six_one_by_one(x: Any) -> Tensor:
    result = x.new_zeros(len(x), 3, 3)
    for i, numbers in enumerate(x):
        result[i] = six_by_two_crosses(numbers[None])[0]
    return result


@wrong("six_to_rotation", "numbers of a network, with a gradient", "not their gradient")
def six_with_a_number_torn_out(x: Any) -> Tensor:
    result = x.new_zeros(len(x), 3, 3)
    for i, numbers in enumerate(x):
        r_1 = normalize(numbers[:3], dim=0)
        r_2 = normalize(numbers[3:] - float(r_1 @ numbers[3:]) * r_1, dim=0)
        result[i] = torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], 1)
    return result


@wrong("six_to_rotation", "numbers of a network, with a gradient", "not their gradient")
def six_with_a_gradient_of_its_own(x: Any) -> Tensor:
    return six_cut_off(x) * torch.ones(1, dtype=x.dtype, requires_grad=True)


@wrong("six_to_rotation", "the first two columns", "expected a tensor")
def six_in_numpy(x: Any) -> np.ndarray:
    return six_by_two_crosses(x).detach().numpy()


@wrong("six_to_rotation", "numbers in float32", "RuntimeError")
def six_with_constants(x: Any) -> Tensor:
    columns = six_by_two_crosses(x)
    return columns @ torch.eye(3, dtype=torch.float64)  # fails on a network's float32


# 4. A representation with a hole ------------------------------------------------------------------


@right("hole_axis")
def hole_by_weights(R: Any, errors: Any) -> Tensor:
    """No threshold: what is spread evenly adds a multiple of I, and changes no eigenvector."""
    d = R[:, :, 2] * errors[:, None].clamp(max=0.5)
    return torch.linalg.svd(d, full_matrices=False)[2][0]


@right("hole_axis")
def hole_by_search(R: Any, errors: Any) -> Tensor:
    """The candidate direction within 15 degrees of which the errors are the largest."""
    candidates = R[::16, :, 2]
    near = (candidates @ R[:, :, 2].T).abs() > np.cos(np.deg2rad(15))
    value = torch.stack([errors[some].mean() for some in near])
    best = candidates[value.topk(4).indices]
    best = best * (best @ best[0]).sign()[:, None]
    return normalize(best.mean(0), dim=0)


@wrong("hole_axis", "a random axis, ten wrong labels", "degrees off")
def hole_by_weights_of_any_size(R: Any, errors: Any) -> Tensor:
    d = R[:, :, 2] * errors[:, None]
    return torch.linalg.svd(d, full_matrices=False)[2][0]


@wrong("hole_axis", "a random axis, ten wrong labels", "degrees off")
def hole_by_the_worst(R: Any, errors: Any) -> Tensor:
    return R[errors.argmax(), :, 2]


@wrong("hole_axis", "an axis along z", "degrees off")
def hole_by_the_mean(R: Any, errors: Any) -> Tensor:
    worst = errors.topk(80).indices
    return normalize(R[worst, :, 2].mean(0), dim=0)


@wrong("hole_axis", "an axis along y", "degrees off")
def hole_by_rows(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R.mT, errors)


@wrong("hole_axis", "an axis along y", "degrees off")
def hole_of_the_x_axis(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R[:, :, [1, 2, 0]], errors)


@wrong("hole_axis", "an axis along y", "degrees off")
def hole_by_the_rotation_axis(R: Any, errors: Any) -> Tensor:
    v = rotations.matrix_to_axis_angle(R[errors.topk(80).indices])
    return torch.linalg.eigh(v.T @ v).eigenvectors[:, -1]


@wrong("hole_axis", "an axis along y", "degrees off")
def hole_by_the_smallest_eigenvalue(R: Any, errors: Any) -> Tensor:
    d = R[errors.topk(80).indices, :, 2]
    return torch.linalg.eigh(d.T @ d).eigenvectors[:, 0]


@wrong("hole_axis", "an axis along y", "degrees off")
def hole_of_the_best(R: Any, errors: Any) -> Tensor:
    return checks.hole_axis(R, -errors)


@wrong("hole_axis", "an axis along y", "length 7")
def hole_unscaled(R: Any, errors: Any) -> Tensor:
    return 7 * checks.hole_axis(R, errors)


@wrong("hole_axis", "an axis along z", "degrees off")
def hole_along_y(R: Any, errors: Any) -> Tensor:
    return torch.tensor([0.0, 1, 0])


# 5. The mean of several predictions ---------------------------------------------------------------


@right("mean_prediction")
def mean_by_the_library(numbers: Any, representation: str) -> Tensor:
    return rotations.mean_rotation(RotationHead(representation).decode(numbers))


@right("mean_prediction")
def mean_by_quaternions(numbers: Any, representation: str) -> Tensor:
    """The first eigenvector knows no sign (Markley 2007)."""
    q = rotations.matrix_to_quaternion(RotationHead(representation).decode(numbers))
    return rotations.quaternion_to_matrix(torch.linalg.eigh(q.T @ q).eigenvectors[:, -1])


@right("mean_prediction")
def mean_of_angles(numbers: Any, representation: str) -> Tensor:
    """Downhill from the first: the mean that minimises the sum of squared angles."""
    R = RotationHead(representation).decode(numbers)
    mean = R[0]
    for _ in range(30):
        step = rotations.matrix_to_axis_angle(mean.T @ R).mean(0)
        mean = mean @ rotations.axis_angle_to_matrix(step)
    return mean


@right("mean_prediction")
def mean_of_quaternions_on_one_side(numbers: Any, representation: str) -> Tensor:
    q = rotations.matrix_to_quaternion(RotationHead(representation).decode(numbers))
    reference = rotations.matrix_to_quaternion(mean_by_the_library(numbers, representation))
    return rotations.quaternion_to_matrix((q * (q @ reference).sign()[:, None]).mean(0))


@wrong("mean_prediction", "predictions near half a turn", "degrees")
def mean_of_numbers(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers.mean(0))


@wrong("mean_prediction", "predictions near half a turn", "degrees")
def mean_of_unit_numbers(numbers: Any, representation: str) -> Tensor:
    if representation in ("quaternion", "6d", "procrustes"):
        numbers = normalize(numbers, dim=1)
    return mean_of_numbers(numbers, representation)


@wrong("mean_prediction", "numbers of different lengths", "degrees")
def mean_of_quaternions_as_long_as_they_are(numbers: Any, representation: str) -> Tensor:
    if representation == "quaternion":
        numbers = numbers * (numbers @ numbers[0]).sign()[:, None]
        return mean_of_numbers(numbers, representation)
    return mean_by_the_library(numbers, representation)


@wrong("mean_prediction", "matrices that stretch", "degrees")
def mean_of_unit_matrices(numbers: Any, representation: str) -> Tensor:
    if representation == "procrustes":
        return mean_of_unit_numbers(numbers, representation)
    return mean_by_the_library(numbers, representation)


@wrong("mean_prediction", "predictions near the identity", "a matrix that stretches")
def mean_matrix(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers).mean(0)


@wrong("mean_prediction", "predictions near the identity", "degrees")
def mean_by_the_first(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers)[0]


@wrong("mean_prediction", "predictions near the identity", "degrees")
def mean_by_the_middle_one(numbers: Any, representation: str) -> Tensor:
    R = RotationHead(representation).decode(numbers)
    return min(R, key=lambda one: float(checks.spread(one, R)))


@wrong("mean_prediction", "predictions near half a turn", "degrees")
def mean_of_axis_angles(numbers: Any, representation: str) -> Tensor:
    R = RotationHead(representation).decode(numbers)
    return rotations.axis_angle_to_matrix(rotations.matrix_to_axis_angle(R).mean(0))


@wrong("mean_prediction", "predictions near the identity", "mirrors")
def mean_with_reflections(numbers: Any, representation: str) -> Tensor:
    U, _, Vh = torch.linalg.svd(RotationHead(representation).decode(numbers).mean(0))
    return U @ torch.diag(torch.tensor([1.0, 1, -1]).to(U)) @ Vh


@wrong("mean_prediction", "predictions near the identity", "expected shape (3, 3)")
def means_of_each(numbers: Any, representation: str) -> Tensor:
    return RotationHead(representation).decode(numbers)
