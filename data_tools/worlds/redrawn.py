"""Instants of the `headset` world in other light, or with other glasses, as a dataset.

night = Redrawn(range(20), split="test", daylight=0.0, light="visible")
data = data_tools.batches.load(night)
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from data_tools.shapes.mesh import Mesh
from data_tools.views import Dataset, View
from data_tools.worlds.headset import CAMERAS, WORLD, draw, require_glasses_scale
from data_tools.worlds.headset_scenes import worn_scaled
from data_tools.worlds.world import WorldModels
from posecore.arrays import fail, require_integer

__all__ = ["Redrawn"]


class Redrawn(Dataset):
    """Instants of the world drawn again by `draw`, such as for `data_tools.batches.load`.

    A view is drawn when it is asked for, in about the time that making it took.

    Args:
        indices: of the instants; their views follow one another, left, centre and right.
        conditions: what `draw` takes besides: `split`, and `scale`, `daylight`, `gain`, ...

    Raises:
        ValueError: naming the argument that does not fit; what `draw` refuses, when it draws.
    """

    def __init__(self, indices: Iterable[int], **conditions: Any) -> None:
        self.indices = [require_integer("indices", index, 0) for index in indices]
        if len(set(self.indices)) < len(self.indices):
            fail("indices", "each instant once", self.indices)
        require_glasses_scale(conditions.get("glasses_scale", 1.0))
        self.conditions = conditions
        self._last: tuple[int, list[View]] = (-1, [])

    def __len__(self) -> int:
        return len(self.indices) * len(CAMERAS)

    def __getitem__(self, index: int) -> View:
        row, which = divmod(range(len(self))[index], len(CAMERAS))
        if self._last[0] != row:
            self._last = (row, draw(self.indices[row], **self.conditions))
        return self._last[1][which]

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The ids of the objects, in ascending order."""
        return WORLD.object_ids

    def models(self) -> WorldModels:
        """The glasses' meshes and what is known of their shape.

        Raises:
            ValueError: if the glasses' scale is out of bounds.
        """
        scale = require_glasses_scale(self.conditions.get("glasses_scale", 1.0))
        if scale == 1:
            return WORLD.models
        return WorldModels({number: partial(_scaled, number, scale) for number in WORLD.models.ids})


def _scaled(number: int, scale: float) -> Mesh:
    return worn_scaled(number - 1, scale).mesh
