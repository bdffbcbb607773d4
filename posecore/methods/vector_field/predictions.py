"""Predictions of a frozen network on a dataset, cached to train the refiner."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor
from tqdm.auto import tqdm

from data_tools.batches import Augmentation, Stack
from posecore.arrays import require_integer
from posecore.methods.vector_field.masked_fields import MaskedFields, predict_fields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.systems import VectorFieldSystem

__all__ = [
    "initial_poses",
    "predict_views",
]

BATCH_SIZE = 8
BATCH_KEYS = ("object_id", "R", "t", "K")


def predict_views(
    net: VectorFieldNet,
    data: Stack,
    size: tuple[int, int] | None = None,
    *,
    max_images: int | None = None,
    augment: Augmentation | None = None,
    seed: int = 0,
    show: bool | None = None,
) -> list[tuple[MaskedFields, dict[str, Tensor]]]:
    """The fields that a trained network predicts for whole images, for `RefinerTraining`.

    The network computes where it is (`predict_fields`); the fields come to the CPU.

    Args:
        net: in evaluation mode, as `fit` leaves it.
        data: with colour images.
        size: (width, height) of the images; None for the data's.
        max_images: no more images than so many, evenly over the data, whose parts may differ.
        augment: each image is varied once; None for none.
        seed: of the variations.
        show: a progress bar; by default in a terminal.

    Returns:
        Of each batch of images in which the network sees something its fields, and the true
        "object_id", "R" and "t" of the objects in it, and "K" of the images.

    Raises:
        ValueError: if a number is out of range.
    """
    step = 1
    if max_images is not None:
        step = max(1, math.ceil(len(data) / require_integer("max_images", max_images, 1)))
    generator = torch.Generator().manual_seed(require_integer("seed", seed, 0))
    views = torch.arange(0, len(data), step).split(BATCH_SIZE)
    seen = []
    for some in tqdm(views, desc="fields", disable=None if show is None else not show):
        batch = data.frames(some, size, augment=augment, generator=generator)
        fields = predict_fields(net, batch["rgb"])
        if len(fields):
            seen.append((fields.to("cpu"), {name: batch[name] for name in BATCH_KEYS}))
    return seen


def initial_poses(
    system: VectorFieldSystem,
    seen: Sequence[tuple[MaskedFields, Mapping[str, Tensor]]],
    show: bool | None = None,
) -> list[tuple[Tensor, Tensor]]:
    """The poses that a system finds in fields, before any refiner, for `RefinerTraining`.

    It is these that a refiner will have to mend, and their errors are not those of chance: the
    pose and the arrows beside it are wrong together.

    Args:
        system: of the network that the fields are from.
        seen: as `predict_views` returns it.
        show: a progress bar; by default in a terminal.

    Returns:
        For each part of `seen` R (S, 3, 3) and t (S, 3) of its entries, float32.
    """
    found = []
    for fields, batch in tqdm(seen, desc="poses", disable=None if show is None else not show):
        firsts = [one.first for one in system.estimate_fields(fields, batch["K"])]
        R, t = (torch.from_numpy(np.stack(part)).float() for part in zip(*firsts, strict=True))
        found.append((R, t))
    return found
