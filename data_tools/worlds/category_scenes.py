"""Scenes of the world of categories: what lies where, before which camera, in which light."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from data_tools.renderer import (
    Ambient,
    Labels,
    Light,
    PreparedMesh,
    material_images,
    prepare,
    render_colour,
)
from data_tools.sensors import depth_sensor, rgb_sensor
from data_tools.shapes import CATEGORIES, make_category, make_floor
from data_tools.shapes.building import turn
from data_tools.worlds.placing import Resting, extents, look_at, slide_in, turn_z
from data_tools.worlds.world import Recipe
from posecore.cameras import crop_and_resize_intrinsics, project
from posecore.poses import apply, compose, invert

__all__ = ["INSTANCES", "Scene", "draw_scene", "photographs"]

INSTANCES = {"train": range(48), "synthetic": range(48, 60), "shifted": range(60, 72)}
CAMERA = np.array([[577.5, 0, 319.5], [0, 577.5, 239.5], [0, 0, 1]])  # that of CAMERA25

Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Framing:
    """What a view shows.

    Attributes:
        objects: how many objects it is about, from and to.
        clutter: how many other things lie around them.
        margin: the width of the image over that of its objects.
    """

    objects: tuple[int, int]
    clutter: tuple[int, int]
    margin: tuple[float, float]


@dataclass(frozen=True)
class Look:
    """In what the splits differ besides their instances.

    Attributes:
        floors: remainders of a floor's seed by 6, which decide its kind.
        lamp: how bright the lamp is, from and to.
        tint: how far the colour of the light strays from white.
        height: of the lamp above the ground, degrees.
        shade: how bright the light from all around is.
        exposure: of the colour image.
        noise: factor on the noise of both cameras.
    """

    floors: tuple[int, ...]
    lamp: tuple[float, float]
    tint: float
    height: tuple[float, float]
    shade: tuple[float, float]
    exposure: tuple[float, float]
    noise: float


_CROP = Framing((1, 1), (0, 2), (1.15, 1.6))
_FRAMINGS = {"tiny": _CROP, "book": _CROP, "paper": Framing((3, 6), (0, 0), (1.1, 1.5))}
_STUDIO = Look((0, 3, 4), (0.7, 1.2), 0.06, (45, 80), (0.7, 1.3), (0.9, 1.1), 1.0)
_HOME = Look((1, 2, 5), (0.5, 2.0), 0.3, (20, 60), (0.25, 0.9), (0.65, 1.35), 2.2)
_LOOKS = {"train": _STUDIO, "synthetic": _STUDIO, "shifted": _HOME}


@dataclass(frozen=True, eq=False)
class Scene:
    """Things before a camera.

    Attributes:
        things: first the objects that the view is about, then clutter, floor and wall.
        poses: of the things in the camera's frame.
        which: category and instance of each of the objects.
        camera: its pose in the world, whose floor is the plane z = 0 below it.
        K: (3, 3) camera matrix.
        size: width and height of the image in pixels.
    """

    things: list[PreparedMesh]
    poses: list[Pose]
    which: list[tuple[str, int]]
    camera: Pose
    K: np.ndarray
    size: tuple[int, int]


def draw_scene(recipe: Recipe, index: int, rng: np.random.Generator) -> Scene:
    """A scene. Categories come in turns with the index, and so do the instances of each."""
    framing, look = _FRAMINGS[recipe["scale"]], _LOOKS[recipe["split"]]
    instances = INSTANCES[recipe["split"]]
    count = int(rng.integers(*framing.objects, endpoint=True))
    others = int(rng.integers(*framing.clutter, endpoint=True))
    which = [(CATEGORIES[index % 6], instances[index // 6 % len(instances)])]
    for _ in range(count + others - 1):
        which.append((str(rng.choice(CATEGORIES)), int(rng.choice(instances))))
    things = [_instance(*each) for each in which]
    placed = _placed(which, rng)
    about = np.mean([t for _, t in placed[:count]], axis=0)

    camera = _camera(about, rng)
    to_camera = invert(*camera)
    foot = about * [1, 1, 0]
    farthest = max(np.linalg.norm((t - about)[:2]) for _, t in placed)
    floor, wall = (_floor(6 * int(rng.integers(8)) + int(rng.choice(look.floors))) for _ in "ab")
    away = camera[1] - about  # the wall is behind, square to the line of sight or nearly so
    front = turn_z(np.arctan2(away[1], away[0]) + rng.normal(0, 0.35))[:, 0]
    upright = np.stack([np.cross((0, 0, 1), front), (0, 0, 1), front], axis=1)
    placed.append((turn_z(rng.uniform(0, 2 * np.pi)), foot))
    placed.append((upright, foot - front * (farthest + rng.uniform(0.3, 2.0))))
    poses = [compose(*to_camera, *pose) for pose in placed]
    size = recipe["width"], recipe["height"]
    K = _crop(things[:count], poses[:count], framing.margin, size, rng)
    return Scene([*things, floor, wall], poses, which[:count], camera, K, size)


def _placed(which: list[tuple[str, int]], rng: np.random.Generator) -> list[Pose]:
    """Things on a floor close together, as they stay when they are put down."""
    poses, there = [], []
    for each in which:
        resting = _resting(*each)
        R, height = resting.draw(rng)
        extent = extents(resting.hull, R)
        direction = turn_z(rng.uniform(0, 2 * np.pi))[:2, 0]
        start = rng.normal(0, 0.03, 2) if there else np.zeros(2)
        place = slide_in(extent, height, there, start, direction, rng.uniform(0.003, 0.03))
        there.append((extent, place))
        poses.append((R, place))
    return poses


def _camera(about: np.ndarray, rng: np.random.Generator) -> Pose:
    """The pose in the world of a camera that sees a point somewhere in its image."""
    elevation = np.radians(rng.uniform(18, 65))
    flat = np.cos(elevation) * turn_z(rng.uniform(0, 2 * np.pi))[:, 0]
    eye = about + rng.uniform(0.45, 1.1) * (flat + np.sin(elevation) * np.array([0, 0, 1]))
    R, t = look_at(eye, about, rng.normal(0, 0.14))
    aside = turn("x", rng.uniform(-9, 9)) @ turn("y", rng.uniform(-14, 14))
    return invert(aside @ R, aside @ t)


def _crop(
    things: list[PreparedMesh],
    poses: list[Pose],
    margin: tuple[float, float],
    size: tuple[int, int],
    rng: np.random.Generator,
) -> np.ndarray:
    """(3, 3) the camera matrix of the part of the camera's image in which the things are."""
    points = [apply(R, t, item.vertices.T) for item, (R, t) in zip(things, poses, strict=True)]
    pixels = project(CAMERA, np.concatenate(points))
    low, high = pixels.min(0), pixels.max(0)
    extent = np.array(size) * ((high - low) / size).max() * rng.uniform(*margin)
    corner = (low + high - extent) / 2 + 0.06 * extent * rng.uniform(-1, 1, 2)
    return crop_and_resize_intrinsics(CAMERA, [*corner, *extent], size)


