"""Which face of an object does each pixel see, and how far away is it?

Everything here is float64, and sums are written out instead of left to a matrix product: the same
input gives the same bytes whatever the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_tools.renderer.clipping import clip_near
from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.scanlines import Rows, count_pixels, crop_rows, fill_keys, to_rows

__all__ = ["NEAR", "ObjectBuffer", "affine", "rasterise"]

NEAR = 0.01  # metres: nothing closer to the camera is drawn
EDGE_ON = 1e-9  # metres: a face whose plane passes the camera as close as this is only a line


@dataclass(frozen=True, eq=False, repr=False)
class ObjectBuffer:
    """What one camera sees of one object if nothing stands before it.

    Attributes:
        x, y: column and row in the image of the first pixel of `keys`.
        keys: (h, w) int64, 0 where the object is not. Read as float64 a key is 1 / z; its last
            `face_bits` bits hold the number of the face. The larger key is the nearer face, so one
            maximum settles both who is seen and how far away.
        face_bits: how many bits of a key hold the face.
        full_pixels: size of the silhouette in pixels.
        full_box: x, y, width and height of the silhouette. It and `full_pixels` count pixels
            outside the image too, up to an image's width and height beyond its border (as BOP
            does), if the rasteriser was asked for it.
    """

    x: int
    y: int
    keys: np.ndarray
    face_bits: int
    full_pixels: int
    full_box: tuple[int, int, int, int]

    @property
    def window(self) -> tuple[slice, slice]:
        """The part of the image that `keys` describes."""
        height, width = self.keys.shape
        return slice(self.y, self.y + height), slice(self.x, self.x + width)

    @property
    def mask(self) -> np.ndarray:
        """(h, w) bool, where the object is."""
        return self.keys > 0

    @property
    def inverse_depth(self) -> np.ndarray:
        """(h, w) float64, 1 / z in 1/m to nine digits; 0 where the object is not."""
        return self.keys.view(np.float64)

    @property
    def face(self) -> np.ndarray:
        """(h, w) int64, which of the prepared faces is seen; 0 also where the object is not."""
        return self.keys & ((1 << self.face_bits) - 1)


def rasterise(
    prepared: PreparedMesh,
    R: np.ndarray,
    t: np.ndarray,
    K: np.ndarray,
    size: tuple[int, int],
    *,
    near: float = NEAR,
    outside: bool = True,
) -> ObjectBuffer | None:
    """Draw one object into a buffer of its own.

    Backs of closed parts are not drawn, unless the near plane cuts the object open: then one looks
    into it. Arguments are not checked here but in the functions that draw scenes.

    Args:
        prepared: the object.
        R, t: (3, 3) and (3,) float64, its pose.
        K: (3, 3) float64 camera matrix.
        size: width and height of the image in pixels.
        near: metres; triangles are cut where they come closer.
        outside: count the pixels outside the image as well.

    Returns:
        The buffer, or None if the object covers no pixel; its `keys` are empty if it covers some
        outside the image only.
    """
    triangles = _project(prepared, R, t, K, near)
    if triangles is None:
        return None
    x, y, faces, distance = triangles
    width, height = size
    more_x, more_y = (width, height) if outside else (0, 0)
    rows = to_rows(x, y, (-more_x, -more_y, width + more_x - 1, height + more_y - 1))
    if not len(rows.y):
        return None
    left, top, right, bottom = _box(rows)
    full_box = (left, top, right - left + 1, bottom - top + 1)
    beyond = left < 0 or top < 0 or right >= width or bottom >= height
    if beyond:
        full_pixels = count_pixels(rows, full_box)
        rows = crop_rows(rows, width, height)
        left, top, right, bottom = _box(rows) if len(rows.y) else (0, 0, -1, -1)
    # The plane n . x + d = 0 of a face is seen by a camera at c through the pixel p = (x, y, 1)
    # where z n . (R^-1 K^-1 p) + n . c + d = 0: the inverse depth is affine in the pixel.
    rays = -np.linalg.inv(K @ R)
    planes = prepared.planes[:, faces]
    a, b, c = (affine((*rays[:, k], 0.0), planes) / distance for k in range(3))
    bits = max(1, (prepared.corners.shape[1] - 1).bit_length())
    box = (left, top, right - left + 1, bottom - top + 1)
    keys = fill_keys(rows, (a, b, c), faces, box, bits)
    if not beyond:
        full_pixels = int(np.count_nonzero(keys))
    return ObjectBuffer(left, top, keys, bits, full_pixels, full_box)


def affine(row: np.ndarray | tuple, x: np.ndarray) -> np.ndarray:
    """`row[0] x[0] + row[1] x[1] + row[2] x[2] + row[3]`, summed in this order."""
    return row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3]


def _box(rows: Rows) -> tuple[int, int, int, int]:
    return int(rows.first.min()), int(rows.y.min()), int(rows.last.max()), int(rows.y.max())


def _project(
    prepared: PreparedMesh, R: np.ndarray, t: np.ndarray, K: np.ndarray, near: float
) -> tuple | None:
    """The triangles that face the camera: columns and rows of their corners, faces, distances.

    The distance is that of the camera from the face's plane, positive before it.
    """
    if not len(prepared.source):
        return None
    P = np.column_stack([K @ R, K @ t])
    scaled_x, scaled_y, z = (affine(P[k], prepared.vertices) for k in range(3))
    if z.max() < near:
        return None
    opened = z.min() < near
    distance = affine((*-np.linalg.inv(R) @ t, 0.0), prepared.planes) + prepared.planes[3]
    if opened:
        seen = np.abs(distance) > EDGE_ON
    else:
        seen = distance > EDGE_ON
        if prepared.two_sided is not None:
            seen |= prepared.two_sided & (distance < -EDGE_ON)
    faces = np.flatnonzero(seen)
    corners = prepared.corners[:, faces]
    if opened:
        parts, source = clip_near(np.stack([scaled_x, scaled_y, z], 1)[corners.T], near)
        faces = faces[source]
        x, y = list((parts[..., 0] / parts[..., 2]).T), list((parts[..., 1] / parts[..., 2]).T)
    else:
        column, line = scaled_x / z, scaled_y / z
        x, y = [column[corner] for corner in corners], [line[corner] for corner in corners]
    return x, y, faces, distance[faces]
