"""From a field of directions to keypoints: pixels vote for where their rays cross.

Every pixel of an object says in which direction a keypoint lies. Two rays cross in a hypothesis;
the hypothesis that most pixels point at wins, and the lines of those pixels give the keypoint by
least squares. How far the good hypotheses lie apart tells how sure it is.

Source: Peng et al. 2019, "PVNet: Pixel-wise Voting Network for 6DoF Pose Estimation", section 3.1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_integer, require_number

__all__ = [
    "Votes",
    "count_inliers",
    "hypothesis_covariance",
    "intersect_lines",
    "vote",
    "vote_pixels",
]

FLOOR = 0.1
"""Pixels: no keypoint is believed to be surer than this."""
UNKNOWN = 1000.0
"""Pixels: the standard deviation given to a keypoint that no two pixels vote for."""
_PARALLEL = 1e-4  # rays at a smaller angle (radians) cross further away than any image reaches
_ONE_POINT = 1e-12  # of the trace squared; lines agree to two millionths of a radian under it
_CONFIDENCE = 0.99
_BELOW = 0.1  # PVNet's released code leaves out hypotheses with a share this much below the best
_CHUNK = 255  # pixels; their tests stay in the cache, and a byte holds their count


class Votes(NamedTuple):
    """What the pixels of O objects say about K keypoints each; S hypotheses a keypoint."""

    points: Array
    """(O, K, 2) keypoints in pixels; the middle of the mask where no two rays cross, 0 without."""
    covariances: Array
    """(O, K, 2, 2) how unsure they are, pixels squared; always positive definite."""
    inliers: Array
    """(O, K) share of the pixels drawn from that point at the best hypothesis; 0 without one."""
    hypotheses: Array
    """(O, K, S, 2) crossings of two rays; the middle between their pixels where they do not."""
    weights: Array
    """(O, K, S) share of pixels that point at each; 0 where it is more than 0.1 below the best."""
    found: Array
    """(O,) bool: at least one keypoint has an inlier."""
    pixels: Array
    """(O,) int64, the number of pixels of each mask."""


def vote(
    mask: Array,
    vectors: Array,
    *,
    hypotheses: int = 128,
    sample: int | None = None,
    threshold: float = 0.99,
    rounds: int = 20,
    seed: int = 0,
) -> Votes:
    """Keypoints of several objects in one image, by RANSAC over the pixels of each.

    A round draws `hypotheses` pairs of pixels for every keypoint and counts who points at their
    crossing. Keypoints have another round until, with 99 % confidence, one of their pairs was of
    two inliers. Each object is drawn for on its own: what the others show does not change it.

    Args:
        mask: (O, H, W) bool, the pixels of each object; none at all is allowed.
        vectors: (O, K, 2, H, W) from each pixel towards each keypoint, (x, y); of any length,
            but a vector of length 0 votes for nothing. Looked at in the masks only.
        hypotheses: S, pairs drawn in a round.
        sample: most pixels of a mask that are drawn from and counted; all if not given.
        threshold: cosine in (0, 1) of the angle by which an inlier may miss.
        rounds: most rounds; of several, the one with the best hypothesis is returned.
        seed: of the draws; the same seed gives the same keypoints.

    Returns:
        `Votes`, computed in float64, in the kind and precision of `vectors`.

    Raises:
        ValueError: if a shape or a parameter is wrong, or a vector in a mask is not finite.
    """
    fields, inside = _array("vectors", vectors), _array("mask", mask)
    if fields.ndim != 5 or fields.shape[2] != 2 or 0 in fields.shape:
        fail("vectors", "shape (O, K, 2, H, W), none of them 0", f"shape {fields.shape}")
    if inside.dtype != bool:
        fail("mask", "bool", inside.dtype)
    expected = (fields.shape[0], *fields.shape[3:])
    if inside.shape != expected:
        fail("mask", f"shape {expected} as vectors have", f"shape {inside.shape}")
    settings = _settings(hypotheses, sample, threshold, rounds, seed)

    votes = []
    for field, wanted in zip(fields, inside, strict=True):
        rows, columns = wanted.nonzero()
        pixels = np.stack([columns, rows], -1).astype(np.float64)
        votes.append(_vote(pixels, field[:, :, rows, columns].astype(np.float64), settings))
    return _like(Votes(*(np.stack(values) for values in zip(*votes, strict=True))), vectors)


def vote_pixels(
    pixels: Array,
    vectors: Array,
    *,
    hypotheses: int = 128,
    sample: int | None = None,
    threshold: float = 0.99,
    rounds: int = 20,
    seed: int = 0,
) -> Votes:
    """`vote` for one object whose pixels are given as a list.

    Args:
        pixels: (P, 2) pixels of the object; P may be 0.
        vectors: (P, K, 2) from each pixel towards each keypoint.
        hypotheses, sample, threshold, rounds, seed: as in `vote`.

    Returns:
        `Votes` without their first dimension.

    Raises:
        ValueError: as in `vote`.
    """
    places, field = _array("pixels", pixels), _array("vectors", vectors)
    if places.ndim != 2 or places.shape[1] != 2:
        fail("pixels", "shape (P, 2)", f"shape {places.shape}")
    if field.ndim != 3 or field.shape[::2] != (len(places), 2) or field.shape[1] == 0:
        fail("vectors", f"shape ({len(places)}, K, 2)", f"shape {field.shape}")
    if not np.isfinite(places).all():
        fail("pixels", "finite values", f"{int((~np.isfinite(places)).sum())} others")
    settings = _settings(hypotheses, sample, threshold, rounds, seed)
    gathered = field.transpose(1, 2, 0).astype(np.float64, order="C")
    return _like(_vote(places.astype(np.float64), gathered, settings), vectors)


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
    elif bool((weights < 0).any()):
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
    """How many pixels point at each hypothesis: `(h - p) . v > threshold |h - p| |v|`.

    A vector of length 0 points nowhere. Computed in float32: a pixel that misses by the threshold
    to six digits, or that the hypothesis lies on, may fall on either side.

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
    threshold = _require_threshold(threshold)
    places, field, guesses = (
        x.detach().cpu().double().numpy() for x in (pixels, vectors, hypotheses)
    )
    middle = places.mean(0)
    walls = _walls(places - middle, _directions(field.transpose(1, 2, 0)), threshold)
    counts = _count(walls, guesses - middle)
    return torch.from_numpy(counts).to(pixels.device)


