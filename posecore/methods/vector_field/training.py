"""`train vector_field`: the network of the field, then the refiner."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

from data_tools.batches import Stack, load
from data_tools.views import Dataset
from posecore.arrays import fail, require_integer, require_number
from posecore.methods.sources import open_source
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
from posecore.methods.vector_field.runs import Run, read_run
from posecore.methods.vector_field.systems import VectorFieldSystem
from posecore.scale import scale
from posecore.training import fit, seeded
from posecore.training.machine import choose_device

__all__ = ["train"]

AT_ONCE = 64  # windows that are cut together; their backgrounds are of each other
IN_POOL = 30_000  # windows at most: of 96 x 96 pixels, 1.4 GB


def train(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or data that do not fit.
        OSError: if the run cannot be written.
    """
    try:
        task = _prepare(options)
        net = _train_field(task, options.imagenet)
        if task.run.refiner_width is not None:
            _train_refiner(task, net)
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        sys.exit(130)


class _Task(NamedTuple):
    plan: Plan
    run: Run
    data: Stack
    device: torch.device
    processes: int
    first: bool  # of the processes: the one that writes and shows

    def fit(self, name: str, model: nn.Module, *data: Any, **options: Any) -> None:
        """Train a model of the run, and keep it."""
        history = fit(
            model,
            *data,
            schedule=self.plan.schedule,
            seed=self.run.options["seed"],
            device=str(self.device),
            resume=self.run.path / "checkpoints" / name,
            **options,
        )
        if self.first:
            self.run.write_weights(name, model)
            print(f"{name}: {history!r}")


def _prepare(options: argparse.Namespace) -> _Task:
    """Check all that was asked for, and read the data."""
    scale_name = options.scale or scale()
    plan, processes = PLANS[scale_name], int(os.environ.get("WORLD_SIZE", "1"))
    first = os.environ.get("RANK", "0") == "0"
    loss = _loss(options, plan)
    batch = _integer("--batch", options.batch, plan.batch, 1)
    if batch % processes:
        fail("--batch", f"a multiple of the {processes} processes", batch)
    steps = _integer("--steps", options.steps, plan.steps, 1)
    refiner_steps = _integer("--refiner-steps", options.refiner_steps, plan.refiner_steps, 0)
    require_integer("--seed", options.seed, 0)
    path, device = Path(options.out), choose_device(options.device)
    if path.exists() and not path.is_dir():
        fail("--out", "a folder", f"the file {options.out!r}")

    dataset = open_source(options.data, options.split, scale_name, show=first)
    known, objects = dataset.models(), _objects(options, dataset)
    if options.data.startswith("linemod:"):
        dataset = open_source(options.data, options.split, scale_name, object_id=objects)
        if len(objects) > 1 and first:
            words = "note: linemod names one object of each image, and others count as background"
            print(words, file=sys.stderr)
    data = load(dataset, progress=first and sys.stderr.isatty())
    for kind, words in (("rgb", "colour images"), ("instance", "masks of all objects")):
        if kind not in data.kinds:
            fail("--data", f"data with {words}", f"{options.data} with {', '.join(data.kinds)}")
    asked = {
        "data": options.data,
        "split": options.split,
        "objects": objects,
        "scale": scale_name,
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
    if (path / "run.json").exists():
        run = read_run(path)
        run.require_options(asked)
    else:
        models = object_models(known, objects)
        refiner_width = plan.refiner_width if refiner_steps else None
        run = Run(path, asked, plan.width, plan.most, refiner_width, models)
    return _Task(plan, run, data, device, processes, first)


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
    if task.first:
        run.write()
    names = ("projection", "weight", "begin", "forward_only")
    loss = VectorFieldLoss(**{name: options[name] for name in names})
    objective = Objective(run.models, loss, plan.pixels)
    recipe = {**options, "views": len(data)}
    task.fit(
        "net", net, batches, objective, steps=options["steps"],
        lr=plan.lr, optimiser=plan.optimiser, clip=10.0, recipe=recipe,
    )  # fmt: skip
    return net


def _train_refiner(task: _Task, net: VectorFieldNet) -> None:
    plan, options = task.plan, task.run.options
    with seeded(options["seed"]):
        refiner = task.run.new_refiner()
    show = None if task.first else False
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
        size=math.ceil(plan.refiner_batch / task.processes) * task.processes,
    )
    recipe = {**options, "net": weights_digest(net)}
    task.fit(
        "refiner", refiner, learning.batches, learning.loss,
        steps=options["refiner_steps"], lr=plan.refiner_lr, clip=1.0, recipe=recipe,
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


def _integer(name: str, value: int | None, default: int | None, low: int) -> int | None:
    return default if value is None else require_integer(name, value, low)


def _loss(options: argparse.Namespace, plan: Plan) -> VectorFieldLoss:
    begin = plan.begin if options.begin is None else require_number("--begin", options.begin, 0, 1)
    forward_only = plan.forward_only if options.forward_only is None else options.forward_only
    try:
        weight = "dynamic" if options.weight == "dynamic" else float(options.weight)
        return VectorFieldLoss(options.projection, weight, begin, forward_only)
    except ValueError:
        fail("--weight", "dynamic, or a number of at least 0", options.weight)


def _objects(options: argparse.Namespace, dataset: Dataset) -> list[int]:
    there = list(dataset.object_ids)
    if not there:
        fail("--data", "data with known poses", options.data)
    missing = sorted(set(options.objects or there) - set(there))
    if missing:
        shown = ", ".join(map(str, there[:20])) + (", ..." if len(there) > 20 else "")
        fail("--objects", f"some of {shown}, which {options.data} has", missing)
    return sorted(set(options.objects or there))
