"""The record of a procedural object: a mesh, what it is made of, and how it is symmetric."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from posecore.arrays import fail, require_integer, require_number

__all__ = ["Material", "Mesh"]

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """What a surface looks like; colours and shares are linear, from 0 to 1.

    Attributes:
        colour: red, green and blue albedo.
        second: the other colour of a pattern.
        pattern: the name of a pattern in `data_tools.textures`, "" for plain colour.
        scale: of the pattern, repeats per unit of its coordinates (metres, unless `place` scales).
        specular: strength of the highlight, 0 for matt.
        shininess: exponent of the highlight; larger is smaller and sharper.
        infrared: albedo for near infrared light, which skin, cloth and lenses return differently.
        second_infrared: of the pattern's other colour; None is the same, as inks and dyes that are
            bright in one light and dark in another often vanish in infrared.
        seed: which variant of a pattern that has variants, such as the words on a label.
        place: 3 x 4, row after row: the affine map from the object's coordinates to the pattern's.

    Raises:
        ValueError: naming the attribute that does not fit this description.
    """

    colour: Colour
    second: Colour = (0.0, 0.0, 0.0)
    pattern: str = ""
    scale: float = 1.0
    specular: float = 0.0
    shininess: float = 20.0
    infrared: float = 0.5
    second_infrared: float | None = None
    seed: int = 0
    place: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("colour", "second"):
            if len(getattr(self, name)) != 3:
                fail(name, "red, green and blue", repr(getattr(self, name)))
            for share in getattr(self, name):
                require_number(name, share, 0, 1)
        for name in ("specular", "infrared"):
            require_number(name, getattr(self, name), 0, 1)
        if self.second_infrared is not None:
            require_number("second_infrared", self.second_infrared, 0, 1)
        for name in ("scale", "shininess"):
            require_number(name, getattr(self, name), above=0)
        require_integer("seed", self.seed, 0)
        if len(self.place) != 12 or not np.isfinite(self.place).all():
            fail("place", "12 finite numbers of a 3 x 4 map", repr(self.place))


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in metres, in its object's frame.

    Attributes:
        name: what it is.
        vertices: (V, 3) float64.
        faces: (F, 3) int32, counter-clockwise from outside.
        corner_normals: (F, 3, 3) float32 unit shading normals, one for each corner of each face,
            so that a crease stays sharp without a second mesh.
        material: (F,) int16 index into `materials`.
        materials: the materials.
        closed: (F,) bool, whether the face belongs to a watertight part, so that its back is never
            seen.
        symmetries: (S, 4, 4) motions that leave the object as it is, identity first; of an axis of
            revolution, its turns in equal steps.
        axis: (3,) the axis of revolution through the origin, None where there is none.

    Raises:
        ValueError: naming the attribute that does not fit this description.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    corner_normals: np.ndarray
    material: np.ndarray
    materials: tuple[Material, ...]
    closed: np.ndarray
    symmetries: np.ndarray = field(default_factory=lambda: np.eye(4)[None])
    axis: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.faces)
        for name, shape, kind in (
            ("vertices", (len(self.vertices), 3), np.float64),
            ("faces", (count, 3), np.int32),
            ("corner_normals", (count, 3, 3), np.float32),
            ("material", (count,), np.int16),
            ("closed", (count,), np.bool_),
            ("symmetries", (len(self.symmetries), 4, 4), np.float64),
        ):
            array = getattr(self, name)
            if array.shape != shape or array.dtype != kind:
                fail(name, f"{np.dtype(kind)} of shape {shape}", f"{array.dtype} {array.shape}")
        if not np.isfinite(self.vertices).all():
            fail("vertices", "finite metres", "others")
        if count and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            fail("faces", f"indices below {len(self.vertices)}", int(self.faces.max()))
        if count and not 0 <= self.material.min() <= self.material.max() < len(self.materials):
            fail("material", f"indices below {len(self.materials)}", int(self.material.max()))

    @cached_property
    def diameter(self) -> float:
        """The largest distance between two vertices, metres."""
        return float(pdist(self.vertices[ConvexHull(self.vertices).vertices]).max())

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) the smallest and the largest coordinates, metres."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @property
    def size(self) -> np.ndarray:
        """(3,) extent along the axes, metres."""
        return self.bounds[1] - self.bounds[0]
