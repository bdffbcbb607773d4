"""A run of `train invariant_gcn`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import nn

from posecore.arrays import fail, require_integer
from posecore.methods.invariant_gcn.recipe import NETS
from posecore.methods.runs import NetRun

__all__ = ["InvariantGCNRun"]


@dataclass(frozen=True)
class InvariantGCNRun(NetRun):
    """A run as its folder has it.

    Attributes:
        path, options, kind, net, objects: as of every `NetRun`; `net` without the mean sizes.
        points: N, of a cloud.
        sizes, near: of its graph, as of `recipe.Recipe`.
        categories: names, in the order in which the network knows them.
        revolution: which of them are solids of revolution about y.
        mean_size: (C, 3) metres.

    Raises:
        ValueError: for numbers or names that cannot be.
    """

    method: ClassVar[str] = "invariant_gcn"
    NETS = NETS

    points: int
    sizes: list[int]
    near: list[int]
    categories: list[str]
    revolution: list[str]
    mean_size: list[list[float]]

    def __post_init__(self) -> None:
        require_integer("points", self.points, 3)
        if len(set(self.categories)) != len(self.categories) or not self.categories:
            fail("categories", "names, each once", self.categories)
        if not set(self.revolution) <= set(self.categories):
            fail("revolution", f"some of {self.categories}", self.revolution)
        if len(self.mean_size) != len(self.categories):
            fail("mean_size", f"one of each of {self.categories}", self.mean_size)

    def new_net(self) -> nn.Module:
        """The network, untrained."""
        return self.NETS[self.kind](self.mean_size, **self.net)
