"""Pixels that point along lines: where these meet, and which pixels point at a point.

For `voting`. What is not in `__all__` takes checked NumPy arrays, its vectors as (K, 2, P): of P
pixels towards each of K keypoints.

Source: Peng et al. 2019, "PVNet: Pixel-wise Voting Network for 6DoF Pose Estimation", section 3.1.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_number, somewhere

__all__ = ["count_inliers", "hypothesis_covariance", "intersect_lines"]

FLOOR = 0.1
"""Pixels: no keypoint is believed to be surer than this."""
_PARALLEL = 1e-4  # rays at a smaller angle (radians) cross further away than any image reaches
_ONE_POINT = 1e-12  # of the trace squared; lines agree to two millionths of a radian under it
_CHUNK = 255  # pixels; their tests stay in the cache, and a byte holds their count
_ROUNDING = 1e-6  # relative; 8 roundings of float32 make half of it
_NEAR = 1.0  # pixels; nearer ones count less and less, as their angles change without bound
_STEPS = 10
_ARRIVED = 1e-2  # pixels; a shorter step is the last


@array_function(points="... L 2", directions="... L 2", weights="... L")
def intersect_lines(points: Array, directions: Array, weights: Array | None = None) -> Array:
    """The point of least weighted squared distance to L lines; the crossing if they are two.

    Lines, not rays: the point may lie behind them. Where all lines have one direction, many points
    are as good: of these, the one nearest to the weighted mean of `points`.

    Args:
        points: (..., L, 2) a point on each line.
        directions: (..., L, 2) of any length; a line of length 0 counts for nothing.
        weights: (..., L) at least 0, of any sum; equal if not given. If no line counts, the result
            is the mean of `points`.

    Returns:
        (..., 2), computed in float64.

    Raises:
        ValueError: if a weight is negative.
    """
    dtype = points.dtype
    points, directions = torch.broadcast_tensors(points.double(), directions.double())
    if weights is None:
        weights = points.new_ones(points.shape[:-1])
    elif somewhere(weights < 0):
        fail("weights", "at least 0", f"the smallest {float(weights.min()):g}")
    # Coordinates one by one: PyTorch is slow where it adds up two numbers at a time.
    cosine, sine = _unit(*directions.unbind(-1))
    x, y = -sine, cosine  # the normal
    weights = weights.double() * ((x != 0) | (y != 0))
    weights = weights / weights.amax(-1, keepdim=True).clamp_min(torch.finfo(torch.float64).tiny)
    counted = torch.where(weights.sum(-1, keepdim=True) > 0, weights, 1.0)
    middle = (counted[..., None, :] @ points)[..., 0, :] / counted.sum(-1, keepdim=True)
    # Measured from the middle, the numbers stay small: less is lost where lines nearly agree.
    right, down = (points - middle[..., None, :]).unbind(-1)
    offsets = x * right + y * down
    a, b, c = ((weights * product).sum(-1) for product in (x * x, x * y, y * y))
    u, v = (weights * x * offsets).sum(-1), (weights * y * offsets).sum(-1)
    trace, determinant = a + c, a * c - b * b
    one_point = determinant > _ONE_POINT * trace.square()
    exact = torch.stack([c * u - b * v, a * v - b * u], -1)
    exact = exact / torch.where(one_point, determinant, 1.0)[..., None]
    # One direction only: the matrix is trace * n n^T, and its pseudoinverse divides by the trace.
    nearest = torch.stack([u, v], -1) / torch.where(trace > 0, trace, 1.0)[..., None]
    return (middle + torch.where(one_point[..., None], exact, nearest)).to(dtype)


@array_function(pixels="P 2", vectors="P K 2", hypotheses="K S 2")
def count_inliers(
    pixels: Array, vectors: Array, hypotheses: Array, threshold: float = 0.99
) -> Array:
    """Inliers of each hypothesis: pixels with `(h - p) . v > threshold |h - p| |v|`.

    A vector of length 0 points nowhere, and no pixel points at itself. Computed in float32: a pixel
    on the edge of the cone, or that the hypothesis almost lies on, may or may not count.

    Args:
        pixels: (P, 2) x, y.
        vectors: (P, K, 2) from each pixel towards each keypoint.
        hypotheses: (K, S, 2) in pixels.
        threshold: cosine in (0, 1).

    Returns:
        (K, S) int64.

    Raises:
        ValueError: if `threshold` is not between 0 and 1.
    """
    threshold = require_threshold(threshold)
    places, field, guesses = (
        x.detach().cpu().double().numpy() for x in (pixels, vectors, hypotheses)
    )
    middle = places.mean(0)
    walls = cone_walls(places - middle, directions(field.transpose(1, 2, 0)), threshold)
    counts = count_inside(walls, guesses - middle)
    return torch.from_numpy(counts).to(pixels.device)


@array_function(hypotheses="... S 2", weights="... S", centre="... 2")
def hypothesis_covariance(
    hypotheses: Array, weights: Array, centre: Array | None = None, floor: float = FLOOR
) -> Array:
    """The covariance of weighted hypotheses (PVNet, section 3.1).

    `floor` squared is added on the diagonal, and a millionth of the trace, so that the result is
    positive definite also where all hypotheses agree or lie on a line, and also in float32.

    Args:
        hypotheses: (..., S, 2) in pixels.
        weights: (..., S) at least 0 and not all 0.
        centre: (..., 2) what distances are measured from; the weighted mean if not given. `vote`
            gives the keypoint: if the mean lies elsewhere, that makes it less sure as well.
        floor: pixels, above 0.

    Returns:
        (..., 2, 2) pixels squared.

    Raises:
        ValueError: if a weight is negative, all of a keypoint's are 0, or `floor` is not positive.
    """
    floor = require_number("floor", floor, above=0)
    largest = weights.amax(-1, keepdim=True)
    if somewhere((weights < 0) | (largest == 0)):
        fail("weights", "at least 0 and not all 0", f"the smallest {float(weights.min()):g}")
    shares = weights.double() / largest.double()
    shares = shares / shares.sum(-1, keepdim=True)
    guesses = hypotheses.double()
    if centre is None:
        middle = (shares[..., None] * guesses).sum(-2)
    else:
        middle = centre.double()
    x, y = (guesses - middle[..., None, :]).unbind(-1)
    xx, xy, yy = ((shares * product).sum(-1) for product in (x * x, x * y, y * y))
    least = floor**2 + 1e-6 * (xx + yy)
    entries = torch.stack([xx + least, xy, xy, yy + least], -1)
    return entries.unflatten(-1, (2, 2)).to(hypotheses.dtype)


def require_threshold(threshold: float) -> float:
    """Return the least cosine of an inlier, or refuse it.

    Raises:
        ValueError: if it is no number above 0 and below 1.
    """
    return require_number("threshold", threshold, high=1 - 1e-9, above=0)


def cone_walls(pixels: np.ndarray, units: np.ndarray, threshold: float) -> np.ndarray:
    """The two straight walls of the cone that each pixel looks into, (K, 2, 3, P) float32.

    A point h at h - p = d is inside if d . v > cos |d|. With the tangent of the angle and v turned
    by a quarter, n, that is tan d . v > |d . n|, two inequalities linear in d: h is inside if
    (h, 1) has positive products with both walls. Unlike the square, this loses no digits. What
    rounding can add to a product is taken off, or a pixel could be in its own cone.
    """
    tangent = np.sqrt(1 - threshold**2) / threshold
    x, y = units[:, 0], units[:, 1]
    walls = np.empty((len(units), 2, 3, len(pixels)), np.float32)
    rounding = _ROUNDING / threshold * np.hypot(pixels[:, 0], pixels[:, 1])
    rounding += np.finfo(np.float32).tiny
    for side, (a, b) in enumerate(
        [(tangent * x + y, tangent * y - x), (tangent * x - y, tangent * y + x)]
    ):
        walls[:, side, 0], walls[:, side, 1] = a, b
        walls[:, side, 2] = -(a * pixels[:, 0] + b * pixels[:, 1] + rounding)
    return walls


def count_inside(walls: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many of the pixels' cones (K, 2, 3, P) each of the points (K, S, 2) is in, (K, S)."""
    counts = np.zeros(points.shape[:2], np.int64)
    for total, pair, rows in zip(counts, walls, _with_one(points), strict=True):
        for start in range(0, pair.shape[-1], _CHUNK):
            positive = (
                pair[..., start : start + _CHUNK].swapaxes(1, 2) @ rows.T > 0
            )  # (2, chunk, S)
            total += np.add.reduce(positive[0] & positive[1], axis=0, dtype=np.uint8)
    return counts


