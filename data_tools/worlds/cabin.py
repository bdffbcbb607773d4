"""The car around the driver: seat, cabin, and what is seen through its windows."""

from __future__ import annotations

import functools

import numpy as np

from data_tools.renderer import PreparedMesh, prepare
from data_tools.shapes import make_seat
from data_tools.shapes.building import Part, assemble, paint, turn
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import box
from data_tools.textures.prints import noise

__all__ = ["make_cabin", "windows", "windows_in_colour"]

_SKY = np.array([0.85, 0.97, 1.15])  # by day, linear
_LEAVES = np.array([0.22, 0.34, 0.10])


@functools.lru_cache(maxsize=1)
def make_cabin() -> tuple[PreparedMesh, PreparedMesh]:
    """The driver's seat, and the cabin behind it, in the car's frame."""
    cloth = Material(
        paint("#303236"), paint("#202226"), "cloth", 3, infrared=0.45, second_infrared=0.3
    )
    trim = Material(paint("#4a4a4c"), specular=0.1, infrared=0.35)
    roof = Material(paint("#9a9890"), paint("#8c8a84"), "noise", 4, infrared=0.5)
    belt = Material(paint("#222224"), infrared=0.5)

    def block(size: tuple, at: tuple, material: Material, *turns: np.ndarray) -> Part:
        part = box(size, min(0.05, 0.45 * min(size)), material, 2)
        for R in turns:
            part = part.moved(R)
        return part.moved(shift=at)

    parts = [
        block((1.7, 0.04, 1.7), (-0.3, -0.31, 0.65), roof, turn("x", -5)),
        block((1.5, 0.75, 0.2), (-0.33, 0.55, 1.0), cloth, turn("x", -10)),
        block((1.6, 0.06, 0.5), (-0.33, 0.2, 1.35), trim),
    ]
    for x in (-0.75, 0.1):
        parts.append(block((0.26, 0.17, 0.1), (x, 0.1, 1.05), cloth))
    for side in (-1, 1):
        x = -0.33 + side * 0.78
        parts += [
            block((0.08, 0.9, 2.0), (x, 0.55, 0.6), trim),  # the door, below its window
            block((0.07, 0.55, 0.12), (x - side * 0.03, -0.1, 0.38), trim, turn("x", 8)),
            block((0.1, 0.6, 0.16), (x - side * 0.08, -0.05, 1.2), trim, turn("x", 30)),
        ]
    parts.append(block((0.012, 0.9, 0.045), (0.4, 0.1, 0.32), belt, turn("z", 8)))
    return prepare(make_seat()), prepare(assemble("cabin", parts, centre=False))


def windows(rng: np.random.Generator, daylight: float, height: int, width: int) -> np.ndarray:
    """(H, W) what is seen through the windows: the sky over trees, linear.

    Args:
        rng: the random numbers.
        daylight: how bright it is outside, from 0 at night to 1.
        height, width: of the image in pixels.
    """
    sky, leaves = _outside(rng, height, width)
    return daylight * (0.42 * sky + 0.3 * (1 - sky) * leaves**2) + 0.006


def windows_in_colour(
    rng: np.random.Generator, daylight: float, height: int, width: int
) -> np.ndarray:
    """(H, W, 3) the same in visible light, to which the sky is brighter and leaves are darker.

    Args:
        rng, daylight, height, width: as for `windows`, which takes the same random numbers.
    """
    sky, leaves = (image[..., None] for image in _outside(rng, height, width))
    return daylight * (sky * _SKY + (1 - sky) * leaves**2 * _LEAVES) + 0.0003


def _outside(rng: np.random.Generator, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) how much of a pixel is sky, and (H, W) how dense the leaves are, both 0 to 1."""
    columns, rows = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    points = np.stack([0.7 * columns, 0.4 * rows, 0 * rows], axis=-1).reshape(-1, 3)
    leaves = noise(points + rng.uniform(0, 1, 3)).reshape(height, width)
    sky = np.clip((0.53 + 0.35 * (leaves - 0.5) - rows) / 0.02, 0, 1)
    return sky, leaves
