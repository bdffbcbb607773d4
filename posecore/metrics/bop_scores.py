"""The scores of the BOP challenges, made of errors: average recall, detection's precision, time.

Average recall (AR) is for localisation: an image says which objects it holds and how many, and the
recalls at several thresholds are averaged (Hodan et al., BOP Challenge 2020 on 6D Object
Localization, ECCVW 2020, section 2.2). Detection says nothing of the kind, and has COCO's average
precision at the same thresholds (Nguyen et al., BOP Challenge 2024 on Model-Based and Model-Free 6D
Object Pose Estimation, 2025). Constants and details are those of the BOP toolkit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posecore.metrics.detection import (
    Detections,
    coco_average_precision,
    match_at_thresholds,
    pair_at_thresholds,
)
from posecore.metrics.evaluation import ObjectErrors
from posecore.metrics.pose_table import PoseTable

__all__ = [
    "LEAST_VISIBLE",
    "MOST_DETECTIONS",
    "MSPD_THRESHOLDS",
    "MSSD_THRESHOLDS",
    "VSD_THRESHOLDS",
    "average_precisions",
    "average_recalls",
    "detection_precision",
    "matches",
    "surest_of_images",
    "time_per_image",
]

MSSD_THRESHOLDS = np.arange(1, 11) * 0.05
"""Parts of the diameter."""
MSPD_THRESHOLDS = np.arange(1, 11) * 5.0
"""Pixels, in an image 640 wide."""
VSD_THRESHOLDS = np.arange(0.05, 0.51, 0.05)
"""Parts of the visible surface. VSD is a quotient of counts and may be equal to one of them, so
these are the toolkit's to the last digit."""
LEAST_VISIBLE = 0.1
"""Of an object, for it to count in detection (`visib_gt_min`)."""
MOST_DETECTIONS = 100
"""Estimates of an image that detection looks at."""
AR, AP = "AR, their mean", "AP, their mean"
SAME_TIME = 0.001  # seconds by which the times of an image's estimates may differ


def matches(errors: np.ndarray, thresholds: np.ndarray) -> int:
    """How many estimates of an image are right, summed over thresholds, each with its own pairs.

    Args:
        errors: (D, G) of its estimates, surest first; or (T, D, G), of each threshold.
        thresholds: (T,) in the unit of the errors.
    """
    scores = -np.arange(errors.shape[-2])
    return int(match_at_thresholds(errors, scores, thresholds).sum())


def detection_precision(
    images: Sequence[Detections], name: str, thresholds: np.ndarray, unit: float = 1.0
) -> float | None:
    """BOP24's average precision of one object: COCO's, averaged over thresholds.

    At each threshold the surest estimate of an image chooses first, among all true poses, counted
    or not. As the toolkit has it, estimates are left out if they find a pose that does not count,
    and also if their image holds no such object at all: there a false alarm costs nothing. Equal
    scores count in the order of the images.

    Args:
        images: those that hold the object.
        name: of the error.
        thresholds: (T,).
        unit: by which errors are divided before they are compared.

    Returns:
        In [0, 1]; None if no pose counts.
    """
    count = sum(int(image.counted.sum()) for image in images)
    if not count:
        return None
    scores = np.concatenate([image.scores for image in images])
    right, left_out = [], []
    for image in images:
        paired = pair_at_thresholds(image.errors[name] / unit, image.scores, thresholds)
        right.append(np.append(image.counted, False)[paired])  # -1 is the last one
        left_out.append((paired >= 0) & ~right[-1])
    hits, kept = np.concatenate(right, 1), ~np.concatenate(left_out, 1)
    return float(
        np.mean(
            [
                coco_average_precision(scores[some], hit[some], count)
                for hit, some in zip(hits, kept, strict=True)
            ]
        )
    )


def surest_of_images(table: PoseTable, count: int = MOST_DETECTIONS) -> np.ndarray:
    """Which rows (N,) are among the `count` surest of their image, whatever their object."""
    _, image = np.unique(np.stack([table.scene_id, table.image_id], 1), axis=0, return_inverse=True)
    image = image.reshape(-1)
    order = np.lexsort((-table.score, image))  # stable
    begin = np.searchsorted(image[order], image[order])
    kept = np.zeros(len(table), dtype=bool)
    kept[order] = np.arange(len(table)) - begin < count
    return kept


