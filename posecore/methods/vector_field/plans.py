"""The sizes of `train vector_field` at each scale."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from data_tools.batches import Augmentation
from posecore.training.loop import ADAM
from posecore.training.muon import Muon

__all__ = ["MILD", "PLANS", "Plan", "halved"]

MILD = Augmentation(occluder=0.2, background=0.25, blur=0.5, noise=0.012, light=0.2, colour=0.1)
"""Milder than the default, for tests that are rendered as training images are."""


def halved(done: float) -> float:
    """The paper's learning rate, from the part of the training that is done to a factor.

    Halved every 20 of 200 epochs (You et al., Section IV-A).
    """
    return 0.5 ** math.floor(10 * done + 1e-9)  # 0.29 * 100, for one, is a little below 29


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The sizes of a scale.

    Attributes:
        width, most: of the network of the field.
        refiner_width: of the refiner.
        window: (width, height) in pixels of what is trained on, at most the whole image.
        batch, refiner_batch: windows, and objects, in a step.
        pixels: of each object in a window that the loss looks at; None for all.
        looks: how often each object of an image is cut into the `Pool` of windows, about; None for
            no pool, but windows cut anew for every step.
        visible, shift, elsewhere: of `Windows`.
        augment: how images are varied, for the refiner too.
        begin, forward_only: of `VectorFieldLoss`, where the command is not told.
        optimiser: of the field; that of the refiner is Adam.
        lr, schedule: of the field.
        refiner_lr: the schedule is the same.
        steps: of the field; None for `epochs` rounds of as many windows as there are images.
        refiner_steps: of the refiner.
        refiner_images: at most so many of the training images are looked at for it.
    """

    width: int
    most: int | None = None
    window: tuple[int, int]
    batch: int
    pixels: int | None = 256
    looks: int | None = None
    visible: float = 0.1
    shift: float = 0.3
    elsewhere: float = 0.0
    augment: Augmentation
    begin: float = 0.0
    forward_only: bool = False
    optimiser: Callable[..., torch.optim.Optimizer] = ADAM
    lr: float
    schedule: str | Callable[[float], float] = "cosine"
    steps: int | None = None
    epochs: int = 200
    refiner_width: int
    refiner_batch: int = 64
    refiner_lr: float = 1e-3
    refiner_steps: int
    refiner_images: int = 4000


# Numbers of chapter 8's experiments.
SMALL = {
    "visible": 0.15, "shift": 0.22, "elsewhere": 0.15, "augment": MILD,
    "begin": 0.15, "forward_only": True, "optimiser": Muon,
}  # fmt: skip
PLANS = {
    "tiny": Plan(
        # With the rate of the book all that twenty steps teach is that most is background.
        width=8, window=(64, 64), batch=4, looks=1, steps=20, lr=1e-3, **SMALL,
        refiner_width=4, refiner_batch=8, refiner_steps=20,
    ),
    "book": Plan(
        width=64, most=72, window=(96, 96), batch=32, looks=8, steps=9000, lr=8e-3, **SMALL,
        refiner_width=16, refiner_steps=2000,
    ),
    # The paper and PVNet, whose refiner is trained "until the training loss converges".
    "paper": Plan(
        width=64, window=(640, 480), batch=32, pixels=None, augment=Augmentation(),
        lr=1e-4, schedule=halved,
        refiner_width=64, refiner_lr=1e-4, refiner_steps=50_000,
    ),
}  # fmt: skip
