"""How chapter 8 trains and tests: three objects of `tabletop` in one network.

A drill, a vase, which looks the same from all sides, and a teapot. Networks are trained on windows
of the `train` split and tested on whole images of other tables, `easy` and `occluded`.

The optimiser is Muon, not the paper's Adam, whose loss after 1000 steps it has after 400.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from torch import Tensor

import data_tools
from book.tools.checkpoints import resume_folder
from data_tools import batches
from posecore.cameras import resize_intrinsics
from posecore.methods.objects import object_models
from posecore.methods.vector_field.fields import FieldTargets, field_targets
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.recipe import RECIPES, Recipe
from posecore.models import ObjectModel
from posecore.scale import scale
from posecore.training import History, fit

__all__ = [
    "DATA",
    "NAMES",
    "OBJECTS",
    "camera",
    "crops",
    "frames",
    "models",
    "new_net",
    "recipe",
    "stack",
    "train_net",
    "true_fields",
]

OBJECTS = (7, 3, 5)
DATA = ("tabletop/train", "tabletop/easy")
"""What a training opens; of the second only what its objects are."""
NAMES = ("drill", "vase", "teapot")


def recipe() -> Recipe:
    """That of the scale in force."""
    return RECIPES[scale()]


@lru_cache(maxsize=4)
def stack(split: str) -> batches.Stack:
    """A split of `tabletop` at the scale in force."""
    return batches.load(data_tools.open("tabletop", split=split), progress=False)


@lru_cache(maxsize=1)
def models() -> list[ObjectModel]:
    """The three objects: 2000 points of each surface, and nine keypoints."""
    return object_models(data_tools.open("tabletop", split="easy").models(), OBJECTS)


def frames(split: str, views: Tensor) -> batches.Batch:
    """Images of a split, resized to the networks' input size, with their labels.

    At book scale that is smaller than the world's images: a window of as much of the scene teaches
    as much, at half the cost.
    """
    data = stack(split)
    return data.frames(views, recipe().image_size(data))


def true_fields(batch: batches.Batch, known: Sequence[ObjectModel]) -> FieldTargets:
    """The true field of some objects in images, at all of their pixels."""
    return field_targets(
        batch,
        np.stack([model.keypoints for model in known]),
        [model.object_id for model in known],
        [model.symmetries if model.symmetric else None for model in known],
        None,
    )


def camera(split: str, view: int) -> np.ndarray:
    """Camera matrix (3, 3) of such an image."""
    data = stack(split)
    return resize_intrinsics(data.K[view].numpy(), data.size, recipe().image_size(data))


def new_net(seed: int = 0) -> VectorFieldNet:
    """The network of the scale in force, with its first weights."""
    return recipe().new_net(models(), seed)


@lru_cache(maxsize=1)
def crops(background_fraction: float = 0.0) -> batches.RandomCrops | batches.CropPool:
    """The pool of random crops of the trainings: each object seen in `train` about 16 times.

    Args:
        background_fraction: as for `RandomCrops`.
    """
    some = replace(recipe(), background_fraction=background_fraction)
    return some.crops(stack("train"), models())


def train_net(
    recipe: Recipe, *, seed: int = 0, show: bool | None = False, keep: bool = True
) -> tuple[VectorFieldNet, History]:
    """A network, trained by a recipe.

    Args:
        recipe: the one of the scale in force, or one that differs from it in the loss, the steps
            or the part of the windows that are anywhere.
        seed: of weights, and of which windows come when.
        show: as for `fit`.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    net = new_net(seed)
    loss = {
        "projection": recipe.projection, "weight": recipe.weight, "warmup": recipe.warmup,
        "ignore_reversed": recipe.ignore_reversed,
    }  # fmt: skip
    details = (*loss.values(), recipe.background_fraction, seed, recipe.steps)
    history = fit(
        net,
        recipe.batches(crops(recipe.background_fraction), seed=seed),
        recipe.objective(models()),
        steps=recipe.steps,
        seed=seed,
        device="cpu",
        resume=resume_folder(train_net, *details, data=DATA) if keep else None,
        recipe=loss,
        show=show,
        **recipe.fit_field,
    )
    return net, history
