"""The table of category-level metrics: a line for each, a column for each category, their mean."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posecore.arrays import fail
from posecore.metrics.category_evaluation import IOU_OF_PAIRS, CategoryErrors
from posecore.metrics.report import COUNT, MEDIAN_OF_PAIRS, Line

__all__ = ["report_categories"]

BOX = "average precision of the 3D box, %"
POSE = f"average precision of the pose, % (pairs of 3D IoU > {IOU_OF_PAIRS}: detection put aside)"
POSE_OF_ALL = "average precision of the pose, % (what is missed or said too much counts)"


def report_categories(errors: Mapping[str, CategoryErrors]) -> list[Line]:
    """Sum up errors with every metric of the field.

    Args:
        errors: category -> errors, from `evaluate_categories`.

    Returns:
        One line for each metric, for `report.to_text`: `objects` has the categories, `mean` is the
        mean over them (mAP), `pooled` is None. Lengths in mm, angles in degrees, shares in per
        cent.

    Raises:
        ValueError: if there are no categories.
    """
    if not errors:
        fail("errors", "at least one category", "none")
    columns = {name: _summarise(one) for name, one in errors.items()}
    lines = []
    for section, label in dict.fromkeys(key for column in columns.values() for key in column):
        values = {name: column.get((section, label)) for name, column in columns.items()}
        known = [value for value in values.values() if value is not None]
        mean = None if section == COUNT else float(np.mean(known))
        lines.append(Line(section, label, values, None, mean))
    return lines


def _summarise(errors: CategoryErrors) -> dict[tuple[str, str], float]:
    """(section, label) -> value."""
    lines: dict[tuple[str, str], float] = {
        (COUNT, "ground truth"): errors.count,
        (COUNT, "estimated"): errors.estimated,
        (COUNT, "pairs"): len(errors.pairs),
    }
    for threshold, precision in errors.iou.items():
        lines[BOX, f"3D IoU > {threshold}"] = 100 * precision
    for section, values in ((POSE, errors.pose), (POSE_OF_ALL, errors.pose_of_all)):
        for (degrees, cm), precision in values.items():
            lines[section, f"{degrees:g} deg {cm:g} cm"] = 100 * precision
    if len(errors.pairs):
        lines[MEDIAN_OF_PAIRS, "rotation, deg"] = float(np.rad2deg(np.median(errors.rotation)))
        lines[MEDIAN_OF_PAIRS, "translation, mm"] = 1000 * float(np.median(errors.translation))
        lines[MEDIAN_OF_PAIRS, "scale, % off"] = 100 * float(np.median(np.abs(errors.scale - 1)))
        lines[MEDIAN_OF_PAIRS, "3D IoU"] = float(np.median(errors.overlap))
    return lines
