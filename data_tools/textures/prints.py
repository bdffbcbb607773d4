"""Pictures and noise that are made once and then looked up.

A picture holds, at each of its pixels, how much of a material's second colour there is. Pictures
are blurred a little and noise holds no fine detail, so that neither flickers in small images.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import cv2
import numpy as np

__all__ = ["FRONT", "keyboard", "label", "look_up", "noise", "screen"]

CELLS = 64  # of the noise, along each axis of one repeat
WORDS = ("TOMATO", "BEANS", "SALT", "PEACH", "SOUP", "TEA", "RICE", "HONEY", "MINT", "CORN")
LETTERS = cv2.FONT_HERSHEY_DUPLEX
FRONT = 0.375  # of the way around a label


@cache
def _noise_grid() -> np.ndarray:
    """(CELLS + 1)^3 flat float32 from 0 to 1: periodic, 1/f, of 3 to 16 waves in one repeat."""
    rng = np.random.default_rng(20)
    waves = np.fft.fftfreq(CELLS, 1 / CELLS)
    x, y, z = np.meshgrid(waves, waves, waves[: CELLS // 2 + 1], indexing="ij")
    length = np.sqrt(x * x + y * y + z * z)
    band = (length >= 3) & (length <= 16)
    spectrum = np.where(band, np.maximum(length, 1) ** -2.2, 0) * np.exp(
        2j * np.pi * rng.random(length.shape)
    )
    field = np.fft.irfftn(spectrum, (CELLS,) * 3, axes=(0, 1, 2))
    field = np.clip(0.5 + 0.22 * field / field.std(), 0, 1).astype(np.float32)
    return np.pad(field, ((0, 1),) * 3, mode="wrap").ravel()


def noise(points: np.ndarray) -> np.ndarray:
    """Smooth noise from 0 to 1 at points (P, 3), repeating every 1 along each axis; (P,)."""
    grid, side = _noise_grid(), CELLS + 1
    cells = (points - np.floor(points)).astype(np.float32) * np.float32(CELLS)
    corner = np.minimum(cells.astype(np.int32), CELLS - 1)  # rounding may reach the very end
    x, y, z = (cells - corner).T
    base = (corner[:, 0] * side + corner[:, 1]) * side + corner[:, 2]

    def along_z(index: np.ndarray) -> np.ndarray:
        low = grid[index]
        return low + z * (grid[index + 1] - low)

    near, far = along_z(base), along_z(base + side * side)
    near += y * (along_z(base + side) - near)
    far += y * (along_z(base + side * side + side) - far)
    return near + x * (far - near)


def look_up(picture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A picture (H, W) at u rightwards and v downwards, both from 0 to 1, bilinear; (P,).

    u runs around, as on a can; v stops at the borders.
    """
    height, width = picture.shape
    x = (u - np.floor(u)) * width - 0.5
    y = np.clip(v * height - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(np.int32), np.minimum(y.astype(np.int32), height - 2)
    a, b = x - left, y - top
    right, left = (left + 1) % width, left % width
    flat = picture.ravel()
    top, bottom = top * width, (top + 1) * width
    upper = flat[top + left] * (1 - a) + flat[top + right] * a
    lower = flat[bottom + left] * (1 - a) + flat[bottom + right] * a
    return upper * (1 - b) + lower * b


def _finished(picture: np.ndarray, blur: float) -> np.ndarray:
    wide = np.hstack([picture] * 3)  # the blur, too, runs around
    soft = cv2.GaussianBlur(wide, (0, 0), blur).astype(np.float32) / 255
    width = picture.shape[1]
    return np.ascontiguousarray(soft[:, width : 2 * width])


def _text(picture: np.ndarray, word: str, left: int, base: int, width: int, thick: int) -> None:
    """A word across `width` pixels, in the colour that the background is not."""
    (size, _), _ = cv2.getTextSize(word, LETTERS, 1, 2)
    scale = min(width / size, 3.4)
    shade = 0 if picture[base - 10, left + width // 2] > 127 else 255
    cv2.putText(picture, word, (left, base), LETTERS, scale, shade, thick, cv2.LINE_AA)


@cache
def label(seed: int) -> np.ndarray:
    """(192, 512) the print around a can or a bottle.

    A badge with a word fills the first `FRONT` of the way around; a bar code is at the back.
    """
    rng = np.random.default_rng(seed)
    picture = np.zeros((192, 512), np.uint8)
    style = seed % 4
    word = WORDS[rng.integers(len(WORDS))]
    if style == 0:
        cv2.ellipse(picture, (96, 96), (86, 62), 0, 0, 360, 255, -1, cv2.LINE_AA)
        cv2.ellipse(picture, (96, 96), (76, 52), 0, 0, 360, 0, 3, cv2.LINE_AA)
        _text(picture, word, 34, 108, 124, 5)
    elif style == 1:
        picture[70:] = 255
        _text(picture, word, 16, 52, 160, 6)
        cv2.circle(picture, (96, 128), 42, 0, -1, cv2.LINE_AA)
    elif style == 2:
        corner = np.array([[0, 192], [0, 110], [230, 30], [230, 192]])
        cv2.fillPoly(picture, [corner], 255, cv2.LINE_AA)
        _text(picture, word, 20, 160, 152, 6)
    else:
        picture[:34] = picture[-34:] = 255
        cv2.rectangle(picture, (8, 54), (184, 138), 255, 5, cv2.LINE_AA)
        _text(picture, word, 28, 110, 136, 6)
    left = 300  # the back: a bar code above lines of text
    cv2.rectangle(picture, (left - 12, 44), (left + 132, 152), 0, -1)
    for column in range(0, 108, 12):
        cv2.rectangle(
            picture, (left + column, 54), (left + column + int(rng.integers(3, 9)), 94), 255, -1
        )
    for row in range(108, 150, 14):
        cv2.line(picture, (left, row), (left + int(rng.integers(60, 120)), row), 255, 5)
    return _finished(picture, 1.6)


@cache
def keyboard() -> np.ndarray:
    """(160, 400) rows of keys between darker gaps, the space bar at the bottom."""
    picture = np.zeros((160, 400), np.uint8)
    for row in range(5):
        top, shift = 4 + row * 31, (0, 7, 12, 20, 0)[row]
        widths = [28.0] * 14 if row < 4 else [28, 28, 28, 34, 140, 34, 28, 28, 28]
        edges = np.cumsum([0, *widths])
        edges = 3 + (edges / edges[-1]) * 394
        for key, (left, right) in enumerate(pairwise(edges)):
            move = 0 if key == 0 else shift
            end = 397 if key == len(widths) - 1 else min(right + shift, 397)
            corners = (int(left + move) + 3, top + 2), (int(end) - 3, top + 26)
            cv2.rectangle(picture, *corners, 255, -1, cv2.LINE_AA)
    return _finished(picture, 1.8)


@cache
def screen(seed: int) -> np.ndarray:
    """(160, 256) a desktop: a window of text or of a chart on a wallpaper of hills."""
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(np.arange(256), np.arange(160))
    hills = 90 + 22 * np.sin(columns / rng.uniform(20, 45) + rng.uniform(0, 6))
    picture = np.where(rows > hills, 150, 20 + rows // 3).astype(np.uint8)
    x, y = int(rng.integers(18, 90)), int(rng.integers(14, 40))
    cv2.rectangle(picture, (x, y), (x + 140, y + 96), 245, -1)
    cv2.rectangle(picture, (x, y), (x + 140, y + 13), 60, -1)
    if seed % 2:
        for row in range(y + 26, y + 90, 13):
            cv2.line(picture, (x + 12, row), (x + int(rng.integers(60, 128)), row), 70, 5)
    else:
        for bar in range(6):
            height = int(rng.integers(14, 66))
            left = x + 14 + bar * 20
            cv2.rectangle(picture, (left, y + 88 - height), (left + 12, y + 88), 90, -1)
    cv2.rectangle(picture, (0, 150), (256, 160), 30, -1)
    return _finished(picture, 1.2)