def inlier_mask(walls: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether each pixel's cone (K, 2, 3, P) has its keypoint's point (K, 2) inside, (K, P)."""
    return ((_with_one(points)[:, None, None] @ walls)[:, :, 0] > 0).all(1)


def fit_lines(
    pixels: np.ndarray, units: np.ndarray, inside: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """`intersect_lines` of the pixels `inside` (K, P), without its threads.

    As a step from `points` (K, 2), and none in a direction that the lines leave open.
    """
    x, y = -units[:, 1] * inside, units[:, 0] * inside  # normals
    offsets = x * (pixels[:, 0] - points[:, :1]) + y * (pixels[:, 1] - points[:, 1:])
    normals = np.stack([x, y], 1)  # (K, 2, P)
    return points + _solve(normals @ normals.swapaxes(1, 2), normals @ offsets[..., None])


def fit_angles(
    pixels: np.ndarray, units: np.ndarray, inside: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """The points that the pixels `inside` (K, P) miss by the least squared angles.

    A line that is off by an angle misses a point by more the further away its pixel is, and the
    less the nearer the point comes: `fit_lines` ends too near to the pixels. Angles do not change
    with the distance. Gauss-Newton on their sines, started from `points` (K, 2), which stay where
    it does not arrive, or arrives where the sum of squares is not smaller.
    """
    # Half the time. Points that nothing was to be gained for keep their digits.
    pixels, units, start = (x.astype(np.float32) for x in (pixels, units, points))
    fitted, left = start.copy(), np.arange(len(points))
    reach = np.abs(pixels).max()
    for _ in range(_STEPS):
        x, y, weights = _ways(pixels, inside[left], fitted[left])
        sines = (units[left, 0] * y - units[left, 1] * x) * np.sqrt(weights)
        # Of the direction of the way, not of the noisy ray: errors of both must not be multiplied.
        slopes = np.stack([-y * weights, x * weights], 1)
        step = -_solve(slopes @ slopes.swapaxes(1, 2), slopes @ sines[..., None])
        length = np.hypot(step[:, 0], step[:, 1])
        # At most as far as the pixels are: rays that nearly agree could throw it anywhere.
        longest = np.hypot(fitted[left, 0], fitted[left, 1]) + reach
        fitted[left] += step * np.minimum(1, longest / np.maximum(length, _ARRIVED))[:, None]
        left = left[length > _ARRIVED]
        if not len(left):
            break
    gained = _misses(pixels, units, inside, start) - _misses(pixels, units, inside, fitted)
    better = gained > _ROUNDING**2 * len(pixels)
    better[left] = False
    return np.where(better[:, None], fitted, points)


def _misses(
    pixels: np.ndarray, units: np.ndarray, inside: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Sum of the squared sines by which pixels miss points; 1 if they look away from it, (K,)."""
    x, y, weights = _ways(pixels, inside, points)
    across = units[:, 0] * y - units[:, 1] * x
    behind = np.minimum(units[:, 0] * x + units[:, 1] * y, 0)
    return (weights * (across * across + behind * behind)).sum(1)


def _ways(
    pixels: np.ndarray, inside: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From pixels to points in x and y, and 1 / length squared or 0 if not inside, (K, P)."""
    x, y = points[:, :1] - pixels[:, 0], points[:, 1:] - pixels[:, 1]
    return x, y, inside / np.maximum(x * x + y * y, _NEAR**2)


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(K, 2, 2) x = (K, 2, 1), x (K, 2) the shortest one where many fit."""
    return (np.linalg.pinv(matrix, rcond=_ONE_POINT, hermitian=True) @ right)[..., 0]


def crossings(
    p: np.ndarray, v: np.ndarray, q: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where lines through p along v and through q along w cross, (..., 2), and if they do, (...).

    Parallel lines get the middle between p and q. `v` and `w` are unit or zero vectors.
    """
    sine = v[..., 0] * w[..., 1] - v[..., 1] * w[..., 0]
    cross = np.abs(sine) > _PARALLEL
    between = q - p
    along = between[..., 0] * w[..., 1] - between[..., 1] * w[..., 0]
    along = along / np.where(cross, sine, 1)
    crossing = p + along[..., None] * v
    return np.where(cross[..., None], crossing, (p + q) / 2), cross


def _with_one(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones_like(points[..., :1])], -1).astype(np.float32)


def directions(vectors: np.ndarray) -> np.ndarray:
    """Vectors (K, 2, P) of length 1, or 0 where they have none."""
    length = np.hypot(vectors[:, :1], vectors[:, 1:])
    return vectors / np.where(length > 0, length, 1)


def _unit(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """`directions` with gradients; divided twice, so that no square leaves the range."""
    largest = torch.maximum(x.abs(), y.abs())
    largest = torch.where(largest > 0, largest, 1.0)
    x, y = x / largest, y / largest
    squares = x * x + y * y
    length = torch.where(squares > 0, squares, 1.0).sqrt()
    return x / length, y / length
