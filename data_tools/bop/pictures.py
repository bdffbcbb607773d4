"""Pictures from the bytes of a file: known to be whole, of a size that fits, decoded by OpenCV.

OpenCV fills in what is missing from a damaged picture, and takes whatever memory its header asks
for, so both are looked at before. What has a checksum (PNG) is checked to the last byte; a JPEG for
its end, behind which other bytes may follow; a BMP for its length.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np

__all__ = ["MOST_PIXELS", "decode_picture", "describe", "is_jpeg", "not_black"]

MOST_PIXELS = 100_000_000  # of one picture; three times what an 8K camera takes
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8"
# Zeros are stuffed after 255 within the coded data, and D0 to D7 are the marks of restarts.
MARKER = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")


def decode_picture(path: Path, data: bytes) -> np.ndarray:
    """A picture as it is stored: (H, W), or (H, W, 3 or 4) with blue first and alpha last.

    Args:
        path: for messages.
        data: the file's bytes: PNG, JPEG, TIFF or BMP. Palettes come out as colours.

    Raises:
        ValueError: naming the file, if it is none of them, cut off or damaged, or has more than
            MOST_PIXELS pixels.
    """
    if data.startswith(PNG_SIGNATURE):
        size = _check_png(path, data)
    elif is_jpeg(data):
        size = _check_jpeg(path, data)
    elif data.startswith((b"II*\0", b"MM\0*")):
        size = _tiff_size(data)
    elif data.startswith(b"BM"):
        size = _check_bmp(path, data)
    else:
        raise ValueError(f"{path}: neither PNG nor JPEG nor TIFF nor BMP, begins with {data[:8]!r}")
    if size is not None and size[0] * size[1] > MOST_PIXELS:
        raise ValueError(
            f"{path}: expected at most {MOST_PIXELS // 10**6} million pixels, "
            f"got {size[0]} x {size[1]}"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ValueError(f"{path}: cannot be decoded: {' '.join(str(error).split())}") from error
    if image is None:
        raise ValueError(f"{path}: cannot be decoded")
    return image


def is_jpeg(data: bytes) -> bool:
    """Whether the bytes of a file begin as a JPEG does."""
    return data.startswith(JPEG_SIGNATURE)


def describe(image: np.ndarray) -> str:
    """Channels and bits, for messages."""
    return f"{image.shape[2] if image.ndim == 3 else 1} of {image.dtype.itemsize * 8} bits"


def not_black(image: np.ndarray, lossy: bool) -> np.ndarray:
    """(H, W) bool: where a picture has a colour, whichever it is; what is transparent has none.

    Args:
        image: (H, W) or (H, W, C), C of 3, or 4 with alpha last.
        lossy: whether black may have become nearly black, as in a JPEG: then a pixel counts from
            half the brightest one on.
    """
    bright = image if image.ndim == 2 else image[..., :3].max(-1)
    seen = bright > bright.max() / 2 if lossy else bright > 0
    return seen & (image[..., 3] > 0) if image.shape[2:] == (4,) else seen


def _check_png(path: Path, data: bytes) -> tuple[int, int]:
    """Walk over the chunks (length, type, data, CRC) from the signature to IEND: PNG, section 5."""
    view = memoryview(data)
    position = len(PNG_SIGNATURE)
    while True:
        length = int.from_bytes(view[position : position + 4], "big")
        kind = bytes(view[position + 4 : position + 8])
        end = position + 8 + length
        if end + 4 > len(data):
            raise ValueError(f"{path}: PNG cut off or damaged at byte {position} of {len(data)}")
        if zlib.crc32(view[position + 4 : end]) != int.from_bytes(view[end : end + 4], "big"):
            raise ValueError(f"{path}: PNG damaged: wrong checksum at byte {position}")
        position = end + 4
        if kind == b"IEND":
            # IHDR, the first chunk, begins with width and height.
            return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _check_jpeg(path: Path, data: bytes) -> tuple[int, int] | None:
    """Refuse a JPEG without its end; its size, or None if its header does not say."""
    size, ended = _walk_jpeg(data)
    if not ended and not data.rstrip(b"\0\r\n ").endswith(b"\xff\xd9"):
        raise ValueError(f"{path}: JPEG without its end marker: the file was cut off")
    return size


def _walk_jpeg(data: bytes) -> tuple[tuple[int, int] | None, bool]:
    """Size, and whether the end of the image is there, not that of a thumbnail in its header."""
    size, position = None, len(JPEG_SIGNATURE)
    while (marker := MARKER.match(data, position)) is not None:
        kind, position = data[marker.end() - 1], marker.end()
        if kind == 0xD9:
            return size, True
        length = int.from_bytes(data[position : position + 2], "big")
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):  # the start of a frame
            height, width = (
                int.from_bytes(data[position + i : position + i + 2], "big") for i in (3, 5)
            )
            size = (width, height)
        position += length
        if kind == 0xDA:  # a scan, and its coded data behind it
            after = MARKER.search(data, position)
            if after is None:
                break
            position = after.start()
    return size, False


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of the first page: TIFF 6.0, section 2."""
    order = "little" if data.startswith(b"II") else "big"

    def number(start: int, length: int) -> int:
        return int.from_bytes(data[start : start + length], order)

    table = number(4, 4)
    found = {}
    for row in range(number(table, 2)):
        entry = table + 2 + 12 * row
        if number(entry, 2) in (256, 257):
            found[number(entry, 2)] = number(entry + 8, 2 if number(entry + 2, 2) == 3 else 4)
    return (found[256], found[257]) if len(found) == 2 else None


def _check_bmp(path: Path, data: bytes) -> tuple[int, int]:
    """Refuse a BMP that is shorter than its header says."""

    def number(start: int, length: int, signed: bool = False) -> int:
        return int.from_bytes(data[start : start + length], "little", signed=signed)

    old = number(14, 4) == 12
    width = number(18, 2) if old else number(18, 4, True)
    height = number(20, 2) if old else abs(number(22, 4, True))  # below 0 for rows from the top
    bits, packed = (number(24, 2), 0) if old else (number(28, 2), number(30, 4))
    row = -(-width * bits // 32) * 4
    least = number(10, 4) + (0 if packed in (1, 2) else row * height)
    if len(data) < max(least, number(2, 4)) or len(data) < 34:
        raise ValueError(f"{path}: BMP cut off at byte {len(data)} of {max(least, number(2, 4))}")
    return width, height
