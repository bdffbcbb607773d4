"""Six categories with real variation inside each: bottle, bowl, camera, can, laptop, mug.

Canonical frames are shared within a category, as in NOCS (Wang et al., 2019): the origin is the
middle of the bounding box, y is up, and z is the front: the lens of a camera and the screen and
keys of a laptop face +z. The handle of a mug points along +x.

Bottle, bowl and can are flagged as solids of revolution about y, and so they are but for their
print: as in NOCS the symmetry is one of shape, whatever the label shows. A mug has none, though
without its handle in sight it looks as if it had.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data_tools.shapes.building import Part, assemble, turn, turns
from data_tools.shapes.gadgets import camera, laptop
from data_tools.shapes.mesh import Mesh
from data_tools.shapes.vessels import bottle, bowl, can, mug
from posecore.arrays import require_choice, require_integer

__all__ = ["CATEGORIES", "make_category"]

TURNS = 36  # steps in which a solid of revolution is turned
_BUILDERS: dict[str, Callable[[np.random.Generator], list[Part]]] = {
    "bottle": bottle,
    "bowl": bowl,
    "camera": camera,
    "can": can,
    "laptop": laptop,
    "mug": mug,
}
CATEGORIES = tuple(_BUILDERS)


def make_category(category: str, seed: int) -> Mesh:
    """An instance of a category.

    Args:
        category: one of `CATEGORIES`.
        seed: which instance, at least 0.

    Returns:
        its mesh: 2 000 to 6 000 faces, origin in the middle of the bounding box, y up, z front.

    Raises:
        ValueError: for another category or seed.
    """
    require_choice("category", category, CATEGORIES)
    require_integer("seed", seed, 0)
    rng = np.random.default_rng((CATEGORIES.index(category), seed))
    parts = _BUILDERS[category](rng)
    up = turn("x", -90)  # the parts have z up and their front at -y
    if category in ("bottle", "bowl", "can"):
        axis = (0.0, 1.0, 0.0)
        return assemble(category, parts, up, symmetries=turns(axis, TURNS), axis=axis)
    return assemble(category, parts, up)
