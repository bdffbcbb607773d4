"""What is in an image of the tabletop world: objects, table, wall, lamps and camera."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_tools.renderer import Light, PreparedMesh, prepare
from data_tools.shapes import CATEGORIES, NAMES, Material, Mesh, make_category, make_floor
from data_tools.shapes import make_object as make_mesh
from data_tools.textures import PATTERNS
from data_tools.worlds.placing import (
    Resting,
    distance_apart,
    extents,
    look_at,
    slide_in,
    turn_z,
)

__all__ = ["IDS", "LINEMOD", "Scene", "draw_floating", "draw_table", "make_object", "prepared"]

IDS = tuple(range(1, len(NAMES) + 1))
# LINEMOD's camera, in images of 640 x 480 pixels.
LINEMOD = np.array([[572.4114, 0, 325.2611], [0, 573.5704, 242.0490], [0, 0, 1]])
LOW = np.deg2rad(10)  # as deep as a camera goes
NEAREST, FARTHEST = (0.45, 0.85), 1.0  # metres from the camera to the middle of the objects
CLEAR = 0.12  # metres between the camera and anything
OTHERS = tuple(name for name in CATEGORIES if name != "laptop")  # that would hide everything

Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in an image; x and y lie in the table and z is up.

    Attributes:
        ids: of the labelled objects, which are the first of the things.
        things: all that is drawn.
        poses: of the things, from their frame to the world.
        casters: how many of the things throw shadows, the first ones.
        camera: the pose from the world to the camera.
        lights: in the world.
        ambient: red, green and blue of the light from above and from below.
    """

    ids: list[int]
    things: list[PreparedMesh]
    poses: list[Pose]
    casters: int
    camera: Pose
    lights: list[Light]
    ambient: tuple[np.ndarray, np.ndarray]


def draw_table(rng: np.random.Generator, packed: bool, tests: bool) -> Scene:
    """Objects that stand and lie on a table before a wall.

    Args:
        rng: the random numbers.
        packed: whether they are many, close together, and seen from low down.
        tests: whether tables and unlabelled things are those of the tests.
    """
    count = rng.integers(6, 9) if packed else rng.integers(3, 6)
    ids = rng.permutation(IDS)[:count].tolist()
    others = _others(rng, tests, rng.integers(2, 5) if packed else rng.integers(3))
    ways = [*map(_resting, ids), *(resting for _, resting in others)]
    azimuth = rng.uniform(0, 2 * np.pi)
    poses = _placed(rng, ways, count, azimuth, packed)
    corners = [way.hull @ R.T + t for way, (R, t) in zip(ways, poses, strict=True)]
    camera, centre = _camera(rng, corners, count, azimuth, packed)
    outward = azimuth + np.pi + rng.uniform(-0.5, 0.5)
    reach = (np.concatenate(corners)[:, :2] @ [np.cos(outward), np.sin(outward)]).max()
    table = turn_z(rng.uniform(0, 2 * np.pi)), np.zeros(3)
    surfaces = [table, _wall(outward, reach + rng.uniform(0.3, 1.5))]
    seeds = rng.integers(600, size=2) + 600 * tests
    floors = [prepare(make_floor(int(seed), 8.0)) for seed in seeds]
    lights, ambient = _lights(rng, centre)
    things = [*map(prepared, ids), *(thing for thing, _ in others), *floors]
    return Scene(ids, things, poses + surfaces, len(poses), camera, lights, ambient)


def _placed(
    rng: np.random.Generator, ways: Sequence[Resting], count: int, azimuth: float, packed: bool
) -> list[Pose]:
    """Poses of things on the table, the ones that come first in the middle.

    The first `count` are the objects; other things are on the side of the camera if all are packed.
    """
    placed: list[tuple[np.ndarray, np.ndarray]] = []
    poses = []
    for number, way in enumerate(ways):
        R, height = way.draw(rng)
        angle = rng.uniform(0, 2 * np.pi)
        if packed and number >= count:
            angle = azimuth + rng.normal(0, 0.5)
        direction = np.array([np.cos(angle), np.sin(angle)])
        gap = rng.uniform(0.001, 0.006) if packed else rng.uniform(0.01, 0.06)
        extent = extents(way.hull, R)
        place = slide_in(extent, height, placed, rng.normal(0, 0.02, 2), direction, gap)
        placed.append((extent, place))
        poses.append((R, place))
    return poses


