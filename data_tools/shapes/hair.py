"""Hair, beards and hats, over a head of `data_tools.shapes.faces` and in its frame.

Hair is the head grown by its thickness, within the region where it grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, paint, turn
from data_tools.shapes.faces import Proportions
from data_tools.shapes.implicit import Shape, ball, blend, carve, common, limb, skin
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import ellipsoid, loft, revolve, spline, tube
from posecore.arrays import require_choice

__all__ = ["BEARDS", "CLOTHES", "HAIR", "grow_beard", "grow_hair"]

BEARDS = ("none", "stubble", "moustache", "full")
CLOTHES = ("#33415c", "#7a2e39", "#3c5a45", "#8b8f96", "#20242b", "#b9a27c", "#54407a", "#c9cdd2")
LOW, HIGH = np.array([-0.12, -0.1, -0.26]), np.array([0.12, 0.19, 0.05])  # around all hair
STEP = 0.0105

_CROWN = ball((0, 0.052, -0.125), (0.1, 0.095, 0.1))
_FULL_CROWN = blend([_CROWN, ball((0, 0.06, -0.06), (0.085, 0.075, 0.05))], 0.02)
_FOREHEAD = ball((0, -0.028, -0.008), (0.07, 0.088, 0.062))  # and all the face: kept free


def grow_hair(
    style: str, head: Shape, p: Proportions, strands: Material, rng: np.random.Generator
) -> list[Part]:
    """Hair or a hat, in a style of `HAIR`.

    Raises:
        ValueError: for another style.
    """
    require_choice("style", style, HAIR)
    return _STYLES[style](head, p, strands, rng)


def _grown(shape: Shape, thickness: float) -> Shape:
    return lambda points: shape(points) - thickness


def _bald(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    return []


def _short(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    region = carve(_CROWN, [_FOREHEAD], 0.02)
    return [skin(common(_grown(head, 0.0065), region, 0.008), LOW, HIGH, STEP, strands)]


def _cropped(head: Shape, strands: Material) -> Part:
    """What shows under a hat."""
    region = carve(_CROWN, [_FOREHEAD], 0.02)
    return skin(common(_grown(head, 0.004), region, 0.006), LOW, HIGH, 0.014, strands)


def _parted(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    quiff = ball((-0.03, 0.088 * p.height, -0.045), (0.05, 0.03, 0.045))
    volume = blend([_grown(head, 0.013), quiff], 0.02)
    region = carve(blend([_CROWN, ball((-0.02, 0.1, -0.05), 0.05)], 0.02), [_FOREHEAD], 0.015)
    return [skin(common(volume, region, 0.008), LOW, HIGH, STEP, strands)]


def _long(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    sides = [
        ball((side * 0.072 * p.width, -0.052, -0.106), (0.023, 0.125, 0.046)) for side in (-1, 1)
    ]
    behind = ball((0, -0.065, -0.15), (0.09, 0.125, 0.062))
    top = common(_grown(head, 0.014), carve(_FULL_CROWN, [_FOREHEAD], 0.015), 0.01)
    face = ball((0, -0.045, 0.0), (0.064, 0.1, 0.085))
    shape = carve(blend([top, *sides, behind], 0.03), [face], 0.012)
    return [skin(shape, LOW - [0, 0.11, 0], HIGH, 0.0125, strands)]


def _bun(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    top = common(_grown(head, 0.008), carve(_FULL_CROWN, [_FOREHEAD], 0.015), 0.008)
    knot = ball((0, 0.1 * p.height, -0.2 * p.depth), 0.036)
    return [skin(blend([top, knot], 0.012), LOW - [0, 0, 0.03], HIGH, STEP, strands)]


def _curly(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    puff = ball((0, 0.062, -0.118), (0.116, 0.108, 0.112))

    def curls(points: np.ndarray) -> np.ndarray:
        return puff(points) - 0.006 * np.sin(210 * points + np.array([0, 1, 0])).prod(-1)

    shape = carve(curls, [ball((0, -0.035, 0.0), (0.073, 0.094, 0.075))], 0.02)
    return [skin(shape, LOW - [0.04, 0, 0.03], HIGH + [0.04, 0.03, 0], 0.0125, strands)]


def _cap(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    colour = paint(str(rng.choice(CLOTHES)))
    cloth = Material(colour, infrared=float(rng.uniform(0.1, 0.25)))  # skin is brighter
    radii = np.array([0.083 * p.width, 0.086 * p.height, 0.102 * p.depth])
    rise = np.linspace(0, np.pi / 2, 10)[:-1]
    profile = [(0, -0.08), (0.97, -0.08), *zip(np.cos(rise), np.sin(rise), strict=True), (0, 1)]
    crown = revolve([(profile, cloth)], 40).moved(turn("x", -90)).bent(lambda v: v * radii)
    x = np.linspace(-1, 1, 15)
    front = np.stack([0.074 * x, 0.006 * (1 - 2.2 * x**2), 0.062 * np.sqrt(1.02 - x**2)], -1)
    outline = np.vstack([front, [[0.06, -0.004, -0.03], [0, 0, -0.045], [-0.06, -0.004, -0.03]]])
    peak = loft(np.stack([outline, outline + [0, 0.004, 0]]), cloth)
    button = ellipsoid((0.006, 0.004, 0.006), cloth, (0, 0.044 + radii[1], -0.113), 1)
    return [
        _cropped(head, strands),
        crown.moved(turn("x", 6), (0, 0.044, -0.107 * p.depth)),
        peak.moved(turn("x", 8), (0, 0.049, -0.018)),
        button,
    ]


def _beanie(head: Shape, p: Proportions, strands: Material, rng: np.random.Generator) -> list[Part]:
    colour = paint(str(rng.choice(CLOTHES)))
    bright = float(rng.uniform(0.15, 0.4))
    upright = (1.0, 0, 0, 0, 0, 0, 1.0, 0.11, 0, 1.0, 0, 0)  # the ribs' axis
    wool = Material(
        colour, (0.05, 0.05, 0.06), "ribs", 1, 0.03, 10, bright, 0.4 * bright, place=upright
    )
    middle, slope = -0.108 * p.depth, -0.25  # the rim rises towards the front
    dome = ball((0, 0.045, middle), (0.085 * p.width, 0.096 * p.height, 0.104 * p.depth))
    tip = ball((0, 0.116 * p.height + 0.012, -0.11), 0.022)

    def under_rim(points: np.ndarray) -> np.ndarray:
        return 0.036 - points[..., 1] + slope * (points[..., 2] + 0.02)

    knitted = skin(common(blend([dome, tip], 0.03), under_rim, 0.01), LOW, HIGH, 0.01, wool)
    angle = 2 * np.pi * np.arange(40) / 40
    x, z = 0.0835 * p.width * np.cos(angle), middle + 0.1025 * p.depth * np.sin(angle)
    rim = np.stack([x, 0.04 + slope * (z + 0.02), z], -1)
    rolled = tube(rim, (0.0055, 0.017), wool, (0, 1, 0), 10, around=True)
    return [_cropped(head, strands), knitted, rolled]


_STYLES: dict[str, Callable[..., list[Part]]] = {
    "bald": _bald,
    "short": _short,
    "parted": _parted,
    "long": _long,
    "bun": _bun,
    "curly": _curly,
    "cap": _cap,
    "beanie": _beanie,
}
HAIR = tuple(_STYLES)


def grow_beard(style: str, head: Shape, p: Proportions, strands: Material) -> list[Part]:
    """A beard of `BEARDS`; stubble is a matter of the skin's pattern.

    Raises:
        ValueError: for another style.
    """
    require_choice("style", style, BEARDS)
    h = p.height
    hairs = replace(strands, scale=20)
    bar = [(-0.028, -0.062 * h, -0.013), (-0.015, -0.0515 * h, -0.004), (0, -0.049 * h, -0.0005)]
    bar += [(-x, y, z) for x, y, z in bar[1::-1]]
    if style == "moustache":
        thick = np.interp(np.arange(14), [0, 3, 10, 13], [0.001, 0.0045, 0.0045, 0.001])
        return [tube(spline(bar, 14), thick, hairs, (0, 1, 0), 8)]
    if style != "full":
        return []
    cheeks = [
        limb((s * 0.072 * p.width, -0.02, -0.078), (s * 0.052, -0.085 * h, -0.05), 0.012, 0.022)
        for s in (-1, 1)
    ]
    corners = [limb(bar[k], (bar[k][0], -0.085, -0.015), 0.0075, 0.012) for k in (0, 4)]
    chin = ball((0, -0.098 * h, -0.042), (0.06 * p.width, 0.045, 0.055))
    region = blend([chin, *cheeks, *corners, limb(bar[1], bar[3], 0.0085)], 0.012)
    shape = common(_grown(head, 0.0065), region, 0.008)
    return [skin(shape, (-0.1, -0.17, -0.13), (0.1, 0.02, 0.03), 0.0085, hairs)]
