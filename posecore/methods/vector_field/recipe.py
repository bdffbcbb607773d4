"""The recipe of the vector field: what is trained, in which stages, with which numbers.

The command line, the pages of the book and its ledger call this, and differ by arguments only.

    recipe = RECIPES["book"]
    data, models = batches.load(data_tools.open("tabletop", split="train")), object_models(...)
    net = recipe.new_net(models)
    fit(net, recipe.batches(recipe.crops(data, models)), recipe.objective(models),
        steps=recipe.steps, **recipe.fit_field)
    training = recipe.refiner_training(net, data, models)
    refiner = recipe.new_refiner(models)
    fit(refiner, training.batches, training.loss, steps=recipe.refiner_steps, **recipe.fit_refiner)
    system = recipe.system("OPEPL-DR", net, models, refiner)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from data_tools.batches import Augmentation, Batches, CropPool, RandomCrops, Stack
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.objective import Objective
from posecore.methods.vector_field.predictions import initial_poses, predict_views
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.systems import VectorFieldSystem
from posecore.methods.vector_field.voting import VoteOptions
from posecore.models import ObjectModel
from posecore.training import seeded
from posecore.training.loop import ADAM
from posecore.training.muon import Muon

__all__ = ["MILD", "RECIPES", "Recipe", "halved"]

MILD = Augmentation(occluder=0.2, background=0.25, blur=0.5, noise=0.012, light=0.2, colour=0.1)
"""Milder than the default, for tests that are rendered as training images are."""


def halved(done: float) -> float:
    """The paper's learning rate schedule: the part of the training that is done -> a factor.

    Halved every 20 of 200 epochs (You et al., Section IV-A).
    """
    return 0.5 ** math.floor(10 * done + 1e-9)  # 0.29 * 100, for one, is a little below 29


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The hyperparameters of a scale, and the networks, batches and losses that they define.

    Attributes:
        width, max_channels: of the network of the field.
        image_width: larger images are reduced to this width; None leaves them as they are.
        crop: (width, height) in pixels of what is trained on, at most the whole image.
        pool: (batches, crops in each) of a `CropPool`; None for crops cut anew for every step.
        batch: crops in a step.
        visible, shift, background_fraction: of `RandomCrops`.
        augment: how images are varied, for the refiner too.
        projection, weight, warmup, ignore_reversed: of `VectorFieldLoss`.
        pixels: of each object in a crop that the loss looks at; None for all.
        optimiser, lr, schedule, clip: of the field, as for `fit`.
        steps: of the field; None for `epochs` rounds of as many crops as there are images.
        refiner_width, refiner_batch, refiner_steps, refiner_lr: the refiner, its objects in a step;
            its schedule is the field's, its optimiser Adam.
        refiner_images: at most so many of the training images are predicted for it.
        voting, threshold: of `VectorFieldSystem`.
    """

    width: int
    max_channels: int | None = None
    image_width: int | None = None
    crop: tuple[int, int]
    pool: tuple[int, int] | None = None
    batch: int
    visible: float = 0.1
    shift: float = 0.3
    background_fraction: float = 0.0
    augment: Augmentation
    projection: str = "pixel"
    weight: float | str = "dynamic"
    warmup: float = 0.0
    ignore_reversed: bool = False
    pixels: int | None = 256
    optimiser: Callable[..., torch.optim.Optimizer] = ADAM
    lr: float
    schedule: str | Callable[[float], float] = "cosine"
    clip: float = 10.0
    steps: int | None = None
    epochs: int = 200
    refiner_width: int
    refiner_batch: int = 64
    refiner_steps: int
    refiner_lr: float = 1e-3
    refiner_images: int = 4000
    # PVNet's last step is biased towards the object; the paper says nothing of another.
    voting: VoteOptions = field(default_factory=lambda: VoteOptions(fit="angles"))
    threshold: float = 0.8

    # The field -----------------------------------------------------------------------------------

    def image_size(self, data: Stack) -> tuple[int, int]:
        """(width, height) in pixels of the images that the network is given."""
        return reduced(data.size, self.image_width)

    def new_net(self, models: Sequence[ObjectModel], seed: int = 0) -> VectorFieldNet:
        """The network of the field with its first weights."""
        with seeded(seed):
            return VectorFieldNet(
                len(models), len(models[0].keypoints), self.width, self.max_channels
            )

    def crops(
        self, data: Stack, models: Sequence[ObjectModel], *, most: int | None = None, seed: int = 0
    ) -> RandomCrops | CropPool:
        """What batches are drawn from.

        Args:
            data: of the training.
            models: of the objects.
            most: no more crops than so many are cut into a pool.
            seed: of a pool.
        """
        width, _ = size = self.image_size(data)
        crops = RandomCrops(
            data,
            [model.object_id for model in models],
            size=tuple(map(min, self.crop, size)),
            augment=self.augment,
            visible=0.0 if data.visible_fraction is None else self.visible,
            shift=self.shift,
            zoom=width / data.size[0],
            background_fraction=self.background_fraction,
        )
        if self.pool is None:
            return crops
        batches, count = self.pool
        if most is not None:
            count = min(count, most)
            batches = min(batches, math.ceil(most / count))
        return CropPool(crops, batches=batches, count=count, seed=seed)

    def batches(
        self,
        crops: RandomCrops | CropPool,
        *,
        steps: int | None = None,
        batch: int | None = None,
        seed: int = 0,
    ) -> Batches:
        """The batches of a training; `steps` and `batch` are the recipe's if they are not given."""
        steps, batch = steps or self.steps, batch or self.batch
        return Batches(crops.draw, batch_size=batch, steps=steps, seed=seed)

    def objective(self, models: Sequence[ObjectModel]) -> Objective:
        """The loss of a step."""
        loss = VectorFieldLoss(self.projection, self.weight, self.warmup, self.ignore_reversed)
        return Objective(models, loss, self.pixels)

    @property
    def fit_field(self) -> dict[str, Any]:
        """What `fit` is told for the field."""
        return {
            "lr": self.lr, "schedule": self.schedule, "optimiser": self.optimiser,
            "clip": self.clip,
        }  # fmt: skip

    # The refiner ---------------------------------------------------------------------------------

    def new_refiner(self, models: Sequence[ObjectModel], seed: int = 0) -> FieldRefiner:
        """The refiner with its first weights."""
        with seeded(seed):
            return FieldRefiner(models, width=self.refiner_width)

    def refiner_training(
        self,
        net: VectorFieldNet,
        data: Stack,
        models: Sequence[ObjectModel],
        *,
        initial: bool = True,
        batch: int | None = None,
        seed: int = 0,
        show: bool | None = None,
    ) -> RefinerTraining | None:
        """Batches and loss of a refiner, from what a trained network predicts.

        Args:
            net: of the field, as it stays.
            data, models: of the training.
            initial: whether half of the poses to begin with are those of the system itself.
            batch: objects in a step; None for the recipe's.
            seed: of the variations of the images.
            show: progress bars; by default in a terminal.

        Returns:
            None if the network sees no object in the images.
        """
        seen = predict_views(
            net, data, self.image_size(data), max_images=self.refiner_images, augment=self.augment,
            seed=seed, show=show,
        )  # fmt: skip
        if not seen:
            return None
        system = VectorFieldSystem(net, models, voting=self.voting)
        poses = initial_poses(system, seen, show) if initial else None
        return RefinerTraining(seen, models, poses, size=batch or self.refiner_batch)

    @property
    def fit_refiner(self) -> dict[str, Any]:
        """What `fit` is told for the refiner."""
        return {"lr": self.refiner_lr, "schedule": self.schedule, "clip": 1.0}

    # The system ----------------------------------------------------------------------------------

    def system(
        self,
        name: str,
        net: VectorFieldNet,
        models: Sequence[ObjectModel],
        refiner: FieldRefiner | None = None,
        **options: Any,
    ) -> VectorFieldSystem:
        """One of `SYSTEMS`, by its name.

        Args:
            name: of the system.
            net, models, refiner: as for `VectorFieldSystem`.
            options: of it besides; voting and threshold are the recipe's if they are not given.
        """
        options = {"voting": self.voting, "threshold": self.threshold} | options
        return VectorFieldSystem.named(name, net, models, refiner, **options)


