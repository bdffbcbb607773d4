"""`train vector_field`: the network of the field, then the refiner."""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

from data_tools.batches import Stack
from data_tools.batches.memory import BYTES, require_room
from posecore.arrays import fail, require_number
from posecore.methods.runs import resumed
from posecore.methods.training import Job, integer_option, open_data
from posecore.methods.vector_field.frozen_fields import (
    look_at_views,
    own_poses,
    weights_digest,
)
from posecore.methods.vector_field.learning import Objective, Pool, Windows
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.models import object_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.plans import PLANS, Plan
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.runs import VectorFieldRun, read_run
from posecore.methods.vector_field.systems import VectorFieldSystem
from posecore.training import seeded

__all__ = ["train"]

AT_ONCE = 64  # windows that are cut together; their backgrounds are of each other
IN_POOL = 30_000  # windows at most: of 96 x 96 pixels, 1.4 GB
NET_BYTES = 600, 15  # of a pixel that the network learns from at the least, and for its width
KINDS = {"rgb": "colour images", "instance": "masks of all objects"}


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
    plan: Plan
    job: Job
    run: VectorFieldRun
    data: Stack


def _prepare(options: argparse.Namespace) -> _Task:
    """Check all that was asked for, and read the data."""
    job = Job.asked(options)
    plan = PLANS[job.scale]
    loss = _loss(options, plan)
    batch = integer_option("--batch", options.batch, plan.batch, 1)
    if batch % job.processes:
        fail("--batch", f"a multiple of the {job.processes} processes", batch)
    steps = integer_option("--steps", options.steps, plan.steps, 1)
    refiner_steps = integer_option("--refiner-steps", options.refiner_steps, plan.refiner_steps, 0)
    data, known, objects = open_data(options, job, KINDS)
    each = max(NET_BYTES[0], NET_BYTES[1] * plan.width) if job.device.type == "cpu" else BYTES
    require_room("--batch", batch, tuple(map(min, plan.window, data.size)), each)
    asked = {
        "data": options.data,
        "split": options.split,
        "objects": objects,
        "scale": job.scale,
        "steps": steps or math.ceil(plan.epochs * len(data) / batch),
        "refiner_steps": refiner_steps,
        "batch": batch,
        "projection": loss.projection,
        "weight": loss.weight,
        "begin": loss.begin,
        "forward_only": loss.forward_only,
        "imagenet": options.imagenet,
        "seed": options.seed,
    }
    run = resumed(job.path, asked, read_run)
    if run is None:
        models = object_models(known, objects)
        refiner_width = plan.refiner_width if refiner_steps else None
        run = VectorFieldRun(job.path, asked, plan.width, plan.most, refiner_width, models)
    return _Task(plan, job, run, data)


def _train_field(task: _Task, imagenet: str | None) -> VectorFieldNet:
    plan, run, data = task.plan, task.run, task.data
    options = run.options
    batches = _batches(task)
    with seeded(options["seed"]):
        net = run.new_net()
    if imagenet:
        try:
            net.backbone.load_imagenet(imagenet)
        except ValueError as error:
            raise ValueError(f"--imagenet: {error}") from error
    if task.job.first:
        run.write()
    names = ("projection", "weight", "begin", "forward_only")
    loss = VectorFieldLoss(**{name: options[name] for name in names})
    objective = Objective(run.models, loss, plan.pixels)
    recipe = {**options, "views": len(data)}
    task.job.fit(
        run, "net", net, batches, objective, steps=options["steps"],
        lr=plan.lr, schedule=plan.schedule, optimiser=plan.optimiser, clip=10.0, recipe=recipe,
    )  # fmt: skip
    return net


def _train_refiner(task: _Task, net: VectorFieldNet) -> None:
    plan, options = task.plan, task.run.options
    with seeded(options["seed"]):
        refiner = task.run.new_refiner()
    show = None if task.job.first else False
    seen = look_at_views(
        net, task.data, most=plan.refiner_images, augment=plan.augment,
        seed=options["seed"], show=show,
    )  # fmt: skip
    if not seen:
        fail("--steps", "enough for a field that sees objects, or --refiner-steps 0", "too few")
    learning = RefinerTraining(
        seen,
        task.run.models,
        own_poses(VectorFieldSystem(net, task.run.models), seen, show),
        size=math.ceil(plan.refiner_batch / task.job.processes) * task.job.processes,
    )
    recipe = {**options, "net": weights_digest(net)}
    task.job.fit(
        task.run, "refiner", refiner, learning.batches, learning.loss,
        steps=options["refiner_steps"], lr=plan.refiner_lr, schedule=plan.schedule,
        clip=1.0, recipe=recipe,
    )  # fmt: skip


def _batches(task: _Task) -> Windows | Pool:
    """The windows of a training, cut anew for every step or drawn from a pool."""
    plan, data, options = task.plan, task.data, task.run.options
    draws = {"steps": options["steps"], "count": options["batch"], "seed": options["seed"]}
    visible = 0.0 if data.visible_fraction is None else plan.visible
    cut = draws
    if plan.looks is not None:
        rows = data.rows(object_id=options["objects"], visible=visible)
        drawn = options["steps"] * options["batch"]
        wanted = max(1, min(plan.looks * len(rows), drawn, IN_POOL))
        count = min(wanted, AT_ONCE)
        cut = draws | {"steps": math.ceil(wanted / count), "count": count}
    windows = Windows(
        data,
        task.run.models,
        **cut,
        size=tuple(map(min, plan.window, data.size)),
        augment=plan.augment,
        visible=visible,
        shift=plan.shift,
        elsewhere=plan.elsewhere,
    )
    return windows if plan.looks is None else Pool(windows, **draws)


def _loss(options: argparse.Namespace, plan: Plan) -> VectorFieldLoss:
    begin = plan.begin if options.begin is None else require_number("--begin", options.begin, 0, 1)
    forward_only = plan.forward_only if options.forward_only is None else options.forward_only
    if options.projection == "none" and options.weight != "dynamic":
        fail("--weight", "nothing, as --projection none leaves that loss out", options.weight)
    try:
        weight = "dynamic" if options.weight == "dynamic" else float(options.weight)
        return VectorFieldLoss(options.projection, weight, begin, forward_only)
    except ValueError:
        fail("--weight", "dynamic, or a number of at least 0", options.weight)
