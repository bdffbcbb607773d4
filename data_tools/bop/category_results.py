"""Category-level results: BOP's CSV files with a category and a size in every line.

The columns are BOP's, `scene_id,im_id,obj_id,score,R,t,time`, then

- `category`, a name, which decides what is compared with what; `obj_id` may say which instance it
  is, or be 0: nobody looks at it;
- `size`, three lengths of the bounding box along the object's axes, separated by blanks;
- of a file of ground truth `axis` as well: three numbers, the axis in the object's frame about
  which this instance may turn freely, `0 1 0` of a bottle, and `0 0 0` if there is none.

Lengths are millimetres as in BOP, and `t` leads to the middle of the bounding box. The header is
needed: it tells such a file from one of BOP, whose own reader refuses it. As in `results`, metres
become millimetres by moving the decimal point, so that what was written is read bit by bit.
"""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import numpy as np

from data_tools.bop.files import _short, read_bytes
from data_tools.bop.results import COLUMNS as BOP_COLUMNS
from data_tools.bop.results import _metres, _millimetres, _number, _read_row
from data_tools.bop.rotations import check_rotations
from posecore.arrays import fail
from posecore.files import require_path, write_bytes
from posecore.metrics.pose_table import CategoryPoseTable

__all__ = ["has_categories", "read_category_results", "write_category_results"]

COLUMNS = (*BOP_COLUMNS, "category", "size", "axis")
HEADER = ",".join(COLUMNS)


def has_categories(path: str | Path) -> bool:
    """Whether a results file says in its header that its lines have a category.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is empty or cannot be read.
    """
    lines = read_bytes(require_path("path", path))[:2000].decode("utf-8-sig", "replace")
    return "category" in lines.strip().partition("\n")[0].split(",")


def read_category_results(path: str | Path, *, axes: bool = False) -> CategoryPoseTable:
    """Read category-level results, or the ground truth of such.

    Rotations that are not quite orthonormal become the nearest ones, with one warning if they are
    noticeably off.

    Args:
        path: the CSV file.
        axes: whether the column `axis` has to be there, as of a ground truth; without it no
            instance has a symmetry.

    Returns:
        The rows in the order of the file; metres.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, line and column of what is no such row, or no rotation.
    """
    path = require_path("path", path)
    try:
        lines = read_bytes(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected a text file: {error}") from error
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip()]
    top = numbered.pop(0)[1].strip() if numbered else ""
    known = [",".join(COLUMNS[:count]) for count in (len(COLUMNS), len(COLUMNS) - 1)]
    if top not in known[: 1 if axes else 2]:
        expected = f"the header {HEADER}" + ("" if axes else ", the last column being optional")
        raise ValueError(f"{path}: expected {expected}, got {top[:120]!r}")
    columns = COLUMNS[: top.count(",") + 1]
    rows = [_read(path, number, line, columns) for number, line in numbered]
    scene_id, image_id, object_id, score, R, t, time, category, size, axis = (
        zip(*rows, strict=True) if rows else [()] * len(COLUMNS)
    )
    return CategoryPoseTable(
        scene_id=np.array(scene_id, np.int64),
        image_id=np.array(image_id, np.int64),
        object_id=np.array(object_id, np.int64),
        R=check_rotations(
            path,
            np.reshape(np.array(R, np.float64), (-1, 3, 3)),
            "project",
            lambda i: f"line {numbered[i][0]}, column R",
        ),
        t=np.reshape(np.array(t, np.float64), (-1, 3)),
        score=np.array(score, np.float64),
        time=np.array(time, np.float64),
        category=np.array(category, str),
        size=np.reshape(np.array(size, np.float64), (-1, 3)),
        axis=np.reshape(np.array(axis, np.float64), (-1, 3)),
    )


def write_category_results(
    path: str | Path, table: CategoryPoseTable, *, axes: bool = False
) -> None:
    """Write category-level results; the same table always gives the same bytes.

    The file appears whole or not at all: if writing fails, an older file is still as it was.

    Args:
        path: the CSV file, in a folder that exists.
        table: poses and sizes in metres.
        axes: whether to write the axes of symmetry, which a ground truth has to have.

    Raises:
        ValueError: if an id is negative, or a category has a comma, a line break, or blanks around
            it.
        OSError: if the file cannot be written.
    """
    if not isinstance(table, CategoryPoseTable):
        fail("table", "a CategoryPoseTable", type(table).__name__)
    for name in ("scene_id", "image_id", "object_id"):
        if (getattr(table, name) < 0).any():
            fail(f"table.{name}", "ids of at least 0", getattr(table, name).min())
    for name in np.unique(table.category).tolist():
        if name != name.strip() or "," in name or len(name.splitlines()) != 1:
            fail(
                "table.category", "names without commas, line breaks and blanks around", repr(name)
            )
    lines = [",".join(COLUMNS if axes else COLUMNS[:-1])]
    for i in range(len(table)):
        fields = [str(x[i]) for x in (table.scene_id, table.image_id, table.object_id)]
        fields.append(repr(table.score[i].item()))
        fields.append(" ".join(map(repr, table.R[i].ravel().tolist())))
        fields.append(" ".join(map(_millimetres, table.t[i].tolist())))
        fields += [repr(table.time[i].item()), str(table.category[i])]
        fields.append(" ".join(map(_millimetres, table.size[i].tolist())))
        if axes:
            fields.append(" ".join(map(repr, table.axis[i].tolist())))
        lines.append(",".join(fields))
    write_bytes(Path(path), ("\n".join(lines) + "\n").encode())


def _read(path: Path, number: int, line: str, columns: tuple[str, ...]) -> tuple:
    """The values of a line, and no axis if the file has none."""

    def refuse(message: str) -> NoReturn:
        raise ValueError(f"{path}: line {number}: {message}")

    fields = line.split(",")
    if len(fields) != len(columns):
        refuse(f"expected {len(columns)} columns ({','.join(columns)}), got {len(fields)}")
    own = len(BOP_COLUMNS)
    values = [*_read_row(path, number, ",".join(fields[:own])), fields[own].strip()]
    if not values[-1]:
        refuse("column category: expected a name, got none")
    for column, field in zip(columns[own + 1 :], fields[own + 1 :], strict=True):
        texts = field.split()
        if len(texts) != 3:
            refuse(f"column {column}: expected 3 numbers, got {len(texts)}")
        numbers = [_number(text) for text in texts]
        if None in numbers:
            bad = _short(texts[numbers.index(None)])
            refuse(f"column {column}: expected finite numbers, got {bad}")
        if column == "size":
            numbers = [_metres(text) for text in texts]
            if min(numbers) <= 0:
                refuse(f"column size: expected lengths above 0, got {field.strip()}")
        values.append(numbers)
    return tuple(values if "axis" in columns else [*values, [0.0, 0.0, 0.0]])
