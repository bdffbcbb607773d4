"""Average precision: how well scored estimates find the objects that are there."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from posecore.arrays import Array, fail, require_integer, require_number, to_numbers

__all__ = ["average_precision", "match_by_overlap"]


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
    overlaps = _numbers("overlaps", overlaps, 2)
    scores = _numbers("scores", scores, 1)
    if len(scores) != len(overlaps):
        fail("scores", f"shape ({len(overlaps)},) as overlaps has rows", f"shape {scores.shape}")
    threshold = require_number("threshold", threshold)
    free = np.ones(overlaps.shape[1], dtype=bool)
    found = np.zeros(len(scores), dtype=bool)
    for estimate in np.argsort(-scores, kind="stable"):
        candidates = np.where(free, overlaps[estimate], -np.inf)
        if candidates.size and candidates.max() > threshold:
            free[candidates.argmax()] = False
            found[estimate] = True
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
