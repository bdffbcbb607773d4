"""Numbers by which a run at `tiny` tells whether chapter 8's measurements are still the same.

After twenty steps no pose is right, so at `tiny` every recall is 0, whatever the code does. These
numbers differ with all that decides recalls: the weights that training ends in, and the poses that
votes, PnP, refiner and rules make of true fields with noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from book.ch08_vector_fields import comparison
from book.ch08_vector_fields import field_training as training
from posecore import weights
from posecore.methods.outcomes import recall
from posecore.methods.vector_field.masked_fields import MaskedFields
from posecore.methods.vector_field.systems import SYSTEMS, Estimate, VectorFieldSystem
from posecore.methods.vector_field.voting import VoteOptions

__all__ = ["witness_losses", "witness_systems"]

NOISE = 0.25
"""Standard deviation of what is added to true fields, in lengths of their vectors."""
VIEWS = 10


def witness_losses(seed: int) -> dict[str, object]:
    """Digests of the networks' weights, and errors of poses from fields with noise."""
    found: dict[str, object] = {
        f"weights, {name}": weights.digest(comparison.trained(name, seed).state_dict())
        for name in comparison.LOSSES
    }
    system = VectorFieldSystem(comparison.trained("pixel", seed), training.models())
    for split in comparison.SPLITS:
        # The whole road of `compare_losses`, with these fields in place of a network's.
        chosen = comparison.estimate_split(_Given(system, split, seed), split)
        done = comparison.evaluate(split, comparison._poses(chosen))
        shares = comparison._shares("given fields", split, done)
        found |= {f"shares, {key}": value for key, value in shares.items()}
        views, batch, fields = _noisy_fields(split, seed)
        for fit in ("angles", "lines"):
            system.voting = VoteOptions(fit=fit)
            estimates = {
                (int(views[one.image]), one.object_id): one
                for one in system.estimate_fields(fields, batch["K"])
            }
            poses = {key: (one.R, one.t) for key, one in estimates.items()}
            found |= _errors(f"{split}, {fit}", split, poses)
            if fit == "angles":
                plain = comparison._plain(estimates, split)
                found |= _errors(f"{split}, plain PnP", split, plain)
    return found


def witness_systems(seed: int) -> dict[str, object]:
    """Digests of the refiners' weights, and pose errors of each system on noisy fields."""
    net = comparison.trained("pixel", seed)
    steps = comparison.choose(**comparison.REFINER_STEPS)
    found: dict[str, object] = {}
    for own in (True, False):
        refiner = comparison.train_refiner(net, own=own, seed=seed, steps=steps)
        found[f"weights, own {own}"] = weights.digest(refiner.state_dict())
        system = training.recipe().system("OPEPL-R", net, training.models(), refiner)
        for split in comparison.SPLITS:
            views, batch, fields = _noisy_fields(split, seed)
            estimates = system.estimate_fields(fields, batch["K"])
            for name in SYSTEMS:
                poses = {
                    (int(views[one.image]), one.object_id): comparison.chosen_pose(name, one)
                    for one in estimates
                }
                found |= _errors(f"{split}, {name}, own {own}", split, poses)
            found[f"{split}, own {own}, overlap"] = float(sum(one.overlap for one in estimates))
    return found


class _Given:
    """A system that is given noisy fields in place of its network's; of each object also a worse
    estimate, so that it counts which of two is chosen."""

    def __init__(self, system: VectorFieldSystem, split: str, seed: int) -> None:
        self.system, self.split, self.seed = system, split, seed

    def estimate(self, images: torch.Tensor, K: torch.Tensor) -> list[Estimate]:
        """The estimates of the first `VIEWS` views of the split, asked for first."""
        views, batch, fields = _noisy_fields(self.split, self.seed)
        good = self.system.estimate_fields(fields, batch["K"])
        worse = [replace(one, score=one.score / 2, t=2 * one.t) for one in good]
        return [*worse, *good, *worse] if len(views) == len(images) else []


def _noisy_fields(
    split: str, seed: int
) -> tuple[torch.Tensor, dict[str, torch.Tensor], MaskedFields]:
    """Views, their batch, and the true fields of their objects with noise."""
    views = torch.arange(min(VIEWS, len(training.stack(split))))
    batch = training.frames(split, views)
    targets = training.true_fields(batch, training.models())
    noise = torch.randn(
        targets.vectors.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float32
    )
    vectors = targets.vectors + NOISE * torch.linalg.vector_norm(
        targets.vectors, dim=-1, keepdim=True
    ) * noise.to(targets.vectors)
    return views, batch, MaskedFields(*targets[1:5], vectors)


def _errors(name: str, split: str, poses: dict) -> dict[str, object]:
    done = comparison.evaluate(split, poses).values()
    here = [one for one in done if np.isfinite(one.add)]
    return {
        f"{name}, found": len(here),
        f"{name}, add": float(sum(one.add for one in here)),
        f"{name}, projection": float(sum(one.projection for one in here)),
        f"{name}, t": float(sum(one.t for one in here)),
        f"{name}, recall": recall(done),
        f"{name}, recall by projection": recall(done, lambda one: one.projected_right),
    }
