"""People in a car: heads that differ by seed, the torso under the neck, and the seat behind.

All meshes are in the frame of the glasses that the person wears (`data_tools.shapes.glasses`): put
the head at the pose of the glasses, and the torso and the seat where the head would be if it looked
straight ahead. The head turns about `PIVOT`, where neck and skull meet, and stays on its neck.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_tools.shapes.building import assemble, paint
from data_tools.shapes.cabin import PIVOT, make_seat, torso
from data_tools.shapes.faces import Proportions, ears, eyes, face, head_shape, lips
from data_tools.shapes.glasses import MODELLED
from data_tools.shapes.hair import BEARDS, HAIR, grow_beard, grow_hair
from data_tools.shapes.mesh import Material, Mesh
from posecore.arrays import require_integer

__all__ = ["BEARDS", "HAIR", "PIVOT", "Subject", "make_seat", "make_subject"]

# Skins and hair from light to dark; in infrared skins are all bright, and hair is brighter than it
# looks, so there the shades are drawn on their own.
SKINS = ("#f3d3bd", "#e8b998", "#d39c76", "#b37a52", "#8b5a3a", "#5c3a26")
HAIRS = ("#17130f", "#2c1d13", "#8f8c88", "#543621", "#8a5a2e", "#c79f58", "#dcd8d0", "#7a2f16")


@dataclass(frozen=True, eq=False)
class Subject:
    """One person.

    Attributes:
        head: with hair, beard and ears; moves with the glasses.
        torso: neck, shoulders and clothes; stays in the seat.
        hair: one of `HAIR`.
        beard: one of `BEARDS`.
    """

    head: Mesh
    torso: Mesh
    hair: str
    beard: str


def make_subject(seed: int) -> Subject:
    """A person; hair and beards come in turns, so that seeds next to each other look different.

    Args:
        seed: which person, at least 0.

    Returns:
        head of 7 000 to 13 000 faces, torso of 3 000 to 4 500.

    Raises:
        ValueError: if `seed` is not an integer of at least 0.
    """
    require_integer("seed", seed, 0)
    rng = np.random.default_rng((77, seed))
    hair = HAIR[(seed * 3 + seed // 8) % len(HAIR)]
    beard = "none"
    if hair not in ("long", "bun"):
        beard = BEARDS[(seed + seed // 4) % len(BEARDS)]
    shape = Proportions(
        width=rng.uniform(0.94, 1.05),
        height=rng.uniform(0.92, 1.08),
        depth=rng.uniform(0.95, 1.05),
        jaw=rng.uniform(0.82, 1.14) * (0.92 if hair in ("long", "bun") else 1.0),
        nose=rng.uniform(0.7, 1.35),
        chin=rng.uniform(0.8, 1.2),
        cheeks=rng.uniform(0.7, 1.3),
    )
    tone = rng.integers(len(SKINS))
    colour = paint(SKINS[tone])
    shade = paint(HAIRS[rng.integers(len(HAIRS) if tone < 3 else 3)])
    flesh = Material(
        colour,
        tuple(np.minimum(np.multiply(shade, 0.35), np.multiply(colour, 0.3)).tolist()),
        specular=0.12,
        shininess=15,
        infrared=float(rng.uniform(0.5, 0.68)),
        second_infrared=0.18,
        seed=2 * int(rng.integers(50)) + (beard == "stubble"),
    )
    hair_bright = float(rng.uniform(0.1, 0.32))
    strands = Material(
        shade,
        tuple(0.45 * c for c in shade),
        "strands",
        28,
        0.06,
        20,
        hair_bright,
        0.6 * hair_bright,
        seed=seed % 100,
    )
    head = head_shape(shape)
    parts = [face(head, shape, flesh), *eyes(flesh, rng), *ears(shape, flesh)]
    parts += lips(shape, flesh, 0.006 if beard == "full" else 0.0)
    parts += grow_hair(hair, head, shape, strands, rng)
    parts += grow_beard(beard, head, shape, strands)
    return Subject(
        assemble(f"head {seed}", parts, MODELLED, centre=False),
        assemble(f"torso {seed}", torso(flesh, rng), MODELLED, centre=False),
        hair,
        beard,
    )
