"""Files that come in whole or not at all: images, JSON, and the writing of new ones.

Everything a reader refuses is a `ValueError` that begins with the file's name.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data_tools.bop.pictures import decode_picture, describe, is_jpeg, not_black

__all__ = [
    "find_image",
    "has_file",
    "has_folder",
    "read_bytes",
    "read_depth",
    "read_grey",
    "read_integer",
    "read_json",
    "read_mask",
    "read_number",
    "read_numbers",
    "read_rgb",
    "refuse_broken_link",
]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
LARGEST_ID = 10**18 - 1  # what fits into 64 bits, and is said easily


def has_file(path: Path) -> bool:
    """Whether a file is there.

    Raises:
        ValueError: if a link is there that leads nowhere.
    """
    if path.is_file():
        return True
    refuse_broken_link(path)
    return False


def has_folder(path: Path) -> bool:
    """Whether a folder is there.

    Raises:
        ValueError: if a link is there that leads nowhere.
    """
    if path.is_dir():
        return True
    refuse_broken_link(path)
    return False


def refuse_broken_link(path: Path) -> None:
    """Refuse a symbolic link that leads nowhere, as to a disk that is not mounted.

    To take it for nothing would drop a whole kind of images without a word.

    Raises:
        ValueError: naming the link and where it leads.
    """
    if path.is_symlink() and not os.path.exists(path):
        raise ValueError(
            f"{path}: this link leads to {os.readlink(path)}, where nothing is: expected its "
            "disk to be mounted, or no link"
        )


def read_bytes(path: Path) -> bytes:
    """The content of a file that must not be empty.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is empty or cannot be read, or is a link that leads nowhere.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        refuse_broken_link(Path(path))
        raise FileNotFoundError(f"{path}: no such file") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from error
    if not data:
        raise ValueError(f"{path}: empty file")
    return data


def find_image(folder: Path, stem: str) -> Path:
    """The image `folder/stem` with whatever suffix it has.

    Raises:
        FileNotFoundError: if there is none.
        ValueError: if it is a link that leads nowhere.
    """
    for suffix in (*IMAGE_SUFFIXES, *map(str.upper, IMAGE_SUFFIXES)):
        if has_file(path := folder / (stem + suffix)):
            return path
    raise FileNotFoundError(f"{folder / stem}: no such image ({', '.join(IMAGE_SUFFIXES)})")


def read_rgb(path: Path) -> np.ndarray:
    """A colour image (H, W, 3), uint8, red first; grey in all three, and without alpha.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no image, or has not 8 bits.
    """
    image = decode_picture(path, read_bytes(path))
    if image.dtype != np.uint8:
        raise ValueError(f"{path}: expected three channels of 8 bits, got {describe(image)}")
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGB)


def read_grey(path: Path) -> np.ndarray:
    """A grey image (H, W), uint8 or uint16; one of three channels if they are equal.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no image, has colours, or neither 8 nor 16 bits.
    """
    image = decode_picture(path, read_bytes(path))
    grey = image if image.ndim == 2 else image[..., 0]
    equal = image.ndim == 2 or (image[..., :3] == grey[..., None]).all()
    if image.dtype not in (np.uint8, np.uint16) or not equal:
        raise ValueError(f"{path}: expected one channel of 8 or 16 bits, got {describe(image)}")
    return np.ascontiguousarray(grey)


def read_depth(path: Path, scale: float) -> np.ndarray:
    """A depth image (H, W) in metres, float32, 0 where nothing was measured.

    Args:
        path: an image of one channel of 16 bits.
        scale: millimetres per unit of the image.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no image, or not of one channel of 16 bits.
    """
    image = decode_picture(path, read_bytes(path))
    if image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError(f"{path}: expected one channel of 16 bits, got {describe(image)}")
    with np.errstate(over="ignore"):  # what is too far becomes infinite, and no View takes that
        return (image * scale / 1000).astype(np.float32)


def read_mask(path: Path) -> np.ndarray:
    """A mask (H, W), bool: true where the image, grey or coloured, is not black.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no image, or has neither 8 nor 16 bits.
    """
    data = read_bytes(path)
    image = decode_picture(path, data)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits, got {describe(image)}")
    return not_black(image, is_jpeg(data))


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no whole JSON file, names something twice, or has NaN or Infinity.
    """
    data = read_bytes(path)
    try:
        return json.loads(
            data, object_pairs_hook=_without_duplicates, parse_constant=_refuse_constant
        )
    except (ValueError, RecursionError) as error:  # not JSON, or not text
        raise ValueError(f"{path}: damaged JSON: {error}") from error


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(k for k in keys if keys.count(k) > 1)!r} is there twice")
    return entries


def _refuse_constant(text: str) -> None:
    raise ValueError(f"{text} is no number")


def read_number(where: str, entry: Any, key: str) -> float:
    """The finite number under `key` of a JSON object; `where` names file and place in messages.

    Raises:
        ValueError: if it is missing or none.
    """
    value = _entry(where, entry, key)
    if type(value) not in (int, float) or not abs(value) <= sys.float_info.max:
        raise ValueError(f"{where}: {key}: expected a finite number, got {_short(value)}")
    return float(value)


def read_integer(where: str, entry: Any, key: str) -> int:
    """The integer from 0 to `LARGEST_ID` under `key` of a JSON object.

    Raises:
        ValueError: if it is missing or none.
    """
    value = _entry(where, entry, key)
    if type(value) is not int or not 0 <= value <= LARGEST_ID:
        bounds = f"from 0 to {LARGEST_ID}" if type(value) is int and value > 0 else "of at least 0"
        raise ValueError(f"{where}: {key}: expected an integer {bounds}, got {_short(value)}")
    return value


def read_numbers(where: str, entry: Any, key: str, count: int) -> np.ndarray:
    """The `count` finite numbers under `key` of a JSON object, as float64.

    Raises:
        ValueError: if they are missing, another number of them, or none.
    """
    value = _entry(where, entry, key)
    # Sets of types and NumPy, since a scene holds a million numbers.
    if isinstance(value, list) and len(value) == count and set(map(type, value)) <= {int, float}:
        with contextlib.suppress(OverflowError):  # an integer with hundreds of digits
            numbers = np.array(value, np.float64)
            if np.isfinite(numbers).all():
                return numbers
    raise ValueError(f"{where}: {key}: expected {count} finite numbers, got {_short(value)}")


def _entry(where: str, entry: Any, key: str) -> Any:
    if not isinstance(entry, dict):
        raise ValueError(f"{where}: expected a JSON object, got {_short(entry)}")
    if key not in entry:
        raise ValueError(f"{where}: {key} is missing")
    return entry[key]


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write an integer of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= 80 else text[:77] + "..."
