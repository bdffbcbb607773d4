"""From triangles on the screen to rows of pixels, and from rows to pixels; no loop over either.

Fill rule. A pixel is seen through its centre, which lies at whole numbers. A centre on the left or
upper edge of a triangle belongs to it, one on the right or lower edge does not. Where an edge
crosses a row is computed from its upper end, whichever triangle asks, and comes out the same to the
last bit: of two triangles that share an edge exactly one draws a centre on it, and there are no
cracks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Rows", "count_pixels", "crop_rows", "fill_keys", "to_rows"]

FLATTEST = 1e-9  # pixels: an edge lower than this is taken to be as high, and never divides by 0


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of pixels: columns `first` to `last` of row `y` belong to triangle `triangle`."""

    triangle: np.ndarray
    y: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def __getitem__(self, wanted: np.ndarray) -> Rows:
        return Rows(self.triangle[wanted], self.y[wanted], self.first[wanted], self.last[wanted])


def to_rows(x: list[np.ndarray], y: list[np.ndarray], canvas: tuple[int, int, int, int]) -> Rows:
    """Cut triangles into rows of pixels.

    Args:
        x, y: the columns and rows of the three corners, each (T,) float64.
        canvas: the first column and row, and the last ones; rows are cut at them.
    """
    left, top, right, bottom = canvas
    # Most faces of a fine mesh lie between pixel centres: they leave before the work begins.
    first_y = np.maximum(np.ceil(np.minimum(np.minimum(y[0], y[1]), y[2])), top)
    last_y = np.minimum(np.ceil(np.maximum(np.maximum(y[0], y[1]), y[2])) - 1, bottom)
    first_x = np.maximum(np.ceil(np.minimum(np.minimum(x[0], x[1]), x[2])), left)
    last_x = np.minimum(np.ceil(np.maximum(np.maximum(x[0], x[1]), x[2])) - 1, right)
    hit = np.flatnonzero((first_y <= last_y) & (first_x <= last_x))
    (x0, y0), (x1, y1), (x2, y2) = _from_top_to_bottom([c[hit] for c in x], [c[hit] for c in y])

    # Each row lies between the long edge, 0 to 2, and one of the two short ones, 0 to 1 or 1 to 2.
    long_slope = (x2 - x0) / np.maximum(y2 - y0, FLATTEST)
    short_x, short_y = np.concatenate([x0, x1]), np.concatenate([y0, y1])
    short_slope = np.concatenate([x1 - x0, x2 - x1])
    short_slope /= np.maximum(np.concatenate([y1 - y0, y2 - y1]), FLATTEST)

    first_y = first_y[hit].astype(np.int64)
    height = last_y[hit].astype(np.int64) - first_y + 1
    triangle, row = _repeat(height)
    row += first_y[triangle]
    at = row.astype(np.float64)
    long = x0[triangle] + (at - y0[triangle]) * long_slope[triangle]
    edge = triangle + len(hit) * (at >= y1[triangle])
    short = short_x[edge] + (at - short_y[edge]) * short_slope[edge]
    first = np.maximum(np.ceil(np.minimum(long, short)), left)
    last = np.minimum(np.ceil(np.maximum(long, short)) - 1, right)
    kept = np.flatnonzero(first <= last)
    first, last = first[kept].astype(np.int64), last[kept].astype(np.int64)
    return Rows(hit[triangle[kept]], row[kept], first, last)


def crop_rows(rows: Rows, width: int, height: int) -> Rows:
    """The part of the rows that lies in an image."""
    inside = (rows.y >= 0) & (rows.y < height) & (rows.last >= 0) & (rows.first < width)
    rows = rows[np.flatnonzero(inside)]
    first, last = np.maximum(rows.first, 0), np.minimum(rows.last, width - 1)
    return Rows(rows.triangle, rows.y, first, last)


def count_pixels(rows: Rows, box: tuple[int, int, int, int]) -> int:
    """How many pixels of `box` (x, y, width, height) are in any of the rows, each counted once.

    A row adds 1 where it begins and takes it away behind its end; the running sum says how many
    rows cover a pixel.
    """
    left, top, width, height = box
    line = (rows.y - top) * (width + 1) - left
    total = (width + 1) * height
    steps = np.bincount(line + rows.first, minlength=total)
    steps -= np.bincount(line + rows.last + 1, minlength=total)
    return int(np.count_nonzero(np.cumsum(steps)))


def fill_keys(
    rows: Rows,
    planes: tuple[np.ndarray, np.ndarray, np.ndarray],
    faces: np.ndarray,
    box: tuple[int, int, int, int],
    face_bits: int,
) -> np.ndarray:
    """The nearest face at each pixel of `box`, as keys (see `ObjectBuffer`).

    Args:
        rows: rows of pixels inside the box.
        planes: (a, b, c), each (T,), so that 1 / z = a x + b y + c on triangle T.
        faces: (T,) number of each triangle's face.
        box: x, y, width, height.
        face_bits: how many bits of the key hold the face.

    Returns:
        (height, width) int64 keys.
    """
    left, top, width, height = box
    a, b, c = planes
    slope = a[rows.triangle]
    begin = b[rows.triangle] * rows.y + c[rows.triangle] + slope * rows.first
    row, step = _repeat(rows.last - rows.first + 1)
    depth_key = (begin[row] + slope[row] * step).view(np.int64)
    depth_key &= -1 << face_bits
    depth_key |= faces[rows.triangle][row]
    step += ((rows.y - top) * width + rows.first - left)[row]
    keys = np.zeros(width * height, np.int64)
    np.maximum.at(keys, step, depth_key)
    return keys.reshape(height, width)


def _repeat(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 3): the items 0 0 1 1 1, and 0 1 0 1 2, the place of each within its item."""
    item = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(item)) - (np.cumsum(counts) - counts)[item]
    return item, place


def _from_top_to_bottom(
    x: list[np.ndarray], y: list[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The three corners of each triangle in the order of their rows."""
    corners = list(zip(x, y, strict=True))
    for i, j in ((0, 1), (1, 2), (0, 1)):
        (x_i, y_i), (x_j, y_j) = corners[i], corners[j]
        swap = y_i > y_j
        corners[i] = np.where(swap, x_j, x_i), np.where(swap, y_j, y_i)
        corners[j] = np.where(swap, x_i, x_j), np.where(swap, y_i, y_j)
    return corners
