"""Soft shadows: the scene seen from the lamp.

What the lamp sees is lit, what is behind it lies in shadow (Williams, "Casting curved shadows on
curved surfaces", 1978). Three faults of that idea are known by name, and each has its cure here:

- *Acne*: a surface shades itself because the map has texels. Each texel is compared with the plane
  in which the point lies, not with the point (receiver plane; Isidoro, "Shadow mapping", GDC 2006).
- *Stairs*: the answers of sixteen texels are averaged, weighted so that the sum changes smoothly
  (percentage closer filtering; Reeves, Salesin and Cook, SIGGRAPH 1987).
- *One softness*: near the foot of an object its shadow is sharp, far away it is soft. The width
  follows from how far the blocker is (Fernando, "Percentage-closer soft shadows", 2005); wide
  filters read every second, fourth, ... texel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import cv2
import numpy as np

from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.rasteriser import rasterise
from data_tools.renderer.surfaces import Triple, dot, normalised, rotated
from data_tools.renderer.visibility import Pose

__all__ = ["ShadowMap", "shadow_map"]

CLOSE = 0.005  # metres from the lamp within which nothing throws a shadow
WIDEST = 3  # levels of softness: texels of 1, 2, 4, 8
MARGIN = 5 << WIDEST  # texels of nothing around a map, so that no filter leaves it
GRAZING = 0.05  # cosine of the light's angle below which a plane fades into the dark
STEEPEST = 0.3  # share by which the inverse depth of a plane may grow within a step


class ShadowMap:
    """What a lamp sees: `lit` tells the share of its light that arrives at a point.

    Args:
        R, t: from the camera's frame to the lamp's, which looks along its z axis.
        K: (3, 3) its camera matrix, in texels.
        inverse_depth: (n, n) 1 / z of what it sees, 0 for nothing.
        radius: metres, of the lamp.
    """

    def __init__(
        self, R: np.ndarray, t: np.ndarray, K: np.ndarray, inverse_depth: np.ndarray, radius: float
    ) -> None:
        self._R, self._t = R.astype(np.float32), t.astype(np.float32)
        self._focal = K[0, 0].astype(np.float32), K[1, 1].astype(np.float32)
        self._centre = K[0, 2].astype(np.float32), K[1, 2].astype(np.float32)
        self._size = len(inverse_depth)
        seen = np.pad(inverse_depth.astype(np.float32), MARGIN)
        self._map = seen.reshape(-1)
        # The nearest thing around each texel, so that a search in wide steps misses nothing thin.
        self._search = 1 << WIDEST if radius > 0 else 1
        nearest = cv2.dilate(seen, np.ones((self._search + 1,) * 2, np.uint8))
        self._nearest = nearest.reshape(-1)
        # And the nearest thing in each window of the search.
        coarse = np.ascontiguousarray(nearest[:: self._search, :: self._search])
        self._window = cv2.dilate(coarse, np.ones((4, 4), np.uint8), anchor=(0, 0))
        self._radius = np.float32(radius)

    def lit(self, point: Triple, normal: Triple) -> np.ndarray:
        """The share of the light that arrives, 0 to 1.

        Args:
            point: points in the camera's frame.
            normal: unit normals of the planes in which they lie.

        Returns:
            (P,) float32; 0 for planes that turn away from the lamp, 1 for points of others that
            the map does not cover.
        """
        p = tuple(c + s for c, s in zip(rotated(self._R, point), self._t, strict=True))
        n = rotated(self._R, normal)
        share = np.clip(-dot(n, normalised(p)) / np.float32(GRAZING), 0, 1)
        # What has nothing near it that could stand before it is lit, and that is most.
        rest = np.flatnonzero(self._covers(p) & (share > 0))
        p, n = tuple(c[rest] for c in p), tuple(c[rest] for c in n)
        width = self._penumbra(p, n)
        some = np.flatnonzero(width >= 0)
        rest, width = rest[some], width[some]
        p, n = tuple(c[some] for c in p), tuple(c[some] for c in n)
        # A filter is three texels wide, or six, ...: mix the two that enclose the wanted width.
        level = np.clip(np.log2(np.maximum(width / 3, np.float32(1))), 0, WIDEST)
        mixed = np.zeros(len(rest), np.float32)
        for k in range(WIDEST + 1):
            weight = 1 - np.abs(level - k)
            part = np.flatnonzero(weight > 0)
            if len(part):
                plane = self._plane(tuple(c[part] for c in p), tuple(c[part] for c in n), 1 << k)
                mixed[part] += weight[part] * self._filtered(plane, 1 << k)
        share[rest] *= mixed
        return share

    def _covers(self, p: Triple) -> np.ndarray:
        """Whether points are before the lamp, and in its map or so close that a filter reads it."""
        result = p[2] > CLOSE
        z = np.maximum(p[2], np.float32(CLOSE))
        for k in range(2):
            texel = self._focal[k] * p[k] / z + self._centre[k]
            result &= (texel > -MARGIN) & (texel < self._size + MARGIN)
        return result

    def _plane(self, p: Triple, n: Triple, step: int) -> tuple[np.ndarray, ...]:
        """Column and row of points, their inverse depths, and how these grow along u and v.

        On the plane n . x = h the inverse depth is n . ray / h, affine in the texel. The points are
        moved by half a step towards the lamp, since a curved surface leaves its plane.
        """
        texel = np.float32(0.5 * step / min(self._focal))
        x, y, z = (c + texel * p[2] * k for c, k in zip(p, n, strict=True))
        inverse = 1 / np.maximum(z, np.float32(CLOSE))
        u = self._focal[0] * x * inverse + self._centre[0]
        v = self._focal[1] * y * inverse + self._centre[1]
        # A plane that the light grazes is taken to be a little less steep.
        offset = np.minimum(dot(n, (x, y, z)), np.float32(-1e-6))
        steepest = STEEPEST * inverse / step
        along = np.clip(n[0] / (self._focal[0] * offset), -steepest, steepest)
        down = np.clip(n[1] / (self._focal[1] * offset), -steepest, steepest)
        return u, v, inverse, along, down

    def _penumbra(self, p: Triple, n: Triple) -> np.ndarray:
        """Width in texels of the half-shadow in which a point lies; -1 if nothing is before it."""
        plane = self._plane(p, n, 1)
        left, top, _, _ = self._corner(plane, self._search)
        corner = tuple((c.astype(np.int64) + MARGIN) // self._search for c in (top, left))
        lowest = plane[2] - 2 * self._search * (np.abs(plane[3]) + np.abs(plane[4]))
        within = np.flatnonzero(self._window[corner] > np.maximum(lowest, 0))
        width = np.full(len(lowest), -1, np.float32)
        width[within] = self._searched(tuple(c[within] for c in plane))
        return width

    def _searched(self, plane: tuple[np.ndarray, ...]) -> np.ndarray:
        """`_penumbra`, texel by texel."""
        inverse = plane[2]
        # On a slope the surface itself comes before its plane within a step of the search: that
        # has to be looked at, but tells nothing of the width.
        slope = self._search * (np.abs(plane[3]) + np.abs(plane[4]))
        anything = np.zeros(len(inverse), bool)
        total, count = np.zeros((2, len(inverse)), np.float32)
        for found, expected in self._texels(self._nearest, plane, self._search):
            anything |= found > expected
            blocks = found > expected + slope
            count += blocks
            total += np.where(blocks, found, np.float32(0))
        # Similar triangles: width / (2 radius) = (z - blocker) / blocker = z / blocker - 1.
        ratio = total / np.maximum(count, 1) / np.maximum(inverse, np.float32(1e-9)) - 1
        width = 2 * self._radius * np.maximum(ratio, 0) * inverse * min(self._focal)
        return np.where(anything, width, np.float32(-1))

    def _filtered(self, plane: tuple[np.ndarray, ...], step: int) -> np.ndarray:
        """The share of 4 x 4 texels, `step` apart, that see the point.

        Their weights are a box three steps wide around the point, smoothed: they sum to 1, and a
        texel enters and leaves with weight 0.
        """
        _, _, share_u, share_v = self._corner(plane, step)
        texels = self._texels(self._map, plane, step)
        total = np.zeros(len(plane[0]), np.float32)
        for weight in (1 - share_v, 1, 1, share_v):
            first, second, third, fourth = (
                found <= expected for found, expected in islice(texels, 4)
            )
            row = (1 - share_u) * first
            row += second
            row += third
            row += share_u * fourth
            total += weight * row
        return total * np.float32(1 / 9)

    def _texels(
        self, seen: np.ndarray, plane: tuple[np.ndarray, ...], step: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """What 4 x 4 texels around a point hold, row by row, and what its plane is there.

        The texels are those of a grid of every `step`-th.
        """
        u, v, inverse, along, down = plane
        left, top, _, _ = self._corner(plane, step)
        line = self._size + 2 * MARGIN
        index = (top.astype(np.int64) + MARGIN) * line + left.astype(np.int64) + MARGIN
        corner = inverse + along * (left - u) + down * (top - v)
        along, down = np.float32(step) * along, np.float32(step) * down
        for j in range(4):
            expected = corner + np.float32(j) * down
            for i in range(4):
                if i:
                    expected = expected + along
                yield seen[step * (j * line + i) :].take(index), expected

    def _corner(self, plane: tuple[np.ndarray, ...], step: int) -> tuple[np.ndarray, ...]:
        """Column and row of the first of the 4 x 4 texels around a point, and where the point lies
        between the second and the third, from 0 to 1."""
        end = self._size // step + 2  # points outside the map are moved into its empty margin
        u, v = (c / step for c in plane[:2])
        left, top = (np.clip(np.floor(c), -2, end) for c in (u, v))
        share_u, share_v = np.clip(u - left, 0, 1), np.clip(v - top, 0, 1)
        return step * (left - 1), step * (top - 1), share_u, share_v


def shadow_map(
    objects: Sequence[PreparedMesh],
    poses: Sequence[Pose],
    position: np.ndarray,
    radius: float,
    points: Triple,
    texels: int,
) -> ShadowMap | None:
    """What a lamp sees of the objects, where it matters to the points.

    Args:
        objects, poses: what throws shadows, in the camera's frame.
        position: (3,) the lamp, in the camera's frame.
        radius: metres, of the lamp.
        points: what the camera sees, in its frame.
        texels: width and height of the map.

    Returns:
        The map, or None if no shadow can fall on the points.
    """
    if not objects or not len(points[0]):
        return None
    boxes = np.concatenate(
        [_corners(o) @ R.T + t for o, (R, t) in zip(objects, poses, strict=True)]
    )
    R = _facing(boxes.mean(0) - position)
    t = -R @ position
    receivers = tuple(c + s for c, s in zip(rotated(R, points), t, strict=True))
    low, high = _extent(tuple(c[receivers[2] > CLOSE] for c in receivers))
    filter_width = 3 << WIDEST if radius > 0 else 3  # texels that are read beyond the border
    margin = (high - low) * filter_width / texels
    low, high = low - margin, high + margin
    casters = boxes @ R.T + t
    if (casters[:, 2] > CLOSE).all():
        reach = np.array(_extent(tuple(casters.T)))
        margin = 0.05 * (reach[1] - reach[0])
        low, high = np.maximum(low, reach[0] - margin), np.minimum(high, reach[1] + margin)
    if not (low < high).all():
        return None
    focal = (texels - 4) / (high - low)
    centre = 2 - 0.5 - focal * low
    K = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    nearest = np.zeros((texels, texels))
    for item, (R_object, t_object) in zip(objects, poses, strict=True):
        pose = R @ R_object, R @ t_object + t
        buffer = rasterise(item, *pose, K, (texels, texels), near=CLOSE, outside=False)
        if buffer is not None:
            window = nearest[buffer.window]
            np.maximum(window, buffer.inverse_depth, out=window)
    return ShadowMap(R, t, K, nearest, radius)


def _corners(item: PreparedMesh) -> np.ndarray:
    """(8, 3) corners of the object's box."""
    low, high = item.vertices.min(1), item.vertices.max(1)
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)


def _facing(direction: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from the camera's frame to one that looks along the direction."""
    length = np.linalg.norm(direction)
    z = direction / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(side, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _extent(points: Triple) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and the largest x / z and y / z; an empty range for no points."""
    x, y, z = points
    if not len(z):
        return np.zeros(2), np.zeros(2)
    across, down = x / z, y / z
    return np.array([across.min(), down.min()]), np.array([across.max(), down.max()])
