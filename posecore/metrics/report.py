"""The table of all metrics: a line for each, a column for each object and two for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posecore.metrics import summaries
from posecore.metrics.evaluation import HEAD_ANGLES, IOU_THRESHOLDS, ObjectErrors, pool

__all__ = ["Line", "report", "summarise", "to_text"]

MSSD_THRESHOLDS = np.arange(1, 11) * 0.05  # of the diameter; Hodan et al., BOP Challenge 2020
MSPD_THRESHOLDS = np.arange(1, 11) * 5.0  # pixels, in an image 640 wide

COUNT = "poses"
CORRECT = "correct, % of all ground truth"
CORRECT_FOUND = "correct, % of the estimated"
CORRECT_COUNT = "correct, number of poses"
AREA = "area under the accuracy curve to 10 cm, %"
RECALL = "BOP average recall, %"
PRECISION = "average precision of the box, %"
MEDIAN = "median of the estimated"
ANGLES = "single angles of the estimated (R = Ry(yaw) Rx(pitch) Rz(roll)), degrees"
ADD_KINDS = {"add": "ADD", "add_s": "ADD-S", "add_or_s": "ADD(-S)"}
MEDIANS = {  # name -> label, factor to the printed unit
    "add": ("ADD, mm", 1000),
    "add_s": ("ADD-S, mm", 1000),
    "mssd": ("MSSD, mm", 1000),
    "translation": ("translation, mm", 1000),
    "rotation": ("rotation, deg", 180 / np.pi),
    "projection": ("2D projection, px", 1),
    "mspd": ("MSPD, px", 1),
    "iou": ("3D IoU", 1),
}
DIGITS = {COUNT: 0, CORRECT_COUNT: 0, MEDIAN: 3, ANGLES: 2}  # else 1


@dataclass(frozen=True)
class Line:
    """One metric.

    Attributes:
        section, label: what it is called.
        objects: object id -> value, None where it could not be computed.
        pooled: the value over all poses, each with the same weight.
        mean: the mean over the objects, each with the same weight; None for counts.
    """

    section: str
    label: str
    objects: dict[int, float | None]
    pooled: float | None
    mean: float | None


def report(errors: Mapping[int, ObjectErrors], image_width: float = 640) -> list[Line]:
    """Sum up errors with every metric.

    Args:
        errors: object id -> errors, from `evaluation.evaluate`.
        image_width: pixels; the thresholds of MSPD grow with it.

    Returns:
        One line for each metric. Lengths in mm, angles in degrees, shares in per cent.
    """
    columns = {i: summarise(one, image_width) for i, one in errors.items()}
    pooled = summarise(pool(list(errors.values())), image_width)
    fullest_first = sorted(columns.values(), key=len, reverse=True)  # its order is the order
    keys = dict.fromkeys(key for column in fullest_first for key in column)
    lines = []
    for section, label in keys:
        values = {i: column.get((section, label)) for i, column in columns.items()}
        known = [value for value in values.values() if value is not None]
        counted = section in (COUNT, CORRECT_COUNT)
        mean = None if counted else float(np.mean(known))
        lines.append(Line(section, label, values, pooled.get((section, label)), mean))
    order = {section: n for n, section in enumerate(dict.fromkeys(line.section for line in lines))}
    return sorted(lines, key=lambda line: order[line.section])


def summarise(errors: ObjectErrors, image_width: float = 640) -> dict[tuple[str, str], float]:
    """(section, label) -> value, for all metrics that the errors allow. Units as in `report`."""
    values = errors.values
    lines: dict[tuple[str, str], float] = {
        (COUNT, "ground truth"): len(errors.found),
        (COUNT, "estimated"): int(errors.found.sum()),
    }
    correct = _correct(values)
    for label, (right, _) in correct.items():
        lines[CORRECT, label] = 100 * float(right.mean())
    for label, (right, estimated) in correct.items():
        if estimated.any():
            lines[CORRECT_FOUND, label] = 100 * float(right[estimated].mean())
    for label, (right, _) in correct.items():
        lines[CORRECT_COUNT, label] = int(right.sum())
    for name, label in ADD_KINDS.items():
        if name in values:
            lines[AREA, label] = 100 * summaries.auc(values[name], 0.1)
    if "mssd" in values:
        relative = values["mssd"] / values["diameter"]
        lines[RECALL, "MSSD"] = 100 * summaries.average_recall(relative, MSSD_THRESHOLDS)
    if "mspd" in values:
        thresholds = MSPD_THRESHOLDS * image_width / 640
        lines[RECALL, "MSPD"] = 100 * summaries.average_recall(values["mspd"], thresholds)
    for threshold, precision in errors.precision.items():
        lines[PRECISION, f"3D IoU > {threshold}"] = 100 * precision
    for name, (label, factor) in MEDIANS.items():
        estimated = values[name][np.isfinite(values[name])] if name in values else np.empty(0)
        if estimated.size:
            lines[MEDIAN, label] = factor * float(np.median(estimated))
    if "yaw" in values and errors.found.any():
        lines |= _angle_lines(values)
    return lines


def _correct(values: Mapping[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Label -> which poses are right, and which of them were estimated at all."""
    right = {}
    for name, label in ADD_KINDS.items():
        if name in values:
            right[f"{label} < 0.1 d"] = values[name] < 0.1 * values["diameter"], values[name]
    if "projection" in values:
        right["2D projection < 5 px"] = values["projection"] < 5, values["projection"]
    if "rotation" in values:
        rotation, translation = values["rotation"], values["translation"]
        for degrees, cm in ((5, 2), (5, 5), (10, 5), (10, 10)):
            good = summaries.within(rotation, translation, degrees, cm)
            right[f"{degrees} deg {cm} cm"] = good, rotation
    if "iou" in values:
        for threshold in IOU_THRESHOLDS:
            right[f"3D IoU > {threshold}"] = values["iou"] > threshold, values["iou"]
    return {label: (good, np.isfinite(error)) for label, (good, error) in right.items()}


