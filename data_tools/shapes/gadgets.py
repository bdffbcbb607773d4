"""Cameras and laptops: z up, lens and screen facing -y."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, on_plane, paint, random_paint, turn
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import box, ellipsoid, revolve, tube

__all__ = ["camera", "laptop"]

STEEL = Material(
    paint("#c9c9cd"), paint("#a2a2a8"), "brushed", 40, 0.6, 40, infrared=0.6, second_infrared=0.5
)
BLACK = Material(
    paint("#232326"), paint("#3a3a3e"), "noise", 60, 0.25, 25, infrared=0.12, second_infrared=0.2
)
GLASS = Material(paint("#14122a"), specular=0.9, shininess=120, infrared=0.05)


def laptop(rng: np.random.Generator) -> list[Part]:
    """An open laptop; hinge at the back, 80 to 135 degrees open."""
    width = rng.uniform(0.26, 0.36)
    depth, thick = width * rng.uniform(0.62, 0.74), rng.uniform(0.012, 0.02)
    lid_thick, opening = rng.uniform(0.005, 0.008), rng.uniform(80, 135)
    grey = rng.uniform(0.03, 0.6)
    tint = np.array([1.0, rng.uniform(0.9, 1.0), rng.uniform(0.85, 1.05)])
    tone = tuple(np.clip(grey * tint, 0, 1).tolist())
    shell = Material(
        tone, tuple(0.8 * c for c in tone), "brushed", 25, 0.3, 40, infrared=0.2 + 0.5 * grey
    )
    keys = Material(
        paint("#141416"), paint("#3c3c42"), "keyboard", infrared=0.08, second_infrared=0.2
    )
    if rng.random() < 0.35:
        keys = Material(
            paint("#2c2c30"), paint("#d2d2cf"), "keyboard", infrared=0.1, second_infrared=0.5
        )
    paper = random_paint(rng, (0.4, 0.9), (0.2, 0.5))
    ink = random_paint(rng, (0.0, 0.35), (0.85, 1.0))
    picture = Material(paper, ink, "screen", 1, 0.5, 90, 0.05, seed=int(rng.integers(1000)))
    bezel = Material(paint("#101012"), specular=0.3, infrared=0.06)
    wide, deep = 0.9 * width, rng.uniform(0.45, 0.52) * depth  # the field of keys
    middle = rng.uniform(0.1, 0.13) * depth
    keys = on_plane(keys, (-wide / 2, middle - deep / 2, 0), (wide, 0, 0), (0, deep, 0))
    pad = box(
        (rng.uniform(0.25, 0.36) * width, 0.26 * depth, 0.0012),
        0.0005,
        Material(tuple(0.35 * c for c in tone), specular=0.3, infrared=0.2),
    )
    base = [
        box((width, depth, thick), 0.004, shell, 3),
        _under_pattern(box((wide, deep, 0.002), 0.0008, keys), (0, middle, thick / 2)),
        pad.moved(shift=(0, -0.32 * depth, thick / 2)),
    ]
    # The lid stands on the hinge, its screen facing -y, and is then swung back.
    border = rng.uniform(0.006, 0.014)
    across, high = width - 2 * border, depth - 3 * border
    screen = on_plane(picture, (-across / 2, 0, 2 * border), (across, 0, 0), (0, 0, high))
    frame = box((width - 0.006, 0.001, depth - 0.006), 0.0004, bezel)
    sheet = box((across, 0.001, high), 0.0004, screen)
    ends = np.array([[-0.35 * width, 0, 0], [0.35 * width, 0, 0]])
    lid = [
        box((width, lid_thick, depth), 0.0024, shell, 3).moved(shift=(0, 0, depth / 2)),
        frame.moved(shift=(0, -lid_thick / 2, depth / 2)),
        _under_pattern(sheet, (0, -lid_thick / 2 - 0.0006, 2 * border + high / 2)),
        tube(ends, 0.45 * lid_thick + 0.002, bezel, (0, 0, 1), 12),
    ]
    hinge = (0, depth / 2 - 0.003, thick / 2 + 0.002)
    return base + [part.moved(turn("x", 90 - opening), hinge) for part in lid]


def _under_pattern(part: Part, shift: tuple[float, float, float]) -> Part:
    """A part shifted under its pattern, which is already in place."""
    return replace(part, vertices=part.vertices + shift)


def camera(rng: np.random.Generator) -> list[Part]:
    """A reflex camera, a range finder or a compact, with a lens of any length."""
    width, height = rng.uniform(0.1, 0.145), rng.uniform(0.062, 0.088)
    depth = rng.uniform(0.03, 0.045)
    barrel, reach = height * rng.uniform(0.33, 0.45), rng.uniform(0.018, 0.075)
    leather = BLACK
    if rng.random() < 0.45:
        leather = replace(BLACK, colour=random_paint(rng, (0.4, 0.8), (0.2, 0.6)), infrared=0.35)
    plate = STEEL if rng.random() < 0.5 else BLACK
    x = rng.uniform(-0.14, 0.06) * width
    parts = [
        box((width, depth, 0.74 * height), 0.006, leather).moved(shift=(0, 0, -0.1 * height)),
        box((width, depth, 0.3 * height), 0.006, plate).moved(shift=(0, 0, 0.36 * height)),
        box((1.001 * width, 1.002 * depth, 0.12 * height), 0.0035, plate).moved(
            shift=(0, 0, -0.44 * height)
        ),
    ]
    rubber = Material(paint("#1c1c1e"), paint("#3d3d40"), "ribs", specular=0.3, infrared=0.1)
    smooth = Material(paint("#26262a"), specular=0.5, shininess=40, infrared=0.12)
    steps = [0.0, 0.28, 0.32, 0.62, 0.66, 1.0]
    radii = np.array([1.0, 1.0, 0.92, 0.92, 1.0, 1.0]) * barrel
    side = [(r, s * reach) for r, s in zip(radii, steps, strict=True)]
    front = [(radii[-1], reach), (0.9 * barrel, reach), (0.8 * barrel, 0.86 * reach)]
    pane = [
        (0.8 * barrel * np.cos(a), 0.86 * reach + 0.16 * barrel * np.sin(a))
        for a in np.linspace(0, np.pi / 2, 6)
    ]
    pane[-1] = (0, pane[-1][1])
    strips = [
        ([(0, 0), side[0]], smooth),
        (side[:2], smooth),
        (side[1:4], rubber),
        (side[3:], smooth),
        (front, smooth),
        (pane, GLASS),
    ]
    lens = revolve(strips, 36).moved(turn("x", 90), (x, -depth / 2 + 0.001, -0.04 * height))
    parts.append(lens)
    kind = rng.integers(3)
    if kind == 0:  # a reflex camera: prism over the lens, grip on the wearer's right
        hump = box((0.36 * width, 0.85 * depth, 0.34 * height), 0.007, plate)
        parts.append(
            hump.bent(lambda v: v * (1 - [0.35, 0.2, 0] * (v[:, 2:] > 0))).moved(
                shift=(x, 0, 0.6 * height)
            )
        )
        parts.append(
            box((0.2 * width, 0.5 * depth, 0.9 * height), 0.007, BLACK).moved(
                shift=(-0.41 * width, -0.5 * depth, 0)
            )
        )
    elif kind == 1:  # a range finder: windows and a hot shoe
        for where in (-0.05, 0.36):
            window = box((0.14 * width, 0.004, 0.15 * height), 0.0015, GLASS)
            parts.append(window.moved(shift=(where * width, -depth / 2, 0.36 * height)))
        parts.append(
            box((0.16 * width, 0.5 * depth, 0.004), 0.0015, STEEL).moved(
                shift=(x, 0, 0.52 * height)
            )
        )
    else:  # a compact with a flash
        flash = Material(paint("#e6e4d8"), specular=0.6, shininess=60, infrared=0.7)
        parts.append(
            box((0.2 * width, 0.004, 0.14 * height), 0.0015, flash).moved(
                shift=(0.34 * width, -depth / 2, 0.34 * height)
            )
        )
    knob = Material(paint("#8d8d92"), paint("#505054"), "ribs", specular=0.6, infrared=0.4)
    for where, size, rise in (
        (-0.4, 0.007, 0.006),
        (0.38, rng.uniform(0.008, 0.012), 0.007),
        (0.2, 0.005, 0.008),
    ):
        profile = [(0, 0), (size, 0), (size, 0.8 * rise), (0.85 * size, rise), (0, rise)]
        parts.append(revolve([(profile, knob)], 24).moved(shift=(where * width, 0, 0.5 * height)))
    parts.append(ellipsoid((0.007, 0.003, 0.005), GLASS, (x, depth / 2, 0.42 * height), 1))
    return parts
