"""The checks of chapter 5's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from book.tools.checks import Exercise
from posecore import rotations
from posecore.nets.rotation_heads import RotationHead

SECONDS = 20.0

Inputs = Iterator[tuple]


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(array, float))


def _with_values(rng: np.random.Generator, *values: float) -> np.ndarray:
    """A matrix with these singular values, the last with the sign of its determinant."""
    U, V = rotations.random_rotations(2, generator=rng)
    return U @ np.diag(values) @ V.T


# 1. The nearest rotation --------------------------------------------------------------------------


def nearest_rotation(M: Tensor) -> Tensor:
    """The rotations (N, 3, 3) nearest to matrices (N, 3, 3)."""
    return rotations.special_procrustes(M)


def _matrices(rng: np.random.Generator) -> Inputs:
    scaled = np.diag([3.0, 2, 1])[None]
    yield "a matrix that only stretches", _tensor(scaled)
    yield "two rotations", rotations.random_rotations(2, generator=0, dtype=torch.float64)
    yield "a matrix that stretches and mirrors", _tensor(scaled * [1, 1, -1])
    mirrored = [_with_values(rng, 3, 2, -1) for _ in range(3)]
    yield "three matrices that mirror", _tensor(np.stack(mirrored))
    yield "four random matrices", _tensor(rng.normal(size=(4, 3, 3)))
    mixed = [_with_values(rng, 2, 1, 0.5 * sign) for sign in (1, -1, 1, -1)]
    yield "two that mirror and two that do not", _tensor(np.stack(mixed))
    flat = [[[0.0, -3, 0], [2, 0, 0], [0, 0, 0]]]
    yield "a matrix whose determinant is 0", _tensor(np.array(flat))
    singular = [_with_values(rng, 2, 1, 0) for _ in range(3)]
    yield "three matrices of rank two", _tensor(np.stack(singular))
    yield "a reflection, of which many rotations are nearest", _tensor(np.diag([1.0, 1, -1])[None])
    yield "a matrix of zeros, where every rotation is", torch.zeros(1, 3, 3, dtype=torch.float64)
    yield "matrices as small as 1e-9", _tensor(1e-9 * rng.normal(size=(3, 3, 3)))
    yield "no matrices at all", torch.zeros(0, 3, 3, dtype=torch.float64)


def _is_nearest(answer: Tensor, M: Tensor) -> str:
    if answer.dtype != M.dtype:
        return f"expected numbers of the input's kind, {M.dtype}, got {answer.dtype}"
    off = M - nearest_rotation(M), M - answer
    best, got = (torch.linalg.matrix_norm(difference) for difference in off)
    for number in range(len(M)):
        if not rotations.is_rotation(answer[number]):
            determinant = float(torch.linalg.det(answer[number]))
            return (
                f"expected a rotation at [{number}], got a matrix that is none, "
                f"of determinant {determinant:.3g}"
            )
        if not got[number] <= best[number] + 1e-6:
            return (
                f"expected a rotation at [{number}] whose distance to M[{number}] is "
                f"{best[number]:.4g}, got one at the distance {got[number]:.4g}"
            )
    return ""


check_nearest_rotation = Exercise(
    nearest_rotation,
    _matrices,
    hints=(
        "torch.linalg.svd(M) gives U, s, Vh for all matrices at once, Vh being V^T. U @ Vh is the "
        "nearest orthogonal matrix; look at torch.linalg.det of it.",
        "Where d = torch.linalg.det(U @ Vh) is -1, flip the direction of the smallest singular "
        "value: change the sign of the last column of U, and only then take U @ Vh. There is one d "
        "for each matrix; d[:, None] fits the columns U[:, :, 2]. The sign of det(M) will not do: "
        "it is 0 for a flat matrix.",
    ),
    judge=_is_nearest,
    seconds=SECONDS,
)


# 2. Its gradient ----------------------------------------------------------------------------------


def procrustes_gradient(M: Tensor, G: Tensor) -> Tensor:
    """The gradient (3, 3) of a loss at M, from its gradient G (3, 3) at the nearest rotation."""
    M = M.detach().clone().requires_grad_()
    return torch.autograd.grad(rotations.special_procrustes(M), M, G)[0]


def _matrices_and_gradients(rng: np.random.Generator) -> Inputs:
    def gradient() -> Tensor:
        return _tensor(rng.normal(size=(3, 3)))

    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=torch.float64)
    stretch = _tensor(np.diag([3.0, 2, 1]))
    yield "a matrix that only stretches", stretch, quarter
    for _ in range(3):
        yield "a matrix that does not mirror", _tensor(_with_values(rng, 3, 2, 1)), gradient()
    yield "the identity, whose singular values are equal", torch.eye(3).double(), gradient()
    turned = rotations.random_rotations(generator=1, dtype=torch.float64)
    yield "a rotation", turned, gradient()
    yield "ten times a rotation", 10 * turned, gradient()
    yield "two equal singular values", _tensor(_with_values(rng, 2, 1, 1)), gradient()
    for _ in range(3):
        yield "a matrix that mirrors", _tensor(_with_values(rng, 3, 2, -1)), gradient()
    yield "a flat matrix, s_3 = 0", _tensor(np.diag([2.0, 1, 0])), gradient()
    yield "a matrix near a jump: s_2 + s_3 = 0.01", _tensor(_with_values(rng, 2, 1, -0.99)), quarter
    nearer = _tensor(_with_values(rng, 2, 1, -0.9995))
    yield "a matrix nearer to a jump: s_2 + s_3 = 0.0005", nearer, quarter


check_procrustes_gradient = Exercise(
    procrustes_gradient,
    _matrices_and_gradients,
    hints=(
        "The map from dM to dR is its own transpose: take G in the place of dM, so Y = U^T G V D, "
        "Z_ij = (Y_ij - Y_ji) / (s_i + s_j), and the gradient is U Z D V^T. torch.linalg.svd gives "
        "Vh = V^T.",
        "Three things go wrong at special matrices. D needs the sign of det(U @ Vh). s has that "
        "sign in its last entry. And the diagonal of Z is 0, also where s_3 + s_3 is: put 1 there "
        "before you divide.",
    ),
    tolerance=1e-4,  # near a jump, differences with steps of 1e-6 and sums + 1e-8 are still right
    seconds=SECONDS,
)


# 3. Six numbers -----------------------------------------------------------------------------------


def six_to_rotation(x: Tensor) -> Tensor:
    """The rotations (N, 3, 3) of six numbers each (N, 6), by Gram-Schmidt."""
    return rotations.rotation_6d_to_matrix(x)


def _six_numbers(rng: np.random.Generator) -> Inputs:
    yield "the first two columns of the identity", _tensor([[1.0, 0, 0, 0, 1, 0]])
    turned = rotations.random_rotations(3, generator=0, dtype=torch.float64)
    yield "columns of three rotations", rotations.matrix_to_rotation_6d(turned)
    yield "a first vector of another length", _tensor([[0.0, 5, 0, 0, 0, 1]])
    yield "a second vector of another length", _tensor([[0.0, 1, 0, 0, 0, 0.2]])
    yield "two vectors at 45 degrees", _tensor([[1.0, 0, 0, 1, 1, 0]])
    yield "two vectors at 135 degrees, of different lengths", _tensor([[2.0, 0, 0, -3, 3, 0]])
    yield "random numbers", _tensor(rng.normal(size=(4, 6)))
    yield "large and small numbers", _tensor(rng.normal(size=(3, 6)) * [[1e-3], [1], [1e3]])
    yield "two rows, as many as there are vectors", _tensor(rng.normal(size=(2, 6)))
    yield "numbers of a network, with a gradient", _tensor(rng.normal(size=(2, 6))).requires_grad_()
    yield "numbers in float32, as networks have them", _tensor(rng.normal(size=(2, 6))).float()
    yield "no rows at all", torch.zeros(0, 6, dtype=torch.float64)


def _is_gram_schmidt(answer: Tensor, x: Tensor) -> str:
    if x.requires_grad and not answer.requires_grad:
        return (
            "the numbers come from a network, but no gradient can go back through the result; "
            "use torch's functions only, and no torch.tensor(...) or .detach()"
        )
    expected = six_to_rotation(x).detach()
    wrong = ~torch.isclose(answer.detach().to(expected), expected, rtol=0, atol=1e-5)
    if not wrong.any():
        return _wrong_gradient(answer, x) if x.requires_grad else ""
    n, row, column = (int(i) for i in wrong.nonzero()[0])
    want, have = (float(R[n, row, column]) for R in (expected, answer))
    return f"expected {want:.4g} in row {row}, column {column} of rotation [{n}], got {have:.4g}"


def _wrong_gradient(answer: Tensor, x: Tensor) -> str:
    """For a right answer: whether what comes back through it is right, too."""
    weights = torch.linspace(-1, 2, answer.numel(), dtype=answer.dtype).reshape(answer.shape)
    (expected,) = torch.autograd.grad((weights * six_to_rotation(x)).sum(), x)
    (got,) = torch.autograd.grad((weights * answer).sum(), _leaf(answer), allow_unused=True)
    if got is not None and torch.allclose(got, expected, rtol=1e-4, atol=1e-6):
        return ""
    return (
        "the rotations are right, but not their gradient: part of it cannot go back to x; "
        "let no number of the way be torn out by .item(), float(...) or .detach()"
    )


def _leaf(answer: Tensor) -> Tensor:
    """What an answer was made of: the student's function got a copy of x."""
    nodes, seen = [answer.grad_fn], set()
    while nodes:
        node = nodes.pop()
        if hasattr(node, "variable"):
            return node.variable
        seen.add(node)
        nodes += [before for before, _ in node.next_functions if before and before not in seen]
    raise ValueError("expected rotations that were made of x")


