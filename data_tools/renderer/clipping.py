"""Cutting triangles at the near plane: what lies behind the camera has no place in the image."""

from __future__ import annotations

import numpy as np

__all__ = ["clip_near"]


def clip_near(corners: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """The part of each triangle that lies at z >= `near`, as triangles again.

    A triangle with one corner in front leaves a smaller triangle, one with two corners in front a
    quadrilateral, which is drawn as two triangles (Sutherland and Hodgman, "Reentrant polygon
    clipping", 1974, for one plane and all triangles at once).

    Args:
        corners: (T, 3, 3) corners (x, y, z) in any frame in which z is the depth; x and y may be
            pixels times depth, since a cut is linear.
        near: depth of the plane.

    Returns:
        (C, 3, 3) triangles and (C,) the number of the triangle that each is a part of.
    """
    front = corners[:, :, 2] >= near
    count = front.sum(1)
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    # Turn each triangle until the corner that is alone on its side comes first.
    a, b, c = _turned(corners[one], front[one].argmax(1))
    tips = np.stack([a, _cut(a, b, near), _cut(a, c, near)], axis=1)
    a, b, c = _turned(corners[two], front[two].argmin(1))
    from_b, from_c = _cut(b, a, near), _cut(c, a, near)
    halves = np.stack([from_b, b, c], axis=1), np.stack([from_b, c, from_c], axis=1)
    whole = np.flatnonzero(count == 3)
    parts = np.concatenate([corners[whole], tips, *halves])
    return parts, np.concatenate([whole, one, two, two])


def _turned(corners: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    row = np.arange(len(corners))
    return tuple(corners[row, (first + k) % 3] for k in range(3))


def _cut(inside: np.ndarray, outside: np.ndarray, near: float) -> np.ndarray:
    """Where edges cross the plane; two triangles get the same point on the edge that they share."""
    share = (near - inside[:, 2]) / (outside[:, 2] - inside[:, 2])
    point = inside + share[:, None] * (outside - inside)
    point[:, 2] = near
    return point
