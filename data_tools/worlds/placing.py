"""How things come to lie on a table: poses in which they rest, and places where none is in another.

The table is the plane z = 0. A convex hull is described by its extents in `DIRECTIONS`: how far it
reaches in each. Two hulls are apart if they are apart in one of these directions (the theorem of
the separating axis; with some directions only, a little more apart than they need to be).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from data_tools.shapes.mesh import Mesh
from posecore.arrays import fail

__all__ = ["DIRECTIONS", "Resting", "distance_apart", "extents", "look_at", "slide_in", "turn_z"]

NEAR = 0.0005  # metres; what is that close to the table holds an object up
MARGIN = 0.003  # metres by which the centre of mass is within what holds the object up
TYPICAL = 0.015  # metres by which a pose's centre of mass may well be higher than the lowest
GROUPS = {"upright": 0.62, "lying": 0.3, "upside down": 0.08}  # how often


def _directions() -> np.ndarray:
    """(D, 3) unit vectors: 40 around the vertical, on each of five levels, opposite ones too."""
    around = 2 * np.pi * np.arange(40) / 40
    levels = np.deg2rad([-50, -25, 0, 25, 50])[:, None]
    x, y = np.cos(levels) * np.cos(around), np.cos(levels) * np.sin(around)
    return np.stack(np.broadcast_arrays(x, y, np.sin(levels)), -1).reshape(-1, 3)


DIRECTIONS = _directions()
_OPPOSITE = np.array([np.argmin(DIRECTIONS @ direction) for direction in DIRECTIONS])


class Resting:
    """The ways in which an object stays as it is put on a table.

    It rests on a face of its convex hull, with the centre of mass (of the hull) above what holds it
    up, and not too near to its border. The lower the centre is, the more often it is found so.

    Args:
        mesh: the object.
        up: (3,) what is up in its frame.

    Attributes:
        hull: (V, 3) the corners of its convex hull.
        poses: by "upright", "lying" and "upside down" the rotations (P, 3, 3) of the object, and
            how likely each is (P,).

    Raises:
        ValueError: if there is no way.
    """

    def __init__(self, mesh: Mesh, up: Sequence[float] = (0, 0, 1)) -> None:
        hull = ConvexHull(mesh.vertices)
        self.hull = mesh.vertices[hull.vertices]
        centre = _centre_of_mass(mesh.vertices, hull)
        found: dict[str, list[tuple[np.ndarray, float]]] = {}
        downs = hull.equations[:, :3]
        for face in np.flatnonzero(_are_under(mesh.vertices[hull.simplices], downs, centre)):
            down = downs[face]
            R, margin = _turned_down(down), _margin(self.hull, down, centre)
            height = float(-hull.equations[face, 3] - centre @ down)
            cosine = R[2] @ up
            group = "upright" if cosine > 0.9 else "lying" if cosine > -0.9 else "upside down"
            # Hardly anybody puts a bottle on its cap, although it would stand.
            if margin >= (max(MARGIN, height / 4) if group == "upside down" else MARGIN):
                found.setdefault(group, []).append((R, height))
        self.poses = {}
        for group in sorted(found):
            heights = np.array([height for _, height in found[group]])
            shares = np.exp((heights.min() - heights) / TYPICAL)
            self.poses[group] = np.array([R for R, _ in found[group]]), shares / shares.sum()
        if not self.poses:
            fail("mesh", "an object that stays as it is put", mesh.name)

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, float]:
        """A rotation (3, 3), turned about the vertical at random, and the height of the origin."""
        shares = np.array([GROUPS[group] for group in self.poses])
        choice = rng.choice(len(shares), p=shares / shares.sum())
        rotations, shares = list(self.poses.values())[choice]
        R = turn_z(rng.uniform(0, 2 * np.pi)) @ rotations[rng.choice(len(shares), p=shares)]
        return R, float(-(self.hull @ R[2]).min())


def extents(hull: np.ndarray, R: np.ndarray) -> np.ndarray:
    """(D,) how far a turned hull (V, 3) reaches in each of `DIRECTIONS`, metres."""
    return (hull @ (DIRECTIONS @ R).T).max(0)


def distance_apart(one: np.ndarray, other: np.ndarray, shift: np.ndarray) -> float:
    """By how much two hulls are apart at least; negative where they may overlap.

    Args:
        one, other: (D,) their extents.
        shift: (3,) from the origin of the one to the origin of the other.
    """
    return float((DIRECTIONS @ shift - one - other[_OPPOSITE]).max())


def slide_in(
    extent: np.ndarray,
    height: float,
    others: Sequence[tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    direction: np.ndarray,
    gap: float,
) -> np.ndarray:
    """The place nearest to the start where an object is clear of all others.

    Args:
        extent: (D,) of the object.
        height: of its origin, metres.
        others: extents and places (3,) of those that are there already.
        start: (2,) metres.
        direction: (2,) in which it may go from there, a unit vector.
        gap: metres that stay free around it.

    Returns:
        (3,) its place.
    """
    step = DIRECTIONS[:, :2] @ direction
    blocked = []
    for other, place in others:
        at_start = DIRECTIONS @ ([*start, height] - place) - other - extent[_OPPOSITE] - gap
        # It is in the way where at_start + r * step < 0 in all directions.
        with np.errstate(divide="ignore", invalid="ignore"):
            r = -at_start / step
        if (at_start[np.abs(step) < 1e-9] >= 0).any():
            continue
        low = max(r[step < -1e-9])
        high = min(r[step > 1e-9])
        if low < high:
            blocked.append((low, high))
    r = 0.0
    for low, high in sorted(blocked):
        if low < r + 1e-12 < high:
            r = high
    return np.array([*(start + r * direction), height])


def look_at(camera: np.ndarray, target: np.ndarray, roll: float) -> tuple[np.ndarray, np.ndarray]:
    """The pose (R, t) from the world, with z up, to a camera that looks at a target.

    Args:
        camera, target: (3,) metres, not above each other.
        roll: radians by which the camera is turned about its axis.
    """
    z = (target - camera) / np.linalg.norm(target - camera)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    R = turn_z(roll) @ np.stack([x, np.cross(z, x), z])
    return R, -R @ camera


def turn_z(angle: float) -> np.ndarray:
    """The rotation (3, 3) about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _centre_of_mass(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """Of the solid hull: of tetrahedra from a point within to the faces, which do not overlap."""
    inside = points[hull.vertices].mean(0)
    a, b, c = (points[hull.simplices] - inside).swapaxes(0, 1)
    volume = np.abs(np.einsum("fi,fi->f", a, np.cross(b, c)))
    return inside + (volume[:, None] * (a + b + c)).sum(0) / (4 * volume.sum())


def _are_under(faces: np.ndarray, downs: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(F,) bool, whether a point is above a face (3, 3) when its `down` is down."""
    ahead = np.roll(faces, -1, axis=1)
    sides = np.einsum("fki,fi->fk", np.cross(ahead - faces, centre - faces), downs)
    return (sides.min(1) >= 0) | (sides.max(1) <= 0)


def _margin(hull: np.ndarray, down: np.ndarray, centre: np.ndarray) -> float:
    """How far the centre of mass is within what holds the object up; negative outside of it."""
    R = _turned_down(down)
    points = hull @ R.T
    held = points[points[:, 2] < points[:, 2].min() + NEAR, :2]
    if len(held) < 3 or np.linalg.matrix_rank(held - held[0], 1e-6) < 2:
        return -np.inf
    equations = ConvexHull(held).equations
    return float(-(equations[:, :2] @ (R @ centre)[:2] + equations[:, 2]).max())


def _turned_down(down: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) that turns a direction into -z."""
    x = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-down, x), -down])
