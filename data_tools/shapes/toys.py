"""A duck, a car, a drill and a cat: z up; duck and cat face -y, car and drill -x."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_tools.shapes.building import Part, on_plane, paint, turn
from data_tools.shapes.implicit import ball, below, blend, carve, limb, skin
from data_tools.shapes.mesh import Material
from data_tools.shapes.pieces import box, ellipsoid, revolve, spline, tube

__all__ = ["STEEL", "car", "cat", "drill", "duck"]

STEEL = Material(paint("#c4c4c8"), specular=0.6, shininess=40, infrared=0.6)
SHINY_BLACK = Material(paint("#101012"), specular=0.8, shininess=90, infrared=0.05)
RUBBER = Material(paint("#1d1d1f"), paint("#38383b"), "noise", 40, 0.15, infrared=0.08)


def duck() -> list[Part]:
    """A rubber duck."""
    yellow = Material(paint("#f6c51c"), paint("#e9a313"), "noise", 8, 0.4, 40, 0.7, seed=3)
    orange = Material(paint("#e8641b"), specular=0.4, shininess=40, infrared=0.6)
    white = Material(paint("#f4f1e6"), specular=0.5, shininess=60, infrared=0.7)
    shape = blend(
        [
            ball((0, 0.01, 0.036), (0.041, 0.054, 0.034)),
            limb((0, 0.045, 0.045), (0, 0.073, 0.068), 0.022, 0.006),
            limb((0, -0.02, 0.05), (0, -0.026, 0.075), 0.024),
            ball((0, -0.03, 0.09), (0.029, 0.03, 0.028)),
        ],
        0.02,
    )
    body = skin(
        carve(shape, [below(0.006)], 0.004),
        (-0.06, -0.08, -0.01),
        (0.06, 0.1, 0.13),
        0.0045,
        yellow,
    )
    parts = [body]
    for side in (-1, 1):
        wing = blend(
            [
                ball((side * 0.037, 0.012, 0.042), (0.009, 0.03, 0.017)),
                limb((side * 0.04, 0.03, 0.05), (side * 0.043, 0.05, 0.06), 0.009, 0.003),
            ],
            0.015,
        )
        low, high = sorted((side * 0.02, side * 0.06))
        parts.append(
            skin(
                wing,
                (low - 0.005, -0.03, 0.01),
                (high + 0.005, 0.07, 0.08),
                0.004,
                replace(yellow, colour=paint("#eeb414")),
            )
        )
        parts.append(ellipsoid((0.0075, 0.004, 0.0085), white, (side * 0.0135, -0.0545, 0.099), 1))
        parts.append(
            ellipsoid((0.004, 0.003, 0.005), SHINY_BLACK, (side * 0.013, -0.0575, 0.0995), 1)
        )

    def curved(v: np.ndarray) -> np.ndarray:
        """The tip of the beak, at -y, turned up."""
        return v + np.array([0, 0, 16]) * (np.minimum(v[:, 1:2], 0) ** 2)

    upper = ellipsoid((0.017, 0.021, 0.0055), orange).bent(curved)
    lower = ellipsoid((0.013, 0.014, 0.004), replace(orange, colour=paint("#c94d12")))
    parts.append(upper.moved(shift=(0, -0.062, 0.085)))
    parts.append(lower.moved(shift=(0, -0.059, 0.079)))
    return parts


def car() -> list[Part]:
    """A toy car with a spoiler and a name on its roof."""
    red = Material(paint("#c42f2b"), specular=0.5, shininess=70, infrared=0.55)
    white = Material(paint("#f0ede4"), specular=0.4, shininess=50, infrared=0.75)
    glass = Material(paint("#20303c"), specular=0.8, shininess=100, infrared=0.06)
    lamp = Material(paint("#fbe9a4"), specular=0.6, shininess=60, infrared=0.7)
    tail = Material(paint("#7e1414"), specular=0.5, infrared=0.4)
    number = on_plane(
        Material(
            paint("#f0ede4"), paint("#26436f"), "print", seed=4, infrared=0.7, second_infrared=0.3
        ),
        (0.022, -0.032, 0),
        (0, 0.064, 0),
        (-0.044, 0, 0),
    )
    chassis = box((0.142, 0.064, 0.026), 0.009, red, 3)
    chassis = chassis.bent(
        lambda v: v * (1 - [0, 1.1, 1.6] * np.maximum(np.abs(v[:, :1]) - 0.045, 0) * 2)
    )
    cabin = box((0.078, 0.056, 0.03), 0.007, glass, 3)
    cabin = cabin.bent(lambda v: v * (1 + [-0.28, -0.16, 0] * (v[:, 2:] > 0)))
    roof = box((0.05, 0.044, 0.007), 0.003, number, 2)
    parts = [
        chassis.moved(shift=(0, 0, 0.027)),
        cabin.moved(shift=(0.014, 0, 0.051)),
        roof.moved(shift=(0.014, 0, 0.0665)),
        box((0.012, 0.066, 0.008), 0.003, white).moved(shift=(-0.069, 0, 0.019)),
        box((0.012, 0.066, 0.008), 0.003, white).moved(shift=(0.069, 0, 0.019)),
        box((0.014, 0.06, 0.003), 0.0013, red).moved(turn("y", 14), (0.07, 0, 0.054)),
        box((0.03, 0.014, 0.003), 0.001, white).moved(shift=(-0.045, 0, 0.0395)),
    ]
    profile = [
        (0, 0),
        (0.009, 0),
        (0.0145, 0.001),
        (0.017, 0.003),
        (0.017, 0.011),
        (0.0145, 0.013),
        (0.0102, 0.013),
    ]
    hub = [(0.0102, 0.013), (0.0095, 0.0115), (0.003, 0.0125), (0, 0.0125)]
    for side in (-1, 1):
        for x in (-0.042, 0.044):
            wheel = revolve([(profile, RUBBER), (hub, white)], 24)
            parts.append(wheel.moved(turn("x", 90 if side < 0 else -90), (x, side * 0.024, 0.017)))
        parts.append(
            box((0.004, 0.004, 0.016), 0.0015, red, 1).moved(shift=(0.062, side * 0.022, 0.046))
        )
        parts.append(ellipsoid((0.004, 0.0075, 0.0075), lamp, (-0.0695, side * 0.021, 0.03), 2))
        parts.append(ellipsoid((0.003, 0.008, 0.004), tail, (0.0705, side * 0.021, 0.03), 1))
    return parts


def drill() -> list[Part]:
    """A cordless drill."""
    yellow = Material(paint("#e8b416"), paint("#d9a010"), "noise", 10, 0.3, 30, 0.6, seed=8)
    grip = Material(
        paint("#222325"), paint("#3d3e41"), "stripes", 130, 0.2, infrared=0.1, second_infrared=0.2
    )
    dark = Material(paint("#2b2c2f"), paint("#4c4d52"), "ribs", specular=0.4, infrared=0.15)
    red = Material(paint("#b3261e"), specular=0.3, infrared=0.45)
    back = [(0, 0), (0.018, 0.002), (0.026, 0.01), (0.0275, 0.022)]
    shell = [(0.0275, 0.022), (0.0285, 0.05), (0.027, 0.092), (0.022, 0.102)]
    collar = [(0.022, 0.102), (0.0215, 0.112), (0.019, 0.114), (0.0185, 0.137), (0.012, 0.15)]
    bit = [(0.012, 0.15), (0.0035, 0.151), (0.0032, 0.172), (0, 0.178)]
    motor = revolve([(back, dark), (shell, yellow), (collar, dark), (bit, STEEL)], 36)
    motor = motor.moved(turn("y", -90), (0.07, 0, 0.165))  # the bit points to -x
    path = spline([(0.03, 0, 0.16), (0.036, 0, 0.11), (0.044, 0, 0.06), (0.047, 0, 0.035)], 14)
    half = np.column_stack(
        [np.interp(np.arange(14), [0, 5, 13], [0.022, 0.0175, 0.02]), np.full(14, 0.0155)]
    )
    sign = Material(paint("#e8b416"), paint("#1b1b1d"), "print", 1, 0.3, 30, 0.6, 0.1, seed=7)
    sign = on_plane(sign, (-0.022, -0.02, -0.011), (0.048, 0, 0), (0, 0, 0.021))
    plate = box((0.05, 0.004, 0.023), 0.0015, sign)
    parts = [
        motor,
        tube(path, half, grip, (0, 1, 0), 18),
        box((0.052, 0.042, 0.016), 0.005, yellow).moved(shift=(0.042, 0, 0.034)),
        box((0.088, 0.052, 0.032), 0.007, RUBBER, 3).moved(shift=(0.038, 0, 0.013)),
        box((0.02, 0.012, 0.026), 0.004, red).moved(turn("y", 8), (0.012, 0, 0.123)),
        plate.moved(shift=(0.018, -0.0262, 0.166)),
        box((0.014, 0.034, 0.006), 0.002, red).moved(shift=(0.03, 0, 0.1375)),
        box((0.03, 0.016, 0.005), 0.002, dark).moved(shift=(0.02, 0, 0.193)),
    ]
    return parts


def cat() -> list[Part]:
    """A sitting cat, its tail around its left side."""
    coat = Material(paint("#cb8a45"), paint("#82491d"), "tabby", 55, 0.08, 15, 0.55, 0.35, seed=2)
    white = Material(paint("#efe6d6"), specular=0.08, infrared=0.7)
    pink = Material(paint("#c77b72"), specular=0.3, infrared=0.6)
    green = Material(paint("#8bb43c"), specular=0.8, shininess=90, infrared=0.3)
    torso = [
        ball((0, 0.018, 0.036), (0.038, 0.042, 0.036)),
        limb((0, 0.008, 0.05), (0, -0.012, 0.09), 0.031, 0.022),
        ball((0, -0.022, 0.118), (0.03, 0.027, 0.025)),
        ball((0, -0.01, 0.026), (0.026, 0.022, 0.026)),
    ]
    limbs = [
        limb((side * x0, y0, z0), (side * x1, y1, z1), r0, r1)
        for side in (-1, 1)
        for x0, y0, z0, x1, y1, z1, r0, r1 in (
            (0.014, -0.02, 0.075, 0.0145, -0.036, 0.008, 0.0135, 0.0095),
            (0.027, 0.022, 0.025, 0.031, 0.002, 0.02, 0.021, 0.017),
            (0.033, 0.0, 0.009, 0.033, -0.028, 0.007, 0.0095, 0.0085),
            (0.018, -0.02, 0.131, 0.0235, -0.018, 0.15, 0.0115, 0.0025),
        )
    ]
    shape = carve(blend([*torso, *limbs], 0.012), [below(0)], 0.003)
    parts = [skin(shape, (-0.065, -0.07, -0.01), (0.065, 0.075, 0.165), 0.005, coat)]
    curl = [
        (0.02, 0.05, 0.013),
        (0.055, 0.05, 0.012),
        (0.07, 0.015, 0.0115),
        (0.058, -0.02, 0.011),
        (0.036, -0.044, 0.011),
    ]
    thick = np.interp(np.arange(24), [0, 19, 22, 23], [0.0115, 0.0105, 0.007, 0.001])
    parts.append(tube(spline(curl, 24), thick, coat, (0, 0, 1), 12))
    parts.append(ellipsoid((0.016, 0.01, 0.019), white, (0, -0.029, 0.083), 2))
    parts.append(ellipsoid((0.0025, 0.002, 0.0018), pink, (0, -0.0562, 0.1165), 1))
    for side in (-1, 1):
        parts.append(ellipsoid((0.0075, 0.008, 0.0065), white, (side * 0.0055, -0.0475, 0.111), 2))
        parts.append(
            ellipsoid((0.0058, 0.0035, 0.0058), green, (side * 0.0125, -0.0435, 0.1235), 2)
        )
        parts.append(
            ellipsoid((0.0021, 0.002, 0.0048), SHINY_BLACK, (side * 0.0128, -0.0462, 0.1235), 1)
        )
        parts.append(ellipsoid((0.0095, 0.0095, 0.007), white, (side * 0.0145, -0.0385, 0.007), 2))
    return parts