@array_function(hypotheses="... S 2", weights="... S", centre="... 2")
def hypothesis_covariance(
    hypotheses: Array, weights: Array, centre: Array | None = None, floor: float = FLOOR
) -> Array:
    """How far weighted hypotheses lie apart (PVNet, section 3.1).

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
    if bool((weights < 0).any()) or bool((largest == 0).any()):
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


class _Settings(NamedTuple):
    hypotheses: int
    sample: int | None
    threshold: float
    rounds: int
    seed: int


def _settings(
    hypotheses: int, sample: int | None, threshold: float, rounds: int, seed: int
) -> _Settings:
    return _Settings(
        require_integer("hypotheses", hypotheses, 1),
        None if sample is None else require_integer("sample", sample, 2),
        _require_threshold(threshold),
        require_integer("rounds", rounds, 1),
        require_integer("seed", seed, 0),
    )


def _require_threshold(threshold: float) -> float:
    return require_number("threshold", threshold, high=1 - 1e-9, above=0)


def _vote(pixels: np.ndarray, vectors: np.ndarray, settings: _Settings) -> Votes:
    """`Votes` of one object from its pixels (P, 2) and their vectors (K, 2, P)."""
    keypoints, _, count = vectors.shape
    if not np.isfinite(vectors).all():
        bad = int((~np.isfinite(vectors)).any((0, 1)).sum())
        fail("vectors", "finite values", f"{bad} of {count} pixels with others")
    middle = pixels.mean(0) if count else np.zeros(2)
    points = np.tile(middle, (keypoints, 1))
    covariances = np.tile(UNKNOWN**2 * np.eye(2), (keypoints, 1, 1))
    hypotheses = np.tile(middle, (keypoints, settings.hypotheses, 1))
    weights = np.zeros((keypoints, settings.hypotheses))
    if count >= 2:
        generator = np.random.default_rng(settings.seed)
        if settings.sample is not None and settings.sample < count:
            chosen = generator.choice(count, settings.sample, replace=False)
            pixels, vectors = pixels[chosen], vectors[..., chosen]
        centred = pixels - middle
        units = _directions(vectors)
        walls = _walls(centred, units, settings.threshold)
        guesses, weights = _ransac(centred, units, walls, settings, generator)
        refined = _refine(centred, units, walls, guesses[np.arange(keypoints), weights.argmax(1)])
        weights[weights < weights.max(1, keepdims=True) - _BELOW] = 0
        found = weights.max(1) > 0
        covariances[found] = hypothesis_covariance(guesses[found], weights[found], refined[found])
        points[found] += refined[found]
        hypotheses = guesses + middle
    shares = weights.max(1)
    found = (shares > 0).any()
    return Votes(points, covariances, shares, hypotheses, weights, found, np.int64(count))


def _ransac(
    pixels: np.ndarray,
    units: np.ndarray,
    walls: np.ndarray,
    settings: _Settings,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses (K, S, 2) and the share of pixels that point at them (K, S)."""
    keypoints, _, count = units.shape
    shape = (keypoints, settings.hypotheses)
    hypotheses, votes, best = np.zeros((*shape, 2)), np.zeros(shape), np.full(keypoints, -1.0)
    unsure = np.arange(keypoints)
    for drawn in range(1, settings.rounds + 1):
        draws = (len(unsure), settings.hypotheses)
        first = generator.integers(count, size=draws)
        second = (first + generator.integers(1, count, size=draws)) % count  # never the same pixel
        guesses, cross = _crossings(
            pixels[first],
            units[unsure[:, None], :, first],
            pixels[second],
            units[unsure[:, None], :, second],
        )
        shares = _count(walls[unsure], guesses) * cross / count
        better = shares.max(1) > best[unsure]
        chosen = unsure[better]
        hypotheses[chosen], votes[chosen] = guesses[better], shares[better]
        best[chosen] = shares[better].max(1)
        miss = (1 - best**2) ** (drawn * settings.hypotheses)  # no pair was of two inliers
        unsure = np.flatnonzero(miss > 1 - _CONFIDENCE)
        if not len(unsure):
            break
    return hypotheses, votes


