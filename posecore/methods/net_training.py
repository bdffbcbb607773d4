"""`train METHOD` where one network is trained for all objects: written once for such methods."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from data_tools.batches import Batches
from posecore.arrays import fail
from posecore.methods.runs import NetRun, read_net_run, resumed
from posecore.methods.training import Job, default_split, integer_option
from posecore.training.loop import ADAM

__all__ = ["FitNumbers", "NetRecipe", "add_net_options", "train_net"]


@dataclass(frozen=True, kw_only=True)
class FitNumbers:
    """What a recipe for `train_net` says of its training.

    Attributes:
        batch: samples in a step.
        steps, optimiser, lr, schedule, clip: as for `fit`.
    """

    batch: int
    steps: int
    optimiser: Callable[..., torch.optim.Optimizer] = ADAM
    lr: float = 1e-3
    schedule: str | Callable[[float], float] = "cosine"
    clip: float | None = None

    @property
    def fit(self) -> dict[str, Any]:
        """What `posecore.training.fit` is told."""
        return {
            "lr": self.lr, "schedule": self.schedule, "optimiser": self.optimiser,
            "clip": self.clip,
        }  # fmt: skip


class NetRecipe(Protocol):
    """The numbers of a scale, a frozen dataclass, as `train_net` calls it."""

    kind: str
    batch: int
    steps: int

    def batches(self, data: Any, *, seed: int) -> Batches:
        """Of a training."""

    def new_loss(self) -> Callable[[nn.Module, Any], Mapping[str, Tensor]]:
        """As `posecore.training.fit` takes it."""

    @property
    def fit(self) -> dict[str, Any]:
        """What else that is told."""


def add_net_options(command: argparse.ArgumentParser, what: str) -> None:
    """Add the options that all of these methods have to the parser of `train`.

    Args:
        command: as `posecore.methods.training.add_parser` returned it.
        what: a batch consists of, for the help.
    """
    command.add_argument("--steps", type=int, help="default: by the scale")
    command.add_argument("--batch", type=int, help=f"{what} in a step; default: by the scale")


def train_net(
    options: argparse.Namespace,
    recipes: Mapping[str, Any],
    load: Callable[[argparse.Namespace, Job, Any], Any],
    new_run: Callable[[Path, dict[str, Any], Any, Any], NetRun],
    new_net: Callable[[Any, Any, int], nn.Module],
    kind: type[NetRun],
) -> None:
    """Run the command.

    Args:
        options: of the command, those of `add_net_options` among them.
        recipes: a `NetRecipe` by the names of scales.
        load: `load(options, job, recipe)` gives the data as the recipe's `batches` takes them.
        new_run: `new_run(path, options, recipe, data)` makes the record of a new run.
        new_net: `new_net(recipe, data, seed)` gives the network with its first weights.
        kind: of run.

    Raises:
        ValueError: for an option that cannot be, data that do not fit, or a folder in which another
            process trains.
        OSError: if the run cannot be written.
    """
    job = Job.asked(options)
    recipe = _asked(recipes[job.scale], options)
    if recipe.batch % job.processes:
        fail("--batch", f"a multiple of the {job.processes} processes", recipe.batch)
    if options.split is None:
        options.split = default_split(options.data)
    data = load(options, job, recipe)
    objects = None if options.objects is None else sorted(set(options.objects))
    asked = {
        "data": options.data, "split": options.split, "objects": objects,
        "scale": job.scale, "kind": recipe.kind, "steps": recipe.steps, "batch": recipe.batch,
        "seed": options.seed,
    }  # fmt: skip
    if hasattr(options, "clouds"):
        asked["clouds"] = options.clouds
    run = resumed(job.path, asked, lambda path: read_net_run(path, kind))
    if run is None:
        run = new_run(job.path, asked, recipe, data)
    with job.alone():
        if job.first:
            run.write()
        job.fit(
            run, "net", new_net(recipe, data, options.seed),
            recipe.batches(data, seed=options.seed), recipe.new_loss(), steps=recipe.steps,
            recipe={**asked, "count": len(data)}, **recipe.fit,
        )  # fmt: skip


def _asked(recipe: Any, options: argparse.Namespace) -> Any:
    """The recipe with the numbers that were asked for."""
    return replace(
        recipe,
        kind=getattr(options, "kind", None) or recipe.kind,
        steps=integer_option("--steps", options.steps, recipe.steps, 1),
        batch=integer_option("--batch", options.batch, recipe.batch, 1),
    )
