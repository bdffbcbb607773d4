"""Infrared pictures with six numbers each: the pose of the glasses in the camera's frame."""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Stack
from data_tools.batches.memory import require_bytes
from posecore.arrays import fail, require_integer
from posecore.methods.infrared.triples import brightness, first_rows, reduced
from posecore.methods.random_bins.network import pose_numbers

__all__ = ["Pictures"]


class Pictures:
    """Pictures and poses of all views, made once and kept in memory.

    Args:
        data: of infrared views, each with an object's pose; of several the first.
        image: (width, height) to which pictures are reduced.

    Attributes:
        images: (V, 1, h, w) uint8.
        values: (V, 6) float32 yaw, pitch, roll in radians and x, y, z in metres, from object to
            camera.
        object_id, view: (V,) int64 which object, and which view of the data.

    Raises:
        ValueError: if the data lack what is needed, or the pictures do not fit into memory.
    """

    def __init__(self, data: Stack, image: tuple[int, int]) -> None:
        if "ir" not in data.kinds:
            fail("data", "infrared images", ", ".join(data.kinds) or "none")
        rows = first_rows(data)
        self.view, self.object_id = torch.arange(len(data)), data.object_id[rows]
        self.values = pose_numbers(data.R[rows].float(), data.t[rows].float())
        total = len(self.view) * image[0] * image[1]
        require_bytes("data", "pictures that fit into", f"{len(self.view)} pictures", total)
        data.check(self.view)
        self.images = torch.stack(
            [
                reduced(data.image("ir", view).astype(np.float32), image)[None]
                for view in self.view.tolist()
            ]
        )

    def __len__(self) -> int:
        """How many pictures."""
        return len(self.images)

    def only(self, chosen: Tensor) -> Pictures:
        """Some of the pictures: those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        part = copy.copy(self)
        for name in ("images", "values", "object_id", "view"):
            setattr(part, name, getattr(self, name)[chosen])
        if not len(part):
            fail("chosen", "one picture or more", "none")
        return part

    def brightness(self) -> tuple[float, float]:
        """Mean and standard deviation of the pictures, of 0 to 1."""
        return brightness(self.images)

    def draw(self, count: int, *, generator: torch.Generator) -> dict[str, Tensor]:
        """A batch of `count` pictures, drawn with the generator.

        Returns:
            "images" (B, 1, h, w) float32, 0 to 1, and "values" (B, 6).

        Raises:
            ValueError: if `count` is no positive integer.
        """
        require_integer("count", count, 1)
        rows = torch.randint(len(self), (count,), generator=generator)
        return {"images": self.images[rows].float() / 255, "values": self.values[rows]}
