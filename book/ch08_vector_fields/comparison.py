"""What chapter 8 compares: losses, systems, and uncertainty in PnP."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from book.ch08_vector_fields import field_training as training
from book.ch08_vector_fields import outcomes
from book.tools.checkpoints import resume_folder
from book.tools.keys import Key
from posecore.methods.vector_field.frozen_fields import (
    look_at_views,
    own_poses,
    weights_digest,
)
from posecore.methods.vector_field.masked_fields import MaskedFields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.systems import SYSTEMS, Estimate, VectorFieldSystem
from posecore.registration import pnp
from posecore.scale import choose
from posecore.training import fit, seeded

__all__ = [
    "BINS",
    "DATA",
    "FIT",
    "LOSSES",
    "REFINER_STEPS",
    "SPLITS",
    "STEPS",
    "THRESHOLD",
    "chosen_pose",
    "compare_losses",
    "compare_systems",
    "new_refiner",
    "run",
    "train_refiner",
    "trained",
    "visible_key",
]

SPLITS = ("easy", "occluded")
DATA = ("tabletop/train", "tabletop/easy", "tabletop/occluded")
STEPS = {"tiny": 20, "book": 1600, "paper": 250_000}
REFINER_STEPS = {"tiny": 20, "book": 2000, "paper": 50_000}
LOSSES: dict[str, tuple] = {
    "none": ("none", 0.0),
    "pixel": ("pixel", "dynamic", 0.15, True),
    "printed": ("pixel", "dynamic"),
    "unit": ("unit", "dynamic", 0.15, True),
    "constant": ("pixel", 0.05, 0.0, True),
}
"""Projection loss, its weight, when it begins and whether vectors that point away are left out:
PVNet without one; the book's reading; Eq 1 and 2 as printed; unit vectors in place of pixels; and
the last weight of Eq 2 from the beginning."""
BINS = (0.1, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Of the visible fraction."""
FIT = "angles"
"""The last step of the vote. PVNet's least squares of lines draws keypoints towards the object."""
THRESHOLD = 0.8
"""Of the overlap, for OPEPL-DR."""

Pose = tuple[np.ndarray, np.ndarray]
Found = dict[tuple[int, int], Estimate]
Seen = list[tuple[MaskedFields, dict[str, Tensor]]]


def run(system: VectorFieldSystem, split: str) -> Found:
    """What a system says of a split, by view and object; of an object that is seen there twice the
    surer estimate."""
    found: Found = {}
    for views, batch in _looks(split):
        for estimate in system.estimate(batch["rgb"], batch["K"]):
            key = int(views[estimate.image]), estimate.object_id
            if key not in found or estimate.score > found[key].score:
                found[key] = estimate
    return found


def compare_losses(seed: int) -> dict[Key, float]:
    """One network for each of `LOSSES`, the same windows for all; percentages right."""
    values = {}
    for name in LOSSES:
        net = trained(name, seed)
        system = VectorFieldSystem(net, training.models(), fit=FIT)
        for split in SPLITS:
            data, found = training.stack(split), run(system, split)
            values |= _shares(name, split, outcomes.outcomes(data, _poses(found)))
            if name == "pixel":
                judged = outcomes.outcomes(data, _plain(found, split))
                values |= _shares("plain PnP", split, judged)
                other = run(VectorFieldSystem(net, training.models(), fit="lines"), split)
                values |= _shares("lines", split, outcomes.outcomes(data, _poses(other)))
    return values


def compare_systems(seed: int) -> dict[Key, float]:
    """OPEPL, -R and -DR with the same network and the same refiner; and one that learnt by chance.

    That one has never begun with poses of the system itself.
    """
    net = trained("pixel", seed)
    steps = choose(**REFINER_STEPS)
    refiner, by_chance = (
        train_refiner(net, own=own, seed=seed, steps=steps) for own in (True, False)
    )
    system = VectorFieldSystem.named("OPEPL-R", net, training.models(), refiner, fit=FIT)
    other = VectorFieldSystem.named("OPEPL-R", net, training.models(), by_chance, fit=FIT)
    values = {}
    everything: dict[str, list] = {name: [] for name in SYSTEMS}
    for split in SPLITS:
        found = run(system, split)
        for name in SYSTEMS:
            chosen = {key: chosen_pose(name, estimate) for key, estimate in found.items()}
            judged = outcomes.outcomes(training.stack(split), chosen)
            values |= _shares(name, split, judged)
            everything[name] += judged
        judged = outcomes.outcomes(training.stack(split), _poses(run(other, split)))
        values |= _shares("by chance", split, judged)
        large = [estimate.overlap > THRESHOLD for estimate in found.values()] or [False]
        values[Key("OPEPL-DR", split, "refined")] = 100 * float(np.mean(large))
    for name, judged in everything.items():
        for low, high in itertools.pairwise(BINS):
            last = high == BINS[-1]
            some = [o for o in judged if low <= o.visible and (o.visible < high or last)]
            if some:
                right = 100 * float(np.mean([outcome.right for outcome in some]))
                values[visible_key(name, low, high)] = right
    return values


