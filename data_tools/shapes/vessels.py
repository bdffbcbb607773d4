"""Bottles, bowls, cans and mugs: z up, the front of a label at -y, the handle of a mug at +x."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, around, paint, random_paint
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import revolve, spline, tube

__all__ = ["SECTIONS", "bottle", "bowl", "can", "mug"]

SECTIONS = 72  # around an axis of revolution
LABEL_FACING = -157.5  # degrees about z that bring a label's badge to the front
STEEL = Material(paint("#c9c9cd"), specular=0.6, shininess=40, infrared=0.6)


def _glazed(rng: np.random.Generator, patterns: tuple[str, ...]) -> Material:
    """Glazed ware in two colours."""
    pattern = str(rng.choice(patterns))
    scale = {"rings": 55, "dots": 55, "checker": 18, "petals": 1}.get(pattern, 7) * rng.uniform(
        0.8, 1.25
    )
    return Material(
        random_paint(rng),
        random_paint(rng, (0.0, 0.8), (0.5, 0.95)),
        pattern,
        scale,
        specular=0.4,
        shininess=50,
        infrared=rng.uniform(0.4, 0.7),
        seed=int(rng.integers(100)),
    )


def _printed(rng: np.random.Generator, low: float, high: float) -> Material:
    dark, light = (
        random_paint(rng, (0.5, 0.9), (0.3, 0.75)),
        random_paint(rng, (0.0, 0.25), (0.85, 1)),
    )
    first, second = (dark, light) if rng.random() < 0.6 else (light, dark)
    seed = int(rng.integers(1000))
    print_ = Material(first, second, "label", 1, 0.2, 30, 0.6, second_infrared=0.75, seed=seed)
    return around(print_, low, high, LABEL_FACING)


def bottle(rng: np.random.Generator) -> list[Part]:
    """A capped bottle, with a label or without."""
    height = rng.uniform(0.16, 0.27)
    radius = height * rng.uniform(0.125, 0.2)
    neck = rng.uniform(0.3, 0.5) * radius
    shoulder, throat = rng.uniform(0.42, 0.62), rng.uniform(0.72, 0.84)
    waist = rng.uniform(0.8, 1.0) if rng.random() < 0.4 else 1.0
    bulge = rng.uniform(0.9, 1.02)
    cap = rng.uniform(0.04, 0.08)
    body = Material(
        random_paint(rng, (0.3, 0.9), (0.2, 0.85)), specular=0.7, shininess=80, infrared=0.4
    )
    lid = Material(
        random_paint(rng), random_paint(rng), "ribs", specular=0.3, infrared=rng.uniform(0.2, 0.7)
    )
    low, high = 0.1, shoulder - 0.06
    labelled = rng.random() < 0.8
    label = _printed(rng, low * height, high * height) if labelled else body
    side = [
        (0.93 * radius, 0.0),
        (radius, 0.03 * height),
        (radius, low * height),
    ]
    middle = spline([(radius, low), (waist * radius, (low + high) / 2), (radius, high)], 9) * [
        1,
        height,
    ]
    upper = spline(
        [
            (radius, high),
            (radius * bulge, shoulder),
            (0.45 * radius * bulge + 0.55 * neck, (shoulder + throat) / 2 + 0.02),
            (1.05 * neck, throat),
            (neck, 0.92),
        ],
        15,
    ) * [1, height]
    top = [
        (neck, 0.92 * height),
        (1.25 * neck, 0.921 * height),
        (1.25 * neck, 0.92 * height + cap * height * 0.8),
        (1.1 * neck, 0.92 * height + cap * height),
        (0, 0.92 * height + cap * height),
    ]
    base = [(0, 0.008), (0.6 * radius, 0.008), (0.75 * radius, 0.0)]
    strips = [(base + side, body), (middle, label), (upper, body), (top, lid)]
    return [revolve(strips, SECTIONS)]


def bowl(rng: np.random.Generator) -> list[Part]:
    """A bowl, shallow to deep."""
    radius = rng.uniform(0.055, 0.095)
    height = radius * rng.uniform(0.45, 0.95)
    wall = rng.uniform(0.003, 0.005)
    flare, steep = rng.uniform(0.4, 0.75), rng.uniform(1.3, 2.2)
    foot = radius * rng.uniform(0.38, 0.5)
    lip = rng.uniform(0.0, 0.006) if rng.random() < 0.5 else 0.0
    base = rng.uniform(0.004, 0.012)
    s = np.linspace(0, 1, 16)
    r = foot + (radius - foot) * s**flare + lip * s**8
    z = base + (height - base) * s**steep
    outer = _glazed(rng, ("rings", "", "rings"))
    inner = replace(_glazed(rng, ("", "rings")), scale=outer.scale)
    under = [(0, base * 0.6), (foot * 0.85, base * 0.6), (foot * 0.9, 0.0), (foot, 0.0)]
    outside = np.column_stack([r, z])
    rim = [(r[-1], z[-1]), (r[-1] - 0.3 * wall, z[-1] + 0.4 * wall), (r[-1] - wall, z[-1])]
    inside = np.column_stack([r - wall, z + wall * np.linspace(1, 0, 16)])[::-1]
    bottom = [tuple(inside[-1]), (0, inside[-1, 1] - 0.0005)]
    return [
        revolve(
            [(under, outer), (outside, outer), (rim, inner), (inside, inner), (bottom, inner)],
            SECTIONS,
        )
    ]


def can(rng: np.random.Generator) -> list[Part]:
    """A can for drinks, soup or fish."""
    kind = ("drink", "soup", "fish")[rng.integers(3)]
    radius = {"drink": 0.031, "soup": 0.036, "fish": 0.043}[kind] * rng.uniform(0.88, 1.12)
    height = radius * {"drink": 3.7, "soup": 2.75, "fish": 1.0}[kind] * rng.uniform(0.75, 1.25)
    taper = rng.uniform(0.76, 0.88) if kind == "drink" else 0.97
    end = min(0.012, 0.18 * height)
    label = _printed(rng, end, height - end)
    base = [(0, 0.004), (0.75 * radius, 0.003), (0.85 * taper * radius, 0.0), (taper * radius, 0.0)]
    foot = [(taper * radius, 0.0), (0.985 * radius, 0.6 * end), (radius, end)]
    rows = np.linspace(end, height - end, 14 if kind != "soup" else 26)
    ribs = 0.0006 * (kind == "soup")  # metres deep
    side = np.column_stack([radius + ribs * np.sin(np.linspace(0, 12 * np.pi, len(rows))), rows])
    side[[0, -1], 0] = radius
    head = [
        (radius, height - end),
        (0.985 * radius, height - 0.6 * end),
        (taper * radius, height - 0.0015),
    ]
    edge = taper * radius
    lid = [
        (edge, height - 0.0015),
        (edge + 0.0008, height - 0.0007),
        (edge, height),
        (edge - 0.0022, height),
        (edge - 0.003, height - 0.004),
        (0.72 * edge, height - 0.004),
        (0.68 * edge, height - 0.003),
        (0.35 * edge, height - 0.003),
        (0.3 * edge, height - 0.004),
        (0, height - 0.004),
    ]
    strips = [(base, STEEL), (foot, STEEL), (side, label), (head, STEEL), (lid, STEEL)]
    return [revolve(strips, SECTIONS)]


def mug(rng: np.random.Generator) -> list[Part]:
    """A mug; the handle is clear of its inside."""
    radius, height = rng.uniform(0.034, 0.048), rng.uniform(0.075, 0.115)
    wall, corner = rng.uniform(0.003, 0.005), rng.uniform(0.004, 0.012)
    foot, belly = rng.uniform(0.72, 1.05), rng.uniform(-0.12, 0.16)
    s = np.linspace(0, 1, 12)
    r = radius * (foot + (1 - foot) * s + belly * 4 * s * (1 - s))
    z = corner + (height - corner) * s
    material = _glazed(rng, ("rings", "dots", "petals", "marble", "speckle", "", "blotches"))
    inside = replace(material, pattern="", colour=random_paint(rng, (0, 0.3), (0.7, 0.95)))
    base = [
        (0, 0.002),
        (r[0] - corner - 0.003, 0.002),
        (r[0] - corner, 0.0),
        (r[0] - 0.3 * corner, 0.25 * corner),
    ]
    rim = [(r[-1], height), (r[-1] - wall / 2, height + 0.3 * wall), (r[-1] - wall, height)]
    hollow = np.column_stack([r - wall, np.maximum(z, 0.006)])[::-1]
    body = revolve(
        [
            (base, material),
            (np.column_stack([r, z]), material),
            (rim, inside),
            (hollow, inside),
            ([tuple(hollow[-1]), (0, 0.005)], inside),
        ],
        SECTIONS,
    )
    low, high = rng.uniform(0.16, 0.26) * height, rng.uniform(0.76, 0.9) * height
    out, square = rng.uniform(0.024, 0.036), rng.uniform(0.0, 1.0)
    droop = rng.uniform(-0.1, 0.15) * (high - low)
    upper, lower = high + droop * 0.3, low + max(droop, 0) * 0.6
    r_low, r_high = np.interp([lower, high], z, r) - wall / 2
    reach = max(r_low, r_high) + out
    path = spline(
        [
            (r_high, 0, high),
            (r_high + out * (0.4 + 0.35 * square), 0, upper + 0.002),
            (reach, 0, (low + high) / 2 + (high - low) * 0.2 * (1 + square) / 2 + droop),
            (reach - 0.3 * out * (1 - square), 0, low + (high - low) * 0.28),
            (r_low, 0, lower),
        ],
        22,
    )
    handle = tube(
        path,
        (rng.uniform(0.0035, 0.005), rng.uniform(0.005, 0.009)),
        replace(material, pattern=""),
        (0, 1, 0),
    )
    return [body, handle]
