"""Training a field: windows around objects, and what the network is to say of them."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Augmentation, Stack
from posecore.arrays import fail, require_integer, require_number
from posecore.methods.vector_field.fields import field_targets
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.models import ObjectModel, require_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.training.randomness import generator_at

__all__ = ["Objective", "Pool", "Windows"]

OF_IMAGES = ("rgb", "instance", "K")
OF_OBJECTS = ("object_id", "R", "t")


class _Drawn:
    """A batch for each step of a training; all that is random in it follows from seed and step."""

    def __init__(self, steps: int, count: int, seed: int) -> None:
        self.steps = require_integer("steps", steps, 1)
        self.count = require_integer("count", count, 1)
        self.seed = require_integer("seed", seed, 0)
        self.step = 0

    def __len__(self) -> int:
        return self.steps

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        while self.step < self.steps:
            batch = self._draw(generator_at(self.seed, self.step))
            batch["done"] = torch.tensor(self.step / self.steps)
            self.step += 1
            yield batch
        self.step = 0

    def _draw(self, generator: torch.Generator) -> dict[str, Tensor]:
        raise NotImplementedError

    def state_dict(self) -> dict[str, int]:
        """Where the next batch begins, as plain integers."""
        return {"step": self.step, "steps": self.steps, "seed": self.seed, "count": self.count}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on where `state_dict` was called.

        Raises:
            ValueError: if it is the state of other batches.
        """
        own = self.state_dict()
        if (
            not isinstance(state, dict)
            or "step" not in state
            or {**state, "step": own["step"]} != own
        ):
            fail("state", f"one like {own}", repr(state))
        self.step = require_integer("state['step']", state["step"], 0, self.steps)


class Windows(_Drawn):
    """The batches of a training: windows of images, each with an object of the network in it.

    The network is convolutional: what it learns in windows it says of whole images. A window is a
    few times as large as the object in it, which is anywhere in it, so little is spent on
    background. A network that has only seen such windows may find its objects on a bare table, and
    `elsewhere` puts some windows anywhere. It can be resumed: all that is random in a batch follows
    from seed and step.

    Args:
        data: with colour images and masks.
        models: the objects of the network; others count as background.
        steps: batches in all.
        count: windows in a batch.
        size: (width, height) of a window in pixels, or one number for both.
        seed: of what is drawn.
        augment: how windows are varied; None for not.
        visible: the least visible fraction of the object that a window is put around.
        shift: how far its middle may be from that of the window, as part of the window's sides.
        zoom: pixels of a window for one of the image. Below 1 windows show more and cost less.
        elsewhere: the part of the windows, 0 to 1, whose middles are anywhere in the images.

    Yields:
        A dict of tensors: for each of B windows "rgb" (B, 3, h, w), "K" (B, 3, 3) and "instance"
        (B, h, w), which of the M objects below is seen, or -1; for each of as many objects as there
        are in the fullest view "object_id" (B, M), -1 for none, "R" (B, M, 3, 3), "t" (B, M, 3);
        and "done", (), the part of the training that is behind.

    Raises:
        ValueError: naming the argument that does not fit this description; if `data` has none of
            the objects.
    """

    def __init__(
        self,
        data: Stack,
        models: Sequence[ObjectModel],
        *,
        steps: int,
        count: int = 16,
        size: int | tuple[int, int] = 128,
        seed: int = 0,
        augment: Augmentation | None = None,
        visible: float = 0.1,
        shift: float = 0.3,
        zoom: float = 1.0,
        elsewhere: float = 0.0,
    ) -> None:
        super().__init__(steps, count, seed)
        self.shift = require_number("shift", shift, 0, 1)
        self.zoom = require_number("zoom", zoom, above=0)
        self.elsewhere = require_number("elsewhere", elsewhere, 0, 1)
        sides = size if isinstance(size, Sequence) else (size, size)
        if len(sides) != 2:
            fail("size", "width and height, or one number", size)
        self.size = tuple(require_integer("size", side, 1) for side in sides)
        self._data, self._augment = data, augment
        ids = [model.object_id for model in require_models(models)]
        self._rows = data.rows(object_id=ids, visible=visible)
        if not len(self._rows):
            fail("data", f"views that show one of the objects {ids}", "none")

    def _draw(self, generator: torch.Generator) -> dict[str, Tensor]:
        rows = self._rows[torch.randint(len(self._rows), (self.count,), generator=generator)]
        views, boxes = self._data.view[rows], self._data.box[rows]
        sides = torch.tensor(self.size, dtype=boxes.dtype) / self.zoom
        away = 2 * torch.rand(self.count, 2, generator=generator, dtype=boxes.dtype) - 1
        middle = boxes[:, :2] + boxes[:, 2:] / 2 + self.shift * away * sides
        if self.elsewhere:
            chance = torch.rand(self.count, 3, generator=generator, dtype=boxes.dtype)
            anywhere = chance[:, 1:] * torch.tensor(self._data.size, dtype=boxes.dtype)
            middle = torch.where(chance[:, :1] < self.elsewhere, anywhere, middle)
        windows = torch.cat([middle - sides / 2, sides.expand(self.count, 2)], 1)
        batch = self._data.frames(
            views, self.size, boxes=windows, augment=self._augment, generator=generator
        )
        return _by_window(batch)


