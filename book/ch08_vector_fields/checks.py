"""The checks of chapter 8's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from book.tools.checks import Exercise
from book.tools.gradients import gradient_at_leaf
from posecore import rotations
from posecore.methods.vector_field import losses, refinement

SECONDS = 20.0

Inputs = Iterator[tuple]


def _tensor(values: object) -> Tensor:
    return torch.from_numpy(np.array(values, float))


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# 1. Where two rays meet ---------------------------------------------------------------------------

PARALLEL = 1e-6


def intersect_rays(p: Tensor, u: Tensor, q: Tensor, v: Tensor) -> Tensor:
    """Where rays from p (N, 2) along u and rays from q along v meet (N, 2), NaN if they do not."""
    u, v = normalize(u, dim=-1), normalize(v, dim=-1)
    sine = _cross(u, v)
    parallel = sine.abs() < PARALLEL
    sine = torch.where(parallel, torch.ones_like(sine), sine)
    along_u, along_v = _cross(q - p, v) / sine, _cross(q - p, u) / sine
    meet = ~parallel & (along_u >= 0) & (along_v >= 0)
    return torch.where(meet[:, None], p + along_u[:, None] * u, torch.nan)


def _rays(rng: np.random.Generator) -> Inputs:
    def rays(*four: object) -> tuple[Tensor, ...]:
        return tuple(_tensor([one]) for one in four)

    def some(count: int, lengths: float = 1.0) -> tuple[Tensor, ...]:
        p, u, q, v = rng.normal(size=(4, count, 2))
        return tuple(_tensor(one) for one in (100 * p, lengths * u, 100 * q, v / lengths))

    yield "two rays at a right angle", *rays([0, 2], [1, 0], [5, 6], [0, -1])
    yield "a slanted ray and a level one", *rays([0, 0], [1, 1], [9, 4], [-1, 0])
    yield "directions of other lengths", *rays([0, 0], [3, 3], [9, 4], [-0.1, 0])
    yield "parallel rays side by side", *rays([0, 0], [1, 2], [1, 0], [1, 2])
    first, times = np.array([0.1, 0.3]), 1.1
    yield "parallel rays, but for rounding", *rays([0, 0], first, [1, 0], times * first)
    yield "rays in opposite directions", *rays([0, 0], [1, 2], [1, 0], [-2, -4])
    yield "two rays on one line", *rays([0, 0], [1, 2], [3, 6], [-1, -2])
    yield "a crossing behind the first pixel", *rays([0, 2], [-1, 0], [5, 6], [0, -1])
    yield "a crossing behind the second pixel", *rays([0, 2], [1, 0], [5, 6], [0, 1])
    yield "a crossing behind both pixels", *rays([0, 2], [-1, 0], [5, 6], [0, 1])
    yield "the first pixel on the second ray", *rays([3, 0], [0, 1], [0, 0], [1, 0])
    yield "two rays from one pixel", *rays([3, 1], [0, 1], [3, 1], [1, 0])
    yield "rays at 0.06 degrees", *rays([0, 0], [1, 0], [0, -1], [1, 0.001])
    yield "directions as short as 1e-4", *rays([0, 0], [1e-4, 1e-4], [9, 4], [-1e-4, 0])
    yield "directions as long as 1e4", *rays([0, 0], [1e4, 2e4], [1, 0], [1e4, 2e4 + 1e-6])
    for count in (6, 2, 6):
        yield "random rays", *some(count)
    yield "random rays, long and short directions", *some(6, 1e3)
    yield "no rays at all", *some(0)


check_intersect_rays = Exercise(
    intersect_rays,
    _rays,
    hints=(
        "Bring u and v to length 1 and write c(a, b) = a_x b_y - a_y b_x. Apply c(., v) to "
        "p + s u = q + r v: it leaves s c(u, v) = c(q - p, v). And c(., u) leaves r.",
        "c(u, v) is the sine of the angle: below 1e-6 in size, the rays are parallel. They meet "
        "where they are not, and s >= 0, and r >= 0. "
        "torch.where(meet[:, None], p + s[:, None] * u, torch.nan).",
    ),
    seconds=SECONDS,
)


# 2. Votes -----------------------------------------------------------------------------------------


def count_inliers(pixels: Tensor, vectors: Tensor, points: Tensor, threshold: float) -> Tensor:
    """For each of the points (H, 2), how many of the pixels (P, 2) point to it (H,)."""
    to = normalize(points[:, None] - pixels, dim=-1)  # (H, P, 2), zero where a pixel is the point
    cosines = (to * normalize(vectors, dim=-1)).sum(-1)
    return (cosines > threshold).sum(1)


def _voters(rng: np.random.Generator) -> Inputs:
    corner, right = _tensor([[0, 0]]), _tensor([[1, 0]])
    ahead = _tensor([[5, 0], [5, 0.5], [5, 1], [0, 5]])
    yield "points ahead, and 6, 11 and 90 degrees off", corner, right, ahead, 0.99
    yield "a point behind the pixel", corner, right, _tensor([[-5, 0]]), 0.99
    yield "a vector of length 7", corner, 7 * right, ahead, 0.99
    yield "a vector of length 0.1", corner, 0.1 * right, ahead, 0.99
    yield "a narrow threshold", corner, right, ahead, 0.9999
    two, to_the_right = _tensor([[0, 0], [4, 0]]), _tensor([[1, 0], [1, 0]])
    yield "a pixel on the point itself", two, to_the_right, two[1:], 0.99
    zero = _tensor([[0, 0], [1, 0]])
    yield "a pixel whose vector is 0", _tensor([[0, 0], [9, 0]]), zero, _tensor([[20, 0]]), 0.99
    for count, threshold in ((40, 0.99), (40, 0.9), (3, 0.5)):
        pixels, keypoint = rng.uniform(0, 100, size=(count, 2)), rng.uniform(0, 100, size=2)
        angles = np.arctan2(*(keypoint - pixels).T[::-1]) + 0.15 * rng.normal(size=count)
        angles[::3] += np.pi
        lengths = rng.uniform(0.2, 3, size=(count, 1))
        vectors = lengths * np.stack([np.cos(angles), np.sin(angles)], -1)
        points = keypoint + 4 * rng.normal(size=(5, 2))
        some = (_tensor(pixels), _tensor(vectors), _tensor(points))
        yield f"a field of {count} pixels", *some, threshold
    yield "as many points as pixels", some[0], some[1], some[2][:3], 0.9
    yield "no points at all", some[0], some[1], some[2][:0], 0.9
    yield "no pixels at all", some[0][:0], some[1][:0], some[2], 0.9


check_count_inliers = Exercise(
    count_inliers,
    _voters,
    hints=(
        "points[:, None] - pixels has shape (H, P, 2): from every pixel to every point. Multiply "
        "with the vectors, add up over the last dimension, and divide by both lengths: cosines "
        "(H, P).",
        "Three traps. The sign counts: who points away gives no vote. A network's vectors have any "
        "length. And a length may be 0, of the vector or of the way: F.normalize(..., dim=-1) "
        "leaves a 0 as it is, and its cosine is then 0.",
    ),
    seconds=SECONDS,
)


# 3. The projection loss and its blind spot --------------------------------------------------------


def projection_loss(predicted: Tensor, target: Tensor) -> Tensor:
    """Mean smooth-L1 distance of keypoints from the lines along predicted vectors (N, 2)."""
    return losses.projection_loss(predicted, target)


def _predictions(rng: np.random.Generator) -> Inputs:
    def said(values: object) -> Tensor:
        return _tensor(values).requires_grad_()

    yield "a vector 0.5 px beside a keypoint", said([[1, 0]]), _tensor([[20, 0.5]])
    yield "a vector 3 px beside a keypoint", said([[1, 0]]), _tensor([[20, 3]])
    yield "the same, on the other side", said([[1, 0]]), _tensor([[20, -3]])
    yield "a vector of length 5", said([[0, 5]]), _tensor([[3, 20]])
    yield "a vector of length 0.01", said([[0, 0.01]]), _tensor([[3, 20]])
    yield "two vectors, of which one is right", said([[1, 0], [0, 1]]), _tensor([[9, 2], [0, 9]])
    for count in (1, 5, 2):
        target = rng.normal(size=(count, 2)) * [[30]]
        predicted = target / 30 + 0.1 * rng.normal(size=(count, 2))
        yield "random vectors", said(predicted), _tensor(target)
    at_keypoint = _tensor([[0, 0], [0, 4]])
    yield "a target of 0: the pixel is the keypoint", said([[1, 0], [1, 1]]), at_keypoint
    yield "a predicted vector of 0", said([[0, 0], [1, 1]]), _tensor([[3, 4], [0, 4]])
    yield "no vectors at all", said(np.zeros((0, 2))), _tensor(np.zeros((0, 2)))


def _is_the_loss(answer: Tensor, predicted: Tensor, target: Tensor) -> str:
    expected = projection_loss(predicted, target)
    got, want = float(answer.detach()), float(expected.detach())
    if not abs(got - want) <= 1e-6 * (1 + abs(want)):
        return f"expected {want:.6g}, got {got:.6g}"
    if not len(predicted):
        return ""
    gradient = gradient_at_leaf(answer)
    if gradient is None:
        return "no gradient can go back through the result to the predicted vectors"
    wanted = torch.autograd.grad(expected, predicted)[0]
    wrong = ~torch.isclose(gradient.to(wanted), wanted, rtol=1e-4, atol=1e-6)
    if not wrong.any():
        return ""
    n = int(wrong.any(-1).nonzero()[0])
    want, have = ([round(float(x), 6) for x in one[n]] for one in (wanted, gradient))
    return f"the loss is right, but expected the gradient {want} at the vector [{n}], got {have}"


check_projection_loss = Exercise(
    projection_loss,
    _predictions,
    hints=(
        "n is the predicted vector turned by a quarter: torch.stack([p_y, -p_x], -1). First bring "
        "it to length 1, then take its scalar product with the target: that is d, in pixels.",
        "torch.nn.functional.normalize(n, dim=-1) leaves a vector of 0 as it is, and its gradient "
        "is finite; torch.where after a division by 0 would not help the gradient. "
        "smooth_l1_loss(d, torch.zeros_like(d)) takes the mean, which does not exist for N = 0.",
    ),
    judge=_is_the_loss,
    seconds=SECONDS,
)


def blind_prediction(target: Tensor) -> Tensor:
    """Vectors (N, 2) of length 1 that are all wrong, and on which the projection loss is 0."""
    return -normalize(target, dim=-1)


def _targets(rng: np.random.Generator) -> Inputs:
    yield "one target to the right", _tensor([[30, 0]])
    yield "one slanted target", _tensor([[-3, 4]])
    for count in (6, 2):
        yield "random targets", _tensor(30 * rng.normal(size=(count, 2)))
    yield "targets near and far", _tensor(rng.normal(size=(3, 2)) * [[0.1], [10], [1000]])
    yield "no targets at all", _tensor(np.zeros((0, 2)))


def _is_blind(answer: Tensor, target: Tensor) -> str:
    answer = answer.detach().to(target)
    for number, (said, wanted) in enumerate(zip(answer, target, strict=True)):
        length = float(said.norm())
        if not abs(length - 1) < 1e-6:
            return f"expected vectors of length 1, got length {length:.4g} at [{number}]"
        cosine = float(said @ wanted / wanted.norm())
        if not cosine < 0:
            off = np.rad2deg(np.arccos(min(max(cosine, -1), 1)))
            return f"expected vectors more than 90 degrees off, got {off:.3g} at [{number}]"
    loss = float(projection_loss(answer, target))
    return "" if loss <= 1e-12 else f"expected a projection loss of 0, got {loss:.4g}"


check_blind_prediction = Exercise(
    blind_prediction,
    _targets,
    hints=(
        "The loss measures the distance from a line. Which other vector lies on the same line?",
        "A line has two directions, and one of them is right. Mind the length.",
    ),
    judge=_is_blind,
    seconds=SECONDS,
)


# 4. The mean and the covariance of hypotheses -----------------------------------------------------


def mean_and_covariance(points: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """The weighted mean (2,) of points (H, 2), and their covariance (2, 2)."""
    points, weights = points[weights > 0], weights[weights > 0]
    if not len(weights):
        raise ValueError("weights: expected at least one above 0, got none")
    w = (weights / weights.sum()).to(points)
    mean = w @ points
    off = points - mean
    return mean, (w[:, None] * off).T @ off


def _hypotheses(rng: np.random.Generator) -> Inputs:
    square = _tensor([[0, 0], [2, 0], [0, 2], [2, 2]])
    yield "four corners of a square, equal weights", square, torch.ones(4).double()
    yield "weights that sum to 1", square, _tensor([0.1, 0.2, 0.3, 0.4])
    yield "the same weights, ten times", square, _tensor([1, 2, 3, 4])
    for _ in range(3):
        slanted = rng.normal(size=(7, 2)) @ [[5, 2], [0, 1]] + [300, 200]
        yield "a slanted cloud", _tensor(slanted), _tensor(rng.integers(1, 90, size=7))
    yield "two hypotheses", _tensor([[10, 10], [14, 13]]), _tensor([1, 3])
    yield "one hypothesis", _tensor([[300, 200]]), _tensor([12])
    yield "one hypothesis with a weight", _tensor([[300, 200], [5, 5]]), _tensor([12, 0])
    far = _tensor([[0, 0], [2, 0], [1e7, -1e7]])
    yield "a hypothesis far away, of weight 0", far, _tensor([1, 1, 0])
    missing = _tensor([[0, 0], [np.nan, np.nan], [2, 1]])
    yield "rays that did not meet, of weight 0", missing, _tensor([3, 0, 2])
    # Of float32, as networks have it: a mean of squares minus a squared mean loses all digits.
    near = [[600.1, 400.0], [600.0, 400.1], [599.9, 400.0], [600.0, 399.9]]
    near = torch.tensor(near, dtype=torch.float32)
    yield "float32, all to 0.1 px", near, torch.ones(4, dtype=torch.float32)
    yield "weights that are whole numbers, as counts are", square, torch.tensor([5, 0, 1, 2])
    yield "weights that are all 0", square, torch.zeros(4).double()
    yield "no hypotheses at all", square[:0], torch.zeros(0).double()


check_mean_and_covariance = Exercise(
    mean_and_covariance,
    _hypotheses,
    hints=(
        "Divide the weights by their sum: w. The mean is w @ points. Then take the mean away from "
        "the points first, and only then multiply: (w[:, None] * off).T @ off.",
        "0 * nan is nan. So keep the rows with weights > 0 only, at the very start. If none is "
        "left, raise ValueError. Whole numbers: w.to(points.dtype).",
    ),
    tolerance=1e-4,  # the digits that float32 has of 600 px
    seconds=SECONDS,
)


# 5. The activation rule ---------------------------------------------------------------------------


def overlap(points: Tensor, R: Tensor, t: Tensor, K: Tensor, mask: Tensor) -> float:
    """The share of an object's points (N, 3), in a pose, that are seen inside a mask (H, W)."""
    return float(refinement.overlap(points, R, t, K, mask))


