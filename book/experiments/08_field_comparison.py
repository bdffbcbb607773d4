"""What chapter 8 compares: losses, systems, uncertainty in PnP, and how long an image takes."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import time
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from posecore.book.checkpoints import resume_folder
from posecore.papers.vector_field.masked_fields import MaskedFields
from posecore.papers.vector_field.network import VectorFieldNet
from posecore.papers.vector_field.refinement import FieldRefiner
from posecore.papers.vector_field.refiner_training import (
    RefinerTraining,
    look_at_views,
    weights_digest,
)
from posecore.papers.vector_field.systems import STAGES, SYSTEMS, Estimate, VectorFieldSystem
from posecore.registration import pnp
from posecore.scale import choose
from posecore.training import fit, seeded

training = importlib.import_module("book.experiments.08_field_training")
outcomes = importlib.import_module("book.experiments.08_field_outcomes")

__all__ = [
    "BINS",
    "LOSSES",
    "SPLITS",
    "STEPS",
    "compare_losses",
    "compare_systems",
    "measure_speed",
    "new_refiner",
    "part_of",
    "run",
    "train_refiner",
]

SPLITS = ("easy", "occluded")
STEPS = {"tiny": 20, "book": 4000, "paper": 250_000}
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

Pose = tuple[np.ndarray, np.ndarray]
Found = dict[tuple[int, int], Estimate]


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


def compare_losses(seed: int) -> dict[str, float]:
    """One network for each of `LOSSES`, the same windows for all; percentages right."""
    values = {}
    for name in LOSSES:
        net = _trained(name, seed)
        system = VectorFieldSystem(net, training.models())
        for split in SPLITS:
            data, found = training.stack(split), run(system, split)
            values |= _shares(f"{name}, {split}", outcomes.outcomes(data, _poses(found)))
            if name == "pixel":
                judged = outcomes.outcomes(data, _plain(found, split))
                values |= _shares(f"plain PnP, {split}", judged)
    return values


def compare_systems(seed: int) -> dict[str, float]:
    """OPEPL, -R and -DR with the same network and the same refiner."""
    net = _trained("pixel", seed)
    refiner = train_refiner(net, seed=seed)
    values = {}
    everything: dict[str, list] = {name: [] for name in SYSTEMS}
    for name in SYSTEMS:
        system = VectorFieldSystem.named(name, net, training.models(), refiner)
        for split in SPLITS:
            found = run(system, split)
            judged = outcomes.outcomes(training.stack(split), _poses(found))
            values |= _shares(f"{name}, {split}", judged)
            share = 100 * float(np.mean([estimate.refined for estimate in found.values()] or [0]))
            values[f"{name}, {split}, refined"] = share
            everything[name] += judged
        for low, high in itertools.pairwise(BINS):
            last = high == BINS[-1]
            some = [o for o in everything[name] if low <= o.visible and (o.visible < high or last)]
            if some:
                right = 100 * float(np.mean([outcome.right for outcome in some]))
                values[f"{name}, visible {low:.2f} to {high:.2f}"] = right
    return values


def measure_speed(seed: int) -> dict[str, float]:
    """Milliseconds for one image with one, two and three objects, in all and by stage.

    The networks with fewer objects are parts of the one with three: the same but for the last
    layers. Images are looked at one by one, those that show most of the three.
    """
    net = _trained("pixel", seed)
    known = training.models()
    data = training.stack("easy")
    rows = data.rows(object_id=training.OBJECTS, visible=0.5)
    shown = torch.bincount(data.view[rows], minlength=len(data))
    views = shown.argsort(descending=True, stable=True)[: choose(tiny=2, book=20, paper=50)]
    batches = [training.frames("easy", view[None]) for view in views]
    values = {}
    for count in range(1, 1 + len(known)):
        system = VectorFieldSystem(part_of(net, count), known[:count])
        system.estimate(batches[0]["rgb"], batches[0]["K"])  # the first call sets things up
        totals, stages = [], {stage: [] for stage in STAGES}
        for batch in batches:
            start = time.perf_counter()
            estimates = system.estimate(batch["rgb"], batch["K"])
            totals.append(1000 * (time.perf_counter() - start))
            for stage in STAGES:
                seconds = estimates[0].seconds[stage] if estimates else 0.0
                stages[stage].append(1000 * seconds)
        values[f"{count}"] = float(np.median(totals))
        values |= {f"{count}, {s}": float(np.median(times)) for s, times in stages.items()}
    values["3 x 1"] = 3 * values["1"]
    return values


def part_of(net: VectorFieldNet, count: int) -> VectorFieldNet:
    """The same network for the first `count` of its objects."""
    smaller = VectorFieldNet(count, net.keypoints, training.width())
    weights = dict(net.state_dict())
    rows = {"mask_layer": 1 + count, "vector_layer": 2 * net.keypoints * count}
    for layer, number in rows.items():
        for name in ("weight", "bias"):
            weights[f"{layer}.{name}"] = weights[f"{layer}.{name}"][:number]
    smaller.load_state_dict(weights)
    return smaller.eval()


# Refiners -----------------------------------------------------------------------------------------


def new_refiner(seed: int = 0) -> FieldRefiner:
    """A refiner of the three objects, with its first weights."""
    with seeded(seed):
        return FieldRefiner(training.models(), width=choose(tiny=4, book=16, paper=64))


def train_refiner(
    net: VectorFieldNet, *, seed: int = 0, steps: int | None = None, keep: bool = True
) -> FieldRefiner:
    """A refiner for a network that is trained, which stays as it is.

    It learns from the fields of whole training images, and from poses that are wrong by a little.
    """
    steps = choose(tiny=20, book=2000, paper=50_000) if steps is None else steps
    refiner = new_refiner(seed)
    seen = training_fields(net)
    learning = RefinerTraining(seen, training.models(), size=choose(tiny=8, book=64, paper=64))
    fit(
        refiner,
        learning.batches,
        learning.loss,
        steps=steps,
        lr=1e-3,
        clip=1.0,
        seed=seed,
        device="cpu",
        resume=resume_folder(train_refiner, seed, steps, weights_digest(net)) if keep else None,
        show=False,
    )
    return refiner


def training_fields(net: VectorFieldNet) -> list[tuple[MaskedFields, dict[str, Tensor]]]:
    """What a network says of the training images, each varied once."""
    return look_at_views(
        net, training.stack("train"), training.size(), augment=training.VARIED, show=False
    )


# Parts --------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def _trained(name: str, seed: int) -> VectorFieldNet:
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


def _shares(name: str, judged: list) -> dict[str, float]:
    """Percentages right: over the objects, of each of them, and by 2D projection."""
    values = {name: outcomes.recall(judged), f"{name}, 2D": outcomes.recall(judged, "projection")}
    for object_id, word in zip(training.OBJECTS, training.NAMES, strict=True):
        own = [outcome for outcome in judged if outcome.object_id == object_id]
        values[f"{name}, {word}"] = outcomes.recall(own)
    return values