class Pool(_Drawn):
    """Windows cut once, and drawn again and again.

    Cutting and varying a window takes a good part of the time in which a small network learns from
    it, so where each view is looked at dozens of times, some variations of each will do. They are
    cut when the first batch is wanted, and lie in memory: 5 bytes a pixel.

    Args:
        windows: what is cut, from its first batch to its last.
        steps: batches in all.
        count: windows in a batch.
        seed: of what is drawn.

    Yields:
        What `Windows` yields; colours in steps of 1/255.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(self, windows: Windows, *, steps: int, count: int, seed: int = 0) -> None:
        super().__init__(steps, count, seed)
        if not isinstance(windows, Windows):
            fail("windows", "a Windows", type(windows).__name__)
        self._cut = _Cut(windows)

    def drawn(self, *, steps: int, count: int, seed: int = 0) -> Pool:
        """The same windows for another training; the arguments are those of the class."""
        pool = copy.copy(self)
        _Drawn.__init__(pool, steps, count, seed)
        return pool

    @property
    def size(self) -> int:
        """How many windows there are."""
        return self._cut.size

    def _draw(self, generator: torch.Generator) -> dict[str, Tensor]:
        rows = torch.randint(self.size, (self.count,), generator=generator)
        batch = {name: values[rows] for name, values in self._cut.parts.items()}
        batch["rgb"] = batch["rgb"].permute(0, 3, 1, 2).float() / 255
        batch["instance"] = batch["instance"].long()
        return batch


class _Cut:
    """All windows, cut once for all pools that draw from them."""

    def __init__(self, windows: Windows) -> None:
        self._windows = copy.copy(windows)
        self._windows.step = 0
        self.size = windows.steps * windows.count

    @cached_property
    def parts(self) -> dict[str, Tensor]:
        return _put_together([_small(batch) for batch in self._windows])


class Objective:
    """The loss of one step, for `posecore.training.fit`.

    The network computes its vectors at the drawn pixels only: over whole images the losses alone
    would cost more than the network.

    Args:
        models: the objects of the network, in its order.
        loss: which losses, with which weights.
        pixels_per_object: at most so many of each object in each window; None for all.
    """

    def __init__(
        self,
        models: Sequence[ObjectModel],
        loss: VectorFieldLoss | None = None,
        pixels_per_object: int | None = 256,
    ) -> None:
        models = require_models(models)
        self.loss = VectorFieldLoss() if loss is None else loss
        self.pixels_per_object = pixels_per_object
        self._ids = [model.object_id for model in models]
        self._keypoints = torch.from_numpy(np.stack([model.keypoints for model in models])).float()
        self._symmetries = [
            torch.from_numpy(model.symmetries).float() if model.symmetric else None
            for model in models
        ]

    def __call__(self, net: VectorFieldNet, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch of `Windows` or of a `Pool`, by name."""
        targets = field_targets(
            _by_object(batch), self._keypoints, self._ids, self._symmetries, self.pixels_per_object
        )
        features = net.features(batch["rgb"])
        vectors = net.vectors_at(features, targets.image, targets.y, targets.x, targets.object)
        with torch.autocast(features.device.type, enabled=False):
            return self.loss(net.mask(features), vectors, targets, float(batch["done"]))


def _by_window(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Objects in a table of their own, (M, ...), put beside their windows, (B, M, ...).

    So every tensor can be divided among processes along its first dimension.
    """
    image, windows = batch["image"], len(batch["rgb"])
    counts = torch.bincount(image, minlength=windows)
    first = counts.cumsum(0) - counts
    slot = torch.arange(len(image)) - first[image]
    result = {name: batch[name] for name in OF_IMAGES}
    # Row -1 of a table that has a last row more is what is no object.
    result["instance"] = torch.cat([slot, slot.new_tensor([-1])])[batch["instance"]]
    for name in OF_OBJECTS:
        values = batch[name]
        dense = values.new_full((windows, int(counts.max()), *values.shape[1:]), -1)
        dense[image, slot] = values
        result[name] = dense
    return result


def _by_object(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The reverse: one table of B x M objects, those that are none among them."""
    windows, slots = batch["object_id"].shape
    image = torch.arange(windows, device=batch["object_id"].device)
    result = {"K": batch["K"], "image": image.repeat_interleave(slots)}
    instance = batch["instance"]
    result["instance"] = torch.where(instance < 0, -1, instance + slots * image[:, None, None])
    return result | {name: batch[name].flatten(0, 1) for name in OF_OBJECTS}


def _small(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A batch in bytes, where bytes will do."""
    rgb = batch["rgb"].permute(0, 2, 3, 1).mul(255).round_().byte().contiguous()
    kept = {name: values for name, values in batch.items() if name != "done"}
    return kept | {"rgb": rgb, "instance": batch["instance"].to(torch.int16)}


def _put_together(parts: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Batches, each with as many places for objects as its fullest view needs, as one."""
    places = max(part["object_id"].shape[1] for part in parts)
    for part in parts:
        for name in OF_OBJECTS:
            values = part[name]
            more = values.new_full((len(values), places - values.shape[1], *values.shape[2:]), -1)
            part[name] = torch.cat([values, more], 1)
    # One kind of tensor after the other, so that never all of them are there twice.
    return {name: torch.cat([part.pop(name) for part in parts]) for name in list(parts[0])}
