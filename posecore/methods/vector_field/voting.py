"""From a field of directions to keypoints: pixels vote for where their rays cross.

Every pixel of an object says in which direction a keypoint lies. Two rays cross in a hypothesis;
the hypothesis that most pixels point at wins, and those pixels give the keypoint by least squares.
How far the good hypotheses lie apart tells how sure it is.

Source: Peng et al. 2019, "PVNet: Pixel-wise Voting Network for 6DoF Pose Estimation", section 3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, fail, require_choice, require_integer
from posecore.methods.vector_field.lines import (
    cone_walls,
    count_inliers,
    count_inside,
    crossings,
    directions,
    fit_angles,
    fit_lines,
    hypothesis_covariance,
    inlier_mask,
    intersect_lines,
    require_threshold,
)

__all__ = [
    "FITS",
    "VoteOptions",
    "Votes",
    "count_inliers",
    "hypothesis_covariance",
    "intersect_lines",
    "vote",
    "vote_pixels",
]

FITS = ("lines", "angles")
"""What the last step on the inliers can make least."""
UNKNOWN_STD = 1000.0
"""Pixels: the standard deviation given to a keypoint that no two pixels vote for."""
_CONFIDENCE = 0.99
# PVNet's released code leaves out hypotheses with a share this much below the best.
_MAX_BELOW_BEST = 0.1


@dataclass(frozen=True, kw_only=True)
class VoteOptions:
    """How keypoints are voted for.

    A round draws pairs of pixels for every keypoint and counts who points at their crossing.
    Keypoints have another round until, with 99 % confidence, one of their pairs was of two inliers.

    Attributes:
        hypotheses: S, pairs drawn in a round.
        sample: most pixels of a mask that are drawn from and counted; None for all.
        threshold: cosine in (0, 1) of the angle by which an inlier may miss.
        rounds: most rounds; of several, the one with the best hypothesis is returned.
        seed: of the draws; the same seed gives the same keypoints.
        fit: the last step on the inliers. "lines", PVNet's: least squared distance to their lines,
            which lies too near to the mask if they are noisy. "angles": least squared angles, with
            no such bias; the point of the lines where that finds none.

    Raises:
        ValueError: naming an attribute that cannot be.
    """

    hypotheses: int = 128
    sample: int | None = None
    threshold: float = 0.99
    rounds: int = 20
    seed: int = 0
    fit: str = "lines"

    def __post_init__(self) -> None:
        require_choice("fit", self.fit, FITS)
        require_integer("hypotheses", self.hypotheses, 1)
        if self.sample is not None:
            require_integer("sample", self.sample, 2)
        require_threshold(self.threshold)
        require_integer("rounds", self.rounds, 1)
        require_integer("seed", self.seed, 0)


class Votes(NamedTuple):
    """The voted keypoints of O objects, K each, from S hypotheses a keypoint."""

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


def vote(mask: Array, vectors: Array, options: VoteOptions | None = None) -> Votes:
    """Keypoints of several objects in one image, by RANSAC over the pixels of each.

    Each object is drawn for on its own: what the others show does not change it.

    Args:
        mask: (O, H, W) bool, the pixels of each object; none at all is allowed.
        vectors: (O, K, 2, H, W) from each pixel towards each keypoint, (x, y); of any length,
            but a vector of length 0 votes for nothing. Looked at in the masks only.
        options: None for the defaults.

    Returns:
        `Votes`, computed in float64, in the kind and precision of `vectors`.

    Raises:
        ValueError: if a shape is wrong, or a vector in a mask is not finite.
    """
    options = _options(options)
    fields, inside = _array("vectors", vectors), _array("mask", mask)
    if fields.ndim != 5 or fields.shape[2] != 2 or 0 in fields.shape:
        fail("vectors", "shape (O, K, 2, H, W), none of them 0", f"shape {fields.shape}")
    if inside.dtype != bool:
        fail("mask", "bool", inside.dtype)
    expected = (fields.shape[0], *fields.shape[3:])
    if inside.shape != expected:
        fail("mask", f"shape {expected} as vectors have", f"shape {inside.shape}")

    votes = []
    for field, wanted in zip(fields, inside, strict=True):
        rows, columns = wanted.nonzero()
        pixels = np.stack([columns, rows], -1).astype(np.float64)
        votes.append(_vote(pixels, field[:, :, rows, columns].astype(np.float64), options))
    return _like(Votes(*(np.stack(values) for values in zip(*votes, strict=True))), vectors)


def vote_pixels(pixels: Array, vectors: Array, options: VoteOptions | None = None) -> Votes:
    """`vote` for one object whose pixels are given as a list.

    Args:
        pixels: (P, 2) pixels of the object; P may be 0.
        vectors: (P, K, 2) from each pixel towards each keypoint.
        options: None for the defaults.

    Returns:
        `Votes` without their first dimension.

    Raises:
        ValueError: as in `vote`.
    """
    options = _options(options)
    places, field = _array("pixels", pixels), _array("vectors", vectors)
    if places.ndim != 2 or places.shape[1] != 2:
        fail("pixels", "shape (P, 2)", f"shape {places.shape}")
    if field.ndim != 3 or field.shape[::2] != (len(places), 2) or field.shape[1] == 0:
        fail("vectors", f"shape ({len(places)}, K, 2)", f"shape {field.shape}")
    if not np.isfinite(places).all():
        fail("pixels", "finite values", f"{int((~np.isfinite(places)).sum())} others")
    gathered = field.transpose(1, 2, 0).astype(np.float64, order="C")
    return _like(_vote(places.astype(np.float64), gathered, options), vectors)


def _options(options: VoteOptions | None) -> VoteOptions:
    if options is not None and not isinstance(options, VoteOptions):
        fail("options", "a VoteOptions or None", repr(options))
    return VoteOptions() if options is None else options


def _vote(pixels: np.ndarray, vectors: np.ndarray, options: VoteOptions) -> Votes:
    """`Votes` of one object from its pixels (P, 2) and their vectors (K, 2, P)."""
    keypoints, _, count = vectors.shape
    if not np.isfinite(vectors).all():
        bad = int((~np.isfinite(vectors)).any((0, 1)).sum())
        fail("vectors", "finite values", f"{bad} of {count} pixels with others")
    middle = pixels.mean(0) if count else np.zeros(2)
    points = np.tile(middle, (keypoints, 1))
    covariances = np.tile(UNKNOWN_STD**2 * np.eye(2), (keypoints, 1, 1))
    hypotheses = np.tile(middle, (keypoints, options.hypotheses, 1))
    weights = np.zeros((keypoints, options.hypotheses))
    if count >= 2:
        generator = np.random.default_rng(options.seed)
        if options.sample is not None and options.sample < count:
            chosen = generator.choice(count, options.sample, replace=False)
            pixels, vectors = pixels[chosen], vectors[..., chosen]
        centred = pixels - middle
        units = directions(vectors)
        walls = cone_walls(centred, units, options.threshold)
        guesses, weights = _ransac(centred, units, walls, options, generator)
        winners = guesses[np.arange(keypoints), weights.argmax(1)]
        inside = inlier_mask(walls, winners)
        refined = fit_lines(centred, units, inside, winners)
        if options.fit == "angles":
            refined = fit_angles(centred, units, inside, refined)
        weights[weights < weights.max(1, keepdims=True) - _MAX_BELOW_BEST] = 0
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
    options: VoteOptions,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses (K, S, 2) and the share of pixels that point at them (K, S)."""
    keypoints, _, count = units.shape
    shape = (keypoints, options.hypotheses)
    hypotheses, votes, best = np.zeros((*shape, 2)), np.zeros(shape), np.full(keypoints, -1.0)
    unsure = np.arange(keypoints)
    for drawn in range(1, options.rounds + 1):
        draws = (len(unsure), options.hypotheses)
        first = generator.integers(count, size=draws)
        second = (first + generator.integers(1, count, size=draws)) % count  # never the same pixel
        guesses, cross = crossings(
            pixels[first],
            units[unsure[:, None], :, first],
            pixels[second],
            units[unsure[:, None], :, second],
        )
        shares = count_inside(walls[unsure], guesses) * cross / count
        better = shares.max(1) > best[unsure]
        chosen = unsure[better]
        hypotheses[chosen], votes[chosen] = guesses[better], shares[better]
        best[chosen] = shares[better].max(1)
        miss = (1 - best**2) ** (drawn * options.hypotheses)  # no pair was of two inliers
        unsure = np.flatnonzero(miss > 1 - _CONFIDENCE)
        if not len(unsure):
            break
    return hypotheses, votes


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