def _angle_lines(values: Mapping[str, np.ndarray]) -> dict[tuple[str, str], float]:
    """MAE, RMSE and BMAE of yaw, pitch, roll, and the average of the three."""
    lines = {}
    estimated = np.isfinite(values["yaw"])
    for label, metric in (
        ("MAE", lambda error, _: summaries.mean_absolute_error(error)),
        ("RMSE", lambda error, _: summaries.root_mean_squared_error(error)),
        ("BMAE", summaries.balanced_mean_angular_error),
    ):
        numbers = [
            np.rad2deg(metric(values[name][estimated], values[f"true_{name}"][estimated]))
            for name in HEAD_ANGLES
        ]
        for name, number in zip(
            (*HEAD_ANGLES, "average"), (*numbers, np.mean(numbers)), strict=True
        ):
            lines[ANGLES, f"{label} {name}"] = float(number)
    return lines


def to_text(lines: list[Line]) -> str:
    """The report as a table for a terminal; `-` where a metric could not be computed."""
    objects = list(lines[0].objects)
    several = len(objects) > 1
    heads = [f"obj {i}" for i in objects] + (["all", "mean"] if several else [])
    width = max(9, 2 + max(map(len, heads)))
    label_width = 2 + max(len(line.label) for line in lines)
    text = [" " * label_width + "".join(head.rjust(width) for head in heads)]
    section, partial = None, False
    for line in lines:
        if line.section != section:
            section = line.section
            text += ["", section]
        cells = list(line.objects.values()) + ([line.pooled, line.mean] if several else [])
        digits = DIGITS.get(section, 1)
        shown = ["-" if cell is None else f"{cell:.{digits}f}" for cell in cells]
        if several and None in line.objects.values():
            partial = True
            shown[-2:] = [cell if cell == "-" else cell + "*" for cell in shown[-2:]]
        text.append(("  " + line.label).ljust(label_width) + "".join(s.rjust(width) for s in shown))
    if several:
        text += ["", "all: every pose has the same weight; mean: every object has."]
    if partial:
        text.append("*: of those objects only that have a value in the line.")
    return "\n".join(text)