check_six_to_rotation = Exercise(
    six_to_rotation,
    _six_numbers,
    hints=(
        "a, b = x[:, :3], x[:, 3:]. First a at length 1; then take away from b what lies along it, "
        "(r_1 . b) r_1, and only then bring the rest to length 1.",
        "torch.nn.functional.normalize(v, dim=-1) gives length 1, torch.linalg.cross(r_1, r_2) the "
        "third vector. They are columns: torch.stack([r_1, r_2, r_3], dim=-1).",
    ),
    judge=_is_gram_schmidt,
    seconds=SECONDS,
)


# 4. A representation with a hole ------------------------------------------------------------------


def to_five(R: Tensor, a: Tensor) -> Tensor:
    """Rotations (..., 3, 3) as five numbers (..., 5): the z axis, and the turn about it.

    The turn is the cosine and sine of the angle to the x axis, from the zero mark `a x d`.
    """
    x, d = R[..., 0], R[..., 2]
    mark, across = _zero_mark(d, a)
    turn = torch.stack([(x * mark).sum(-1), (x * across).sum(-1)], -1)
    return torch.cat([d, turn], -1)


def from_five(numbers: Tensor, a: Tensor) -> Tensor:
    """The rotations (..., 3, 3) of five numbers (..., 5), as `to_five` says them."""
    d = torch.nn.functional.normalize(numbers[..., :3], dim=-1)
    turn = torch.nn.functional.normalize(numbers[..., 3:], dim=-1)
    mark, across = _zero_mark(d, a)
    x = turn[..., :1] * mark + turn[..., 1:] * across
    return torch.stack([x, torch.linalg.cross(d, x), d], -1)


