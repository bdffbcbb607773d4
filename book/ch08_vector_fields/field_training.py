"""How chapter 8 trains and tests: three objects of `tabletop` in one network.

A drill, a vase, which looks the same from all sides, and a teapot. Networks are trained on windows
of the `train` split and tested on whole images of other tables, `easy` and `occluded`.

The optimiser is Muon, not the paper's Adam, whose loss after 1000 steps it has after 400.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from torch import Tensor

import data_tools
from book.tools.checkpoints import resume_folder
from data_tools import batches
from posecore.cameras import resize_intrinsics
from posecore.methods.vector_field.fields import FieldTargets, field_targets
from posecore.methods.vector_field.learning import Objective, Pool, Windows
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.models import ObjectModel, object_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.plans import MILD
from posecore.scale import choose
from posecore.training import History, fit, seeded
from posecore.training.muon import Muon

__all__ = [
    "DATA",
    "NAMES",
    "OBJECTS",
    "VARIED",
    "camera",
    "frames",
    "models",
    "most",
    "new_net",
    "pool",
    "stack",
    "train_net",
    "true_fields",
    "width",
]

OBJECTS = (7, 3, 5)
DATA = ("tabletop/train", "tabletop/easy")
"""What a training opens; of the second only what its objects are."""
NAMES = ("drill", "vase", "teapot")
VARIED = MILD
"""Milder than the default: tests are rendered as training images are."""


@lru_cache(maxsize=4)
def stack(split: str) -> batches.Stack:
    """A split of `tabletop` at the scale in force."""
    return batches.load(data_tools.open("tabletop", split=split), progress=False)


@lru_cache(maxsize=1)
def models() -> list[ObjectModel]:
    """The three objects: 2000 points of each surface, and nine keypoints."""
    return object_models(data_tools.open("tabletop", split="easy").models(), OBJECTS)


def size() -> tuple[int, int]:
    """Width and height of the images that networks look at.

    At book scale they are smaller than those of the world: a window of as much of the scene teaches
    as much, at half the cost.
    """
    return choose(tiny=(96, 72), book=(224, 168), paper=(640, 480))


def frames(split: str, views: Tensor) -> batches.Batch:
    """Images of a split in the size that networks look at, and all that is known of them."""
    return stack(split).frames(views, size())


def true_fields(batch: batches.Batch, known: Sequence[ObjectModel]) -> FieldTargets:
    """The field of some objects in images, at all of their pixels, as the ground truth has it."""
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
    return resize_intrinsics(data.K[view].numpy(), data.size, size())


def width() -> int:
    """Channels of the first layer, at the scale in force; the paper's ResNet-18 has 64."""
    return choose(tiny=8, book=64, paper=64)


def most() -> int | None:
    """Channels of the last layers at most; the paper's ResNet-18 has 512."""
    return choose(tiny=None, book=72, paper=None)


def new_net(seed: int = 0) -> VectorFieldNet:
    """The network of the scale in force, with its first weights."""
    with seeded(seed):
        return VectorFieldNet(len(OBJECTS), width=width(), most=most())


@lru_cache(maxsize=1)
def pool(elsewhere: float = 0.0) -> Pool:
    """The windows of a training: each object that is seen in `train` about 16 times.

    Args:
        elsewhere: as for `Windows`.
    """
    count = choose(tiny=4, book=64, paper=64)
    windows = Windows(
        stack("train"),
        models(),
        steps=choose(tiny=16, book=700, paper=4000),
        count=count,
        size=choose(tiny=64, book=64, paper=256),
        seed=0,
        augment=VARIED,
        visible=0.15,
        shift=0.22,
        zoom=size()[0] / stack("train").size[0],
        elsewhere=elsewhere,
    )
    return Pool(windows, steps=1, count=1)


def train_net(
    projection: str = "pixel",
    weight: float | str = "dynamic",
    begin: float = 0.0,
    forward_only: bool = False,
    *,
    elsewhere: float = 0.0,
    seed: int = 0,
    steps: int,
    show: bool | None = False,
    keep: bool = True,
) -> tuple[VectorFieldNet, History]:
    """A network, trained with a loss.

    Args:
        projection, weight, begin, forward_only: as for `VectorFieldLoss`.
        elsewhere: the part of the windows that are anywhere.
        seed: of weights, and of which windows come when.
        steps: of 32 windows.
        show: as for `fit`.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    net = new_net(seed)
    count = choose(tiny=4, book=32, paper=32)
    loss = VectorFieldLoss(projection, weight, begin, forward_only)
    recipe = {"projection": projection, "weight": weight, "begin": begin, "forward": forward_only}
    details = (*recipe.values(), elsewhere, seed, steps)
    history = fit(
        net,
        pool(elsewhere).drawn(steps=steps, count=count, seed=seed),
        Objective(models(), loss),
        steps=steps,
        lr=choose(tiny=1e-3, book=8e-3, paper=1e-3),
        optimiser=Muon,
        schedule="cosine",
        clip=10.0,
        seed=seed,
        device="cpu",
        resume=resume_folder(train_net, *details, data=DATA) if keep else None,
        recipe=recipe,
        show=show,
    )
    return net, history
