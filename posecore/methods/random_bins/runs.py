"""A run of `train random_bins`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import nn

from posecore.arrays import fail, require_integer
from posecore.methods.random_bins.recipe import NETS
from posecore.methods.runs import NetRun

__all__ = ["RandomBinsRun"]


@dataclass(frozen=True)
class RandomBinsRun(NetRun):
    """A run as its folder has it.

    Attributes:
        path, options, kind, net, objects: as of every `NetRun`; `net` without the range.
        image: (width, height) in pixels of the pictures that the network takes.
        low, high: the range of the six numbers.

    Raises:
        ValueError: if `image` is no size.
    """

    method: ClassVar[str] = "random_bins"
    NETS = NETS

    image: tuple[int, int]
    low: list[float]
    high: list[float]

    def __post_init__(self) -> None:
        if len(self.image) != 2:
            fail("image", "a width and a height", self.image)
        for side in self.image:
            require_integer("image", side, 1)

    def new_net(self) -> nn.Module:
        """The network, untrained; its classes are drawn anew, and those of the training loaded."""
        return self.NETS[self.kind](torch.tensor(self.low), torch.tensor(self.high), **self.net)
