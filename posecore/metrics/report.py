"""The table of all metrics: a line for each, a column for each object and two for all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posecore.metrics import bop_scores, summaries
from posecore.metrics.evaluation import HEAD_ANGLES, IOU_THRESHOLDS, ObjectErrors

__all__ = ["Line", "report", "summarise", "to_text"]

COUNT = "poses"
CORRECT = "correct, % of all ground truth"
CORRECT_FOUND = "correct, % of the estimated"
CORRECT_COUNT = "correct, number of poses"
AREA = "area under the accuracy curve to 10 cm, %"
RECALL = "BOP average recall, %"
DETECTION = "BOP24 detection, average precision, %"
PRECISION = "average precision of the box, %"
MEDIAN = "median of the estimated"
MEDIAN_OF_PAIRS = "median of the pairs"
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
}
PIXELS = ("projection", "mspd")
DIGITS = {COUNT: 0, CORRECT_COUNT: 0, MEDIAN: 3, MEDIAN_OF_PAIRS: 3, ANGLES: 2}  # else 1


@dataclass(frozen=True, eq=False)
class Line:
    """One metric.

    Attributes:
        section, label: what it is called.
        objects: object id, or category -> value, None where it could not be computed.
        pooled: the value over all poses, each with the same weight.
        mean: the mean over the objects, each with the same weight; None for counts.
    """

    section: str
    label: str
    objects: dict[int, float | None] | dict[str, float | None]
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
    columns = {i: summarise([one], image_width) for i, one in errors.items()}
    pooled = summarise(list(errors.values()), image_width)
    lines = []
    for section, label in pooled:
        values = {i: column.get((section, label)) for i, column in columns.items()}
        known = [value for value in values.values() if value is not None]
        counted = section in (COUNT, CORRECT_COUNT)
        alone = section in (DETECTION, PRECISION)  # of one class by definition
        lines.append(
            Line(
                section,
                label,
                values,
                None if alone else pooled[section, label],
                None if counted else float(np.mean(known)),
            )
        )
    return lines


def summarise(
    parts: Sequence[ObjectErrors], image_width: float = 640
) -> dict[tuple[str, str], float]:
    """(section, label) -> value, for all metrics that the errors allow. Units as in `report`.

    Args:
        parts: the errors of one object, or of several: then every pose has the same weight, and a
            metric covers the objects for which it could be computed.
        image_width: pixels.
    """
    found = _join(parts, lambda part: part.found)
    lines: dict[tuple[str, str], float] = {
        (COUNT, "ground truth"): len(found),
        (COUNT, "estimated"): int(found.sum()),
    }
    correct = _correct(parts)
    for label, (right, _) in correct.items():
        lines[CORRECT, label] = 100 * float(right.mean())
    for label, (right, estimated) in correct.items():
        if estimated.any():
            lines[CORRECT_FOUND, label] = 100 * float(right[estimated].mean())
    for label, (right, _) in correct.items():
        lines[CORRECT_COUNT, label] = int(right.sum())
    for name, label in ADD_KINDS.items():
        if some := _having(parts, name):
            errors = _join(some, lambda part, name=name: part.errors[name])
            lines[AREA, label] = 100 * summaries.auc(errors, 0.1)
    for label, recall in bop_scores.average_recalls(parts, image_width).items():
        lines[RECALL, label] = 100 * recall
    for label, precision in bop_scores.average_precisions(parts, image_width).items():
        lines[DETECTION, label] = 100 * precision
    for threshold in IOU_THRESHOLDS:
        if some := [part.precision[threshold] for part in parts if threshold in part.precision]:
            lines[PRECISION, f"3D IoU > {threshold}"] = 100 * float(np.mean(some))
    for name, (label, factor) in MEDIANS.items():
        if some := _having(parts, name):
            errors = _join(
                some, lambda part, name=name: part.errors[name][part.found & part.measured(name)]
            )
            if errors.size:
                lines[MEDIAN, label] = factor * float(np.median(errors))
    if some := [part for part in parts if part.overlap is not None]:
        overlap = _join(some, lambda part: part.overlap[part.found])
        if overlap.size:
            lines[MEDIAN, "3D IoU"] = float(np.median(overlap))
    if (some := _having(parts, "yaw")) and any(part.found.any() for part in some):
        lines |= _angle_lines(some)
    return lines


def _having(parts: Sequence[ObjectErrors], name: str) -> list[ObjectErrors]:
    return [part for part in parts if name in part.errors and part.measured(name).any()]


def _join(
    parts: Sequence[ObjectErrors], values: Callable[[ObjectErrors], np.ndarray]
) -> np.ndarray:
    return np.concatenate([values(part) for part in parts])


def _correct(parts: Sequence[ObjectErrors]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Label -> which poses are right, and which of them were estimated at all."""
    rules: dict[str, tuple[list[ObjectErrors], Callable[[ObjectErrors], np.ndarray]]] = {}
    for name, label in ADD_KINDS.items():
        rules[f"{label} < 0.1 d"] = (
            _having(parts, name),
            lambda part, name=name: part.errors[name] < 0.1 * part.diameter,
        )
    rules["2D projection < 5 px"] = (
        _having(parts, "projection"),
        lambda part: part.errors["projection"] < 5,
    )
    for degrees, cm in ((5, 2), (5, 5), (10, 5), (10, 10)):
        rules[f"{degrees} deg {cm} cm"] = (
            _having(parts, "rotation"),
            lambda part, degrees=degrees, cm=cm: summaries.within(
                part.errors["rotation"], part.errors["translation"], degrees, cm
            ),
        )
    for threshold in IOU_THRESHOLDS:
        rules[f"3D IoU > {threshold}"] = (
            [part for part in parts if part.overlap is not None],
            lambda part, threshold=threshold: part.overlap > threshold,
        )
    result = {}
    for label, (some, right) in rules.items():
        if some:
            name = "projection" if label.startswith("2D projection") else ""
            rows = [part.measured(name) for part in some]
            pairs = list(zip(some, rows, strict=True))
            result[label] = (
                np.concatenate([right(part)[mask] for part, mask in pairs]),
                np.concatenate([part.found[mask] for part, mask in pairs]),
            )
    return result