def _models_and_masks(rng: np.random.Generator) -> Inputs:
    K = _tensor([[100, 0, 19.5], [0, 100, 14.5], [0, 0, 1]])
    same, forward = torch.eye(3).double(), _tensor([0, 0, 1])
    everything = torch.ones(30, 40, dtype=torch.bool)
    left, top = everything.clone(), everything.clone()
    left[:, 20:], top[15:] = False, False

    def at(*pixels: tuple[float, float]) -> Tensor:
        """Points that are seen at these pixels from 1 m."""
        flat = (np.array(pixels) - [19.5, 14.5]) / 100
        return _tensor(np.c_[flat, np.zeros(len(flat))])

    def some(count: int, size: float) -> Tensor:
        return _tensor(rng.uniform(-size, size, size=(count, 3)))

    one_behind = _tensor([[0, 0, 0], [0, 0, -2]])
    at_camera = _tensor([[0, 0, 0], [0, 0, -1]])
    quarter = at((3, 4), (21, 4), (30, 9), (35, 2))
    cases = (
        ("points in an image that is all mask", at((3, 4), (30, 20)), everything),
        ("an empty mask", at((3, 4), (30, 20)), ~everything),
        ("one point of four in the left half", quarter, left),
        ("three points of four in the upper half", at((3, 4), (21, 4), (30, 9), (35, 20)), top),
        ("points at x = 18.7 and 19.7, a mask up to 19", at((18.7, 4), (19.7, 4)), left),
        ("a point left of the image", at((-4, 4), (5, 4)), everything),
        ("a point less than a pixel outside", at((-0.8, 4), (5, 4)), everything),
        ("a point on the outer half of the first pixel", at((-0.3, 4), (5, 4)), everything),
        ("points right of the image and below it", at((60, 4), (5, 50), (7, 7)), everything),
        ("a point behind the camera", one_behind, everything),
        ("a point at the camera", at_camera, everything),
    )
    for words, points, mask in cases:
        yield words, points, same, forward, K, mask
    yield "a whole object behind the camera", some(20, 0.05), same, -forward, K, everything
    turns = rotations.random_rotations(6, generator=rng)
    for R, half in zip(turns, (left, top) * 3, strict=True):
        t = _tensor([*rng.uniform(-0.05, 0.05, size=2), rng.uniform(0.5, 1.5)])
        yield "a random pose", some(200, 0.1), _tensor(R), t, K, half
    t = _tensor([0.02, -0.1, 0.1])
    yield "an object around the camera", some(300, 0.3), _tensor(R), t, K, top


