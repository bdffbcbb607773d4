"""`train vector_field`: the network of the field, then the refiner, by the recipe."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import NamedTuple

from data_tools.batches import Stack
from data_tools.batches.memory import BYTES, require_room
from posecore import weights
from posecore.arrays import fail, require_number
from posecore.methods.objects import object_models
from posecore.methods.runs import resumed
from posecore.methods.training import Job, integer_option, open_data
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.recipe import RECIPES, Recipe
from posecore.methods.vector_field.runs import VectorFieldRun, read_run

__all__ = ["train"]

NET_BYTES = 600, 15  # of a pixel that the network learns from at the least, and for its width
KINDS = {"rgb": "colour images", "instance": "masks of all objects"}
OF_LOSS = ("projection", "weight", "warmup", "ignore_reversed")


def train(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, data that do not fit, or a folder in which another
            process trains.
        OSError: if the run cannot be written.
    """
    task = _prepare(options)
    with task.job.alone():
        net = _train_field(task, options.imagenet)
        if task.run.refiner_width is not None:
            _train_refiner(task, net)


class _Task(NamedTuple):
    recipe: Recipe
    job: Job
    run: VectorFieldRun
    data: Stack


def _prepare(options: argparse.Namespace) -> _Task:
    """Check all that was asked for, and read the data."""
    job = Job.asked(options)
    recipe = _asked(RECIPES[job.scale], options)
    if recipe.batch % job.processes:
        fail("--batch", f"a multiple of the {job.processes} processes", recipe.batch)
    data, known, objects = open_data(options, job, KINDS)
    each = max(NET_BYTES[0], NET_BYTES[1] * recipe.width) if job.device.type == "cpu" else BYTES
    crop = tuple(map(min, recipe.crop, recipe.image_size(data)))
    require_room("--batch", recipe.batch, crop, each)
    steps = recipe.steps or math.ceil(recipe.epochs * len(data) / recipe.batch)
    recipe = replace(recipe, steps=steps)
    asked = {
        "data": options.data,
        "split": options.split,
        "objects": objects,
        "scale": job.scale,
        "steps": recipe.steps,
        "refiner_steps": recipe.refiner_steps,
        "batch": recipe.batch,
        **{name: getattr(recipe, name) for name in OF_LOSS},
        "imagenet": options.imagenet,
        "seed": options.seed,
    }
    run = resumed(job.path, asked, read_run)
    if run is None:
        models = object_models(known, objects)
        refiner_width = recipe.refiner_width if recipe.refiner_steps else None
        sizes = recipe.width, recipe.max_channels, refiner_width, recipe.image_width
        run = VectorFieldRun(job.path, asked, *sizes, models)
    return _Task(recipe, job, run, data)


def _train_field(task: _Task, imagenet: str | None) -> VectorFieldNet:
    recipe, run = task.recipe, task.run
    seed = run.options["seed"]
    drawn = recipe.steps * recipe.batch
    crops = recipe.crops(task.data, run.models, most=drawn, seed=seed)
    net = recipe.new_net(run.models, seed)
    if imagenet:
        try:
            net.backbone.load_imagenet(imagenet)
        except ValueError as error:
            raise ValueError(f"--imagenet: {error}") from error
    if task.job.first:
        run.write()
    task.job.fit(
        run, "net", net, recipe.batches(crops, seed=seed), recipe.objective(run.models),
        steps=recipe.steps, recipe={**run.options, "views": len(task.data)}, **recipe.fit_field,
    )  # fmt: skip
    return net


def _train_refiner(task: _Task, net: VectorFieldNet) -> None:
    recipe, run, job = task.recipe, task.run, task.job
    seed = run.options["seed"]
    learning = recipe.refiner_training(
        net, task.data, run.models, seed=seed, show=None if job.first else False,
        batch=math.ceil(recipe.refiner_batch / job.processes) * job.processes,
    )  # fmt: skip
    if learning is None:
        fail("--steps", "enough for a field that sees objects, or --refiner-steps 0", "too few")
    job.fit(
        run, "refiner", recipe.new_refiner(run.models, seed), learning.batches, learning.loss,
        steps=recipe.refiner_steps, **recipe.fit_refiner,
        recipe={**run.options, "net": weights.digest(net.state_dict())},
    )  # fmt: skip


def _asked(recipe: Recipe, options: argparse.Namespace) -> Recipe:
    """The recipe with the numbers that were asked for."""
    changes = {
        "steps": integer_option("--steps", options.steps, recipe.steps, 1),
        "refiner_steps": integer_option(
            "--refiner-steps", options.refiner_steps, recipe.refiner_steps, 0
        ),
        "batch": integer_option("--batch", options.batch, recipe.batch, 1),
    }
    for name in ("projection", "ignore_reversed"):
        if (value := getattr(options, name)) is not None:
            changes[name] = value
    if options.warmup is not None:
        changes["warmup"] = require_number("--warmup", options.warmup, 0, 1)
    if options.weight is not None:
        if options.projection == "none":
            fail("--weight", "nothing, as --projection none leaves that loss out", options.weight)
        changes["weight"] = _weight(options.weight)
    return replace(recipe, **changes)


def _weight(text: str) -> float | str:
    try:
        weight = "dynamic" if text == "dynamic" else float(text)
        VectorFieldLoss(weight=weight)
    except ValueError:
        fail("--weight", "dynamic, or a number of at least 0", text)
    return weight
