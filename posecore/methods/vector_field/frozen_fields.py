"""What a network that is trained says of the training images, kept for what learns from it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn
from tqdm.auto import tqdm

from data_tools.batches import Augmentation, Stack
from posecore.arrays import require_integer
from posecore.methods.vector_field.masked_fields import MaskedFields, look_at
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.systems import VectorFieldSystem

__all__ = ["look_at_views", "own_poses", "weights_digest"]

AT_ONCE = 8
KEPT = ("image", "object_id", "R", "t", "K")


def look_at_views(
    net: VectorFieldNet,
    data: Stack,
    size: tuple[int, int] | None = None,
    *,
    most: int | None = None,
    augment: Augmentation | None = None,
    seed: int = 0,
    show: bool | None = None,
) -> list[tuple[MaskedFields, dict[str, Tensor]]]:
    """What a trained network says of whole images, for `RefinerTraining`.

    The network computes where it is (`look_at`); the fields come to the CPU.

    Args:
        net: in evaluation mode, as `fit` leaves it.
        data: with colour images.
        size: (width, height) of the images; None for the data's.
        most: look at no more images than so many, evenly over the data, whose parts may differ.
        augment: each image is varied once; None for none.
        seed: of the variations.
        show: a progress bar; by default in a terminal.

    Returns:
        Of each batch of images in which the network sees something its fields, and the true
        "image", "object_id", "R" and "t" of the objects in it, and "K" of the images.

    Raises:
        ValueError: if a number is out of range.
    """
    step = 1
    if most is not None:
        step = max(1, math.ceil(len(data) / require_integer("most", most, 1)))
    generator = torch.Generator().manual_seed(require_integer("seed", seed, 0))
    views = torch.arange(0, len(data), step).split(AT_ONCE)
    seen = []
    for some in tqdm(views, desc="fields", disable=None if show is None else not show):
        batch = data.frames(some, size, augment=augment, generator=generator)
        fields = look_at(net, batch["rgb"])
        if len(fields):
            seen.append((fields.to("cpu"), {name: batch[name] for name in KEPT}))
    return seen


def own_poses(
    system: VectorFieldSystem,
    seen: Sequence[tuple[MaskedFields, Mapping[str, Tensor]]],
    show: bool | None = None,
) -> list[tuple[Tensor, Tensor]]:
    """The poses that a system finds in fields, before any refiner, for `RefinerTraining`.

    It is these that a refiner will have to mend, and their errors are not those of chance: the
    pose and the arrows beside it are wrong together.

    Args:
        system: of the network that the fields are from.
        seen: as `look_at_views` returns it.
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


def weights_digest(net: nn.Module) -> str:
    """16 hexadecimal digits of a network's weights, for what belongs to it and to no other.

    A refiner learns from the fields of one network; resumed beside another it would go on wrongly.
    """
    total = hashlib.sha256()
    for name, value in net.state_dict().items():
        total.update(name.encode() + value.cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:16]
