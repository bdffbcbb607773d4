"""Where the images of each object lie, and which of them belong to a split.

    PATH/cat/JPEGImages/000012.jpg, mask/0012.png, pose/pose12.npy, cat.ply        "pvnet"
    PATH/rgb/12.jpg, mask/12.png, pose/pose12.npy, camera.txt, model.ply           "own"
    PATH/data/06/rgb/0012.png, depth/0012.png, mask/0012.png, gt.yml, info.yml     "densefusion"

A file is found by the number in its name, however many zeros it begins with.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from data_tools.bop.files import IMAGE_SUFFIXES, read_bytes
from posecore.arrays import fail

__all__ = [
    "NAMES",
    "SPLITS",
    "Numbered",
    "ObjectFolder",
    "find_objects",
    "read_numbers_of",
    "require_file",
]

# The thirteen objects of both layouts, which leave out the bowl (3) and the cup (7).
NAMES = {
    1: "ape", 2: "benchvise", 4: "cam", 5: "can", 6: "cat", 8: "driller", 9: "duck", 10: "eggbox",
    11: "glue", 12: "holepuncher", 13: "iron", 14: "lamp", 15: "phone",
}  # fmt: skip
SPLITS = ("train", "test")


@dataclass(frozen=True)
class ObjectFolder:
    """The folder with the images of one object.

    Attributes:
        object_id: the number in LINEMOD, 1 for an own object.
        name: the name in LINEMOD, or of the folder.
        path: the folder.
        layout: "pvnet", "own" or "densefusion".
    """

    object_id: int
    name: str
    path: Path
    layout: str


class Numbered:
    """The files of a folder by the number in their names, such as 000012.jpg or pose12.npy.

    Args:
        folder: where they lie.
        suffixes: of the files that count.

    Raises:
        ValueError: if there is no such folder, or two files have the same number.
    """

    def __init__(self, folder: Path, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> None:
        self.folder = folder
        if not folder.is_dir():
            raise ValueError(f"{folder}: no such folder")
        self._files: dict[int, Path] = {}
        for file in sorted(folder.iterdir()):
            match = re.fullmatch(r"(?:pose)?([0-9]+)(?:_label)?", file.stem)
            if match is None or file.suffix not in suffixes:
                continue
            if (other := self._files.setdefault(int(match[1]), file)) != file:
                raise ValueError(f"{folder}: two files of one image, {other.name} and {file.name}")

    def __getitem__(self, number: int) -> Path:
        """The file of an image.

        Raises:
            ValueError: if there is none.
        """
        if number not in self._files:
            raise ValueError(f"{self.folder}: no file of image {number}")
        return self._files[number]

    @property
    def numbers(self) -> list[int]:
        """The numbers of all files, in ascending order."""
        return sorted(self._files)


def find_objects(path: Path) -> dict[int, ObjectFolder]:
    """The objects below a folder by their ids, in ascending order.

    Args:
        path: the folder of one object, or of a dataset with one folder for each.

    Raises:
        ValueError: if neither is there.
    """
    if (found := _object_in(path)) is not None:
        return {found.object_id: found}
    parent = path / "data" if (path / "data").is_dir() else path
    children = [_object_in(child) for child in sorted(parent.iterdir()) if child.is_dir()]
    objects = {c.object_id: c for c in children if c is not None and c.layout != "own"}
    if not objects:
        fail(
            "path",
            "the folder of an object, with JPEGImages or rgb in it, or one with such folders, "
            "named as in LINEMOD (cat) or by the object's number (06)",
            repr(str(path)),
        )
    return dict(sorted(objects.items()))


def _object_in(path: Path) -> ObjectFolder | None:
    """What a folder holds; None if it is not that of an object."""
    numbers = {name: number for number, name in NAMES.items()}
    if (path / "JPEGImages").is_dir() and path.name in numbers:
        return ObjectFolder(numbers[path.name], path.name, path, "pvnet")
    if not (path / "rgb").is_dir():
        return None
    if not re.fullmatch("[0-9]+", path.name) or (path / "camera.txt").is_file():
        return ObjectFolder(1, path.name, path, "own")
    number = int(path.name)
    return ObjectFolder(number, NAMES[number], path, "densefusion") if number in NAMES else None


def read_numbers_of(path: Path) -> list[int]:
    """The images that a list names, one on each line, in its order.

    A line is a number or a file's name, with folders or without: 0012, 0012.jpg,
    LINEMOD/cat/JPEGImages/000012.jpg.

    Raises:
        ValueError: naming the file, and the line that is something else or is there twice.
    """
    lines: dict[int, int] = {}
    for row, line in enumerate(_lines(path), 1):
        match = re.fullmatch(r"(?:.*[/\\])?([0-9]+)(?:\.[a-z]+)?", line)
        if match is None:
            raise ValueError(f"{path}: line {row}: expected an image, got {line[:80]!r}")
        if (first := lines.setdefault(int(match[1]), row)) != row:
            raise ValueError(f"{path}: line {row}: image {match[1]} is on line {first} already")
    if not lines:
        raise ValueError(f"{path}: no images in this list")
    return list(lines)


def _lines(path: Path) -> Iterable[str]:
    try:
        text = read_bytes(require_file(path)).decode("ascii")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: no list of images: {error}") from error
    return (line.strip() for line in text.rstrip().splitlines())


def require_file(path: Path) -> Path:
    """The path, if a file is there.

    Raises:
        ValueError: if there is none.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    return path