def visible_key(system: str, low: float, high: float) -> Key:
    """The key of a system's recall on both splits, of objects of which so much is visible."""
    return Key(system, metric="add", group=f"visible {low:.2f} to {high:.2f}")


def chosen_pose(system: str, estimate: Estimate) -> Pose:
    """What a system says, told by an estimate of OPEPL-R, which has the pose of before, too."""
    when = SYSTEMS[system]
    if when == "always" or (when == "overlap" and estimate.overlap > THRESHOLD):
        return estimate.R, estimate.t
    return estimate.first


# Refiners -----------------------------------------------------------------------------------------


def new_refiner(seed: int = 0) -> FieldRefiner:
    """A refiner of the three objects, with its first weights."""
    with seeded(seed):
        width = choose(tiny=4, book=16, paper=64)
        return FieldRefiner(training.models(), width)


def train_refiner(
    net: VectorFieldNet,
    *,
    own: bool = True,
    seed: int = 0,
    steps: int,
    keep: bool = True,
) -> FieldRefiner:
    """A refiner for a network that is trained, which stays as it is.

    Args:
        net: says the fields.
        own: whether half of the poses to begin with are those that the system itself finds. All
            others are true ones made wrong by chance.
        seed: of weights and of chance.
        steps: of 64 objects.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    refiner = new_refiner(seed)
    names = (own, seed, steps, weights_digest(net))

    @lru_cache(maxsize=1)
    def learning() -> RefinerTraining:
        """Not before it is wanted: a training that is found again needs none."""
        seen, models = training_fields(net), training.models()
        system = VectorFieldSystem(net, models, fit=FIT)
        poses = own_poses(system, seen, show=False) if own else None
        return RefinerTraining(seen, models, poses, size=choose(tiny=8, book=64, paper=64))

    fit(
        refiner,
        lambda generator: learning().batches(generator),
        lambda model, batch: learning().loss(model, batch),
        steps=steps,
        lr=1e-3,
        clip=1.0,
        seed=seed,
        device="cpu",
        resume=resume_folder(train_refiner, *names, data=training.DATA) if keep else None,
        show=False,
    )
    return refiner


@lru_cache(maxsize=1)
def training_fields(net: VectorFieldNet) -> Seen:
    """What a network says of the training images, each varied once."""
    return look_at_views(
        net, training.stack("train"), training.size(), augment=training.VARIED, show=False
    )


# Parts --------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def trained(name: str, seed: int) -> VectorFieldNet:
    """The network of a loss and a seed."""
    return training.train_net(*LOSSES[name], seed=seed, steps=choose(**STEPS))[0]


def _looks(split: str) -> Iterator[tuple[Tensor, dict[str, Tensor]]]:
    for views in torch.arange(len(training.stack(split))).split(10):
        yield views, training.frames(split, views)


def _poses(found: Found) -> dict[tuple[int, int], Pose]:
    return {key: (estimate.R, estimate.t) for key, estimate in found.items()}


def _plain(found: Found, split: str) -> dict[tuple[int, int], Pose]:
    """PnP of the same keypoints, all trusted alike."""
    known = {model.object_id: model for model in training.models()}
    poses = {}
    for (view, object_id), estimate in found.items():
        K = training.camera(split, view)
        with contextlib.suppress(ValueError):  # no pose fits: not found
            solved = pnp(known[object_id].keypoints, estimate.keypoints, K)
            poses[view, object_id] = solved.R, solved.t
    return poses


def _shares(name: str, split: str, judged: list) -> dict[Key, float]:
    """Percentages right: over the objects, of each of them, and by 2D projection."""
    values = {
        Key(name, split, "add"): outcomes.recall(judged),
        Key(name, split, "projection"): outcomes.recall(judged, "projection"),
    }
    for object_id, word in zip(training.OBJECTS, training.NAMES, strict=True):
        own = [outcome for outcome in judged if outcome.object_id == object_id]
        values[Key(name, split, "add", word)] = outcomes.recall(own)
    return values
