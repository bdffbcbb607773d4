"""Four AR glasses that differ at a glance; each is always the same.

The frame of the glasses is the frame whose pose is estimated, and the head's is the same while
they are worn. Its origin lies midway between the centres of the lenses; seen by a camera in front
of the wearer,

    x points right (the wearer's left), y down, z away from the camera (to the back of the head),

so that a wearer who looks straight into the camera, upright, has R = I:

        .-------.   .------.
        | right |-o-| left |----> x
        '-------' | '------'
                  v               z: into the page
                  y

In `R = Ry(yaw) Rx(pitch) Rz(roll)` a positive yaw turns the face to the wearer's right (left in the
image), a positive pitch lowers it, and a positive roll turns the image of the head clockwise.

Parts are modelled with x to the wearer's left, y up and z forward: `MODELLED` turns that frame into
the one above.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data_tools.shapes.building import Part, assemble, paint, turn
from data_tools.shapes.mesh import Material, Mesh
from data_tools.shapes.pieces import box, ellipsoid, loft, revolve, spline, tube
from posecore.arrays import require_choice

__all__ = ["GLASSES", "MODELLED", "make_glasses"]

MODELLED = np.diag([1.0, -1.0, -1.0])
UP, LEFT = (0, 1, 0), (1, 0, 0)
BLACK = Material(paint("#1a1a1c"), specular=0.15, shininess=40, infrared=0.1)
LENS = Material(paint("#182226"), specular=0.06, shininess=400, infrared=0.06)
CHROME = Material(paint("#c3c3c8"), specular=0.8, shininess=60, infrared=0.55)
GREY = Material(paint("#56585e"), specular=0.12, shininess=30, infrared=0.3)
EYE = Material(paint("#08080c"), specular=1.0, shininess=120, infrared=0.03)  # of a camera


def make_glasses(name: str) -> Mesh:
    """One of the four models.

    Args:
        name: one of `GLASSES`: "classic" has a thick dark frame and electronics in both temples,
            "round" thin metal rims without panes and a camera at the wearer's right hinge, "visor"
            one wide shield on a band around the head, "prism" a brow bar with a display before the
            wearer's right eye.

    Raises:
        ValueError: for another name.
    """
    require_choice("name", name, GLASSES)
    return assemble(f"{name} glasses", _BUILDERS[name](), MODELLED, centre=False)


def _rim(width: float, height: float, square: float, side: int, count: int = 36) -> np.ndarray:
    """(count, 3) outline of a lens: an ellipse at `square` 0, a rectangle towards 1, wrapped
    around the face a little."""
    angle = 2 * np.pi * np.arange(count) / count
    power = 1 - 0.72 * square
    c, s = np.cos(angle), np.sin(angle)
    x = width / 2 * np.sign(c) * np.abs(c) ** power
    y = height / 2 * np.sign(s) * np.abs(s) ** power
    return _wrapped(np.stack([x + side * 0.0335, y, 0 * x], -1))


def _wrapped(points: np.ndarray) -> np.ndarray:
    """Points of a flat front bent back with their distance from the nose."""
    return points - np.array([0, 0, 1]) * (2.2 * points[..., :1] ** 2)


def _pane(width: float, height: float, square: float, side: int) -> Part:
    """A lens: its front is domed, so that it mirrors a lamp in a spot and not as a whole."""
    back = _rim(width, height, square, side) - [0, 0, 0.001]
    front = [
        _rim(share * width, share * height, square, side) + [0, 0, 0.001 + 0.005 * (1 - share**2)]
        for share in (1, 0.8, 0.55, 0.3, 0.1)
    ]
    return loft(np.stack([back, *front]), LENS)


def _temple(side: int, hinge: tuple[float, float, float], half: tuple, material: Material) -> Part:
    """An arm from the hinge over the ear; `half`: half widths and half heights along it."""
    x, y, z = hinge
    path = spline(
        [
            (x, y, z),
            (0.078, y + 0.001, -0.06),
            (0.079, y - 0.002, -0.1),
            (0.077, y - 0.02, -0.128),
            (0.074, y - 0.042, -0.138),
        ],
        20,
    )
    sizes = np.array([np.interp(np.linspace(0, 1, 20), [0, 0.5, 1], column) for column in half]).T
    return tube(path * [side, 1, 1], sizes, material, LEFT, 10)


def _camera(at: tuple[float, float, float], radius: float) -> Part:
    profile = [
        (0, 0),
        (radius, 0),
        (radius, 0.004),
        (0.7 * radius, 0.0045),
        (0.6 * radius, 0.0035),
        (0, 0.004),
    ]
    return revolve([(profile, EYE)], 16).moved(shift=at)


def _classic() -> list[Part]:
    parts = []
    for side in (-1, 1):
        rim = _rim(0.056, 0.042, 0.75, side)
        parts.append(tube(rim, (0.0038, 0.0036), BLACK, (0, 0, 1), 8, around=True, crease=0.9))
        parts.append(_pane(0.054, 0.04, 0.75, side))
        parts.append(
            box((0.012, 0.014, 0.012), 0.003, BLACK).moved(
                turn("y", 18 * side), (side * 0.066, 0.011, -0.0125)
            )
        )
        half = ((0.0045, 0.0042, 0.003), (0.0085, 0.0075, 0.0045))
        parts.append(_temple(side, (0.0705, 0.01, -0.016), half, BLACK))
        pod = box((0.011, 0.022, 0.05), 0.004, GREY).moved(
            turn("y", 7 * side), (side * 0.0765, 0.008, -0.05)
        )
        parts.append(pod)
    bridge = spline([(-0.01, 0.009, 0), (0, 0.012, 0.003), (0.01, 0.009, 0)], 8)
    parts.append(tube(bridge, (0.003, 0.0045), BLACK, UP, 8))
    parts.append(_camera((-0.067, 0.016, -0.0085), 0.0032))
    parts.append(_camera((0.067, 0.016, -0.0085), 0.0032))
    return parts


def _round() -> list[Part]:
    gold = Material(paint("#c9a24a"), specular=0.8, shininess=60, infrared=0.6)
    parts = []
    for side in (-1, 1):
        parts.append(tube(_rim(0.05, 0.05, 0, side), 0.0017, gold, (0, 0, 1), 8, around=True))
        half = ((0.0016, 0.0016, 0.002), (0.002, 0.002, 0.003))
        parts.append(_temple(side, (0.062, 0.008, -0.0075), half, gold))
        pad = ellipsoid((0.0025, 0.006, 0.0035), CHROME, (side * 0.0105, -0.012, -0.0085), 1)
        parts.append(pad)
    bridge = spline([(-0.0105, 0.0085, 0), (0, 0.0135, 0.002), (0.0105, 0.0085, 0)], 10)
    parts.append(tube(bridge, 0.0019, gold, UP, 8))
    parts.append(box((0.014, 0.02, 0.03), 0.005, BLACK, 3).moved(shift=(-0.0725, 0.008, -0.014)))
    parts.append(_camera((-0.0725, 0.009, 0.0), 0.0052))
    parts.append(box((0.008, 0.016, 0.055), 0.003, GREY).moved(shift=(-0.082, 0.007, -0.062)))
    return parts


def _visor() -> list[Part]:
    shell = Material(paint("#35373c"), specular=0.12, shininess=30, infrared=0.22)
    band = Material(paint("#6f7278"), specular=0.1, infrared=0.4)
    turns = np.linspace(-1.08, 1.08, 30)
    middle = np.stack([0.0775 * np.sin(turns), 0 * turns, 0.078 * (np.cos(turns) - 1) + 0.014], -1)
    outward = np.stack([np.sin(turns), 0 * turns, np.cos(turns)], -1)
    nose = 0.016 * np.exp(-((turns / 0.24) ** 2))
    low, high = -0.031 + nose + 0.006 * turns**2, np.full(30, 0.023)
    heights = np.array([0.0, 0.06, 0.28, 0.5, 0.72, 0.94, 1.0, 1.0, 0.5, 0.0])
    depth = np.append(0.008 * (heights * (1 - heights) * 4)[:7], [-0.0022, -0.0015, -0.0022])
    y = low[:, None] + heights * (high - low)[:, None]
    rings = middle[:, None] + depth[:, None] * outward[:, None]
    rings[..., 1] = y
    parts = [loft(rings, LENS)]
    brow = middle + [0, 0.031, -0.003]
    parts.append(tube(brow, (0.0085, 0.0105), shell, UP, 12))
    loop = np.linspace(0.9, 2 * np.pi - 0.9, 34)
    around = np.stack(
        [
            0.0855 * np.sin(loop),
            0.034 + 0.012 * (1 - np.cos(loop)) / 2,
            0.108 * np.cos(loop) - 0.094,
        ],
        -1,
    )
    parts.append(tube(around, (0.0035, 0.0095), band, UP, 8))
    parts.append(box((0.07, 0.036, 0.02), 0.007, shell, 3).moved(shift=(0, 0.046, -0.208)))
    for side in (-1, 1):
        pod = box((0.018, 0.03, 0.06), 0.006, shell, 3)
        parts.append(pod.moved(turn("y", 8 * side), (side * 0.0835, 0.027, -0.058)))
        parts.append(_camera((side * 0.034, 0.032, 0.0065), 0.0042))
    parts.append(_camera((0, 0.032, 0.0155), 0.0055))
    return parts


def _prism() -> list[Part]:
    titan = Material(paint("#aeb4ba"), specular=0.6, shininess=40, infrared=0.5)
    shell = Material(paint("#e2ded4"), specular=0.3, shininess=30, infrared=0.7)
    turns = np.linspace(-1, 1, 24)
    brow = _wrapped(np.stack([0.068 * turns, 0.02 + 0.003 * np.cos(3 * turns), 0 * turns], -1))
    parts = [tube(brow, (0.0026, 0.0032), titan, UP, 8)]
    half = ((0.002, 0.002, 0.0025), (0.003, 0.003, 0.0045))
    for side in (-1, 1):
        parts.append(_temple(side, (0.067, 0.0175, -0.009), half, titan))
        arm = spline(
            [
                (side * 0.01, 0.021, 0),
                (side * 0.0085, 0.008, -0.002),
                (side * 0.0105, -0.008, -0.0075),
            ],
            8,
        )
        parts.append(tube(arm, 0.0016, titan, (0, 0, 1), 8))
        parts.append(ellipsoid((0.0025, 0.0065, 0.0035), GREY, (side * 0.0108, -0.011, -0.0085), 1))
    parts.append(
        box((0.015, 0.02, 0.088), 0.006, shell, 3).moved(turn("y", -5), (-0.081, 0.012, -0.042))
    )
    parts.append(box((0.0135, 0.028, 0.034), 0.006, shell, 3).moved(shift=(-0.081, 0.002, -0.118)))
    parts.append(
        box((0.036, 0.015, 0.013), 0.004, shell).moved(turn("y", -14), (-0.0665, 0.0165, 0.003))
    )
    parts.append(
        box((0.022, 0.0125, 0.0115), 0.002, LENS).moved(turn("y", -10), (-0.0395, 0.0155, 0.0085))
    )
    parts.append(_camera((-0.071, 0.0165, 0.0085), 0.0045))
    return parts


_BUILDERS: dict[str, Callable[[], list[Part]]] = {
    "classic": _classic,
    "round": _round,
    "visor": _visor,
    "prism": _prism,
}
GLASSES = tuple(_BUILDERS)