def _angle_lines(parts: Sequence[ObjectErrors]) -> dict[tuple[str, str], float]:
    """MAE, RMSE and BMAE of yaw, pitch, roll, and the average of the three."""
    lines = {}
    for label, metric in (
        ("MAE", lambda error, _: summaries.mean_absolute_error(error)),
        ("RMSE", lambda error, _: summaries.root_mean_squared_error(error)),
        ("BMAE", summaries.balanced_mean_angular_error),
    ):
        numbers = [
            np.rad2deg(
                metric(
                    _join(parts, lambda part, name=name: part.errors[name][part.found]),
                    _join(parts, lambda part, name=name: part.true_angles[name][part.found]),
                )
            )
            for name in HEAD_ANGLES
        ]
        names = (*HEAD_ANGLES, "average")
        for name, number in zip(names, (*numbers, np.mean(numbers)), strict=True):
            lines[ANGLES, f"{label} {name}"] = float(number)
    return lines


def to_text(lines: list[Line], width: int = 120) -> str:
    """The report as a table for a terminal; `-` where a metric could not be computed.

    Args:
        lines: from `report`.
        width: characters; objects that do not fit beside each other follow below.
    """
    objects = list(lines[0].objects)
    heads = [i if isinstance(i, str) else f"obj {i}" for i in objects]
    cells = {line: [*line.objects.values()] for line in lines}
    pooled = any(line.pooled is not None for line in lines)
    if len(objects) > 1:
        heads += ["all", "mean"] if pooled else ["mean"]
        ends = {line: [line.pooled, line.mean][not pooled :] for line in lines}
        cells = {line: [*row, *ends[line]] for line, row in cells.items()}
    shown = {line: _show(line, row) for line, row in cells.items()}
    column = max(9, 2 + max(map(len, heads)))
    label = 2 + max(len(line.label) for line in lines)
    at_once = max(1, (width - label) // column)
    text = []
    for begin in range(0, len(heads), at_once):
        some = slice(begin, begin + at_once)
        text.append(" " * label + "".join(head.rjust(column) for head in heads[some]))
        section = None
        for line in lines:
            if line.section != section:
                section = line.section
                text += ["", section]
            row = "".join(cell.rjust(column) for cell in shown[line][some])
            text.append(("  " + line.label).ljust(label) + row)
        text.append("")
    if len(objects) > 1 and pooled:
        text.append("all: every pose has the same weight; mean: every object has.")
    if any("*" in cell for row in shown.values() for cell in row):
        text.append("*: of those objects only that have a value in the line.")
    return "\n".join(text).rstrip("\n")


def _show(line: Line, row: list[float | None]) -> list[str]:
    digits = DIGITS.get(line.section, 1)
    cells = ["-" if value is None else f"{value:.{digits}f}" for value in row]
    if None in line.objects.values():
        first = len(line.objects)  # of the two columns over all objects
        cells[first:] = [cell if cell == "-" else cell + "*" for cell in cells[first:]]
    return cells
