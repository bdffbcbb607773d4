"""The paper's Tables 3 and 4 in small: numbers of the ledger, mean and spread over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from book.ch04_points_to_pose.runs import key
from book.tools.claims import Claim
from book.tools.keys import Key
from data_tools.shapes import GLASSES
from posecore.arrays import fail
from posecore.methods.points_to_pose.evaluation import ANGLES, AXES, METRICS

__all__ = ["Table", "not_measured", "orientation", "position", "reduction"]

Numbers = Mapping[Key, np.ndarray]
METHODS = {
    "constant": "constant", "RandomizedBins": "bins, book", "CloudPose": "cloudpose, book",
    "P2R": "p2r, book", "P2P": "p2p, book",
}  # fmt: skip
"""The columns, and the runs that are in them."""


@dataclass(frozen=True)
class Table:
    """A table that a notebook shows.

    Attributes:
        head: names of the columns.
        rows: of text.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def _repr_markdown_(self) -> str:
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def orientation(numbers: Numbers, methods: Mapping[str, str] = METHODS) -> Table:
    """Table 3: degrees by metric, of all glasses by angle, and of each glasses on average.

    Args:
        numbers: of the measurement "race".
        methods: title of the column -> run.
    """
    rows = [
        [f"ALL, {angle}", metric, *_cells(numbers, methods, f"{metric} {angle}")]
        for metric in METRICS
        for angle in ANGLES
    ]
    rows += [
        [glasses or "**ALL**", metric, *_cells(numbers, methods, metric, glasses)]
        for glasses in ("", *GLASSES)
        for metric in METRICS
    ]
    return Table(["glasses", "metric", *methods], rows)


def position(numbers: Numbers, methods: Mapping[str, str] = METHODS) -> Table:
    """Table 4: millimetres along each axis and as a distance, of all glasses and of each.

    Args:
        numbers, methods: as of `orientation`.
    """
    rows = [["ALL", axis, *_cells(numbers, methods, f"position {axis}")] for axis in AXES]
    rows += [
        [glasses or "**ALL**", "distance", *_cells(numbers, methods, "position", glasses)]
        for glasses in ("", *GLASSES)
    ]
    return Table(["glasses", "error", *methods], rows)


def _cells(
    numbers: Numbers, methods: Mapping[str, str], metric: str, glasses: str = ""
) -> list[str]:
    cells = []
    for run in methods.values():
        if key(run, metric, glasses) not in numbers:
            cells.append("not measured")
            continue
        values = numbers[key(run, metric, glasses)]
        spread = f" ± {values.std(ddof=1):.2g}" if len(values) > 1 and values.std() > 0 else ""
        cells.append(f"{values.mean():.3g}{spread}")
    return cells


def not_measured(claims: Sequence[Claim]) -> Table:
    """Claims that no ledger answers yet, and where they stand in the paper."""
    rows = [[claim.statement, claim.source, claim.measurement] for claim in claims]
    return Table(["claim, not measured yet", "where it stands", "measurement"], rows)


def reduction(numbers: Numbers, ours: str, theirs: str, metric: str) -> tuple[float, float]:
    """By how many percent an error is smaller: mean over seeds, and standard deviation.

    Args:
        numbers: of a measurement.
        ours, theirs: runs.
        metric: of both.

    Raises:
        ValueError: if one of them was not measured.
    """
    for run in (ours, theirs):
        if key(run, metric) not in numbers:
            fail("numbers", f"some of {run}", "none")
    shares = 100 * (1 - numbers[key(ours, metric)] / numbers[key(theirs, metric)])
    return float(shares.mean()), float(shares.std(ddof=1))