def reduced(size: tuple[int, int], width: int | None) -> tuple[int, int]:
    """(width, height) of an image that is not wider than `width`."""
    if width is None or size[0] <= width:
        return size
    return width, max(1, round(size[1] * width / size[0]))


# What chapter 8 found best: by its ledger the loss of a constant weight, on average; and crops
# anywhere teach what a bare table is, which is taken for a vase now and then without them.
BEST = {
    "visible": 0.15, "shift": 0.22, "background_fraction": 0.15, "augment": MILD,
    "weight": 0.05, "ignore_reversed": True, "optimiser": Muon,
}  # fmt: skip
RECIPES = {
    "tiny": Recipe(
        # With the rate of the book all that twenty steps teach is that most is background.
        width=8, crop=(64, 64), pool=(16, 4), batch=4, steps=20, lr=1e-3, **BEST,
        refiner_width=4, refiner_batch=8, refiner_steps=20,
    ),
    "book": Recipe(
        width=64, max_channels=72, image_width=224, crop=(64, 64), pool=(700, 64), batch=32,
        steps=11_000, lr=8e-3, **BEST,
        refiner_width=16, refiner_steps=3000,
    ),
    # The paper and PVNet, whose refiner is trained "until the training loss converges".
    "paper": Recipe(
        width=64, crop=(640, 480), batch=32, pixels=None, augment=Augmentation(),
        lr=1e-4, schedule=halved,
        refiner_width=64, refiner_lr=1e-4, refiner_steps=50_000,
    ),
}  # fmt: skip
"""By the names of scales."""