def _zero_mark(d: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
    mark = torch.nn.functional.normalize(torch.linalg.cross(a.expand_as(d), d), dim=-1)
    return mark, torch.linalg.cross(d, mark)


def hole_axis(R: Tensor, errors: Tensor) -> Tensor:
    """The axis (3,) along which the z axes of the worst rotations point, of either sign."""
    worst = errors.topk(max(1, len(errors) // 50)).indices
    d = R[worst, :, 2]
    return torch.linalg.eigh(d.T @ d).eigenvectors[:, -1]


def blurred_errors(R: Tensor, a: Tensor, generator: torch.Generator) -> Tensor:
    """Errors (N,) of a network that is nothing but smooth: it says the mean of what is near."""
    turns = 0.2 * torch.randn(len(R), 6, 3, generator=generator, dtype=R.dtype)
    turns = torch.cat([turns, -turns], 1)  # in pairs, so that few of them are enough
    near = rotations.axis_angle_to_matrix(turns) @ R[:, None]
    return rotations.geodesic_distance(from_five(to_five(near, a).mean(1), a), R)


def _rotations_and_errors(rng: np.random.Generator) -> Inputs:
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))

    def test_set(a: list[float] | Tensor, wrong_labels: int = 0) -> tuple[Tensor, Tensor]:
        a = torch.nn.functional.normalize(torch.as_tensor(a, dtype=torch.float64), dim=-1)
        R = rotations.random_rotations(4000, generator=generator, dtype=torch.float64)
        errors = blurred_errors(R, a, generator)
        errors[:wrong_labels] = torch.pi  # whatever was predicted, the label is another rotation
        return R, errors

    yield "an axis along y", *test_set([0, 1, 0])
    yield "an axis along z", *test_set([0, 0, 1])
    yield "a slanted axis", *test_set([1, 2, 2])
    a, b = torch.randn(2, 3, generator=generator, dtype=torch.float64)
    yield "a random axis", *test_set(a)
    yield "a random axis, ten wrong labels", *test_set(b, wrong_labels=10)


def _is_the_hole(answer: Tensor, R: Tensor, errors: Tensor) -> str:
    length = float(torch.linalg.vector_norm(answer))
    if not abs(length - 1) < 1e-3:
        return f"expected a vector of length 1, got length {length:.4g}"
    cosine = float((answer.to(R) @ hole_axis(R, errors)).abs().clamp(max=1))
    off = np.rad2deg(np.arccos(cosine))
    return f"expected the axis to 8 degrees, got one {off:.0f} degrees off" if off > 8 else ""


check_hole_axis = Exercise(
    hole_axis,
    _rotations_and_errors,
    hints=(
        "Sort by error and look at the worst 2 % only, not at the one worst. What do their z axes, "
        "R[:, :, 2], have in common? Draw them, or print some.",
        "They point along the axis or against it, so their plain mean is near 0. The line that "
        "runs through both heaps is the eigenvector of d.T @ d with the largest eigenvalue: "
        "torch.linalg.eigh(d.T @ d).eigenvectors[:, -1].",
    ),
    judge=_is_the_hole,
    seconds=SECONDS,
)


# 5. The mean of several predictions ---------------------------------------------------------------

REPRESENTATIONS = ("quaternion", "axis_angle", "euler", "6d", "procrustes")
ABOVE_BEST = 1.05


def mean_prediction(numbers: Tensor, representation: str) -> Tensor:
    """The mean rotation (3, 3) of N predictions (N, size)."""
    R = RotationHead(representation).decode(numbers)
    return rotations.special_procrustes(R.mean(0))


def spread(mean: Tensor, R: Tensor) -> Tensor:
    """Root mean square angle between a rotation (3, 3) and N others (N, 3, 3); radians."""
    return rotations.geodesic_distance(mean, R).square().mean().sqrt()


def least_spread(R: Tensor) -> Tensor:
    """The least spread that any mean of (N, 3, 3) has; radians."""
    mean = rotations.special_procrustes(R.mean(0))
    for _ in range(8):  # the mean of the axis-angles is the way downhill
        step = rotations.matrix_to_axis_angle(mean.mT @ R).mean(0)
        mean = mean @ rotations.axis_angle_to_matrix(step)
    return spread(mean, R)


def predictions(
    centre: Tensor, count: int, angle: float, representation: str, generator: torch.Generator
) -> Tensor:
    """Numbers (count, size) for rotations about `angle` radians away from a centre."""
    turns = angle / 3**0.5 * torch.randn(count, 3, generator=generator, dtype=centre.dtype)
    return RotationHead(representation).encode(centre @ rotations.axis_angle_to_matrix(turns))


def _predictions(rng: np.random.Generator) -> Inputs:
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    identity, half = torch.eye(3).double(), torch.diag(torch.tensor([-1.0, 1, -1])).double()

    def some(centre: Tensor, name: str, count: int = 8, angle: float = 0.4) -> Tensor:
        return predictions(centre, count, angle, name, generator)

    for name in REPRESENTATIONS:
        yield "predictions near the identity", some(identity, name), name
    for name in REPRESENTATIONS:
        first, second, third = rotations.random_rotations(
            3, generator=generator, dtype=torch.float64
        )
        yield "a single prediction", some(first, name, 1), name
        yield "predictions near half a turn", some(half, name), name
        yield "predictions anywhere", some(first, name), name
        yield "predictions elsewhere", some(second, name), name
        yield "predictions that are far apart", some(third, name, 20, 0.9), name
    yield "three equal predictions", some(half, "euler", 1).expand(3, -1).clone(), "euler"
    signs = torch.tensor([1.0, -1] * 4, dtype=torch.float64)[:, None]
    yield "quaternions of both signs", signs * some(identity, "quaternion"), "quaternion"
    for name in ("quaternion", "6d", "procrustes"):
        numbers = some(identity, name)
        yield "numbers of different lengths", _one_is_long(numbers, name), name
    more = torch.tensor([0, 2 * torch.pi, 0], dtype=torch.float64)
    full = some(identity, "euler", 4)
    yield "angles that went round once more", torch.cat([full[:2], full[2:] + more]), "euler"
    yield "matrices that stretch", _one_is_wide(some(identity, "procrustes")), "procrustes"


def _furthest(R: Tensor) -> Tensor:
    """The index of the rotation that is furthest from the mean: it must not count for more."""
    return rotations.geodesic_distance(rotations.mean_rotation(R), R).argmax()


def _one_is_long(numbers: Tensor, representation: str) -> Tensor:
    """The numbers of one prediction are much longer than the others."""
    lengths = torch.full((len(numbers), 1), 0.5, dtype=numbers.dtype)
    lengths[_furthest(RotationHead(representation).decode(numbers))] = 9
    return lengths * numbers


def _one_is_wide(numbers: Tensor) -> Tensor:
    """Rotations as matrices that stretch: one by y and z, all others by x."""
    R = numbers.unflatten(-1, (3, 3))
    stretch = torch.tensor([20.0, 0.2, 0.2], dtype=R.dtype).expand(len(R), 3).clone()
    stretch[_furthest(R)] = torch.tensor([1, 10, 10], dtype=R.dtype)
    return (R * stretch[:, None, :]).flatten(1)


def _is_a_mean(answer: Tensor, numbers: Tensor, representation: str) -> str:
    if not rotations.is_rotation(answer):
        return "expected a rotation, got a matrix that stretches or mirrors"
    R = RotationHead(representation).decode(numbers)
    best, got = least_spread(R), spread(answer.to(R), R)
    if got <= ABOVE_BEST * best + 1e-5:
        return ""
    return (
        f"expected a root mean square angle to the predictions of at most "
        f"{torch.rad2deg(ABOVE_BEST * best):.3g} degrees, got {torch.rad2deg(got):.3g} degrees"
    )


check_mean_prediction = Exercise(
    mean_prediction,
    _predictions,
    hints=(
        "Which numbers may be averaged? Not those of every representation: q and -q are one "
        "rotation, and their mean is 0. Bring all predictions to one representation without tears.",
        "RotationHead(representation).decode(numbers) gives matrices (N, 3, 3), whatever the "
        "representation. Their mean is no rotation, but exercise 1 finds the rotation nearest to "
        "it.",
    ),
    judge=_is_a_mean,
    seconds=SECONDS,
)
