"""`poses.csv` and `labels.csv`, read and written; a damaged line is named with its column."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_tools.bop.files import read_bytes
from data_tools.hmdpose.calibration import CAMERAS
from posecore.rotations import quaternion_to_matrix

__all__ = [
    "GLASSES",
    "MOST_FRAMES",
    "OBJECTS",
    "Label",
    "Poses",
    "read_labels",
    "read_poses",
    "to_csv",
]

OBJECTS = ("glasses", "head")
GLASSES = (1, 2, 3, 4)
POSE_COLUMNS = ("frame", "subject", "glasses", "x", "y", "z", "qw", "qx", "qy", "qz")
BOX, SIZE = ("box_x", "box_y", "box_width", "box_height"), ("size_x", "size_y", "size_z")
LABEL_COLUMNS = ("frame", "camera", "object", *BOX, "visible_fraction", *SIZE)
MOST_FRAMES = 10**15  # image ids are three times as large, and are to fit into 64 bits
FARTHEST = 10.0  # metres from the origin of the car; millimetres are soon beyond
LENGTH = 1e-3  # by which the length of a written quaternion may be off 1


@dataclass(frozen=True, eq=False)
class Poses:
    """The rows of `poses.csv`.

    Attributes:
        frame, subject, glasses: (N,) int64.
        R, t: (N, 3, 3) and (N, 3) pose of the glasses in the car, metres.
        lines: (N,) where the rows stand in the file, the first line is 1.
    """

    frame: np.ndarray
    subject: np.ndarray
    glasses: np.ndarray
    R: np.ndarray
    t: np.ndarray
    lines: np.ndarray

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class Label:
    """A row of `labels.csv`; what is not known is None.

    Attributes:
        box: (4,) x, y, width and height in pixels of what is seen.
        visible_fraction: share of the silhouette that is seen, 0 to 1.
        size: (3,) extent of the object in metres.
    """

    box: np.ndarray | None = None
    visible_fraction: float | None = None
    size: np.ndarray | None = None


def read_poses(path: Path) -> Poses:
    """Read a `poses.csv`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, line and column of what does not fit, or is there twice.
    """
    lines, ids, numbers = [], [], []
    seen: dict[int, int] = {}
    for number, cells in _rows(path, POSE_COLUMNS):
        lines.append(number)
        row = _Row(path, number, POSE_COLUMNS, cells)
        ids.append([row.integer("frame", 0, MOST_FRAMES), row.integer("subject", 0, MOST_FRAMES)])
        ids[-1].append(row.integer("glasses", GLASSES[0], GLASSES[-1]))
        numbers.append([row.number(name) for name in POSE_COLUMNS[3:]])
        for name, value in zip("xyz", numbers[-1], strict=False):
            if abs(value) > FARTHEST:
                row.refuse(name, f"metres, at most {FARTHEST:g} from the car's origin", value)
        if (first := seen.setdefault(ids[-1][0], number)) != number:
            row.refuse("frame", f"each frame once; line {first} has it", ids[-1][0])
    if not lines:
        raise ValueError(f"{path}: expected rows below the header, got none")
    columns, values = np.array(ids, np.int64), np.array(numbers, np.float64)
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    off = np.flatnonzero(~(np.abs(lengths - 1) <= LENGTH))
    if off.size:
        first = int(off[0])
        raise ValueError(
            f"{path}: line {lines[first]}: columns qw to qz: expected a unit quaternion, "
            f"got one of length {lengths[first]:.6g}"
        )
    R = quaternion_to_matrix(values[:, 3:])
    return Poses(*columns.T, R, values[:, :3], np.array(lines, np.int64))


def read_labels(path: Path, poses: Poses) -> dict[tuple[int, str, str], Label]:
    """Read a `labels.csv`: by frame, camera and object.

    Args:
        path: the file.
        poses: of the same split. The glasses must have a row for each frame and camera; so must
            the head, if it has any.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, line and column of what does not fit, is there twice or is missing.
    """
    known = set(poses.frame.tolist())
    found: dict[tuple[int, str, str], Label] = {}
    for number, cells in _rows(path, LABEL_COLUMNS):
        row = _Row(path, number, LABEL_COLUMNS, cells)
        frame = row.integer("frame", 0, MOST_FRAMES)
        if frame not in known:
            row.refuse("frame", "one that poses.csv has", frame)
        key = frame, row.choice("camera", CAMERAS), row.choice("object", OBJECTS)
        if key in found:
            row.refuse("frame", "each object of each image once", f"{key} a second time")
        box, size = row.numbers(BOX), row.numbers(SIZE)
        fraction = row.numbers(("visible_fraction",))
        if box is not None and (box[2:] < 0).any():
            row.refuse("box_width", "a width and a height of at least 0", box[2:].tolist())
        if fraction is not None and not 0 <= fraction[0] <= 1:
            row.refuse("visible_fraction", "a share from 0 to 1", fraction[0])
        if size is not None and not ((size >= 0) & (size <= FARTHEST)).all():
            row.refuse("size_x", f"metres from 0 to {FARTHEST:g}", size.tolist())
        found[key] = Label(box, None if fraction is None else float(fraction[0]), size)
    for name in OBJECTS:
        if name == "head" and not any(key[2] == "head" for key in found):
            continue
        for frame in poses.frame.tolist():
            for camera in CAMERAS:
                if (frame, camera, name) not in found:
                    raise ValueError(f"{path}: no row of {name} in frame {frame}, camera {camera}")
    return found


def to_csv(rows: Iterable[Sequence[object]], of: str) -> bytes:
    """The content of a table; reading it gives the same numbers bit by bit.

    Args:
        rows: the cells of each row: integers, floats, words, and None for what is not known.
        of: "poses" or "labels".
    """
    columns = {"poses": POSE_COLUMNS, "labels": LABEL_COLUMNS}[of]
    lines = [",".join(columns)]
    lines += [",".join("" if cell is None else _text(cell) for cell in row) for row in rows]
    return ("\n".join(lines) + "\n").encode("ascii")


def _text(cell: object) -> str:
    if not isinstance(cell, float):
        return str(cell)
    return repr(float(cell)).removesuffix(".0")  # NumPy's would be np.float64(1.0)


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line under the header; lines end as on any system."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected a text file in UTF-8: {error}") from error
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    if lines.pop():
        raise ValueError(f"{path}: line {len(lines) + 1}: no end of the line, the file may be cut")
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip()]
    top = [cell.strip() for cell in numbered[0][1].split(",")] if numbered else []
    if top != list(columns):
        got = ",".join(top) if numbered else "an empty file"
        raise ValueError(f"{path}: line 1: expected the header {','.join(columns)}, got {got:.120}")
    for number, line in numbered[1:]:
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(columns):
            raise ValueError(
                f"{path}: line {number}: expected {len(columns)} columns ({','.join(columns)}), "
                f"got {len(cells)}"
            )
        yield number, cells


class _Row:
    """The cells of a line by their columns, refused with file, line and column."""

    def __init__(self, path: Path, number: int, columns: tuple[str, ...], cells: list[str]) -> None:
        self.where = f"{path}: line {number}"
        self.cells = dict(zip(columns, cells, strict=True))

    def refuse(self, column: str, expected: str, got: object) -> None:
        raise ValueError(f"{self.where}: column {column}: expected {expected}, got {got!s:.80}")

    def integer(self, column: str, low: int, high: int) -> int:
        text = self.cells[column]
        good = text.isascii() and text.isdigit() and len(text) < 19
        if not good or not low <= int(text) <= high:
            self.refuse(column, f"an integer from {low} to {high}", repr(text))
        return int(text)

    def choice(self, column: str, choices: tuple[str, ...]) -> str:
        text = self.cells[column]
        if text not in choices:
            self.refuse(column, f"one of {', '.join(choices)}", repr(text))
        return text

    def number(self, column: str) -> float:
        text = self.cells[column]
        try:
            # Python takes 1_000 for a number, and the digits of other scripts: here it is damage.
            value = float(text) if text.isascii() and "_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.refuse(column, "a finite number", repr(text))
        return value

    def numbers(self, columns: tuple[str, ...]) -> np.ndarray | None:
        """Several that are known together, or None where all are empty."""
        if not any(self.cells[column] for column in columns):
            return None
        return np.array([self.number(column) for column in columns])
