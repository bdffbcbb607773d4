"""Where the images of each object lie, and which of them belong to a split.

    PATH/cat/JPEGImages/000012.jpg, mask/0012.png, pose/pose12.npy, cat.ply        "pvnet"
    PATH/rgb/12.jpg, mask/12.png, pose/pose12.npy, camera.txt, model.ply           "own"
    PATH/data/06/rgb/0012.png, depth/0012.png, mask/0012.png, gt.yml, info.yml     "densefusion"

A file is found by the number in its name, however many zeros it begins with.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from data_tools.bop.files import (
    IMAGE_SUFFIXES,
    has_file,
    has_folder,
    read_bytes,
    refuse_broken_link,
)
from posecore.arrays import fail

__all__ = [
    "NAMES",
    "SPLITS",
    "Numbered",
    "ObjectFolder",
    "decode_text",
    "find_objects",
    "lists_of",
    "read_numbers_of",
    "require_file",
]

# The thirteen objects of both layouts, which leave out the bowl (3) and the cup (7).
NAMES = {
    1: "ape", 2: "benchvise", 4: "cam", 5: "can", 6: "cat", 8: "driller", 9: "duck", 10: "eggbox",
    11: "glue", 12: "holepuncher", 13: "iron", 14: "lamp", 15: "phone",
}  # fmt: skip
SPLITS = ("train", "test")
PICTURES = (*IMAGE_SUFFIXES, ".bmp")
NUMBER = "(0{0,80}[0-9]{1,18})"  # what fits into 64 bits; other digits than these are none here


@dataclass(frozen=True)
class ObjectFolder:
    """The folder with the images of one object.

    Attributes:
        object_id: the number in LINEMOD, or of the folder; 1 for an own object.
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
        suffixes: of the files that count, in small letters or in capitals.

    Raises:
        ValueError: if there is no such folder, or two files have the same number.
    """

    def __init__(self, folder: Path, suffixes: tuple[str, ...] = PICTURES) -> None:
        self.folder = folder
        if not has_folder(folder):
            raise ValueError(f"{folder}: no such folder")
        self._files: dict[int, Path] = {}
        for file in sorted(folder.iterdir()):
            match = re.fullmatch(rf"(?:pose)?{NUMBER}(?:_label)?", file.stem)
            if match is None or file.suffix.lower() not in suffixes:
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
    parent = path / "data" if has_folder(path / "data") else path
    objects: dict[int, ObjectFolder] = {}
    for child in sorted(parent.iterdir()):
        if child.name in NAMES.values() or re.fullmatch(NUMBER, child.name):
            refuse_broken_link(child)
        found = _object_in(child) if child.is_dir() else None
        if found is None or found.layout == "own":
            continue
        if (other := objects.setdefault(found.object_id, found)) != found:
            names = f"{other.path.name} and {child.name}"
            raise ValueError(f"{parent}: two folders of object {found.object_id}, {names}")
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
    if path.name in numbers and has_folder(path / "JPEGImages"):
        return ObjectFolder(numbers[path.name], path.name, path, "pvnet")
    if not has_folder(path / "rgb"):
        return None
    match = re.fullmatch(NUMBER, path.name)
    if match is None or has_file(path / "camera.txt"):
        return ObjectFolder(1, path.name, path, "own")
    number = int(match[1])
    # Others continue the numbers with objects of their own; LINEMOD's bowl and cup have no poses.
    if number in NAMES or number > max(NAMES) or has_file(path / "gt.yml"):
        return ObjectFolder(number, NAMES.get(number, path.name), path, "densefusion")
    return None


def lists_of(folders: Iterable[ObjectFolder]) -> list[str]:
    """The splits that `train.txt` and `test.txt` of some of the objects list."""
    folders = list(folders)
    return [s for s in SPLITS if any(has_file(f.path / f"{s}.txt") for f in folders)]


def read_numbers_of(path: Path) -> list[int]:
    """The images that a list names, one on each line, in its order.

    A line is a number or a file's name, with folders or without: 0012, 0012.jpg,
    LINEMOD/cat/JPEGImages/000012.jpg. See `decode_text` for its encoding.

    Raises:
        ValueError: naming the file, and the line that is something else or is there twice.
    """
    try:
        text = decode_text(read_bytes(require_file(path)))
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: no list of images: {error}") from error
    lines: dict[int, int] = {}
    for row, line in enumerate(map(str.strip, text.rstrip().splitlines()), 1):
        match = re.fullmatch(rf"(?:.*[/\\])?{NUMBER}(?:\.[A-Za-z]+)?", line)
        if match is None:
            raise ValueError(
                f"{path}: no list of images: line {row}: expected an image, got {line[:80]!r}"
            )
        if (first := lines.setdefault(int(match[1]), row)) != row:
            raise ValueError(f"{path}: line {row}: image {match[1]} is on line {first} already")
    if not lines:
        raise ValueError(f"{path}: no images in this list")
    return list(lines)


def decode_text(data: bytes) -> str:
    """A text as the three systems write it, with the mark that names its encoding or without.

    UTF-8, or UTF-16 if it begins with that mark; what is neither is taken as Latin-1.

    Raises:
        UnicodeDecodeError: if it is called UTF-16 and is none.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def require_file(path: Path) -> Path:
    """The path, if a file is there.

    Raises:
        ValueError: if there is none.
    """
    if not has_file(path):
        raise ValueError(f"{path}: no such file")
    return path
