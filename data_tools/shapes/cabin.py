"""What is around the head of a driver: neck and torso, and the seat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, assemble, paint, turn
from data_tools.shapes.glasses import MODELLED
from data_tools.shapes.hair import CLOTHES
from data_tools.shapes.implicit import ball, blend, limb, skin
from data_tools.shapes.mesh import Material, Mesh
from data_tools.shapes.pieces import box, ellipsoid, spline, tube

__all__ = ["PIVOT", "make_seat", "torso"]

PIVOT = np.array([0.0, 0.07, 0.105])  # in the frame of the glasses, metres
_NECK = MODELLED @ PIVOT


def torso(flesh: Material, rng: np.random.Generator) -> list[Part]:
    """Neck, shoulders in one of several clothes, and a collar; x left, y up, z forward."""
    bright = float(rng.uniform(0.15, 0.6))
    first = paint(CLOTHES[rng.integers(len(CLOTHES))])
    pattern = str(rng.choice(["cloth", "", "stripes", "cloth"]))
    cloth = Material(
        first,
        tuple(0.55 * c for c in first),
        pattern,
        22 if pattern == "stripes" else 5,
        0.02,
        10,
        bright,
        0.75 * bright,
        seed=int(rng.integers(100)),
    )
    broad = rng.uniform(0.92, 1.1)
    thick = rng.uniform(0.054, 0.064)
    x, y, z = _NECK
    column = np.array(
        [[x, y, z], [x, y - 0.05, z - 0.006], [x, y - 0.11, z - 0.018], [x, y - 0.17, z - 0.024]]
    )
    neck = tube(
        spline(column, 10),
        thick * np.array([0.84, 0.88, 0.91, 0.93, 0.95, 0.97, 1, 1.06, 1.15, 1.3]),
        flesh,
        (0, 0, 1),
        24,
    )
    dome = ellipsoid((0.84 * thick, 0.05, 0.84 * thick), flesh, (x, y, z), 2)
    sides = (-1, 1)
    slopes = [
        limb((s * 0.02, -0.185, -0.135), (s * 0.13 * broad, -0.25, -0.135), 0.055, 0.05)
        for s in sides
    ]
    arms = [
        limb((s * 0.185 * broad, -0.285, -0.135), (s * 0.235 * broad, -0.52, -0.09), 0.056, 0.046)
        for s in sides
    ]
    shoulders = limb((-0.145 * broad, -0.275, -0.135), (0.145 * broad, -0.275, -0.135), 0.062)
    chest = ball((0, -0.39, -0.125), (0.175 * broad, 0.2, 0.115))
    body = blend([shoulders, *slopes, chest, *arms], 0.05)
    lift = np.array([0, 0.028, 0])
    clothed = skin(body, (-0.4, -0.64, -0.3), (0.4, -0.1, 0.06), 0.026, cloth).moved(shift=lift)
    parts = [neck, dome, clothed]
    loop = 2 * np.pi * np.arange(28) / 28
    ring = np.stack([(thick + 0.012) * np.cos(loop), 0 * loop, (thick + 0.012) * np.sin(loop)], -1)
    style = rng.integers(3)
    fat, tall = ((0.009, 0.01), (0.007, 0.022), (0.016, 0.02))[style]  # crew neck, polo, hood
    ring = ring * (1.12 if style == 2 else 1.0) @ turn("x", 14).T
    plain = replace(cloth, pattern="")
    ring = ring + lift + [0, -0.186 + tall * 0.6, -0.128]
    parts.append(tube(ring, (fat, tall), plain, (0, 1, 0), 8, around=True))
    return parts


def make_seat() -> Mesh:
    """The car seat behind the person, with its headrest: background, in the same frame."""
    cloth = Material(paint("#3a3d42"), paint("#24262a"), "cloth", 4, 0.03, 10, 0.14, 0.09)
    side = Material(paint("#202226"), paint("#2c2f34"), "noise", 6, 0.1, 15, 0.08, 0.1)
    metal = Material(paint("#9a9ca0"), specular=0.1, shininess=40, infrared=0.3)
    back = box((0.46, 0.66, 0.11), 0.045, cloth, 4).moved(turn("x", -8), (0, -0.5, -0.33))
    parts = [back]
    for s in (-1, 1):
        wing = box((0.1, 0.6, 0.15), 0.045, side, 3)
        wing = wing.moved(turn("y", s * -18), (s * 0.235, -0.5, -0.305))
        parts.append(wing.moved(turn("x", -4)))
        post = np.array([[s * 0.065, -0.2, -0.31], [s * 0.065, -0.05, -0.3]])
        parts.append(tube(post, 0.0075, metal, (0, 0, 1), 12))
    rest = box((0.28, 0.19, 0.1), 0.042, cloth, 4)
    rest = rest.bent(lambda v: v + np.stack([0 * v[:, 0], 0 * v[:, 0], 1.2 * v[:, 0] ** 2], -1))
    parts.append(rest.moved(turn("x", -6), (0, 0.015, -0.275)))
    return assemble("seat", parts, MODELLED, centre=False)
