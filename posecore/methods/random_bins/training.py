"""`train random_bins`: on infrared pictures with poses."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch
from torch import nn

from data_tools.batches import load
from posecore.methods.net_training import train_net
from posecore.methods.random_bins.pictures import Pictures
from posecore.methods.random_bins.recipe import RECIPES, Recipe
from posecore.methods.random_bins.runs import RandomBinsRun
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
    train_net(options, RECIPES, _pictures, _new_run, _new_net, RandomBinsRun)


def _pictures(options: argparse.Namespace, job: Job, recipe: Recipe) -> Pictures:
    dataset = open_source(options.data, options.split, job.scale, show=job.first)
    data = load(dataset, progress=job.first and sys.stderr.isatty())
    try:
        pictures = recipe.pictures(data)
    except ValueError as error:
        raise ValueError(f"--data: {options.data}: {error}") from error
    objects = chosen_objects(options, pictures.object_id.unique().tolist())
    return pictures.only(torch.isin(pictures.object_id, torch.tensor(objects)))


def _new_run(
    path: Path, asked: dict[str, Any], recipe: Recipe, pictures: Pictures
) -> RandomBinsRun:
    return RandomBinsRun(
        path, asked, recipe.kind, recipe.net, pictures.object_id.unique().tolist(), recipe.image,
        pictures.values.amin(0).tolist(), pictures.values.amax(0).tolist(),
    )  # fmt: skip


def _new_net(recipe: Recipe, pictures: Pictures, seed: int) -> nn.Module:
    return recipe.new_net(pictures, seed)
