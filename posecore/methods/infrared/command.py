"""`train infrared` and `clouds infrared`: chapter 3 on any infrared dataset of several cameras."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from data_tools.batches import Stack
from posecore.methods import training
from posecore.methods.infrared.clouds import CloudSet, made_from, predict, read_clouds
from posecore.methods.infrared.recipe import RECIPES
from posecore.methods.infrared.runs import InfraredRun, read_run
from posecore.methods.infrared.training import open_triples, train
from posecore.methods.infrared.triples import MASKS, Triples
from posecore.methods.outputs import check_outputs, say_beside
from posecore.methods.sources import new_parser
from posecore.training.machine import choose_device

__all__ = ["add_clouds", "add_train"]

TRAIN = """Train the cloud estimator on triples of infrared images with known poses. No depth and no
masks are needed (--masks threshold makes them). RUN is a folder; a command that was stopped goes on
when it is given again. Several processes: torchrun --nproc-per-node N -m posecore train ..."""
CLOUDS = """Write the clouds that a run predicts of a split's images, each from its image alone, to
one file. Of a run with folds every cloud is made by a network that was not trained on its scene."""


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `infrared` to the methods that can be trained."""
    command = training.add_parser(
        methods, "infrared", train, summary="the cloud estimator", description=TRAIN
    )
    command.add_argument("--steps", type=int, help="default: by the scale")
    command.add_argument("--batch", type=int, help="instants in a step; default: by the scale")
    command.add_argument("--masks", choices=MASKS, help="default: by the scale")
    command.add_argument(
        "--small", action="store_true", help="the sizes and steps that chapter 3 compares"
    )
    command.add_argument(
        "--folds", type=int, help="train so many networks, each without the scenes of its fold"
    )


def add_clouds(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `infrared` to the methods that write clouds."""
    command = new_parser(
        methods, "infrared", write_clouds, summary="of the cloud estimator", description=CLOUDS
    )
    command.add_argument("--run", required=True, help="folder that `train infrared` wrote")
    command.add_argument("--split", help="which part, if there are several")
    command.add_argument("--output", metavar="FILE.safetensors", required=True)


def write_clouds(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the clouds cannot be written.
    """
    output = Path(options.output)
    check_outputs({"--output": options.output}, (options.run, options.data.partition(":")[2]))
    run = read_run(options.run)
    nets = run.load_nets()
    scale = run.options["scale"]
    recipe = replace(RECIPES[scale], image=run.image)
    data, triples = open_triples(options.data, options.split, scale, recipe, True, _no_mask)
    origin = made_from(nets, triples)
    if output.is_file() and _holds(output, origin):
        say_beside(f"{output}: {len(data)} clouds, there already", (options.output,))
        return
    device = choose_device(options.device)
    clouds = predicted([net.to(device) for net in nets], run, data, triples, origin)
    clouds.write(output)
    say_beside(f"{output}: {len(clouds)} clouds of {run.points} points", (options.output,))


def predicted(
    nets: list, run: InfraredRun, data: Stack, triples: Triples, origin: dict
) -> CloudSet:
    """The clouds of all views, in the order of the data."""
    order = triples.views.flatten().argsort()
    images = triples.images.flatten(0, 1)[order]
    which = run.net_of(data.scene_id, data.group)
    every = [predict(net, images) for net in nets]
    rows = torch.arange(len(images))

    def pick(name: str) -> torch.Tensor:
        return torch.stack([getattr(cloud, name) for cloud in every])[which, rows]

    return CloudSet(
        points=pick("points").half(), intensities=pick("intensities").half(), t=pick("t"),
        scale=pick("scale"), net=which, scene_id=data.scene_id, image_id=data.image_id,
        group=data.group, T_world_cam=data.T_world_cam, made_from=origin,
    )  # fmt: skip


def _no_mask(image: np.ndarray, *_: np.ndarray) -> np.ndarray:
    """For data that need not have any: a cloud is made of its image alone."""
    return np.zeros(image.shape, bool)


def _holds(path: Path, origin: dict) -> bool:
    """Whether a file has the clouds that follow from this."""
    try:
        return read_clouds(path).made_from == origin
    except ValueError:
        return False