check_overlap = Exercise(
    overlap,
    _models_and_masks,
    hints=(
        "X = points @ R.T + t, then pixels = X[:, :2] / z * f + c. The nearest pixel is "
        "pixels.round(), x first; but mask[y, x] has the row first.",
        "Build a truth value for each point and multiply (&) them: z > 0, 0 <= x < width, "
        "0 <= y < height. Look only those points up in the mask: mask[y[seen], x[seen]].sum(). An "
        "index of -4 is no error, it counts from the other end. Divide by the number of all "
        "points.",
    ),
    seconds=SECONDS,
)


# 6. Symmetric objects -----------------------------------------------------------------------------

FROM_POLE = np.deg2rad(30)
STEEPEST = 15.0


def canonical_rotation(R: Tensor, t: Tensor) -> Tensor:
    """Of the rotations (N, 3, 3) that look like R, one: the x axis turned towards the camera."""
    z = R[:, :, 2]
    to_camera = -normalize(t, dim=-1)
    x = to_camera - (to_camera * z).sum(-1, keepdim=True) * z
    steep = x.norm(dim=-1, keepdim=True) < 1e-6  # seen along the axis: leave it as it is
    x = normalize(torch.where(steep, R[:, :, 0], x), dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def about_z(angles: Tensor) -> Tensor:
    """Turns (N, 3, 3) by angles (N,) about the z axis."""
    axis = torch.zeros(*angles.shape, 3, dtype=angles.dtype)
    axis[..., 2] = angles
    return rotations.axis_angle_to_matrix(axis)


def upright(z: Tensor) -> Tensor:
    """Some rotations (N, 3, 3) whose third column is z (N, 3)."""
    z = normalize(z, dim=-1)
    # The axis of the camera that is farthest from z.
    other = torch.eye(3, dtype=z.dtype)[z.abs().argmin(-1)]
    x = normalize(torch.linalg.cross(other, z), dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def _symmetric_poses(rng: np.random.Generator) -> Inputs:
    def turned(z: Tensor) -> Tensor:
        """An object with this axis, turned anyhow about it."""
        return upright(z) @ about_z(_tensor(rng.uniform(-np.pi, np.pi, size=len(z))))

    def walk(start: object, across: object, t: object, width: float = 60) -> tuple[Tensor, Tensor]:
        """Axes from `start` - width to + width degrees, leaning towards `across`; any turns."""
        angle = torch.deg2rad(torch.linspace(-width, width, 61, dtype=torch.float64))[:, None]
        z = angle.cos() * _tensor(start) + angle.sin() * _tensor(across)
        return turned(z), _tensor(t).expand(61, 3).clone()

    ahead = [0, 0, 0.6]
    still = upright(_tensor([[0.3, -0.8, -0.5]]))
    four = _tensor([0, 1, 2, 4])
    yield "one pose, turned four times", still @ about_z(four), _tensor(ahead).expand(4, 3).clone()
    for _ in range(3):
        z, t = _tensor(rng.normal(size=(4, 3))), _tensor(rng.uniform(-0.1, 0.1, size=(4, 3)))
        t[:, 2] += 0.6
        yield "random poses, each turned twice", turned(torch.cat([z, z])), torch.cat([t, t])
    yield "an upright object that leans left and right", *walk([0, -1, 0], [1, 0, 0], ahead)
    yield "an upright object that leans back and forth", *walk([0, -1, 0], [0, 0, 1], ahead, 55)
    yield "an object upside down that leans", *walk([0, 1, 0], [1, 0, 0.2], ahead)
    yield "an object that lies on its side and rolls", *walk([1, 0, 0], [0, 1, 0], ahead)
    yield "an object that lies, and points away", *walk([1, 0, 0], [0, 0, 1], ahead, 55)
    yield "an object at the image's rim that leans", *walk([0, -1, 0], [1, 0, 0], [0.15, 0.1, 0.6])
    for _ in range(3):
        start, across = rotations.random_rotations(generator=rng)[:2]
        yield "an object that turns over", *walk(start, across, ahead, 180)
    x = torch.linspace(-0.15, 0.15, 31, dtype=torch.float64)
    t = torch.stack([x, 0 * x, 0 * x + 0.6], -1)
    yield "an object that is pushed to the right", turned(still[:, :, 2].expand(31, 3)), t
    end_on = turned(_tensor([[0, 0, -1], [0, 0, 1]]))
    yield "an axis along the line of sight", end_on, _tensor([ahead, ahead])


def _is_canonical(answer: Tensor, R: Tensor, t: Tensor) -> str:
    answer = answer.detach().to(R)
    valid = rotations.is_rotation(answer)
    if not valid.all():
        return f"expected a rotation at [{int((~valid).nonzero()[0])}], got none"
    cosine = (answer[:, :, 2] * R[:, :, 2]).sum(-1).clamp(-1, 1)
    tilt = (answer[:, :, 2] - R[:, :, 2]).norm(dim=-1)
    if (tilt > 1e-6).any():
        worst = int(tilt.argmax())
        degrees = np.rad2deg(float(cosine[worst].acos()))
        return f"expected a pose that looks the same, got an axis tilted by {degrees:.3g} degrees"
    z, ray = R[:, :, 2], normalize(t, dim=-1)
    sine = torch.linalg.cross(z, ray).norm(dim=-1)
    safe = sine > np.sin(FROM_POLE)
    # How different two poses look: of the axis, and of where the object is.
    look = torch.cdist(z, z) + torch.cdist(ray, ray)
    apart = rotations.geodesic_distance(answer[:, None], answer[None])
    allowed = STEEPEST * torch.where(look < 1e-9, 0.0, look) + 1e-5
    wrong = (apart > allowed) & safe[:, None] & safe
    if not wrong.any():
        return ""
    i, j = divmod(int(torch.where(wrong, apart, -1).argmax()), len(R))
    far, seen = (np.rad2deg(float(one[i, j])) for one in (apart, look))
    if seen < 1e-6:
        return f"poses [{i}] and [{j}] look alike, but their answers are {far:.3g} degrees apart"
    return f"poses [{i}] and [{j}] look alike to {seen:.2g} degrees, their answers to {far:.3g}"


check_canonical_rotation = Exercise(
    canonical_rotation,
    _symmetric_poses,
    hints=(
        "You may turn the object about its own axis: R @ about_z(angle), and nothing else. Keep "
        "the third column of R, and choose a first one at a right angle to it, from what the "
        "camera sees alone. The second is the cross product of the third with the first.",
        "Let x point as much towards the camera as it can: take the direction -t, remove from it "
        "what lies along z, bring the rest to length 1. If nothing is left, the camera looks along "
        "the axis: then keep R's own first column.",
    ),
    judge=_is_canonical,
    seconds=SECONDS,
)
