"""`train vector_field`: the network of the field, then the refiner."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn
from tqdm.auto import tqdm

from data_tools.batches import Augmentation, Stack, load
from data_tools.views import Dataset
from posecore.arrays import fail, require_integer
from posecore.commands.field_runs import Run, read_run
from posecore.commands.sources import open_source
from posecore.papers.vector_field.learning import Objective, Windows
from posecore.papers.vector_field.losses import VectorFieldLoss
from posecore.papers.vector_field.masked_fields import MaskedFields, look_at
from posecore.papers.vector_field.models import object_models
from posecore.papers.vector_field.network import VectorFieldNet
from posecore.papers.vector_field.refiner_training import RefinerTraining, weights_digest
from posecore.scale import scale
from posecore.training import fit, seeded
from posecore.training.machine import choose_device, uses_bfloat16

__all__ = ["PLANS", "Plan", "halved", "train"]

AT_ONCE = 8  # images that the network looks at for the refiner


def halved(done: float) -> float:
    """The paper's learning rate, from the part of the training that is done to a factor.

    Halved every 20 of 200 epochs (You et al., Section IV-A).
    """
    return 0.5 ** math.floor(10 * done + 1e-9)  # 0.29 * 100, for one, is a little below 29


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The sizes of a scale.

    Attributes:
        width, refiner_width: of the networks.
        window: (width, height) in pixels of what is trained on, at most the whole image.
        batch, refiner_batch: windows, and objects, in a step.
        pixels: of each object in a window that the loss looks at; None for all.
        lr, schedule: of the field.
        refiner_lr: the schedule is the same.
        steps: of the field; None for `epochs` rounds of as many windows as there are images.
        refiner_steps: of the refiner.
        refiner_images: at most so many of the training images are looked at for it.
    """

    width: int
    window: tuple[int, int]
    batch: int
    pixels: int | None = 256
    lr: float = 2e-3
    schedule: str | Callable[[float], float] = "cosine"
    steps: int | None = None
    epochs: int = 200
    refiner_width: int
    refiner_batch: int = 64
    refiner_lr: float = 1e-3
    refiner_steps: int
    refiner_images: int = 4000


PLANS = {
    "tiny": Plan(
        width=8, window=(64, 64), batch=4, steps=20,
        refiner_width=4, refiner_batch=8, refiner_steps=20,
    ),
    "book": Plan(
        width=16, window=(128, 128), batch=16, steps=3000, refiner_width=16, refiner_steps=2000
    ),
    # The paper and PVNet, whose refiner is trained "until the training loss converges".
    "paper": Plan(
        width=64, window=(640, 480), batch=32, pixels=None, lr=1e-4, schedule=halved,
        refiner_width=64, refiner_lr=1e-4, refiner_steps=50_000,
    ),
}  # fmt: skip


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
    loss = VectorFieldLoss(options.projection, _weight(options.weight))
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
        "imagenet": options.imagenet,
        "seed": options.seed,
    }
    if (path / "run.json").exists():
        run = read_run(path)
        run.require_options(asked)
    else:
        models = object_models(known, objects)
        run = Run(path, asked, plan.width, plan.refiner_width if refiner_steps else None, models)
    return _Task(plan, run, data, device, processes, first)


def _train_field(task: _Task, imagenet: str | None) -> VectorFieldNet:
    plan, run, data = task.plan, task.run, task.data
    options = run.options
    windows = Windows(
        data,
        run.models,
        steps=options["steps"],
        count=options["batch"],
        size=tuple(map(min, plan.window, data.size)),
        seed=options["seed"],
        augment=Augmentation(),
        visible=0.0 if data.visible_fraction is None else 0.1,
    )
    with seeded(options["seed"]):
        net = run.new_net()
    if imagenet:
        try:
            net.backbone.load_imagenet(imagenet)
        except ValueError as error:
            raise ValueError(f"--imagenet: {error}") from error
    if task.first:
        run.write()
    loss = VectorFieldLoss(options["projection"], options["weight"])
    objective = Objective(run.models, loss, plan.pixels)
    recipe = {**options, "views": len(data)}
    task.fit(
        "net", net, windows, objective,
        steps=options["steps"], lr=plan.lr, clip=10.0, recipe=recipe,
    )  # fmt: skip
    return net


def _train_refiner(task: _Task, net: VectorFieldNet) -> None:
    plan, options = task.plan, task.run.options
    with seeded(options["seed"]):
        refiner = task.run.new_refiner()
    learning = RefinerTraining(
        _looks(net, task),
        task.run.models,
        size=math.ceil(plan.refiner_batch / task.processes) * task.processes,
    )
    recipe = {**options, "net": weights_digest(net)}
    task.fit(
        "refiner", refiner, learning.batches, learning.loss,
        steps=options["refiner_steps"], lr=plan.refiner_lr, clip=1.0, recipe=recipe,
    )  # fmt: skip


def _integer(name: str, value: int | None, default: int | None, low: int) -> int | None:
    return default if value is None else require_integer(name, value, low)


def _weight(text: str) -> float | str:
    try:
        number = "dynamic" if text == "dynamic" else float(text)
        VectorFieldLoss(weight=number)
    except ValueError:
        fail("--weight", "dynamic, or a number of at least 0", text)
    return number


def _objects(options: argparse.Namespace, dataset: Dataset) -> list[int]:
    there = list(dataset.object_ids)
    if not there:
        fail("--data", "data with known poses", options.data)
    missing = sorted(set(options.objects or there) - set(there))
    if missing:
        shown = ", ".join(map(str, there[:20])) + (", ..." if len(there) > 20 else "")
        fail("--objects", f"some of {shown}, which {options.data} has", missing)
    return sorted(set(options.objects or there))


def _looks(net: VectorFieldNet, task: _Task) -> list[tuple[MaskedFields, dict[str, torch.Tensor]]]:
    """What a trained network says of whole training images, each varied once."""
    data, device = task.data, task.device
    generator = torch.Generator().manual_seed(task.run.options["seed"])
    half, seen = uses_bfloat16("auto", device, net), []
    # Evenly over the split, as its parts may differ.
    views = torch.arange(len(data))[:: math.ceil(len(data) / task.plan.refiner_images)]
    for some in tqdm(views.split(AT_ONCE), desc="fields", disable=None if task.first else True):
        batch = data.frames(some, augment=Augmentation(), generator=generator)
        images = batch["rgb"].to(device, memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16, enabled=half):
            fields = look_at(net, images)
        if len(fields):
            known = {name: batch[name] for name in ("image", "object_id", "R", "t", "K")}
            seen.append((fields if device.type == "cpu" else _on_cpu(fields), known))
    if not seen:
        fail("--steps", "enough for a field that sees objects, or --refiner-steps 0", "too few")
    return seen


def _on_cpu(fields: MaskedFields) -> MaskedFields:
    """The same fields where the refiner's poses are made wrong."""
    parts = [fields.of(entry) for entry in range(len(fields))]
    pixels, vectors = (torch.cat(column).cpu() for column in zip(*parts, strict=True))
    image, object, confidence = (
        values.repeat_interleave(fields.counts).cpu()
        for values in (fields.image, fields.object, fields.confidence)
    )
    x, y = pixels.unbind(-1)
    return MaskedFields(image, y, x, object, vectors, confidence)
