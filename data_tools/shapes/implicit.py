"""Soft shapes: blends of ellipsoids and limbs, and their surface as triangles.

A shape is a function from points (..., 3) to a number that is about the distance to the surface,
negative inside. Formulas of the primitives and of the blend: Inigo Quilez, "Distance functions"
and "Smooth minimum".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from data_tools.shapes.building import CREASE, Part
from data_tools.shapes.mesh import Material
from posecore.arrays import fail, require_number

__all__ = ["Shape", "ball", "below", "blend", "carve", "common", "limb", "radial", "skin"]

Shape = Callable[[np.ndarray], np.ndarray]
Point = Sequence[float]


def ball(centre: Point, radii: Point | float) -> Shape:
    """An ellipsoid along the axes.

    Raises:
        ValueError: if a radius is not positive.
    """
    middle, half = np.asarray(centre, np.float64), np.broadcast_to(radii, 3).astype(np.float64)
    if not (half > 0).all():
        fail("radii", "lengths above 0", half.tolist())

    def distance(points: np.ndarray) -> np.ndarray:
        p = (points - middle) / half
        near = np.sqrt(np.einsum("...i,...i", p, p))
        slope = np.sqrt(np.einsum("...i,...i", p / half, p / half))
        # At the very centre both are 0: the distance there is the smallest half axis.
        return np.where(slope > 0, near * (near - 1) / np.maximum(slope, 1e-12), -half.min())

    return distance


def limb(start: Point, end: Point, radius: float, end_radius: float | None = None) -> Shape:
    """A capsule whose radius runs from one end to the other.

    Raises:
        ValueError: if both ends are one point.
    """
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    if np.array_equal(a, b):
        fail("start, end", "two different points", a.tolist())
    grow = (radius if end_radius is None else end_radius) - radius

    def distance(points: np.ndarray) -> np.ndarray:
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        apart = points - a - share[..., None] * (b - a)
        return np.sqrt(np.einsum("...i,...i", apart, apart)) - radius - grow * share

    return distance


def below(height: float) -> Shape:
    """All that lies under a height."""
    return lambda points: points[..., 2] - height


def _soft_min(one: np.ndarray, other: np.ndarray, width: float) -> np.ndarray:
    near = np.maximum(width - np.abs(one - other), 0) / width
    return np.minimum(one, other) - near * near * width / 4


def blend(shapes: Sequence[Shape], width: float) -> Shape:
    """The union of shapes, joints rounded over about `width` metres.

    Raises:
        ValueError: if there are no shapes, or `width` is not positive.
    """
    require_number("width", width, above=0)
    if not shapes:
        fail("shapes", "at least one", 0)

    def distance(points: np.ndarray) -> np.ndarray:
        result = shapes[0](points)
        for shape in shapes[1:]:
            result = _soft_min(result, shape(points), width)
        return result

    return distance


def carve(shape: Shape, cutters: Sequence[Shape], width: float) -> Shape:
    """A shape less others, edges rounded over about `width` metres.

    Raises:
        ValueError: if `width` is not positive.
    """
    require_number("width", width, above=0)

    def distance(points: np.ndarray) -> np.ndarray:
        result = shape(points)
        for cutter in cutters:
            result = -_soft_min(-result, cutter(points), width)
        return result

    return distance


def common(one: Shape, other: Shape, width: float) -> Shape:
    """What lies in both shapes, edges rounded over about `width` metres.

    Raises:
        ValueError: if `width` is not positive.
    """
    require_number("width", width, above=0)
    return lambda points: -_soft_min(-one(points), -other(points), width)


def skin(
    shape: Shape, low: Point, high: Point, step: float, material: Material, crease: float = CREASE
) -> Part:
    """The surface of a shape inside a box, by surface nets (Gibson, 1998).

    One vertex in each cell of the grid that the surface crosses, at the mean of the crossings of
    the cell's edges and then drawn onto the surface; one quadrilateral across each crossed edge.

    Args:
        shape: to be drawn.
        low, high: (3,) corners of the box; the shape must lie inside, a cell away from its sides.
        step: side of a cell, metres; features smaller than two cells are lost, and
            sheets that come nearer than that are joined.
        material: of the whole.
        crease: rad.

    Raises:
        ValueError: if the surface meets the sides of the box, or there is none.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if not (low < high).all():
        fail("low, high", "two opposite corners", f"{low.tolist()}, {high.tolist()}")
    counts = np.ceil((high - low) / require_number("step", step, above=0)).astype(int) + 1
    axes = [low[k] + step * np.arange(counts[k]) for k in range(3)]
    value = shape(np.stack(np.meshgrid(*axes, indexing="ij"), -1))
    inside = value < 0
    if not inside.any():
        fail("shape", "a surface inside the box", "nothing")
    if any(np.moveaxis(inside, k, 0)[[0, -1]].any() for k in range(3)):
        fail("low, high", "a box around the shape", "a shape that runs out of it")

    _join_diagonals(value, 0.01 * step)
    cells = counts - 1
    total, crossings = np.zeros((*cells, 3)), np.zeros(cells)
    quads = []
    index = np.arange(cells.prod()).reshape(cells)
    for axis in range(3):
        before, after = (np.moveaxis(value, axis, 0)[s] for s in (slice(None, -1), slice(1, None)))
        crossed = np.argwhere((before < 0) != (after < 0))
        at = tuple(crossed.T)
        share = before[at] / (before[at] - after[at])
        # The edge's start in grid coordinates, its own axis first; then back to x, y, z.
        point = crossed.astype(np.float64)
        point[:, 0] += share
        point = _back(point, axis)
        start = _back(crossed, axis)
        u, v = (axis + 1) % 3, (axis + 2) % 3
        corners = []
        for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
            cell = start.copy()
            cell[:, u] -= du
            cell[:, v] -= dv
            where = tuple(cell.T)
            np.add.at(total, where, point)
            np.add.at(crossings, where, 1)
            corners.append(index[where])
        quad = np.stack(corners, -1)
        leaving = before[at] < 0  # going along the axis we step out of the shape
        quads.append(np.where(leaving[:, None], quad, quad[:, ::-1]))

    used = crossings.ravel() > 0
    vertices = low + step * total.reshape(-1, 3)[used] / crossings.ravel()[used, None]
    number = np.cumsum(used) - 1
    quad = number[np.vstack(quads)]
    vertices = _drawn_onto(shape, vertices, step)
    quad = np.where(_first_diagonal(vertices[quad], step)[:, None], quad, np.roll(quad, -1, axis=1))
    return Part.of(vertices, np.vstack([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]), material, crease)


