"""The bare head: x to the left, y up, z forward, from the origin of the glasses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh

from data_tools.shapes.building import Part, paint, turn
from data_tools.shapes.implicit import Shape, ball, blend, carve, limb, radial
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import ellipsoid

__all__ = ["Proportions", "ears", "eyes", "face", "head_shape", "lips"]


@dataclass(frozen=True)
class Proportions:
    """Factors around 1 that make one head different from another."""

    width: float
    height: float
    depth: float
    jaw: float
    nose: float
    chin: float
    cheeks: float


def head_shape(p: Proportions) -> Shape:
    """Skull, face, jaw and nose; x to the left, y up, z forward from the glasses."""
    h = p.height
    skull = blend(
        [
            ball((0, 0.036, -0.106 * p.depth), (0.0765 * p.width, 0.08 * h, 0.094 * p.depth)),
            ball((0, -0.024, -0.068), (0.062 * p.width, 0.086 * h, 0.0575)),
            ball((0, -0.072 * h, -0.06), (0.052 * p.width * p.jaw, 0.036 * h, 0.046)),
            ball((0, -0.101 * h, -0.026), (0.021 * p.jaw, 0.014 * h, 0.014 * p.chin)),
            ball((0.04, -0.032, -0.032), (0.019, 0.017, 0.016 * p.cheeks)),
            ball((-0.04, -0.032, -0.032), (0.019, 0.017, 0.016 * p.cheeks)),
            limb((-0.036, 0.02, -0.026), (0.036, 0.02, -0.026), 0.01),
        ],
        0.03,
    )
    sockets = [ball((side * 0.032, -0.001, -0.004), (0.018, 0.0125, 0.015)) for side in (-1, 1)]
    tip = 0.004 + 0.008 * p.nose
    nose = [
        limb((0, 0.004, -0.0185), (0, -0.034, tip - 0.007), 0.0065, 0.0085),
        ball((0.0095, -0.037, -0.006), (0.0065, 0.006, 0.008)),
        ball((-0.0095, -0.037, -0.006), (0.0065, 0.006, 0.008)),
    ]
    mouth = [
        ball((0, -0.0585 * h, -0.0115), (0.019, 0.0045, 0.007)),
        ball((0, -0.0675 * h, -0.0125), (0.017, 0.005, 0.007)),
    ]
    return blend([blend([carve(skull, sockets, 0.012), *nose], 0.012), *mouth], 0.007)


@cache
def _directions() -> tuple[np.ndarray, np.ndarray]:
    """A sphere of directions, denser towards the face."""
    sphere = trimesh.creation.icosphere(subdivisions=4)
    drawn = sphere.vertices + np.array([0, -0.05, 0.5])
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True), np.array(sphere.faces)


def face(head: Shape, p: Proportions, flesh: Material) -> Part:
    """The skin of the head, with brows, mouth and nostrils painted on."""
    # The pattern's mouth is at -0.063 and ours at -0.063 h; brows stay, as the glasses do.
    place = (1.0, 0.0, 0.0, 0.0, 0.0, 1 / p.height, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    painted = replace(flesh, pattern="face", place=place)
    return radial(head, (0, -0.012, -0.075), *_directions(), 0.25, painted)


def eyes(flesh: Material, rng: np.random.Generator) -> list[Part]:
    """Eyeballs between their lids."""
    iris = paint(("#2e1b0f", "#1d3a52", "#2b4220", "#1a0f08")[rng.integers(4)])
    white = Material((0.72, 0.69, 0.65), iris, "eye", 90, 0.15, 120, 0.5, 0.1)
    parts = []
    for side in (-1, 1):
        x = side * 0.0315
        parts.append(ellipsoid(0.0122, white, level=2).moved(shift=(x, -0.001, -0.0265)))
        lid = ellipsoid((0.0135, 0.0125, 0.0128), flesh, level=2)
        parts.append(lid.moved(shift=(x, 0.0055, -0.0275)))
        lid = ellipsoid((0.0135, 0.0125, 0.0128), flesh, level=1)
        parts.append(lid.moved(shift=(x, -0.0105, -0.0287)))
    return parts


def lips(p: Proportions, flesh: Material, forward: float) -> list[Part]:
    """Upper and lower lip, moved `forward` out of a beard."""
    tint = np.multiply(flesh.colour, (0.78, 0.55, 0.55))
    red = replace(flesh, colour=tuple(tint.tolist()), infrared=0.85 * flesh.infrared)
    y, z = -0.0626 * p.height, -0.009 + forward
    upper = ellipsoid((0.0185, 0.0034, 0.0072), red, (0, y + 0.0028, z), 1)
    lower = ellipsoid((0.0165, 0.0046, 0.0075), red, (0, y - 0.0034, z), 1)
    return [upper, lower]


def ears(p: Proportions, flesh: Material) -> list[Part]:
    """Ears, with a bowl and a lobe."""
    parts = []
    for side in (-1, 1):
        shell = ellipsoid((0.0075, 0.031, 0.0185), flesh)

        def cupped(v: np.ndarray, side: int = side) -> np.ndarray:
            bowl = np.exp(-(((v[:, 1] - 0.003) / 0.014) ** 2) - ((v[:, 2] - 0.003) / 0.009) ** 2)
            v = v * (1 + np.array([0, 0, 7.0]) * v[:, 1:2])
            v[:, 0] -= side * 0.008 * bowl * (v[:, 0] * side > 0)
            return v

        ear = shell.bent(cupped).moved(turn("y", side * -24) @ turn("x", -10))
        parts.append(ear.moved(shift=(side * (0.0745 * p.width), -0.013, -0.108)))
    return parts
