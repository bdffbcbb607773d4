"""Muted table tops and floors for objects to stand on."""

from __future__ import annotations

import numpy as np

from data_tools.shapes.building import paint
from data_tools.shapes.mesh import Material, Mesh
from posecore.arrays import require_integer, require_number

__all__ = ["make_floor"]

# Patterns, their repeats per metre, how dark their second colour may be, and their paints.
_KINDS = {
    "planks": (7, 0.5, ("#8a6a4a", "#6f5540", "#a58a68", "#7d7468")),
    "wood": (2.5, 0.65, ("#9a7853", "#b59a76", "#6a5240", "#8c8577")),
    "tiles": (6, 0.6, ("#9c9a94", "#b4a899", "#7f8a8a", "#a58673")),
    "cloth": (4, 0.6, ("#7d8796", "#a59a92", "#6f7f74", "#8b6f6f")),
    "noise": (3, 0.7, ("#8f8f8c", "#6c7078", "#a39b8c", "#7a6f66")),
    "marble": (1.5, 0.8, ("#c8c4bc", "#9b9f9f", "#b3a9a0", "#7c807e")),
}


def make_floor(seed: int, side: float = 2.0) -> Mesh:
    """A square in the plane z = 0 around the origin, seen from above.

    Args:
        seed: which floor, at least 0; kinds come in turns.
        side: metres.

    Returns:
        a mesh of two faces, open; colours of little saturation, so that objects stand out.

    Raises:
        ValueError: if `seed` is no integer of at least 0, or `side` is not positive.
    """
    require_integer("seed", seed, 0)
    half = require_number("side", side, above=0) / 2
    rng = np.random.default_rng((55, seed))
    kind = tuple(_KINDS)[seed % len(_KINDS)]
    scale, dark, paints = _KINDS[kind]
    colour = paint(str(rng.choice(paints)))
    light = rng.uniform(0.75, 1.1)
    colour = tuple(min(1.0, light * rng.uniform(0.93, 1.07) * share) for share in colour)
    darker = tuple(rng.uniform(dark, 0.9) * share for share in colour)
    bright = float(rng.uniform(0.2, 0.6))
    material = Material(
        colour,
        darker,
        kind,
        scale * rng.uniform(0.8, 1.25),
        specular=rng.uniform(0.0, 0.15),
        infrared=bright,
        second_infrared=0.8 * bright,
        seed=int(rng.integers(100)),
    )
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    return Mesh(
        name=f"{kind} floor",
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        corner_normals=np.broadcast_to(np.float32([0, 0, 1]), (2, 3, 3)).copy(),
        material=np.zeros(2, np.int16),
        materials=(material,),
        closed=np.zeros(2, bool),
    )
