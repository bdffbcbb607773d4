"""What chapter 8 compares: losses, systems, and uncertainty in PnP."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from book.ch08_vector_fields import field_training as training
from book.tools.checkpoints import resume_folder
from book.tools.keys import Key
from posecore import weights
from posecore.methods.outcomes import Outcome, outcomes, recall, recall_by
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.recipe import Recipe
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.systems import SYSTEMS, Estimate, VectorFieldSystem, is_refined
from posecore.methods.vector_field.voting import VoteOptions
from posecore.registration import pnp
from posecore.scale import choose
from posecore.training import fit

__all__ = [
    "BINS",
    "DATA",
    "LOSSES",
    "REFINER_STEPS",
    "SPLITS",
    "STEPS",
    "chosen_pose",
    "compare_losses",
    "compare_systems",
    "estimate_split",
    "evaluate",
    "new_refiner",
    "recipe_of",
    "train_refiner",
    "trained",
    "visible_bin",
    "visible_key",
]

SPLITS = ("easy", "occluded")
DATA = ("tabletop/train", "tabletop/easy", "tabletop/occluded")
STEPS = {"tiny": 20, "book": 1600, "paper": 250_000}
REFINER_STEPS = {"tiny": 20, "book": 2000, "paper": 50_000}
LOSSES: dict[str, dict] = {
    "none": {"projection": "none", "weight": 0.0},
    "pixel": {"weight": "dynamic", "warmup": 0.15, "ignore_reversed": True},
    "printed": {"weight": "dynamic"},
    "unit": {"projection": "unit", "weight": "dynamic", "warmup": 0.15, "ignore_reversed": True},
    "constant": {"weight": 0.05, "ignore_reversed": True},
}
"""PVNet without a projection loss; the book's reading; Eq 1 and 2 as printed; unit vectors in place
of pixels; and the last weight of Eq 2 from the beginning."""
BINS = (0.1, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Of the visible fraction."""
Pose = tuple[np.ndarray, np.ndarray]
Found = dict[tuple[int, int], Estimate]


def estimate_split(system: VectorFieldSystem, split: str) -> Found:
    """A system's estimates for a split, by view and object.

    Of several estimates of one object in one view, the one with the highest score counts.
    """
    found: Found = {}
    for views, batch in _frames(split):
        for estimate in system.estimate(batch["rgb"], batch["K"]):
            key = int(views[estimate.image]), estimate.object_id
            if key not in found or estimate.score > found[key].score:
                found[key] = estimate
    return found


def compare_losses(seed: int) -> dict[Key, float]:
    """Recall, in percent, of one network for each of `LOSSES`, trained on the same windows."""
    values = {}
    for name in LOSSES:
        net = trained(name, seed)
        system = training.recipe().system("OPEPL", net, training.models())
        for split in SPLITS:
            found = estimate_split(system, split)
            values |= _shares(name, split, evaluate(split, _poses(found)))
            if name == "pixel":
                values |= _shares("plain PnP", split, evaluate(split, _plain(found, split)))
                lines = VectorFieldSystem(net, training.models(), voting=VoteOptions(fit="lines"))
                other = estimate_split(lines, split)
                values |= _shares("lines", split, evaluate(split, _poses(other)))
    return values


def compare_systems(seed: int) -> dict[Key, float]:
    """Recall of OPEPL, -R and -DR with one network and one refiner, and with a second refiner.

    The second was trained from perturbed true poses only, and on none of the system's own.
    """
    net = trained("pixel", seed)
    steps = choose(**REFINER_STEPS)
    system, other = (
        training.recipe().system(
            "OPEPL-R",
            net,
            training.models(),
            train_refiner(net, own=own, seed=seed, steps=steps),
        )
        for own in (True, False)
    )
    values = {}
    everything: dict[str, list[Outcome]] = {name: [] for name in SYSTEMS}
    for split in SPLITS:
        found = estimate_split(system, split)
        for name in SYSTEMS:
            chosen = {key: chosen_pose(name, estimate) for key, estimate in found.items()}
            done = evaluate(split, chosen)
            values |= _shares(name, split, done)
            everything[name] += done.values()
        values |= _shares("by chance", split, evaluate(split, _poses(estimate_split(other, split))))
        threshold = training.recipe().threshold
        large = [estimate.overlap > threshold for estimate in found.values()] or [False]
        values[Key("OPEPL-DR", split, "refined")] = 100 * float(np.mean(large))
    for name, done in everything.items():
        shares = recall_by(done, visible_bin)
        for low, high in itertools.pairwise(BINS):
            if (low, high) in shares:
                values[visible_key(name, low, high)] = 100 * shares[low, high]
    return values


