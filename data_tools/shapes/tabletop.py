"""Eight objects for a table, each always the same: ids 1 to 8.

Frames: metres, z up, front towards -y, the origin in the middle of the bounding box.

Two are symmetric, in shape and in colour: the vase (3) is a solid of revolution about z, and the
egg box (4) is the same after half a turn about z. The can (2) is round, but its label tells its
turns apart: it has no symmetry, and a method has to read the label.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, around, assemble, paint, turns
from data_tools.shapes.implicit import below, blend, carve, limb, skin
from data_tools.shapes.mesh import Material, Mesh
from data_tools.shapes.pieces import ellipsoid, revolve, spline, tube
from data_tools.shapes.toys import STEEL, car, cat, drill, duck
from posecore.arrays import require_integer

__all__ = ["NAMES", "make_object"]

TURNS = 36


def make_object(object_id: int) -> Mesh:
    """One of the eight objects.

    Args:
        object_id: 1 to 8, in the order of `NAMES`.

    Returns:
        its mesh: 2 000 to 10 000 faces, a diameter of 0.12 to 0.26 m.

    Raises:
        ValueError: for another id.
    """
    name = NAMES[require_integer("object_id", object_id, 1, len(NAMES)) - 1]
    parts = _BUILDERS[name]()
    axis = (0.0, 0.0, 1.0)
    if name == "vase":
        return assemble(name, parts, symmetries=turns(axis, TURNS), axis=axis)
    return assemble(name, parts, symmetries=turns(axis, 2) if name == "egg box" else None)


def _can() -> list[Part]:
    radius, height = 0.034, 0.102
    print_ = Material(paint("#b3202a"), paint("#f3ead6"), "label", 1, 0.2, 30, 0.5, 0.8, seed=21)
    label = around(print_, 0.007, height - 0.007, -157.5)
    edge = radius + 0.0008
    ribs = np.linspace(0.007, height - 0.007, 30)
    side = np.column_stack([radius + 0.0004 * np.sin(np.linspace(0, 14 * np.pi, 30)), ribs])
    base = [
        (0, 0.003),
        (0.9 * radius, 0.003),
        (0.95 * radius, 0),
        (edge, 0),
        (edge, 0.004),
        (radius, 0.007),
    ]
    lid = [
        (radius, height - 0.007),
        (edge, height - 0.004),
        (edge, height),
        (radius - 0.002, height),
        (radius - 0.003, height - 0.005),
        (0.7 * radius, height - 0.005),
        (0.66 * radius, height - 0.0035),
        (0.3 * radius, height - 0.0035),
        (0.26 * radius, height - 0.005),
        (0, height - 0.005),
    ]
    ring = tube(
        0.008 * _circle(16) + [0, -0.012, height - 0.0025], 0.0012, STEEL, (0, 0, 1), 6, True
    )
    return [revolve([(base, STEEL), (side, label), (lid, STEEL)], TURNS * 2), ring]


def _circle(count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)


def _vase() -> list[Part]:
    glaze = Material(paint("#2f6f73"), paint("#e8dfc4"), "rings", 34, 0.5, 60, 0.45, 0.7)
    plain = Material(paint("#2f6f73"), specular=0.5, shininess=60, infrared=0.45)
    dark = Material(paint("#4a3527"), infrared=0.4)
    lower = spline([(0.032, 0), (0.045, 0.03), (0.05, 0.07), (0.037, 0.115)], 16)
    upper = spline([(0.037, 0.115), (0.022, 0.145), (0.021, 0.165), (0.034, 0.19)], 14)
    inside = spline([(0.031, 0.19), (0.0185, 0.164), (0.0195, 0.145), (0.03, 0.12)], 10)
    strips = [
        ([(0, 0.003), (0.027, 0.003), (0.029, 0), (0.032, 0)], dark),
        (lower, glaze),
        (upper, plain),
        ([(0.034, 0.19), (0.0325, 0.1915), (0.031, 0.19)], plain),
        (inside, dark),
        ([(0.03, 0.12), (0, 0.115)], dark),
    ]
    return [revolve(strips, TURNS * 2)]


def _egg_box() -> list[Part]:
    pulp = Material(paint("#9aa1a0"), paint("#747d80"), "pulp", 14, 0.02, 10, 0.5)
    brown = Material(paint("#c98d5f"), specular=0.15, infrared=0.65)
    cream = Material(paint("#f1e6d2"), specular=0.15, infrared=0.75)
    pitch = 0.047
    places = [(pitch * i, pitch * (j - 0.5), i, j) for i in (-1, 0, 1) for j in (0, 1)]
    cups = [limb((x, y, 0.014), (x, y, 0.034), 0.0165, 0.0235) for x, y, *_ in places]
    rim = _slab((0.074, 0.051, 0.004), 0.038)
    shape = carve(blend([*cups, rim], 0.012), [below(0)], 0.003)
    posts = [limb((x, 0, 0.036), (x, 0, 0.054), 0.009, 0.006) for x in (-pitch / 2, pitch / 2)]
    whole = blend([shape, *posts], 0.006)

    def both_ways(points: np.ndarray) -> np.ndarray:
        """Blends depend a little on the order of their shapes; this is exactly symmetric."""
        return np.minimum(whole(points), whole(points * [-1, -1, 1]))

    low, high = (-0.0855, -0.063, -0.009), (0.0855, 0.063, 0.0685)
    tray = skin(both_ways, low, high, 0.0045, pulp)
    parts = [tray]
    for x, y, i, j in places:
        shell = brown if (i, j) in ((-1, 0), (1, 1)) else cream
        egg = ellipsoid((0.0205, 0.0205, 0.027), shell)
        egg = egg.bent(lambda v: v * (1 - [4.5, 4.5, 0] * v[:, 2:]))
        parts.append(egg.moved(shift=(x, y, 0.046)))
    return parts


def _slab(half: tuple[float, float, float], height: float) -> Callable[[np.ndarray], np.ndarray]:
    """A flat box with round corners about the z axis."""
    corner = 0.012

    def distance(points: np.ndarray) -> np.ndarray:
        flat = np.abs(points[..., :2]) - np.array(half[:2]) + corner
        out = np.sqrt((np.maximum(flat, 0) ** 2).sum(-1)) + np.minimum(flat.max(-1), 0) - corner
        return np.maximum(out, np.abs(points[..., 2] - height) - half[2])

    return distance


def _teapot() -> list[Part]:
    china = Material(paint("#eef0ee"), paint("#2b4f9e"), "marble", 5, 0.6, 80, 0.7, 0.55, seed=5)
    white = replace(china, pattern="")
    blue = Material(paint("#2b4f9e"), specular=0.6, shininess=80, infrared=0.5)
    body = spline([(0.036, 0.0), (0.058, 0.025), (0.064, 0.055), (0.05, 0.088), (0.034, 0.1)], 18)
    lid = spline([(0.034, 0.102), (0.026, 0.11), (0.01, 0.116), (0.006, 0.119)], 8)
    knob = [(0.006, 0.119), (0.011, 0.125), (0.01, 0.131), (0.005, 0.135), (0, 0.136)]
    strips = [
        ([(0, 0.003), (0.03, 0.003), (0.036, 0)], china),
        (body, china),
        ([(0.034, 0.1), (0.036, 0.1), (0.036, 0.102), (0.034, 0.102)], blue),
        (lid, white),
        (spline(knob, 9), blue),
    ]
    pot = revolve(strips, 48)
    path = spline([(0.045, 0, 0.035), (0.075, 0, 0.042), (0.09, 0, 0.07), (0.112, 0, 0.098)], 14)
    thick = np.interp(np.linspace(0, 1, 14), [0, 0.5, 1], [0.019, 0.012, 0.0075])
    spout = tube(path, thick, white, (0, 1, 0), 14)
    loop = spline(
        [
            (-0.046, 0, 0.09),
            (-0.08, 0, 0.098),
            (-0.104, 0, 0.07),
            (-0.09, 0, 0.038),
            (-0.056, 0, 0.03),
        ],
        20,
    )
    return [pot, spout, tube(loop, (0.0055, 0.0075), blue, (0, 1, 0), 12)]


_BUILDERS: dict[str, Callable[[], list[Part]]] = {
    "duck": duck,
    "can": _can,
    "vase": _vase,
    "egg box": _egg_box,
    "teapot": _teapot,
    "car": car,
    "drill": drill,
    "cat": cat,
}
NAMES = tuple(_BUILDERS)