def photographs(
    scene: Scene, labels: Labels, split: str, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """What the colour and the depth camera make of a scene: images as in a `View`."""
    look = _LOOKS[split]
    linear = render_colour(
        scene.things,
        scene.poses,
        scene.K,
        scene.size,
        _lights(scene, look, rng),
        ambient=_ambient(scene, look, rng),
        casters=range(len(scene.things) - 2),
        shadow_texels=2 * scene.size[0],
    )
    rgb = rgb_sensor(
        linear,
        rng,
        exposure=rng.uniform(*look.exposure),
        shot_noise=0.015 * look.noise,
        read_noise=0.004 * look.noise,
        blur=0.35 * look.noise,
    )
    infrared, specular = material_images(scene.things, labels)
    enlarged = scene.K[0, 0] / CAMERA[0, 0]  # a crop that is enlarged does not see more sharply
    depth = depth_sensor(
        labels.depth,
        scene.K,
        rng,
        normals=labels.normals,
        reflectance=infrared,
        specular=specular,
        disparity_noise=0.08 * look.noise * enlarged,
        disparity_step=0.125 * enlarged,
    )
    return rgb, depth


def _lights(scene: Scene, look: Look, rng: np.random.Generator) -> list[Light]:
    """A lamp that throws shadows, and a weaker one that softens them."""
    lights = []
    for bright, radius, shadows in ((1.0, rng.uniform(0.02, 0.12), True), (0.25, 0.0, False)):
        height, distance = np.radians(rng.uniform(*look.height)), rng.uniform(1.2, 2.2)
        direction = np.cos(height) * turn_z(rng.uniform(0, 2 * np.pi))[:, 0]
        direction[2] = np.sin(height)
        position = scene.poses[0][1] + scene.camera[0].T @ (distance * direction)
        warm = look.tint * rng.uniform(-1, 1)
        colour = np.array([1 + warm, 1, 1 - warm]) * rng.uniform(*look.lamp) * bright
        lights.append(Light(position, colour * distance**2, radius=radius, shadows=shadows))
    return lights


def _ambient(scene: Scene, look: Look, rng: np.random.Generator) -> Ambient:
    usual, shade = Ambient(), rng.uniform(*look.shade)
    up = scene.camera[0].T @ np.array([0, 0, 1])
    return Ambient(shade * usual.above, shade * usual.below, up)


@functools.lru_cache(maxsize=300)
def _instance(category: str, instance: int) -> PreparedMesh:
    return prepare(make_category(category, instance))


@functools.lru_cache(maxsize=300)
def _resting(category: str, instance: int) -> Resting:
    """How an instance may lie; laptops and bowls do not lie on their side."""
    resting = Resting(_instance(category, instance).mesh, (0, 1, 0))
    if category in ("bowl", "laptop"):
        resting.poses.pop("lying", None)
    return resting


@functools.lru_cache(maxsize=48)
def _floor(seed: int) -> PreparedMesh:
    return prepare(make_floor(seed, 8.0))