def evaluate(split: str, poses: Mapping[tuple[int, int], Pose]) -> dict[tuple[int, int], Outcome]:
    """The poses of a split compared with the truth, by view and object."""
    return outcomes(training.stack(split), training.models(), poses)


def visible_bin(one: Outcome) -> tuple[float, float] | None:
    """The bin of `BINS` in which the visible part of an object lies; None below the first."""
    for low, high in itertools.pairwise(BINS):
        if low <= one.visible and (one.visible < high or high == BINS[-1]):
            return low, high
    return None


def visible_key(system: str, low: float, high: float) -> Key:
    """The key of a system's recall on both splits, of objects of which so much is visible."""
    return Key(system, metric="add", group=f"visible {low:.2f} to {high:.2f}")


def chosen_pose(system: str, estimate: Estimate) -> Pose:
    """The pose of a system, from an estimate of OPEPL-R, which keeps the unrefined pose, too."""
    if is_refined(SYSTEMS[system], estimate.overlap, training.recipe().threshold):
        return estimate.R, estimate.t
    return estimate.first


# Refiners -----------------------------------------------------------------------------------------


def new_refiner(seed: int = 0) -> FieldRefiner:
    """A refiner of the three objects, with its first weights."""
    return training.recipe().new_refiner(training.models(), seed)


def train_refiner(
    net: VectorFieldNet,
    *,
    own: bool = True,
    seed: int = 0,
    steps: int,
    keep: bool = True,
) -> FieldRefiner:
    """Train a refiner on the predictions of a frozen network.

    Args:
        net: predicts the fields.
        own: whether half of the initial poses are those that the system itself finds. All others
            are true poses, perturbed at random.
        seed: of weights and of chance.
        steps: of 64 objects.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    refiner = new_refiner(seed)
    names = (own, seed, steps, weights.digest(net.state_dict()))

    @lru_cache(maxsize=1)
    def learning() -> RefinerTraining:
        """Not before it is wanted: a training that is found again needs none."""
        found = training.recipe().refiner_training(
            net, training.stack("train"), training.models(), initial=own, show=False
        )
        if found is None:
            raise ValueError("net: expected one that sees objects in the training images")
        return found

    fit(
        refiner,
        lambda generator: learning().batches(generator),
        lambda model, batch: learning().loss(model, batch),
        steps=steps,
        seed=seed,
        device="cpu",
        resume=resume_folder(train_refiner, *names, data=training.DATA) if keep else None,
        show=False,
        **training.recipe().fit_refiner,
    )
    return refiner


# Parts --------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def trained(name: str, seed: int) -> VectorFieldNet:
    """The network trained with one of `LOSSES` and a seed."""
    return training.train_net(recipe_of(name), seed=seed)[0]


def recipe_of(name: str) -> Recipe:
    """That of the scale in force, with one of `LOSSES` and fewer steps; no windows are anywhere."""
    plain = {"projection": "pixel", "warmup": 0.0, "ignore_reversed": False}
    changes = plain | LOSSES[name] | {"background_fraction": 0.0, "steps": choose(**STEPS)}
    return replace(training.recipe(), **changes)


def _frames(split: str) -> Iterator[tuple[Tensor, dict[str, Tensor]]]:
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


def _shares(name: str, split: str, done: Mapping[tuple[int, int], Outcome]) -> dict[Key, float]:
    """Percentages right: over the objects, of each of them, and by 2D projection."""
    values = {
        Key(name, split, "add"): recall(done.values()),
        Key(name, split, "projection"): recall(done.values(), lambda one: one.projected_right),
    }
    shares = recall_by(done.values(), lambda one: one.object_id)
    for object_id, word in zip(training.OBJECTS, training.NAMES, strict=True):
        values[Key(name, split, "add", word)] = 100 * shares[object_id]
    return values