def _crossings(
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


def _walls(pixels: np.ndarray, units: np.ndarray, threshold: float) -> np.ndarray:
    """The two straight walls of the cone that each pixel looks into, (K, 2, 3, P) float32.

    A point h at h - p = d is inside if d . v > cos |d|. With the tangent of the angle and v turned
    by a quarter, n, that is tan d . v > |d . n|, two inequalities linear in d: h is inside if
    (h, 1) has positive products with both walls. Unlike the square, this loses no digits.
    """
    tangent = np.sqrt(1 - threshold**2) / threshold
    x, y = units[:, 0], units[:, 1]
    walls = np.empty((len(units), 2, 3, len(pixels)), np.float32)
    for side, (a, b) in enumerate(
        [(tangent * x + y, tangent * y - x), (tangent * x - y, tangent * y + x)]
    ):
        walls[:, side, 0], walls[:, side, 1] = a, b
        walls[:, side, 2] = -(a * pixels[:, 0] + b * pixels[:, 1])
    return walls


def _count(walls: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many of the pixels' cones (K, 2, 3, P) each of the points (K, S, 2) is in, (K, S)."""
    counts = np.zeros(points.shape[:2], np.int64)
    for total, pair, rows in zip(counts, walls, _with_one(points), strict=True):
        for start in range(0, pair.shape[-1], _CHUNK):
            positive = (
                pair[..., start : start + _CHUNK].swapaxes(1, 2) @ rows.T > 0
            )  # (2, chunk, S)
            total += np.add.reduce(positive[0] & positive[1], axis=0, dtype=np.uint8)
    return counts


def _refine(
    pixels: np.ndarray, units: np.ndarray, walls: np.ndarray, winners: np.ndarray
) -> np.ndarray:
    """`intersect_lines` of the pixels that point at each winner (K, 2), without its threads.

    As a step from the winner, and none in a direction that the lines leave open.
    """
    inside = ((_with_one(winners)[:, None, None] @ walls)[:, :, 0] > 0).all(1)  # (K, P)
    x, y = -units[:, 1] * inside, units[:, 0] * inside  # normals
    offsets = x * (pixels[:, 0] - winners[:, :1]) + y * (pixels[:, 1] - winners[:, 1:])
    normals = np.stack([x, y], 1)  # (K, 2, P)
    inverse = np.linalg.pinv(normals @ normals.swapaxes(1, 2), rcond=_ONE_POINT, hermitian=True)
    return winners + (inverse @ (normals @ offsets[..., None]))[..., 0]


def _with_one(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones_like(points[..., :1])], -1).astype(np.float32)


def _directions(vectors: np.ndarray) -> np.ndarray:
    """Vectors (K, 2, P) of length 1, or 0 where they have none."""
    length = np.hypot(vectors[:, :1], vectors[:, 1:])
    return vectors / np.where(length > 0, length, 1)


def _unit(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """`_directions` with gradients; divided twice, so that no square leaves the range."""
    largest = torch.maximum(x.abs(), y.abs())
    largest = torch.where(largest > 0, largest, 1.0)
    x, y = x / largest, y / largest
    squares = x * x + y * y
    length = torch.where(squares > 0, squares, 1.0).sqrt()
    return x / length, y / length


def _array(name: str, value: object) -> np.ndarray:
    """`value` as an array, not copied if it need not be; its numbers are not looked at.

    Voting is done in NumPy: PyTorch's threads wait for each other longer than they work here.
    """
    if isinstance(value, Tensor):
        value = value.detach().cpu()
        value = (value.float() if value.dtype == torch.bfloat16 else value).numpy()
    try:
        array = np.asarray(value)
    except ValueError:  # a ragged list
        fail(name, "an array of numbers", "rows of different lengths")
    if array.dtype.kind not in "fiub":
        fail(name, "an array of numbers", f"dtype {array.dtype}")
    return array


def _like(votes: Votes, vectors: object) -> Votes:
    """Of the kind and device of `vectors`; numbers in its precision if it is a floating one."""
    if isinstance(vectors, Tensor):
        dtype = vectors.dtype if vectors.is_floating_point() else torch.float64
        tensors = [torch.as_tensor(value).to(vectors.device) for value in votes]
        return Votes(*(x.to(dtype) if x.is_floating_point() else x for x in tensors))
    dtype = np.asarray(vectors).dtype
    dtype = dtype.newbyteorder("=") if dtype.kind == "f" else np.dtype(np.float64)
    return Votes(*(x.astype(dtype) if x.dtype.kind == "f" else x for x in votes))