def _camera(
    rng: np.random.Generator,
    corners: list[np.ndarray],
    count: int,
    azimuth: float,
    packed: bool,
) -> tuple[Pose, np.ndarray]:
    """A camera on a hemisphere around the middle of the objects, and that middle.

    It stands back until it sees all of the objects and nothing is in its face.
    """
    objects, everything = np.concatenate(corners[:count]), np.concatenate(corners)
    centre = (objects.min(0) + objects.max(0)) / 2
    elevation = rng.uniform(LOW, 0.52) if packed else rng.uniform(0.5, 1.25)
    flat = np.cos(elevation)
    ray = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    target = centre + rng.normal(0, [0.02, 0.02, 0.01])
    roll = np.clip(rng.normal(0, 0.12), -0.35, 0.35)
    for distance in np.arange(rng.uniform(*NEAREST), FARTHEST, 0.03):
        place = target + distance * ray
        camera = look_at(place, target, roll)
        clear = np.linalg.norm(everything - place, axis=1).min() > CLEAR
        if clear and _in_image(objects, *camera):
            break
    return camera, centre


def _in_image(points: np.ndarray, R: np.ndarray, t: np.ndarray) -> bool:
    """Whether a camera sees all points."""
    x, y, z = LINEMOD @ (points @ R.T + t).T
    return bool((z > 0).all() and (abs(x / z - 320) < 316).all() and (abs(y / z - 240) < 236).all())


def draw_floating(rng: np.random.Generator, count: int) -> Scene:
    """Objects anywhere before the camera, turned as if they stood on tables, before a backdrop.

    Args:
        rng: the random numbers.
        count: how many objects there are; few may be left out where there is no room.
    """
    ids = rng.permutation(IDS)[:count].tolist()
    things = [(prepared(i), _resting(i)) for i in ids] + _others(rng, False, rng.integers(4))
    camera = look_at(np.array([0.0, -1, 0]), np.zeros(3), 0)
    kept: list[int] = []
    poses: list[Pose] = []
    placed: list[tuple[np.ndarray, np.ndarray]] = []
    for number, (_, way) in enumerate(things):
        near, far = (0.45, FARTHEST) if number < count else (0.7, 1.2)
        for _ in range(40):
            spread = 0.5 if count == 1 and number == 0 else 0.8
            R, place = _before_camera(rng, way, *camera, rng.uniform(near, far), spread)
            extent = extents(way.hull, R)
            if all(distance_apart(other, extent, place - t) > 0.005 for other, t in placed):
                kept.append(number)
                placed.append((extent, place))
                poses.append((R, place))
                break
    ids = [ids[number] for number in kept if number < count]
    backdrop, pose = _backdrop(rng)
    drawn = [things[number][0] for number in kept] + [backdrop]
    lights, ambient = _lights(rng, np.zeros(3))
    return Scene(ids, drawn, [*poses, pose], len(poses), camera, lights, ambient)


def _before_camera(
    rng: np.random.Generator,
    way: Resting,
    R: np.ndarray,
    t: np.ndarray,
    depth: float,
    spread: float,
) -> Pose:
    """A pose at a depth before the camera (R, t), in the middle `spread` of the image."""
    pixel = [320, 240] + spread * rng.uniform(-1, 1, 2) * [320, 240]
    place = R.T @ (depth * np.linalg.inv(LINEMOD) @ [*pixel, 1] - t)
    tilt = np.arcsin(rng.uniform(np.sin(LOW), np.sin(1.4)))
    camera = np.array([0, -np.cos(tilt), np.sin(tilt)])
    seen, _ = look_at(camera, np.zeros(3), rng.normal(0, 0.25))
    return R.T @ seen @ way.draw(rng)[0], place


def _backdrop(rng: np.random.Generator) -> tuple[PreparedMesh, tuple[np.ndarray, np.ndarray]]:
    """A tilted wall behind all things, of patches of any shape, pattern and colour.

    So much is in it that the objects are not just what differs from the ground.
    """
    count = rng.integers(8, 40)
    outlines = [4 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)]
    outlines += [_patch(rng) + [0, 0, 0.04 * (k + 1) / count] for k in range(count)]
    sides = [len(outline) for outline in outlines]
    first = np.cumsum([0, *sides[:-1]])
    fans = [
        start + np.array([(0, k, k + 1) for k in range(1, n - 1)])
        for n, start in zip(sides, first, strict=True)
    ]
    faces = np.concatenate(fans)
    mesh = Mesh(
        name="backdrop",
        vertices=np.concatenate(outlines),
        faces=faces.astype(np.int32),
        corner_normals=np.broadcast_to(np.float32([0, 0, 1]), (len(faces), 3, 3)).copy(),
        material=np.repeat(np.arange(count + 1), [n - 2 for n in sides]).astype(np.int16),
        materials=tuple(_paper(rng, outline.mean(0)) for outline in outlines),
        closed=np.zeros(len(faces), bool),
    )
    R, t = _wall(np.pi / 2 + rng.uniform(-0.5, 0.5), rng.uniform(0.9, 1.5))
    return prepare(mesh), (R @ turn_z(rng.uniform(0, 2 * np.pi)), t)


