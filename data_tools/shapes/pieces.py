"""Pieces that objects are built from: solids of revolution, lofts, tubes, boxes, ellipsoids.

Every piece is closed and wound counter-clockwise seen from outside, so its volume is positive.
Pieces may run into each other: the z-buffer sorts it out, and no boolean operation is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import trimesh

from data_tools.shapes.building import CREASE, Part
from data_tools.shapes.mesh import Material
from posecore.arrays import fail, require_integer, require_number, to_numbers

__all__ = ["box", "ellipsoid", "loft", "revolve", "spline", "tube"]


def spline(points: Sequence[Sequence[float]], count: int, closed: bool = False) -> np.ndarray:
    """A smooth curve through points (Catmull-Rom: uniform, of tension 1/2).

    Args:
        points: (N, D), at least two.
        count: how many points to return, the ends among them unless `closed`.
        closed: whether the last point is followed by the first.

    Returns:
        (count, D).

    Raises:
        ValueError: if there are fewer than two points, or `count` is below 2.
    """
    points = to_numbers("points", points)
    if points.ndim != 2 or len(points) < 2:
        fail("points", "at least two points of shape (N, D)", points.shape)
    require_integer("count", count, 2)
    if closed:
        points = np.vstack([points[-1], points, points[:2]])
    else:
        points = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    place = np.linspace(0, len(points) - 3, count, endpoint=not closed)
    first = np.minimum(place.astype(int), len(points) - 4)
    s = (place - first)[:, None]
    a, b, c, d = (points[first + k] for k in range(4))
    curve = b + s / 2 * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))
    if not closed:
        curve[-1] = points[-2]  # exactly, so that a profile may end on its axis
    return curve


def _grid(rows: int, columns: int, around: bool = False) -> np.ndarray:
    """Faces between rows of a grid whose columns close up; `around`: the rows do as well."""
    i, j = np.meshgrid(np.arange(rows if around else rows - 1), np.arange(columns), indexing="ij")
    below, above = i * columns, (i + 1) % rows * columns
    following = (j + 1) % columns
    a, b, c, d = below + j, below + following, above + following, above + j
    return np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)


def loft(
    rings: np.ndarray, material: Material, around: bool = False, crease: float = CREASE
) -> Part:
    """A skin over rings of points, capped by fans, or closed `around` into a torus.

    Args:
        rings: (M, N, 3) metres; every ring must see its own centre, so that its fan is flat.
        material: of the whole.
        around: whether the last ring is joined to the first; else both ends get caps.
        crease: rad.

    Raises:
        ValueError: if there are fewer than two rings, or than three points in a ring.
    """
    rings = to_numbers("rings", rings)
    if rings.ndim != 3 or rings.shape[0] < 2 or rings.shape[1] < 3 or rings.shape[2] != 3:
        fail("rings", "shape (M >= 2, N >= 3, 3)", rings.shape)
    rows, columns = rings.shape[:2]
    vertices, faces = rings.reshape(-1, 3), _grid(rows, columns, around)
    if not around:
        first = np.arange(columns)
        then = np.roll(first, -1)
        last = (rows - 1) * columns
        centre = np.full(columns, rows * columns)
        bottom = np.stack([centre, then, first], -1)
        top = np.stack([centre + 1, last + first, last + then], -1)
        vertices = np.vstack([vertices, rings[0].mean(0), rings[-1].mean(0)])
        faces = np.vstack([faces, bottom, top])
    return Part.of(vertices, faces, material, crease)


def revolve(
    strips: Sequence[tuple[Sequence[Sequence[float]], Material]],
    sections: int = 48,
    crease: float = CREASE,
) -> Part:
    """A solid of revolution about z.

    Args:
        strips: (profile, material) one after the other; a profile is a list of (radius, height).
            The first profile starts on the axis and the last ends on it, both at exactly 0.
        sections: steps of the turn.
        crease: rad.

    Raises:
        ValueError: if the whole profile does not start and end on the axis, touches it in between,
            or repeats a point.
    """
    require_integer("sections", sections, 3)
    if not strips:
        fail("strips", "at least one", 0)
    profile, owner = [], []
    for index, (points, _) in enumerate(strips):
        points = to_numbers("strips", points)
        if points.ndim != 2 or points.shape[1] != 2:
            fail("strips", "profiles of shape (N, 2)", points.shape)
        if not np.isfinite(points).all():
            fail("strips", "finite profiles", points.tolist())
        joint = int(bool(profile) and np.allclose(profile[-1], points[0], atol=1e-9))
        profile += points[joint:].tolist()
        owner += [index] * (len(points) - 1 + (1 - joint) * bool(index))
    r, z = np.array(profile).T
    if r[0] != 0 or r[-1] != 0 or (r[1:-1] <= 0).any():
        fail("strips", "a profile that starts and ends, and only there, at radius 0", r.tolist())
    if (np.hypot(np.diff(r), np.diff(z)) < 1e-9).any():
        fail("strips", "neighbouring points apart from each other", "a repeated point")
    angle = 2 * np.pi * np.arange(sections) / sections
    rows = len(r) - 2
    rings = np.stack(
        [
            r[1:-1, None] * np.cos(angle),
            r[1:-1, None] * np.sin(angle),
            np.broadcast_to(z[1:-1, None], (rows, sections)),
        ],
        -1,
    )
    first = np.arange(sections)
    then = np.roll(first, -1)
    low, high = (np.full(sections, rows * sections + end) for end in (0, 1))
    top = (rows - 1) * sections
    faces = np.vstack(
        [
            np.stack([low, then, first], -1),
            _grid(rows, sections),
            np.stack([high, top + first, top + then], -1),
        ]
    )
    owner = np.array(owner)
    material = np.concatenate(
        [
            np.repeat(owner[0], sections),
            np.repeat(owner[1:-1], 2 * sections),
            np.repeat(owner[-1], sections),
        ]
    )
    vertices = np.vstack([rings.reshape(-1, 3), [[0, 0, z[0]], [0, 0, z[-1]]]])
    part = Part.of(vertices, faces, strips[0][1], crease)
    return replace(part, material=material, materials=tuple(m for _, m in strips))


def tube(
    path: np.ndarray,
    radius: float | np.ndarray,
    material: Material,
    up: Sequence[float],
    sides: int = 10,
    around: bool = False,
    crease: float = CREASE,
) -> Part:
    """A tube along a path.

    Args:
        path: (M, 3) metres.
        radius: a number, (M,), or (M, 2) or (2,) half axes of an ellipse: across `up`, along `up`.
        material: of the whole.
        up: (3,) a direction that the path never takes; it keeps the ellipse from twisting.
        sides: of the cross-section.
        around: whether the path is a loop.
        crease: rad.

    Raises:
        ValueError: if somewhere the path runs along `up`.
    """
    path = to_numbers("path", path)
    if path.ndim != 2 or len(path) < 2 + around or path.shape[1] != 3:
        fail("path", "at least two points of shape (M, 3)", path.shape)
    if around:
        along = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    else:
        along = np.gradient(path, axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    if not (length > 0).all():
        fail("path", "points apart from each other", "a repeated point")
    across = np.cross(along / length, np.asarray(up) / np.linalg.norm(up))
    size = np.linalg.norm(across, axis=1, keepdims=True)
    if (size < 1e-3).any():
        fail("up", "a direction that the path never takes", list(up))
    across /= size
    rise = np.cross(across, along / length)
    half = np.asarray(radius, np.float64)
    half = np.broadcast_to(half[:, None] if half.shape == (len(path),) else half, (len(path), 2))
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = (
        path[:, None]
        + np.cos(angle)[:, None] * (half[:, :1] * across)[:, None]
        + np.sin(angle)[:, None] * (half[:, 1:] * rise)[:, None]
    )
    return loft(rings, material, around, crease)


def box(size: Sequence[float], radius: float, material: Material, steps: int = 2) -> Part:
    """A box with rounded edges, centred on the origin.

    Args:
        size: (3,) metres.
        radius: of the edges, above 0 and under half of the smallest side.
        material: of the whole.
        steps: quadrilaterals across an eighth of an edge's circle.

    Raises:
        ValueError: if `size` is not three lengths, or `radius` does not fit it.
    """
    half = to_numbers("size", size) / 2
    if half.shape != (3,):
        fail("size", "three lengths", half.shape)
    require_number("radius", radius, above=0)
    if radius >= half.min():
        fail("radius", f"less than half the smallest side, {half.min()}", radius)
    ramp = np.tan(np.linspace(-np.pi / 4, 0, steps + 1))
    slope = np.concatenate([ramp, -ramp[::-1]])
    core = np.repeat([-1.0, 1.0], steps + 1)
    count = len(slope)
    u, v = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    corner = (u[:-1, :-1] * count + v[:-1, :-1]).ravel()
    quad = np.stack([corner, corner + count, corner + count + 1, corner + 1], -1)
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            direction = np.roll(
                np.stack([np.full(u.shape, side), slope[u], slope[v]], -1), axis, -1
            )
            middle = np.roll(np.stack([np.full(u.shape, side), core[u], core[v]], -1), axis, -1)
            direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
            vertices.append(((half - radius) * middle + radius * direction).reshape(-1, 3))
            faces.append((quad if side > 0 else quad[:, ::-1]) + len(faces) * count * count)
    quads = np.vstack(faces)
    keys = np.round(np.vstack(vertices) * 1e8).astype(np.int64)
    _, first, same = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    quads = same.ravel()[quads]
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Part.of(np.vstack(vertices)[first], triangles, material)


@cache
def _sphere(level: int) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=level)
    return np.array(mesh.vertices), np.array(mesh.faces)


def ellipsoid(
    radii: Sequence[float] | float,
    material: Material,
    centre: Sequence[float] = (0, 0, 0),
    level: int = 2,
) -> Part:
    """An ellipsoid of 20 x 4^level faces along the axes."""
    vertices, faces = _sphere(level)
    return Part.of(vertices * radii, faces, material).moved(shift=centre)