def time_per_image(table: PoseTable) -> tuple[float, int] | None:
    """Seconds that an image with estimates took on average, and how many such images there are.

    Every estimate carries the time of its whole image.

    Returns:
        None if there are no estimates, or the time of one is not known.

    Raises:
        ValueError: if estimates of an image have times that differ by more than a millisecond.
    """
    if not len(table) or (table.time < 0).any():
        return None
    times: dict[tuple[int, int], float] = {}
    for image, time in zip(table.images, table.time.tolist(), strict=True):
        first = times.setdefault(image, time)
        if abs(first - time) > SAME_TIME:
            raise ValueError(
                f"time: expected the same for all estimates of an image, got {first:g} s and "
                f"{time:g} s in scene {image[0]}, image {image[1]}"
            )
    return float(np.mean(list(times.values()))), len(times)


def average_recalls(parts: Sequence[ObjectErrors], image_width: float = 640) -> dict[str, float]:
    """BOP's average recalls in [0, 1], as far as the errors allow.

    Args:
        parts: of one object, or of several: then every pose has the same weight, and each recall
            covers the objects for which it could be computed.
        image_width: pixels; the thresholds of MSPD grow with it.

    Returns:
        By "VSD", "MSSD" and "MSPD"; and AR, their mean, over the objects that have all three.
    """
    names = ("vsd", "mssd", "mspd")
    recalls = {}
    for name in names:
        if some := [part for part in parts if _has(part, name)]:
            recalls[name.upper()] = _recall(some, name, image_width)
    if some := [part for part in parts if all(_has(part, name) for name in names)]:
        recalls[AR] = float(np.mean([_recall(some, name, image_width) for name in names]))
    return recalls


def average_precisions(parts: Sequence[ObjectErrors], image_width: float = 640) -> dict[str, float]:
    """BOP24's average precisions in [0, 1], means over the objects that have them.

    Args:
        parts: of one object or of several.
        image_width: pixels; the thresholds of MSPD grow with it.

    Returns:
        By "MSSD" and "MSPD"; and AP, their mean.
    """
    every = [_precisions(part, image_width) for part in parts]
    labels = dict.fromkeys(label for one in every for label in one)
    return {i: float(np.mean([one[i] for one in every if i in one])) for i in labels}


def _has(part: ObjectErrors, name: str) -> bool:
    return name in part.errors and bool(part.measured(name).any())


def _recall(parts: Sequence[ObjectErrors], name: str, image_width: float) -> float:
    """Average recall in [0, 1], with pairs of its own at each threshold (and tolerance, of VSD)."""
    recalled, there = 0, 0
    for part in parts:
        unit, thresholds = _unit_and_thresholds(part, name, image_width)
        rows = part.measured(name)
        errors = part.errors[name][rows, None] / unit  # (n, 1), of VSD (n, 1, T)
        tolerances = errors.shape[2] if errors.ndim == 3 else 1
        there += len(errors) * len(thresholds) * tolerances
        if name not in part.pairs:  # every true pose is alone in its image
            recalled += int((errors.reshape(-1, 1) < thresholds).sum())
            continue
        for pairs in part.pairs[name]:
            if pairs.ndim == 3:  # of each tolerance
                pairs = np.repeat(pairs, len(thresholds), axis=0)
            recalled += matches(pairs / unit, np.tile(thresholds, tolerances))
    return recalled / there


def _precisions(part: ObjectErrors, image_width: float) -> dict[str, float]:
    """BOP24's average precisions in [0, 1], as far as they could be computed."""
    values = {}
    for name in ("mssd", "mspd"):
        if part.detections and name in part.errors:
            unit, thresholds = _unit_and_thresholds(part, name, image_width)
            value = detection_precision(part.detections, name, thresholds, unit)
            if value is not None:
                values[name.upper()] = value
    if len(values) == 2:
        values[AP] = float(np.mean([*values.values()]))
    return values


def _unit_and_thresholds(
    part: ObjectErrors, name: str, image_width: float
) -> tuple[float, np.ndarray]:
    """By what errors are divided before BOP compares them, and with what."""
    if name == "vsd":
        return 1.0, VSD_THRESHOLDS
    if name == "mssd":
        return part.diameter, MSSD_THRESHOLDS
    return image_width / 640, MSPD_THRESHOLDS