def _patch(rng: np.random.Generator) -> np.ndarray:
    """(N, 3) corners of a flat patch: three to twelve on an ellipse."""
    count = int(rng.choice([3, 4, 4, 4, 5, 6, 12]))
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
    radii = np.exp(rng.uniform(np.log(0.08), np.log(0.6), 2))
    corners = radii * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    flat = np.column_stack([corners, np.zeros(count)]) @ turn_z(rng.uniform(0, 2 * np.pi)).T
    return flat + [*rng.uniform(-1.1, 1.1, 2), 0]


def _paper(rng: np.random.Generator, centre: np.ndarray) -> Material:
    """Any pattern in any two colours; pictures lie in the middle."""
    pattern = str(rng.choice(list(PATTERNS)))
    grey = rng.uniform(0.03, 0.9, 2)[:, None]
    first, second = np.clip(grey * rng.uniform(0.2, 1.8, (2, 3)), 0, 1).tolist()
    scale = float(np.exp(rng.uniform(np.log(1), np.log(16))))
    R = turn_z(rng.uniform(0, 2 * np.pi))
    middle = np.array([0.5, 0.5, 0]) / scale - R @ centre
    return Material(
        tuple(first),
        tuple(second),
        pattern,
        scale,
        specular=rng.uniform(0, 0.1),
        infrared=rng.uniform(0.2, 0.8),
        seed=int(rng.integers(100)),
        place=tuple(np.column_stack([R, middle]).ravel().tolist()),
    )


def _wall(azimuth: float, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """The pose that puts a floor up as a wall, which looks at the world's origin."""
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    R = np.stack([np.cross([0, 0, 1], -outward), [0, 0, 1], -outward], axis=1)
    return R, distance * outward


def _lights(
    rng: np.random.Generator, centre: np.ndarray
) -> tuple[list[Light], tuple[np.ndarray, np.ndarray]]:
    """A lamp with shadows, a weaker one without, and light from all around."""
    warmth = rng.uniform(-1, 1)
    colour = np.array([1 + 0.16 * warmth, 1, 1 - 0.2 * warmth])
    lights = []
    for power, radius in ((rng.uniform(0.5, 1.0), rng.uniform(0.03, 0.14)), (0.25, 0)):
        azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.9, 1.8)
        away = height * rng.uniform(0.2, 0.9)
        shift = np.array([away * np.cos(azimuth), away * np.sin(azimuth), height])
        # As bright on the table however far the lamp is.
        lights.append(
            Light(centre + shift, power * (shift @ shift) * colour, radius, shadows=radius > 0)
        )
    grey = rng.uniform(0.18, 0.4)
    return lights, (grey * np.array([0.95, 1, 1.08]), 0.45 * grey * np.array([1.05, 1, 0.93]))


def _others(
    rng: np.random.Generator, tests: bool, count: int
) -> list[tuple[PreparedMesh, Resting]]:
    """Things that are in the way, and of which nothing is known; tests have their own."""
    names, seeds = rng.permutation(OTHERS)[:count], rng.integers(4, size=count) + 4 * tests
    return [_other(str(name), int(seed)) for name, seed in zip(names, seeds, strict=True)]


@functools.cache
def _other(category: str, seed: int) -> tuple[PreparedMesh, Resting]:
    mesh = make_category(category, 900 + seed)
    return prepare(mesh), Resting(mesh, up=(0, 1, 0))


@functools.cache
def make_object(object_id: int) -> Mesh:
    """One of the eight objects, made once."""
    return make_mesh(object_id)


@functools.cache
def prepared(object_id: int) -> PreparedMesh:
    """One of the eight objects, ready to be drawn."""
    return prepare(make_object(object_id))


@functools.cache
def _resting(object_id: int) -> Resting:
    return Resting(make_object(object_id))
