"""The checks of chapter 03's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from book.tools.checks import Exercise

Inputs = Iterator[tuple]


# 1. A translation from a pixel -------------------------------------------------------------------


def translation(K: np.ndarray, pixel: np.ndarray, z: float) -> np.ndarray:
    """The point (3,) that a camera K (3, 3) sees at a pixel (2,), z metres in front of it."""
    return z * np.linalg.solve(K, [*pixel, 1.0])


def _pixels(rng: np.random.Generator) -> Inputs:
    K = np.array([[500.0, 0, 320], [0, 400, 240], [0, 0, 1]])
    yield "the principal point", K, np.array([320.0, 240]), 2.0
    yield "a pixel to the right of it", K, np.array([420.0, 240]), 2.0
    yield "a pixel below it", K, np.array([320.0, 280]), 2.0
    for _ in range(3):
        yield "a random pixel", K, rng.uniform(0, 500, 2), rng.uniform(0.5, 2)
    yield "a camera with skew", K + [[0, 30, 0], [0] * 3, [0] * 3], np.array([90.0, 70]), 1.5


check_translation = Exercise(
    translation,
    _pixels,
    hints=(
        {
            "skew": "With skew, two pixels of one column do not lie in one upright plane.",
            "": "Which point in front of the camera, 1 m away along z, is seen at this pixel?",
        },
        "Solve K X = (u, v, 1) for X; its z is 1. Then X times z is the point.",
    ),
)
