"""Results of a method as BOP's CSV files: one line for every estimated pose, millimetres on disk.

The columns are `scene_id,im_id,obj_id,score,R,t,time` (BOP Challenge 2019): R is nine numbers row
by row, t three, both separated by blanks; time is the seconds that the whole image took, or -1.

Writing and reading are exact. Numbers are written with the digits that float64 needs, and metres
become millimetres by moving the decimal point of the written number, not by a product that rounds:
`read_results(path, rotations="as_read")` returns every array that was written bit by bit, and
`"project"` does so for rotations that were read or projected before.
"""

from __future__ import annotations

import math
from decimal import Decimal
from pathlib import Path
from typing import NoReturn

import numpy as np

from data_tools.bop.files import _short, read_bytes
from data_tools.bop.rotations import check_rotations
from data_tools.bop.scenes import known_poses
from posecore.arrays import fail
from posecore.files import require_path, write_bytes
from posecore.metrics.pose_table import PoseTable

__all__ = ["read_results", "write_results"]

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
HEADER = ",".join(COLUMNS)


def read_results(path: str | Path, rotations: str = "project") -> PoseTable:
    """Read a results file.

    As in BOP's own reader the header may be missing. The format holds no count: a file cut between
    two lines, or within the last number of its last line, cannot be told from a whole one. Rows
    whose R is a placeholder, nothing but -1, are left out, and one warning says how many.

    Args:
        path: the CSV file.
        rotations: "project" turns matrices that are not quite rotations into the nearest ones and
            warns once if they are noticeably off; "as_read" leaves them, to reproduce the figures
            of others.

    Returns:
        The rows in the order of the file, translations in metres.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, line and column of what is no such row, or no rotation.
    """
    path = require_path("path", path)
    try:
        lines = read_bytes(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected a text file: {error}") from error
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip()]
    top = numbered[0][1].strip() if numbered else ""
    if top == HEADER:
        del numbered[0]
    elif not top[:1].isdigit():
        raise ValueError(f"{path}: expected the header {HEADER} or a row, got {top[:80]!r}")
    rows = [_read_row(path, number, line) for number, line in numbered]
    known = known_poses(path, np.reshape([row[4] for row in rows], (-1, 3, 3)))
    if not known.all():
        rows = [row for row, there in zip(rows, known, strict=True) if there]
        numbered = [one for one, there in zip(numbered, known, strict=True) if there]
    scene_id, image_id, object_id, score, R, t, time = zip(*rows, strict=True) if rows else [()] * 7
    return PoseTable(
        scene_id=np.array(scene_id, np.int64),
        image_id=np.array(image_id, np.int64),
        object_id=np.array(object_id, np.int64),
        R=check_rotations(
            path,
            np.reshape(np.array(R, np.float64), (-1, 3, 3)),
            rotations,
            lambda i: f"line {numbered[i][0]}, column R",
        ),
        t=np.reshape(np.array(t, np.float64), (-1, 3)),
        score=np.array(score, np.float64),
        time=np.array(time, np.float64),
    )


def write_results(path: str | Path, table: PoseTable) -> None:
    """Write a results file; the same table always gives the same bytes.

    The file appears whole or not at all: if writing fails, an older file is still as it was.

    Args:
        path: the CSV file, in a folder that exists.
        table: poses with translations in metres.

    Raises:
        ValueError: if an id is negative.
        OSError: if the file cannot be written.
    """
    if not isinstance(table, PoseTable):
        fail("table", "a PoseTable", type(table).__name__)
    for name in ("scene_id", "image_id", "object_id"):
        if (getattr(table, name) < 0).any():
            fail(f"table.{name}", "ids of at least 0", getattr(table, name).min())
    lines = [HEADER]
    for i in range(len(table)):
        ids = f"{table.scene_id[i]},{table.image_id[i]},{table.object_id[i]}"
        R = " ".join(map(repr, table.R[i].ravel().tolist()))
        t = " ".join(map(_millimetres, table.t[i].tolist()))
        lines.append(f"{ids},{table.score[i].item()!r},{R},{t},{table.time[i].item()!r}")
    write_bytes(Path(path), ("\n".join(lines) + "\n").encode("ascii"))


def _read_row(path: Path, number: int, line: str) -> tuple:
    def refuse(message: str) -> NoReturn:
        raise ValueError(f"{path}: line {number}: {message}")

    fields = line.split(",")
    if len(fields) != len(COLUMNS):
        refuse(f"expected {len(COLUMNS)} columns ({HEADER}), got {len(fields)}")
    values: list = []
    for column, field in zip(COLUMNS, fields, strict=True):
        texts = field.split()
        count = {"R": 9, "t": 3}.get(column, 1)
        if len(texts) != count:
            refuse(f"column {column}: expected {count} numbers, got {len(texts)}")
        if column.endswith("_id"):
            if not (texts[0].isascii() and texts[0].isdigit() and len(texts[0]) < 19):
                got = _short(texts[0])
                refuse(f"column {column}: expected an integer of at least 0, got {got}")
            values.append(int(texts[0]))
            continue
        numbers = [_number(text) for text in texts]
        if None in numbers:
            bad = texts[numbers.index(None)]
            refuse(f"column {column}: expected finite numbers, got {_short(bad)}")
        if column == "t":
            numbers = [_metres(text) for text in texts]
        values.append(numbers if count > 1 else numbers[0])
    return tuple(values)


def _number(text: str) -> float | None:
    """The finite number that a text is, else None."""
    try:
        number = float(text)
    except ValueError:
        return None
    # Python takes 1_000 for a number, and the digits of other scripts; here they are damage.
    return number if math.isfinite(number) and "_" not in text and text.isascii() else None


def _metres(millimetres: str) -> float:
    """A text of millimetres as metres: the point moved by three, nothing rounded."""
    try:
        return float(Decimal(millimetres).scaleb(-3))
    except ArithmeticError:  # an exponent beyond those of decimals, whose float is 0
        return float(millimetres) / 1000


def _millimetres(metres: float) -> str:
    """Metres as millimetres in decimal digits: the point moved by three, nothing rounded."""
    return f"{Decimal(repr(metres)).scaleb(3):f}"