def _join_diagonals(value: np.ndarray, depth: float) -> None:
    """Put corners inside, in place, until no square of the grid is inside at one diagonal only.

    There two sheets of the surface would share an edge, and four faces would meet in it.
    """
    again = True
    while again:
        again = False
        for axis in range(3):
            flat = np.moveaxis(value, axis, -1)  # a view: squares lie in the first two axes
            a, b, c, d = flat[:-1, :-1], flat[1:, :-1], flat[1:, 1:], flat[:-1, 1:]
            for inner, outer in (((a, c), (b, d)), ((b, d), (a, c))):
                crossed = (inner[0] < 0) & (inner[1] < 0) & (outer[0] >= 0) & (outer[1] >= 0)
                if crossed.any():
                    nearer = crossed & (outer[0] <= outer[1])
                    outer[0][nearer] = -depth
                    outer[1][crossed & ~nearer] = -depth
                    again = True


def _first_diagonal(corners: np.ndarray, step: float) -> np.ndarray:
    """Whether each of (Q, 4, 3) is better cut along its first diagonal: the shorter one.

    Between equals the one that bulges, so that symmetric shapes get symmetric surfaces.
    """
    a, b, c, d = np.moveaxis(corners, 1, 0)
    longer = np.linalg.norm(c - a, axis=1) - np.linalg.norm(d - b, axis=1)
    bulge = (np.cross(b - a, c - a) * (d - a)).sum(1)
    return np.where(np.abs(longer) < 1e-6 * step, bulge < 0, longer < 0)


def _back(points: np.ndarray, axis: int) -> np.ndarray:
    """Coordinates whose `axis` was moved to the front, in the order x, y, z again."""
    order = {0: [0, 1, 2], 1: [1, 0, 2], 2: [1, 2, 0]}[axis]
    return points[:, order]


def _drawn_onto(shape: Shape, vertices: np.ndarray, step: float) -> np.ndarray:
    """A Newton step along the gradient, of at most a quarter of a cell."""
    near = 0.05 * step
    value = shape(vertices)
    gradient = np.stack(
        [shape(vertices + near * axis) - shape(vertices - near * axis) for axis in np.eye(3)], -1
    )
    gradient /= 2 * near
    slope = np.maximum((gradient**2).sum(1), 0.05)
    move = -(value / slope)[:, None] * gradient
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return vertices + move * np.minimum(1, step / 4 / np.maximum(length, 1e-12))


def radial(
    shape: Shape,
    centre: Point,
    directions: np.ndarray,
    faces: np.ndarray,
    reach: float,
    material: Material,
) -> Part:
    """The surface of a shape as seen from a point within: a sphere of directions, drawn out.

    Args:
        shape: every ray from `centre` should leave it once; where one leaves it several times, the
            outermost counts.
        centre: (3,) inside.
        directions: (V, 3) unit vectors, denser where more detail is wanted.
        faces: (F, 3) of the sphere that they form.
        reach: metres, beyond the shape in every direction.
        material: of the whole.

    Raises:
        ValueError: if `centre` is not inside, or the shape reaches farther than `reach`.
    """
    middle = np.asarray(centre, np.float64)
    radii = np.linspace(0, reach, 25)
    value = shape(middle + radii[:, None, None] * directions)
    inside = value < 0
    if not inside[0].all() or inside[-1].any():
        fail("centre", "a point inside a shape that ends within reach", list(centre))
    last = len(radii) - 1 - np.argmax(inside[::-1], axis=0)
    low, high = radii[last], radii[last + 1]
    for _ in range(8):
        half = (low + high) / 2
        within = shape(middle + half[:, None] * directions) < 0
        low, high = np.where(within, half, low), np.where(within, high, half)
    return Part.of(middle + ((low + high) / 2)[:, None] * directions, faces, material)
