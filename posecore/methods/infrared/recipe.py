"""The recipe of the cloud estimator: what is trained, with which numbers.

The command line, chapter 3 and its ledger call this, and differ by arguments only.

    recipe = RECIPES["book"]
    triples = recipe.triples(batches.load(data_tools.open("headset", split="train")))
    net = recipe.new_net(triples)
    fit(net, recipe.batches(triples), recipe.new_loss(triples.size), steps=recipe.steps,
        **recipe.fit)
    cloud = net(images)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from data_tools.batches import Batches, Stack
from posecore.methods.infrared.losses import CloudLoss
from posecore.methods.infrared.network import SIZES, CloudNet
from posecore.methods.infrared.projection import Projector
from posecore.methods.infrared.triples import Triples
from posecore.randomness import seeded
from posecore.training.loop import ADAM
from posecore.training.muon import Muon

__all__ = ["RECIPES", "SMALL", "Recipe"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The numbers of a scale, and what is made of them.

    Attributes:
        image: (width, height) in pixels of the images that the network is given.
        grid: (W, H, D) of the grid of voxels.
        extent: metres from its front to its back: its voxels are about cubes at 0.75 m.
        points, width, blocks, max_channels, hidden, cube, max_scale: of `CloudNet`.
        normalised: whether images are normalised by mean and deviation of the training's.
        masks: one of `triples.MASKS`; the paper has thresholds.
        views: how many teach, the input's own among them; None for all.
        own_view: whether the input's own view is one of those that teach.
        looks: at how many of these, drawn anew, the losses look in a step; None for all.
        turn: degrees by which an input's camera is turned at most, for `Triples.draw`.
        mirror: whether half of the instants are mirrored.
        loss: `CloudLoss` without its projector.
        batch: instants in a step.
        steps, optimiser, lr, schedule, clip: as for `fit`.
    """

    image: tuple[int, int]
    grid: tuple[int, int, int]
    extent: float = 0.64
    points: int
    width: int = 16
    blocks: int
    max_channels: int | None = None
    hidden: int = 1024
    cube: float = 0.4
    max_scale: float = 1.0
    normalised: bool = True
    masks: str = "threshold"
    views: int | None = None
    own_view: bool = True
    looks: int | None = None
    turn: float = 0.0
    mirror: bool = False
    loss: Callable[[Projector], CloudLoss] = CloudLoss
    batch: int
    steps: int
    optimiser: Callable[..., torch.optim.Optimizer] = ADAM
    lr: float = 1e-4
    schedule: str | Callable[[float], float] = "constant"
    clip: float | None = None

    def triples(self, data: Stack, mask_of: Callable[..., np.ndarray] | None = None) -> Triples:
        """Images and masks of a dataset at the sizes of the recipe; arguments as of `Triples`."""
        return Triples(
            data, image=self.image, grid=self.grid[:2], masks=self.masks, mask_of=mask_of
        )

    def new_net(self, triples: Triples, seed: int = 0) -> CloudNet:
        """The network with its first weights, and the object box of a training's translations."""
        with seeded(seed):
            net = CloudNet(self.image, **{name: getattr(self, name) for name in SIZES})
        t = triples.t.flatten(0, 1)
        net.low.copy_(t.amin(0))
        net.high.copy_(t.amax(0))
        if self.normalised:
            mean, std = triples.brightness()
            net.mean.fill_(mean)
            net.std.fill_(std)
        return net

    def projector(self, image: tuple[int, int]) -> Projector:
        """Into the grid, for cameras of images of this (width, height)."""
        return Projector(image, self.grid, self.extent)

    def new_loss(self, image: tuple[int, int]) -> CloudLoss:
        """The loss of a step, for cameras of images of this (width, height)."""
        return self.loss(self.projector(image))

    def batches(
        self, triples: Triples, *, steps: int | None = None, batch: int | None = None, seed: int = 0
    ) -> Batches:
        """The batches of a training; `steps` and `batch` are the recipe's if they are not given."""
        draw = partial(
            triples.draw,
            views=self.views,
            own=self.own_view,
            looks=self.looks,
            turn=self.turn,
            mirror=self.mirror,
        )
        return Batches(draw, steps=steps or self.steps, seed=seed, count=batch or self.batch)

    @property
    def fit(self) -> dict[str, Any]:
        """What `posecore.training.fit` is told."""
        return {
            "lr": self.lr, "schedule": self.schedule, "optimiser": self.optimiser,
            "clip": self.clip,
        }  # fmt: skip


BEST = {
    "optimiser": Muon, "lr": 3e-3, "schedule": "cosine", "clip": 1.0, "masks": "exact",
    "mirror": True, "hidden": 176, "max_channels": 96, "looks": 1, "max_scale": 4.0,
}  # fmt: skip
RECIPES = {
    "tiny": Recipe(
        image=(80, 47), grid=(40, 24, 40), points=256, width=8, blocks=5, batch=4, steps=20, **BEST,
        loss=partial(CloudLoss, blur=(2.0, 0.4), keep=(0.2, 1.0)),
    ),
    "book": Recipe(
        image=(160, 94), grid=(80, 47, 80), points=512, blocks=6, batch=16, steps=23_000, **BEST,
        own_view=False,
        loss=partial(CloudLoss, weights=(0.4, 0.5, 0.1), blur=(4.0, 0.8), keep=(0.2, 1.0)),
    ),
    # The paper; blocks, batch and steps are not in it.
    "paper": Recipe(
        image=(320, 188), grid=(160, 94, 160), points=2000, blocks=6, batch=16, steps=200_000,
    ),
}  # fmt: skip
"""By the names of scales."""

SMALL = {
    "image": (80, 47), "grid": (40, 24, 40), "points": 512, "blocks": 5, "batch": 16,
    "steps": 1500, "own_view": True, "loss": partial(CloudLoss, blur=(2.0, 0.4), keep=(0.2, 1.0)),
}  # fmt: skip
"""What makes of the book's recipe that of the networks which chapter 3 compares: a minute each."""
