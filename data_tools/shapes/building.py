"""Parts of an object, and their assembly into a `Mesh`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from data_tools.shapes.mesh import Colour, Material, Mesh
from posecore.arrays import fail, require_choice, require_integer, require_number, to_numbers

__all__ = [
    "CREASE",
    "Part",
    "around",
    "assemble",
    "on_plane",
    "paint",
    "random_paint",
    "turn",
    "turns",
]

CREASE = 0.7  # rad; a sharper edge than this is shaded as an edge


@dataclass(frozen=True, eq=False)
class Part:
    """One piece of an object.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) counter-clockwise from outside.
        material: (F,) index into `materials`.
        materials: what the piece is made of.
        crease: angle between faces (rad) above which their common edge is shaded sharp.
    """

    vertices: np.ndarray
    faces: np.ndarray
    material: np.ndarray
    materials: tuple[Material, ...]
    crease: float = CREASE

    @classmethod
    def of(
        cls, vertices: np.ndarray, faces: np.ndarray, material: Material, crease: float = CREASE
    ) -> Part:
        """A piece of one material, turned outside out if its volume is negative."""
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        if (np.cross(a, b) * c).sum() < 0:
            faces = faces[:, ::-1]
        return cls(vertices, faces, np.zeros(len(faces), np.int64), (material,), crease)

    def moved(self, rotation: np.ndarray | None = None, shift: Sequence[float] = (0, 0, 0)) -> Part:
        """The piece rotated, then shifted; its patterns move along."""
        R = np.eye(3) if rotation is None else rotation
        t = np.asarray(shift, np.float64)
        materials = tuple(_moved_material(material, R, t) for material in self.materials)
        return replace(self, vertices=self.vertices @ R.T + t, materials=materials)

    def bent(self, function: Callable[[np.ndarray], np.ndarray]) -> Part:
        """The piece with its vertices mapped by `function`, (V, 3) to (V, 3)."""
        return replace(self, vertices=function(self.vertices))

    @cached_property
    def closed(self) -> bool:
        """Whether no edge is open: it has as many faces on one side as on the other."""
        edges = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        count = len(self.vertices)
        forth, back = (np.sort(edges @ weights) for weights in ([count, 1], [1, count]))
        return bool(np.array_equal(forth, back))


def _moved_material(material: Material, R: np.ndarray, t: np.ndarray) -> Material:
    if material.pattern == "":
        return material  # which looks the same everywhere, so that parts share it
    place = np.reshape(material.place, (3, 4))
    linear = place[:, :3] @ R.T
    moved = np.column_stack([linear, place[:, 3] - linear @ t])
    return replace(material, place=tuple(moved.ravel().tolist()))


def paint(code: str) -> Colour:
    """Linear red, green and blue of an sRGB colour such as "#f2c61f" (IEC 61966-2-1).

    Raises:
        ValueError: if `code` is not a number sign and six hexadecimal digits.
    """
    try:
        if len(code) != 7 or code[0] != "#":
            raise ValueError
        values = np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    except ValueError:
        fail("code", "a colour such as '#f2c61f'", repr(code))
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return tuple(linear.tolist())


def random_paint(
    rng: np.random.Generator,
    saturation: tuple[float, float] = (0.3, 0.85),
    value: tuple[float, float] = (0.35, 0.9),
) -> Colour:
    """A linear colour of any hue, with sRGB saturation and value from the given ranges."""
    hue, s, v = rng.random(), rng.uniform(*saturation), rng.uniform(*value)
    wheel = np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1
    rgb = v * (1 + s * (np.clip(wheel, 0, 1) - 1))
    return paint("#" + "".join(f"{round(255 * share):02x}" for share in rgb))


def on_plane(
    material: Material, corner: Sequence[float], right: Sequence[float], up: Sequence[float]
) -> Material:
    """A material whose pattern's unit square lies at `corner`, with sides `right` and `up`.

    Raises:
        ValueError: if `right` and `up` are parallel.
    """
    r, u = np.asarray(right, np.float64), np.asarray(up, np.float64)
    out = np.cross(r, u)
    if not out.any():
        fail("right, up", "two different directions", f"{r.tolist()}, {u.tolist()}")
    linear = np.stack([r / (r @ r), u / (u @ u), out / np.linalg.norm(out)])
    place = np.column_stack([linear, -linear @ np.asarray(corner, np.float64)])
    return replace(material, place=tuple(place.ravel().tolist()))


def around(material: Material, low: float, high: float, facing: float = 0.0) -> Material:
    """A material whose pattern runs around z, 0 at height `low` and 1 at `high`.

    `facing` turns it about z, degrees.

    Raises:
        ValueError: if `high` is not above `low`.
    """
    require_number("high", high, above=low)
    c, s, rise = np.cos(np.radians(facing)), np.sin(np.radians(facing)), 1 / (high - low)
    place = (c, s, 0, 0, -s, c, 0, 0, 0, 0, rise, -low * rise)
    return replace(material, place=tuple(float(value) for value in place))


def turn(axis: str, degrees: float) -> np.ndarray:
    """(3, 3) rotation about "x", "y" or "z".

    Raises:
        ValueError: for another axis.
    """
    require_choice("axis", axis, ("x", "y", "z"))
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def turns(axis: Sequence[float], count: int) -> np.ndarray:
    """(count, 4, 4) rotations about an axis through the origin in equal steps, identity first.

    Raises:
        ValueError: if `count` is below 1, or the axis is no direction.
    """
    require_integer("count", count, 1)
    axis = to_numbers("axis", axis)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not axis.any():
        fail("axis", "a direction of shape (3,)", axis.tolist())
    axis = axis / np.linalg.norm(axis)
    angles = 2 * np.pi * np.arange(count) / count
    motions = np.tile(np.eye(4), (count, 1, 1))
    motions[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    motions[0] = np.eye(4)
    return motions


def assemble(
    name: str,
    parts: Sequence[Part],
    rotation: np.ndarray | None = None,
    centre: bool = True,
    symmetries: np.ndarray | None = None,
    axis: Sequence[float] | None = None,
) -> Mesh:
    """Parts as one mesh.

    Args:
        name: what it is.
        parts: at least one.
        rotation: (3, 3) from the frame of the parts to that of the object.
        centre: whether the origin is put into the middle of the bounding box.
        symmetries: (S, 4, 4) in the frame of the object, default the identity alone.
        axis: (3,) of revolution, in the frame of the object.

    Raises:
        ValueError: if there are no parts.
    """
    if not parts:
        fail("parts", "at least one", 0)
    parts = [part.moved(rotation) for part in parts]
    if centre:
        vertices = np.vstack([part.vertices for part in parts])
        middle = (vertices.min(0) + vertices.max(0)) / 2
        parts = [part.moved(shift=-middle) for part in parts]
    materials = tuple(dict.fromkeys(m for part in parts for m in part.materials))
    offset = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Mesh(
        name=name,
        vertices=np.vstack([part.vertices for part in parts]),
        faces=np.vstack([p.faces + o for p, o in zip(parts, offset, strict=False)]).astype(
            np.int32
        ),
        corner_normals=np.vstack([_corner_normals(part) for part in parts]).astype(np.float32),
        material=np.concatenate(
            [np.array([materials.index(m) for m in p.materials])[p.material] for p in parts]
        ).astype(np.int16),
        materials=materials,
        closed=np.concatenate([np.full(len(part.faces), part.closed) for part in parts]),
        symmetries=np.eye(4)[None] if symmetries is None else symmetries,
        axis=None if axis is None else np.asarray(axis, np.float64),
    )


def _corner_normals(part: Part) -> np.ndarray:
    """(F, 3, 3): at each corner the mean of the faces around its vertex that are not past a crease.

    Faces count by their area times the corner's angle, so that large flat faces stay flat.
    """
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = normal / np.maximum(area, 1e-20)
    edges = np.stack([b - a, c - b, a - c], 1)
    edges = edges / np.maximum(np.linalg.norm(edges, axis=2, keepdims=True), 1e-20)
    cosine = -(edges * np.roll(edges, 1, axis=1)).sum(-1)
    weight = (np.arccos(np.clip(cosine, -1, 1)) * area).ravel()

    vertex = part.faces.ravel()
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex, minlength=len(part.vertices))
    start = np.cumsum(count) - count
    # All pairs of corners that share a vertex.
    one = np.repeat(np.arange(len(vertex)), count[vertex])
    nth = np.arange(len(one)) - np.repeat(np.cumsum(count[vertex]) - count[vertex], count[vertex])
    other = order[start[vertex[one]] + nth]
    face = unit[other // 3]
    smooth = (unit[one // 3] * face).sum(1) > np.cos(part.crease)
    share = np.where(smooth, weight[other], 0)[:, None] * face
    total = np.stack([np.bincount(one, share[:, k], len(vertex)) for k in range(3)], -1)
    total = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)
    return total.reshape(-1, 3, 3)
