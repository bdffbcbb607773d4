"""Instants of the `headset` world in other light, as a dataset.

night = Redrawn(range(20), split="test", daylight=0.0, light="visible")
data = data_tools.batches.load(night)
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from data_tools.views import Dataset, View
from data_tools.worlds.headset import CAMERAS, WORLD, draw
from data_tools.worlds.world import WorldModels
from posecore.arrays import require_integer

__all__ = ["Redrawn"]


class Redrawn(Dataset):
    """Instants of the world drawn again in other light, such as for `data_tools.batches.load`.

    A view is drawn when it is asked for, in about the time that making it took.

    Args:
        indices: of the instants; their views follow one another, left, centre and right.
        conditions: what `draw` takes besides: `split`, and `scale`, `daylight`, `gain`, ...

    Raises:
        ValueError: naming the argument that does not fit; what `draw` refuses, when it draws.
    """

    def __init__(self, indices: Iterable[int], **conditions: Any) -> None:
        self.indices = [require_integer("indices", index, 0) for index in indices]
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
        """The glasses' meshes and what is known of their shape."""
        return WORLD.models
