"""An object's diameter, box and symmetries from its mesh; stated symmetries are put to the test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.bop.models import ModelInfo
from data_tools.bop.surfaces import Surface
from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.clouds import diameter

__all__ = ["TOLERANCE", "Measured", "Symmetry", "SymmetryCheck", "measure_model"]

TOLERANCE = 0.1
"""Share of the diameter by which a symmetry may move the surface.

As candidates for symmetries, BOP takes motions up to a Hausdorff distance of max(15 mm, 0.1 d) of
the vertices; which of them count is decided by looking (Hodan et al., BOP Challenge 2020).
"""
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
STATED = re.compile(r"(?P<axis>[^:@]+):(?P<fold>[^:@]+)(@(?P<offset>[^:@]+))?")
CONTINUOUS = "continuous"
MOST_FOLDS = 120
MOST_MOTIONS = 2 * MOST_FOLDS  # of all discrete symmetries together; the regular solids have 60
# A part of a turn that no polygon has: else a prism with as many sides would pass for round.
TURN = 2 * np.pi * (3 - np.sqrt(5)) / 2
TURNS = 8  # that are tried, of a continuous symmetry and of discrete ones with more motions
SAME = 1e-6  # by which the entries of two motions may differ, lengths as shares of the diameter


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Rotations about one axis that leave an object as it is.

    Attributes:
        axis: (3,) direction; it is brought to length 1.
        fold: into how many equal parts they divide the turn, at least 2; None for any angle.
        offset: (3,) a point on the axis, metres.

    Raises:
        ValueError: naming the attribute that cannot be.
    """

    axis: Sequence[float]
    fold: int | None
    offset: Sequence[float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        vectors = {}
        for name in ("axis", "offset"):
            vectors[name] = to_numbers(name, getattr(self, name))
            if vectors[name].shape != (3,) or not np.isfinite(vectors[name]).all():
                fail(name, "three finite numbers", repr(getattr(self, name)))
        largest = np.abs(vectors["axis"]).max()
        if largest == 0:
            fail("axis", "a direction, not all 0", vectors["axis"].tolist())
        vectors["axis"] = vectors["axis"] / largest
        vectors["axis"] /= np.linalg.norm(vectors["axis"])
        if self.fold is not None:
            require_integer("fold", self.fold, 2, MOST_FOLDS)
        for name, vector in vectors.items():
            object.__setattr__(self, name, vector)

    @classmethod
    def parse(cls, text: str, unit: float = 0.001) -> Symmetry:
        """Read `AXIS:FOLD` or `AXIS:FOLD@X,Y,Z`, such as z:4, x:continuous or 1,1,0:2@0,0,12.5.

        Args:
            text: AXIS is x, y, z or three numbers, FOLD a whole number or "continuous", and X,Y,Z a
                point on the axis, the origin if there is none.
            unit: metres of a unit of that point.

        Raises:
            ValueError: for other texts.
        """
        found = STATED.fullmatch(text)
        if not found:
            fail(
                "symmetry",
                "AXIS:FOLD or AXIS:FOLD@X,Y,Z, such as z:4, z:continuous or 1,1,0:2@0,0,12.5",
                repr(text),
            )
        axis = AXES.get(found["axis"].lower()) or _three("axis", found["axis"])
        offset = np.zeros(3) if found["offset"] is None else _three("offset", found["offset"])
        fold = None
        if found["fold"].lower() != CONTINUOUS:
            if not re.fullmatch("[0-9]{1,9}", found["fold"]):
                fail("fold", 'a whole number of at least 2, or "continuous"', repr(found["fold"]))
            fold = int(found["fold"])
        return cls(axis, fold, np.multiply(offset, unit))

    def motions(self) -> np.ndarray:
        """The rotations but for the identity, (fold - 1, 4, 4); of any angle, some of them."""
        parts = np.arange(1, self.fold or TURNS + 1)
        return self.turned(parts * (2 * np.pi / self.fold if self.fold else TURN))

    def turned(self, angles: np.ndarray) -> np.ndarray:
        """The rotations by some angles (A,) in radians, (A, 4, 4)."""
        T = np.tile(np.eye(4), (len(angles), 1, 1))
        T[:, :3, :3] = Rotation.from_rotvec(np.multiply.outer(angles, self.axis)).as_matrix()
        T[:, :3, 3] = self.offset - T[:, :3, :3] @ self.offset
        return T


@dataclass(frozen=True)
class SymmetryCheck:
    """How well one symmetry fits a mesh.

    Attributes:
        largest, mean: how far points of the surface are from it once they are moved, as shares of
            the diameter.
    """

    largest: float
    mean: float


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of a mesh.

    Attributes:
        info: its diameter, box and symmetries.
        checks: of each stated symmetry; after them, if there are motions that only several together
            make, of those.
    """

    info: ModelInfo
    checks: tuple[SymmetryCheck, ...]


def measure_model(
    mesh: trimesh.Trimesh, symmetries: Sequence[Symmetry] = (), tolerance: float = TOLERANCE
) -> Measured:
    """What `models_info.json` says of an object, from its mesh and its stated symmetries.

    Diameter and box are those of the vertices, as in BOP. Whether an object is symmetric is for its
    owner to say, as its picture counts too, and its use. Each symmetry is put to the test: the
    surface is moved by it, and no point may then be farther from the surface than the tolerance.
    All discrete ones and what they make together are listed, but for turns about an axis of a
    continuous one.

    Args:
        mesh: in metres.
        symmetries: as stated.
        tolerance: share of the diameter, above 0.

    Returns:
        What was measured.

    Raises:
        ValueError: if a symmetry moves the surface farther, discrete ones make no finite group, or
            the mesh has no extent.
    """
    tolerance = require_number("tolerance", tolerance, above=0)
    vertices = np.asarray(mesh.vertices, np.float64)
    extent = float(diameter(vertices))
    if extent == 0:
        fail("mesh", "points that differ", f"{len(vertices)} at one place")
    minimum, size = vertices.min(0), np.ptp(vertices, 0)
    group = _group([one for one in symmetries if one.fold is not None], extent)
    surface = Surface(mesh) if symmetries else None
    checks = []
    for number, one in enumerate(symmetries):
        checks.append(_check(surface, one.motions(), extent))
        if checks[-1].largest > tolerance:
            _refuse(f"symmetries[{number}]", checks[-1], tolerance)
    stated = [T for one in symmetries for T in one.motions() if one.fold is not None]
    together = [T for T in group if not _is_among(T, stated, extent)]
    if together:
        checks.append(_check(surface, np.array(together), extent))
        if checks[-1].largest > tolerance:
            _refuse("symmetries", checks[-1], tolerance)
    axes = _different_axes([one for one in symmetries if one.fold is None], extent)
    kept = [np.eye(4)]
    for T in group:
        # Two motions differ by a turn if one, and then the other undone, leave the axis alone.
        apart = [np.linalg.inv(K) @ T for K in kept]
        if not any(_is_turn(one, motion, extent) for one in axes for motion in apart):
            kept.append(T)
    info = ModelInfo(
        extent,
        minimum,
        size,
        np.reshape(kept[1:], (-1, 4, 4)).round(15) + 0.0,  # no -0.0 and 1e-17 to read
        tuple((one.axis, one.offset) for one in axes),
    )
    info.symmetries()  # refused if they are too many together
    return Measured(info, tuple(checks))


def _three(name: str, text: str) -> np.ndarray:
    words = text.split(",")
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.array([])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        fail(name, "x, y, z or three numbers" if name == "axis" else "three numbers", repr(text))
    return numbers


def _group(symmetries: Sequence[Symmetry], extent: float) -> list[np.ndarray]:
    """All motions that discrete symmetries make together, without the identity."""
    generators = [one.turned(np.array([2 * np.pi / one.fold]))[0] for one in symmetries]
    found, fresh = [np.eye(4)], [np.eye(4)]
    while fresh:
        products = np.reshape([G @ T for T in fresh for G in generators], (-1, 4, 4))
        if len(products):  # roundings are not to add up
            products[:, :3, :3] = Rotation.from_matrix(products[:, :3, :3]).as_matrix()
        fresh = []
        for T in products:
            if not _is_among(T, found, extent):
                found.append(T)
                fresh.append(T)
        if len(found) > MOST_MOTIONS:
            fail(
                "symmetries",
                "discrete symmetries that together are finitely many",
                f"more than {MOST_MOTIONS}: do their axes meet, and at the right angles?",
            )
    return found[1:]


def _check(surface: Surface, motions: np.ndarray, extent: float) -> SymmetryCheck:
    # The first is by the smallest angle, and half of them undo the others.
    tried = motions[np.unique(np.linspace(0, len(motions) - 1, TURNS).astype(int))]
    moved = [surface.points @ T[:3, :3].T + T[:3, 3] for T in tried]
    largest, mean = np.max([surface.gap(points) for points in moved], axis=0) / extent
    return SymmetryCheck(float(largest), float(mean))


def _refuse(name: str, check: SymmetryCheck, tolerance: float) -> None:
    fail(
        name,
        f"motions that leave the surface where it is to {100 * tolerance:.3g} % of the diameter",
        f"points up to {100 * check.largest:.3g} % away from it, on average {100 * check.mean:.2g}",
    )


def _is_among(T: np.ndarray, others: Sequence[np.ndarray], extent: float) -> bool:
    gaps = np.abs(np.reshape(others, (-1, 4, 4)) - T)[:, :3] / [1, 1, 1, extent]
    return bool((gaps.max((1, 2)) < SAME).any())


def _is_turn(one: Symmetry, motion: np.ndarray, extent: float) -> bool:
    """Whether a motion turns about the axis of a symmetry: it leaves the axis where it is."""
    R, t = motion[:3, :3], motion[:3, 3]
    shift = R @ one.offset + t - one.offset
    return bool(
        np.abs(R @ one.axis - one.axis).max() < SAME and np.abs(shift).max() < SAME * extent
    )


def _different_axes(symmetries: Sequence[Symmetry], extent: float) -> list[Symmetry]:
    kept: list[Symmetry] = []
    for one in symmetries:
        quarter = one.turned(np.array([np.pi / 2]))[0]
        if not any(_is_turn(other, quarter, extent) for other in kept):
            kept.append(one)
    return kept
