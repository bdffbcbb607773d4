"""`train infrared`: the cloud estimator, by the recipe; with folds one network for each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Stack, load
from posecore.arrays import fail, require_integer
from posecore.methods.infrared.network import SIZES
from posecore.methods.infrared.recipe import RECIPES, SMALL, Recipe
from posecore.methods.infrared.runs import InfraredRun, read_run
from posecore.methods.infrared.triples import Triples
from posecore.methods.runs import resumed
from posecore.methods.sources import open_source
from posecore.methods.training import Job, default_split, integer_option

__all__ = ["folds_of", "open_triples", "train"]


def train(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, data that do not fit, or a folder in which another
            process trains.
        OSError: if the run cannot be written.
    """
    job = Job.asked(options)
    recipe = _asked(RECIPES[job.scale], options)
    folds = integer_option("--folds", options.folds, 1, 1)
    if recipe.batch % job.processes:
        fail("--batch", f"a multiple of the {job.processes} processes", recipe.batch)
    if options.objects is not None:
        fail("--objects", "nothing, as one network serves all glasses", options.objects)
    if options.split is None:
        options.split = default_split(options.data)
    data, triples = open_triples(options.data, options.split, job.scale, recipe, job.first)
    asked = {
        "data": options.data, "split": options.split, "scale": job.scale, "steps": recipe.steps,
        "batch": recipe.batch, "masks": recipe.masks, "folds": folds, "small": options.small,
        "seed": options.seed,
    }  # fmt: skip
    scenes = data.scene_id[triples.views[:, 0]]
    run = resumed(job.path, asked, read_run)
    if run is None:
        sizes = {name: getattr(recipe, name) for name in ("image", *SIZES)}
        run = InfraredRun(job.path, asked, scenes=folds_of(scenes, folds), **sizes)
    with job.alone():
        if job.first:
            run.write()
        for name, known in zip(run.names, run.scenes, strict=True):
            part = triples.only(torch.isin(scenes, torch.tensor(known)))
            _train(job, run, name, recipe, part)


def _train(job: Job, run: InfraredRun, name: str, recipe: Recipe, triples: Triples) -> None:
    seed = run.options["seed"]
    job.fit(
        run, name, recipe.new_net(triples, seed), recipe.batches(triples, seed=seed),
        recipe.new_loss(triples.size), steps=recipe.steps,
        recipe={**run.options, "instants": len(triples)}, **recipe.fit,
    )  # fmt: skip


def open_triples(
    source: str,
    split: str | None,
    scale: str,
    recipe: Recipe,
    show: bool,
    mask_of: Callable[..., np.ndarray] | None = None,
) -> tuple[Stack, Triples]:
    """The data that a command is given, and what the networks see of it; `mask_of` of `Triples`.

    Raises:
        ValueError: if there are no such data, or they lack what the recipe needs.
    """
    dataset = open_source(source, split, scale, show=show)
    data = load(dataset, progress=show and sys.stderr.isatty())
    try:
        return data, recipe.triples(data, mask_of)
    except ValueError as error:
        raise ValueError(f"--data: {source}: {error}") from error


def folds_of(scenes: Tensor, folds: int) -> list[list[int]]:
    """The scenes that each network is trained on: all of them, or all but those of its fold.

    Args:
        scenes: of the instants.
        folds: how many; 1 for one network, trained on all.

    Raises:
        ValueError: if there are fewer scenes than folds.
    """
    known = sorted(set(scenes.tolist()))
    if folds == 1:
        return [known]
    if len(known) < folds:
        fail("--folds", f"at most the {len(known)} scenes of the data", folds)
    return [[s for i, s in enumerate(known) if i % folds != fold] for fold in range(folds)]


def _asked(recipe: Recipe, options: argparse.Namespace) -> Recipe:
    """The recipe with the numbers that were asked for."""
    recipe = replace(recipe, **SMALL) if options.small else recipe
    changes: Mapping[str, Any] = {
        "steps": integer_option("--steps", options.steps, recipe.steps, 1),
        "batch": integer_option("--batch", options.batch, recipe.batch, 1),
        "masks": options.masks or recipe.masks,
    }
    require_integer("--batch", changes["batch"], 1)
    return replace(recipe, **changes)
