"""`train points_to_pose`, and with other recipes every method on clouds."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from data_tools.batches import Stack, load
from data_tools.shapes.glasses import GLASSES
from posecore.arrays import fail
from posecore.methods.infrared.clouds import CloudSet, read_clouds
from posecore.methods.net_training import train_net
from posecore.methods.points_to_pose.centred_clouds import CentredClouds
from posecore.methods.points_to_pose.pose_clouds import (
    PoseClouds,
    predicted_clouds,
    visible_clouds,
)
from posecore.methods.points_to_pose.recipe import RECIPES
from posecore.methods.points_to_pose.runs import CloudRun, PointsToPoseRun
from posecore.methods.sources import open_source
from posecore.methods.training import Job, chosen_objects

GLASSES_IDS = tuple(range(1, len(GLASSES) + 1))  # of `headset` and `hmdpose`
__all__ = ["clouds_of", "open_clouds", "train", "train_on_clouds"]


def train(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, data that do not fit, or a folder in which another
            process trains.
        OSError: if the run cannot be written.
    """
    train_on_clouds(options, RECIPES, PointsToPoseRun)


def train_on_clouds(
    options: argparse.Namespace, recipes: Mapping[str, Any], kind: type[CloudRun]
) -> None:
    """Run the command of a method on clouds.

    Args:
        options: of the command.
        recipes: by the names of scales; each a `CloudRecipe` with `kind`, `net`, `new_net(seed)`,
            `prepared(clouds)` and `new_loss()`.
        kind: of run.

    Raises:
        ValueError, OSError: as of `train`.
    """

    def new_run(path: Path, asked: dict[str, Any], recipe: Any, clouds: CentredClouds) -> CloudRun:
        objects = clouds.object_id.unique().tolist()
        return kind(path, asked, recipe.kind, recipe.net, objects, recipe.points)

    def new_net(recipe: Any, clouds: CentredClouds, seed: int) -> nn.Module:
        return recipe.new_net(seed)

    train_net(options, recipes, _prepared, new_run, new_net, kind)


def _prepared(options: argparse.Namespace, job: Job, recipe: Any) -> CentredClouds:
    clouds = open_clouds(options, job.scale, recipe.points, job.first)
    known = clouds.object_id.unique().tolist()
    if not set(known) <= set(GLASSES_IDS):
        words = f"glasses on a head, objects {GLASSES_IDS[0]} to {GLASSES_IDS[-1]}"
        fail("--data", words, f"objects {known}")
    objects = chosen_objects(options, known)
    return recipe.prepared(clouds.only(torch.isin(clouds.object_id, torch.tensor(objects))))


def open_clouds(options: argparse.Namespace, scale: str, points: int, show: bool) -> PoseClouds:
    """The clouds that a command is given, of that many points each.

    Args:
        options: `data`, `split`, and the file `clouds` or None for what is truly visible.
        scale: of worlds.
        points: N.
        show: whether to show bars and notes.

    Raises:
        ValueError: if there are no such data or clouds, they do not belong together, or lack what
            is needed.
    """
    predicted = None if options.clouds is None else clouds_of(options.clouds, points)
    dataset = open_source(options.data, options.split, scale, show=show)
    data = load(dataset, progress=show and sys.stderr.isatty())
    if predicted is None:
        return _named("--data", options.data, lambda: visible_clouds(data, points))
    return _named("--clouds", options.clouds, lambda: _predicted(data, predicted, points))


def clouds_of(file: str, points: int) -> CloudSet:
    """The clouds in a file that `clouds infrared` wrote.

    Raises:
        ValueError: naming `--clouds`, if it is no such file, or a cloud has fewer than `points`.
    """
    found = _named("--clouds", None, lambda: read_clouds(file))
    most = found.points.shape[1]
    if most < points:
        fail("--clouds", f"clouds of at least {points} points", f"{file} with {most}")
    return found


def _predicted(data: Stack, clouds: CloudSet, points: int) -> PoseClouds:
    return predicted_clouds(data, clouds).thinned(points)


def _named(option: str, value: str | None, make: Callable[[], Any]) -> Any:
    """What is made, or an error that names an option of the command line."""
    try:
        return make()
    except ValueError as error:
        words = str(error) if value is None else f"{value}: {error}"
        raise ValueError(f"{option}: {words.removeprefix('path: ')}") from error
