"""Average precision: how well scored estimates find the objects that are there."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from posecore.arrays import Array, fail, require_integer, require_number, to_numbers

__all__ = ["average_precision", "match_by_error", "match_by_overlap", "pair_by_overlap"]


def match_by_overlap(overlaps: Array, scores: Array, threshold: float) -> np.ndarray:
    """Which estimates of one image find an object: each counts once, the surest choose first.

    Args:
        overlaps: (D, G) overlap (3D IoU, say) of D estimates with G objects of the same class.
        scores: (D,) confidence; equal scores choose in their order.
        threshold: the overlap that a find must exceed.

    Returns:
        (D,) booleans: True for an estimate that found an object which none before it had found.

    Raises:
        ValueError: on shapes that do not fit, or values that are not finite.
    """
    return pair_by_overlap(overlaps, scores, threshold) >= 0


def pair_by_overlap(overlaps: Array, scores: Array, threshold: float) -> np.ndarray:
    """Which object each estimate of one image finds; as `match_by_overlap`, but says which.

    Returns:
        (D,) integers, -1 for an estimate that found none.

    Raises:
        ValueError: on shapes that do not fit, or values that are not finite.
    """
    overlaps = _numbers("overlaps", overlaps, 2)
    threshold = require_number("threshold", threshold)
    return _pair("overlaps", overlaps, scores, threshold)


def match_by_error(errors: Array, scores: Array, threshold: float) -> np.ndarray:
    """Which estimates of one image are right, as the BOP challenges pair them with the truth.

    The surest estimate chooses first, the pose with the smallest error among those that are free,
    if that error is below the threshold; so every threshold has pairs of its own. Hodan et al., BOP
    Challenge 2020 on 6D Object Localization, ECCVW 2020. BOP takes only as many estimates of an
    object as an image has targets of it: the surest.

    Args:
        errors: (D, G) error of D estimates against G true poses of the same object; infinite where
            it could not be larger.
        scores: (D,) confidence; equal scores choose in their order.
        threshold: in the unit of the errors.

    Returns:
        (D,) booleans.

    Raises:
        ValueError: on shapes that do not fit, an error below 0, or what is not a number.
    """
    errors = to_numbers("errors", errors)
    if errors.ndim != 2:
        fail("errors", "2 dimensions", f"shape {errors.shape}")
    if not (errors >= 0).all():
        fail("errors", "numbers of at least 0", errors[~(errors >= 0)][0])
    threshold = require_number("threshold", threshold)
    return _pair("errors", -errors, scores, -threshold) >= 0


def _pair(name: str, fitness: np.ndarray, scores: Array, threshold: float) -> np.ndarray:
    """For each estimate the free object that fits it best, if better than the threshold."""
    scores = _numbers("scores", scores, 1)
    if len(scores) != len(fitness):
        fail("scores", f"shape ({len(fitness)},) as {name} has rows", f"shape {scores.shape}")
    free = np.ones(fitness.shape[1], dtype=bool)
    found = np.full(len(scores), -1)
    for estimate in np.argsort(-scores, kind="stable"):
        candidates = np.where(free, fitness[estimate], -np.inf)
        if candidates.size and candidates.max() > threshold:
            found[estimate] = candidates.argmax()
            free[found[estimate]] = False
    return found


def average_precision(scores: Array, correct: Array, object_count: int) -> float:
    """The area under the precision-recall curve of all estimates of one class.

    Precision at a recall is taken as the best at that recall or beyond (Everingham et al., The
    PASCAL VOC Challenge, IJCV 2010; the area under all points, as since VOC 2010). Estimates with
    equal scores enter together, so their order in the file does not matter.

    Args:
        scores: (D,) confidence of every estimate in all images; D may be 0.
        correct: (D,) booleans, from `match_by_overlap` or any other rule.
        object_count: how many objects there are to be found, at least 1.

    Returns:
        A number in [0, 1].

    Raises:
        ValueError: on shapes that do not fit, or more correct estimates than objects.
    """
    count = require_integer("object_count", object_count, 1)
    scores = _numbers("scores", scores, 1)
    correct = np.asarray(correct.cpu() if isinstance(correct, Tensor) else correct)
    if correct.shape != scores.shape or (correct.dtype != bool and correct.size):
        fail("correct", f"booleans of shape {scores.shape}", f"{correct.dtype} {correct.shape}")
    if correct.sum() > count:
        fail("correct", f"at most object_count = {count} correct estimates", int(correct.sum()))
    if not correct.any():
        return 0.0
    order = np.argsort(-scores, kind="stable")
    scores, hits = scores[order], np.cumsum(correct[order])
    last = np.append(np.flatnonzero(np.diff(scores)), len(scores) - 1)  # of each group of equals
    precision = hits[last] / (last + 1)
    recall = hits[last] / count
    best_beyond = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall, prepend=0.0) * best_beyond).sum())


def _numbers(name: str, values: Array, dimensions: int) -> np.ndarray:
    array = to_numbers(name, values)
    if array.ndim != dimensions:
        fail(name, f"{dimensions} dimensions", f"shape {array.shape}")
    if not np.isfinite(array).all():
        fail(name, "finite values", f"{int((~np.isfinite(array)).sum())} that are not")
    return array
