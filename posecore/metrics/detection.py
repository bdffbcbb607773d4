"""Average precision: how well scored estimates find the objects that are there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from posecore.arrays import Array, fail, require_integer, require_number, to_numbers

__all__ = [
    "Detections",
    "average_precision",
    "coco_average_precision",
    "match_at_thresholds",
    "match_by_error",
    "match_by_overlap",
    "pair_at_thresholds",
    "pair_by_overlap",
]

COCO_RECALLS = np.linspace(0, 1, 101)


@dataclass(frozen=True, eq=False)
class Detections:
    """All estimates of one object in one image, beside all that is there of it.

    Attributes:
        scores: (D,) confidence.
        counted: (G,) bool, the true poses that are to be found. An estimate that finds one of the
            others is neither right nor wrong.
        errors: name -> (D, G), infinite where it could not be larger.
    """

    scores: np.ndarray
    counted: np.ndarray
    errors: Mapping[str, np.ndarray]


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


def match_at_thresholds(errors: Array, scores: Array, thresholds: Array) -> np.ndarray:
    """`match_by_error` at many thresholds at once.

    Args:
        errors: (D, G), or (T, D, G) if each threshold has errors of its own, as VSD has.
        scores: (D,) confidence; equal scores choose in their order.
        thresholds: (T,) in the unit of the errors.

    Returns:
        (T, D) booleans.

    Raises:
        ValueError: on shapes that do not fit, an error below 0, or what is not a number.
    """
    return pair_at_thresholds(errors, scores, thresholds) >= 0


def pair_at_thresholds(errors: Array, scores: Array, thresholds: Array) -> np.ndarray:
    """Which true pose each estimate of one image finds; as `match_at_thresholds`, but says which.

    Returns:
        (T, D) integers, -1 for an estimate that found none.

    Raises:
        ValueError: on shapes that do not fit, an error below 0, or what is not a number.
    """
    thresholds = _numbers("thresholds", thresholds, 1)
    scores = _numbers("scores", scores, 1)
    errors = to_numbers("errors", errors)
    shape = (len(thresholds), len(scores), "G")
    if errors.ndim not in (2, 3) or errors.shape[:-1] not in (shape[1:2], shape[:2]):
        fail("errors", f"shape {shape[1:]} or {shape}", f"shape {errors.shape}")
    if not (errors >= 0).all():
        fail("errors", "numbers of at least 0", errors[~(errors >= 0)][0])
    errors = np.broadcast_to(errors, (len(thresholds), *errors.shape[-2:]))
    found = np.full(errors.shape[:2], -1)
    if not errors.size:
        return found
    free = np.ones((len(thresholds), errors.shape[2]), dtype=bool)
    every = np.arange(len(thresholds))
    for estimate in np.argsort(-scores, kind="stable"):
        candidates = np.where(free, errors[:, estimate], np.inf)
        best = candidates.argmin(1)
        near = np.flatnonzero(candidates[every, best] < thresholds)
        found[near, estimate] = best[near]
        free[near, best[near]] = False
    return found


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
    scores, correct, count = _ranked(scores, correct, object_count)
    if not correct.any():
        return 0.0
    order = np.argsort(-scores, kind="stable")
    scores, hits = scores[order], np.cumsum(correct[order])
    last = np.append(np.flatnonzero(np.diff(scores)), len(scores) - 1)  # of each group of equals
    precision = hits[last] / (last + 1)
    recall = hits[last] / count
    best_beyond = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall, prepend=0.0) * best_beyond).sum())


def coco_average_precision(scores: Array, correct: Array, object_count: int) -> float:
    """The mean precision of all estimates of one class at 101 recalls, as COCO has it.

    Precision at a recall is taken as the best at that recall or beyond; at recalls that are never
    reached it is 0 (Lin et al., Microsoft COCO, ECCV 2014, as its evaluation code computes it; the
    BOP challenge 2024 does the same for poses). Equal scores count in their order, so whoever gives
    all estimates the same score gets a number that depends on that order. `average_precision` is
    the area itself, and does not.

    Args:
        scores: (D,) confidence of every estimate in all images; D may be 0.
        correct: (D,) booleans.
        object_count: how many objects there are to be found, at least 1.

    Returns:
        A number in [0, 1].

    Raises:
        ValueError: on shapes that do not fit, or more correct estimates than objects.
    """
    scores, correct, count = _ranked(scores, correct, object_count)
    hits = np.cumsum(correct[np.argsort(-scores, kind="stable")])
    precision = hits / np.arange(1, len(hits) + 1)
    best_beyond = np.append(np.maximum.accumulate(precision[::-1])[::-1], 0.0)
    return float(best_beyond[np.searchsorted(hits / count, COCO_RECALLS)].mean())


def _ranked(scores: Array, correct: Array, object_count: int) -> tuple[np.ndarray, np.ndarray, int]:
    """What an average precision is made of, checked."""
    count = require_integer("object_count", object_count, 1)
    scores = _numbers("scores", scores, 1)
    correct = np.asarray(correct.cpu() if isinstance(correct, Tensor) else correct)
    if correct.shape != scores.shape or (correct.dtype != bool and correct.size):
        fail("correct", f"booleans of shape {scores.shape}", f"{correct.dtype} {correct.shape}")
    if correct.sum() > count:
        fail("correct", f"at most object_count = {count} correct estimates", int(correct.sum()))
    return scores, correct, count


def _numbers(name: str, values: Array, dimensions: int) -> np.ndarray:
    array = to_numbers(name, values)
    if array.ndim != dimensions:
        fail(name, f"{dimensions} dimensions", f"shape {array.shape}")
    if not np.isfinite(array).all():
        fail(name, "finite values", f"{int((~np.isfinite(array)).sum())} that are not")
    return array
