"""Random crops of images around objects, cut anew for every batch, or once into a pool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import torch
from torch import Tensor

from data_tools.batches.augmentation import Augmentation
from data_tools.batches.sequence import Batches
from data_tools.batches.stacking import Stack
from posecore.arrays import fail, require_integer, require_number

__all__ = ["CropPool", "RandomCrops"]

KEYS = ("rgb", "instance", "K", "object_id", "R", "t")


class RandomCrops:
    """Crops of images, each with an object in it, for networks that are convolutional.

    What such a network learns from crops it predicts for whole images. A crop is a few times as
    large as the object in it, which is anywhere in it, so little is spent on background. A network
    that has seen nothing else may find its objects on a bare table: `background_fraction` puts some
    crops anywhere.

    Args:
        data: with colour images and masks.
        object_ids: around which objects; all others count as background.
        size: (width, height) of a crop in pixels, or one number for both.
        augment: how crops are varied; None for not.
        visible: the least visible fraction of the object that a crop is put around.
        shift: how far its middle may be from that of the crop, as part of the crop's sides.
        zoom: pixels of a crop for one of the image. Below 1 crops show more and cost less.
        background_fraction: the part of the crops, 0 to 1, whose middles are anywhere in the
            images.

    Raises:
        ValueError: naming the argument that does not fit this description; if `data` has none of
            the objects.
    """

    def __init__(
        self,
        data: Stack,
        object_ids: Sequence[int],
        *,
        size: int | tuple[int, int] = 128,
        augment: Augmentation | None = None,
        visible: float = 0.1,
        shift: float = 0.3,
        zoom: float = 1.0,
        background_fraction: float = 0.0,
    ) -> None:
        self.shift = require_number("shift", shift, 0, 1)
        self.zoom = require_number("zoom", zoom, above=0)
        self.background_fraction = require_number("background_fraction", background_fraction, 0, 1)
        sides = size if isinstance(size, Sequence) else (size, size)
        if len(sides) != 2:
            fail("size", "width and height, or one number", size)
        self.size = tuple(require_integer("size", side, 1) for side in sides)
        self._data, self._augment = data, augment
        self._rows = data.rows(object_id=object_ids, visible=visible)
        if not len(self._rows):
            fail("data", f"views that show one of the objects {list(object_ids)}", "none")

    def __len__(self) -> int:
        """Around how many objects in images there are crops."""
        return len(self._rows)

    def draw(self, count: int, *, generator: torch.Generator) -> dict[str, Tensor]:
        """A batch, for `Batches`.

        Args:
            count: B crops.
            generator: of all that is random in them.

        Returns:
            "rgb" (B, 3, h, w), "K" (B, 3, 3) and "instance" (B, h, w); and of the objects in the
            image of each crop "object_id" (B, M), "R" (B, M, 3, 3) and "t" (B, M, 3): what
            `Stack.frames` says of them.

        Raises:
            ValueError: if `count` is no integer of at least 1.
        """
        count = require_integer("count", count, 1)
        rows = self._rows[torch.randint(len(self._rows), (count,), generator=generator)]
        views, boxes = self._data.view[rows], self._data.box[rows]
        sides = torch.tensor(self.size, dtype=boxes.dtype) / self.zoom
        away = 2 * torch.rand(count, 2, generator=generator, dtype=boxes.dtype) - 1
        middle = boxes[:, :2] + boxes[:, 2:] / 2 + self.shift * away * sides
        if self.background_fraction:
            chance = torch.rand(count, 3, generator=generator, dtype=boxes.dtype)
            anywhere = chance[:, 1:] * torch.tensor(self._data.size, dtype=boxes.dtype)
            middle = torch.where(chance[:, :1] < self.background_fraction, anywhere, middle)
        boxes = torch.cat([middle - sides / 2, sides.expand(count, 2)], 1)
        batch = self._data.frames(
            views, self.size, boxes=boxes, augment=self._augment, generator=generator
        )
        return {name: batch[name] for name in KEYS}


class CropPool:
    """Crops that are cut once, and drawn again and again.

    Cutting and varying a crop takes a good part of the time in which a small network learns from
    it, so where each view is seen dozens of times, some variations of each will do. They are cut
    when the first batch is wanted, and lie in memory: 5 bytes a pixel.

    Args:
        crops: what is cut.
        batches, count: how many at a time: an occluder or a new background comes from another crop
            of the same batch.
        seed: of what is cut.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(self, crops: RandomCrops, *, batches: int, count: int, seed: int = 0) -> None:
        if not isinstance(crops, RandomCrops):
            fail("crops", "a RandomCrops", type(crops).__name__)
        self.crops, self.seed = crops, require_integer("seed", seed, 0)
        self.batches = require_integer("batches", batches, 1)
        self.count = require_integer("count", count, 1)

    def __len__(self) -> int:
        """How many crops there are."""
        return self.batches * self.count

    def draw(self, count: int, *, generator: torch.Generator) -> dict[str, Tensor]:
        """A batch of `count` of them, for `Batches`: what `RandomCrops.draw` returns; colours in
        steps of 1/255.

        Raises:
            ValueError: if `count` is no integer of at least 1.
        """
        rows = torch.randint(len(self), (require_integer("count", count, 1),), generator=generator)
        batch = {name: values[rows] for name, values in self._all.items()}
        batch["rgb"] = batch["rgb"].permute(0, 3, 1, 2).float() / 255
        batch["instance"] = batch["instance"].long()
        return batch

    @cached_property
    def _all(self) -> dict[str, Tensor]:
        drawn = Batches(self.crops.draw, batch_size=self.count, seed=self.seed, steps=self.batches)
        parts = [_small(batch) for batch in drawn]
        # One kind of tensor after the other, so that never all of them are there twice.
        return {name: torch.cat([part.pop(name) for part in parts]) for name in KEYS}


def _small(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A batch in bytes, where bytes will do."""
    rgb = batch["rgb"].permute(0, 2, 3, 1).mul(255).round_().byte().contiguous()
    kept = {name: batch[name] for name in KEYS}
    return kept | {"rgb": rgb, "instance": batch["instance"].to(torch.int16)}
