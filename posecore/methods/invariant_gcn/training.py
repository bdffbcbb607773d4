"""`train invariant_gcn`: on the depth of things of known categories."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch
from torch import nn

from data_tools.batches import load
from posecore.methods.invariant_gcn.category_clouds import CategoryClouds
from posecore.methods.invariant_gcn.recipe import RECIPES, Recipe
from posecore.methods.invariant_gcn.runs import InvariantGCNRun
from posecore.methods.invariant_gcn.seen_clouds import SYMMETRIC, seen_clouds
from posecore.methods.net_training import train_net
from posecore.methods.sources import open_source
from posecore.methods.training import Job, chosen_objects

__all__ = ["train"]


def train(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, data that do not fit, or a folder in which another
            process trains.
        OSError: if the run cannot be written.
    """
    train_net(options, RECIPES, _clouds, _new_run, _new_net, InvariantGCNRun)


def _clouds(options: argparse.Namespace, job: Job, recipe: Recipe) -> CategoryClouds:
    dataset = open_source(options.data, options.split, job.scale, show=job.first)
    data = load(dataset, progress=job.first and sys.stderr.isatty())
    objects = chosen_objects(options, data.object_id.unique().tolist())
    rows = data.rows()
    rows = rows[torch.isin(data.object_id[rows], torch.tensor(objects))]
    try:
        seen = seen_clouds(data, recipe.points, rows=rows)
    except ValueError as error:
        raise ValueError(f"--data: {options.data}: {error}") from error
    return recipe.prepared(seen)


def _new_run(
    path: Path, asked: dict[str, Any], recipe: Recipe, clouds: CategoryClouds
) -> InvariantGCNRun:
    seen = clouds.seen
    return InvariantGCNRun(
        path, asked, recipe.kind, recipe.net, seen.object_id.unique().tolist(), recipe.points,
        list(recipe.sizes), list(recipe.near), list(seen.categories),
        [name for name in seen.categories if name in SYMMETRIC], seen.mean_size().tolist(),
    )  # fmt: skip


def _new_net(recipe: Recipe, clouds: CategoryClouds, seed: int) -> nn.Module:
    return recipe.new_net(clouds.seen.mean_size(), seed)
