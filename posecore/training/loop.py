"""The training loop of every network in the book."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.nn.utils import clip_grads_with_norm_, get_total_norm

from posecore.arrays import fail, require_choice, require_integer, require_number
from posecore.figures.live import Display
from posecore.randomness import reseed, seeded
from posecore.scale import retrain
from posecore.training.checkpoints import Checkpoints
from posecore.training.feed import Feed
from posecore.training.history import History
from posecore.training.machine import (
    Processes,
    choose_device,
    convolves,
    each_tensor,
    uses_bfloat16,
)
from posecore.training.origins import Part, origins

__all__ = ["SCHEDULES", "fit"]

SCHEDULES: dict[str, Callable[[float], float]] = {
    "constant": lambda done: 1.0,
    "linear": lambda done: 1 - done,
    "cosine": lambda done: (1 + math.cos(math.pi * done)) / 2,
}

# One kernel for all of a step: a quarter of the time of a step of a small net.
ADAM = functools.partial(torch.optim.Adam, fused=True)
Evaluate = Callable[[nn.Module], Mapping[str, float]]
Loss = Callable[[nn.Module, Any], Tensor | Mapping[str, Tensor]]


def fit(
    model: nn.Module,
    batches: Callable[[torch.Generator], Any] | Iterable[Any],
    loss: Loss,
    *,
    steps: int,
    lr: float = 1e-3,
    optimiser: Callable[..., torch.optim.Optimizer] = ADAM,
    schedule: str | Callable[[float], float] = "cosine",
    clip: float | None = None,
    seed: int = 0,
    device: str = "auto",
    precision: str = "auto",
    channels_last: bool | None = None,
    evaluate: Evaluate | None = None,
    evaluate_every: int | None = None,
    resume: str | Path | None = None,
    save_seconds: float = 30.0,
    recipe: Mapping[str, Any] | None = None,
    show: bool | None = None,
) -> History:
    """Train a model, from the weights that it has, and leave it in evaluation mode.

        def loss(net, batch):
            return (net(batch["x"]) - batch["y"]).square().mean()

        with seeded(0):
            net = Net()
        history = fit(net, batches, loss, steps=2000)

    Learning rate and random numbers are functions of the step, so where a run stands is told by its
    step, its weights, its optimiser and its place in the data. One that was killed and goes on ends
    in the same bits as one that was not (same machine and number of threads; on a GPU as far as its
    operations repeat themselves). Global random numbers of the caller play no part and go on after
    it where they were.

    Under torchrun each process makes every batch and computes with its part of it. This is the same
    training as one process's if the loss is a mean over samples and no layer looks at the whole
    batch, as batch normalisation does. Every parameter must have a part in the loss. All processes
    must see the resume folder; the first one writes to it, evaluates and shows.

    Args:
        model: all that is to be trained, in one module. It is moved to the device, and stays there.
        batches: one of three; a batch is a tensor, or tensors in a dict, list or tuple.
            A function: `batches(generator)` makes a batch of that generator's numbers.
            A sequence: its items are taken in turns.
            Another iterable: begun again when it is at its end. To be resumed it must have
            `state_dict` and `load_state_dict`, as `data_tools.batches.Batches` and PyTorch's
            stateful loaders do.
        loss: `loss(model, batch)` gives a scalar, or a dict of scalars by name of which "loss" is
            minimised and the others are recorded. It may call any method of the model.
        steps: how many batches.
        lr: the learning rate at the start.
        optimiser: called with the parameters and `lr=`; `functools.partial` adds to it. By default
            Adam, in one kernel.
        schedule: "constant", "linear", "cosine" (both to 0), or what takes the part of the training
            that is done, 0 to 1, to a factor on `lr`.
        clip: gradients are shortened to this norm.
        seed: of dropout and its like, and of the generators that `batches` gets.
        device: "auto" takes a GPU where there is one.
        precision: "float32"; "bfloat16", by autocast; "auto" takes the latter for networks that
            convolve images where the processor has it.
        channels_last: the memory layout of images and their convolutions, several times as fast on
            CPUs; by default wherever there are convolutions.
        evaluate: `evaluate(model)` gives numbers by name, drawn with the losses. The model is in
            evaluation mode and without gradients.
        evaluate_every: steps from one to the next; by default only at the end. It is always
            called at the end.
        resume: a folder for checkpoints. A run that was stopped there goes on; a finished one is
            loaded, or with POSECORE_RETRAIN=1 made again. One of another loss, other data or
            another schedule is refused, as far as `origins` tells them apart. One run at a time.
        save_seconds: from one checkpoint to the next; what a kill, or the stop button, may cost.
        recipe: what else a resumed run must have in common with its beginning, by name; values
            are compared as texts.
        show: a progress bar and, in notebooks, a live curve; by default in a terminal or notebook.

    Returns:
        The curves, those of the parts before an interruption among them.

    Raises:
        ValueError: for an argument that cannot be; if `resume` holds a run with other settings, or
            of another loss or other data; at a loss or gradient that is not finite, naming the
            step. The checkpoints of before stay.
        OSError: if a checkpoint cannot be written; those of before stay.
    """
    steps = require_integer("steps", steps, 1)
    seed = require_integer("seed", seed, 0)
    lr = require_number("lr", lr, above=0)
    clip = math.inf if clip is None else require_number("clip", clip, above=0)
    save_seconds = require_number("save_seconds", save_seconds, 0)
    every = steps if evaluate_every is None else evaluate_every
    require_integer("evaluate_every", every, 1)
    if not callable(schedule):
        require_choice("schedule", schedule, list(SCHEDULES))
    for name, value in (("optimiser", optimiser), ("loss", loss)):
        if not callable(value):
            fail(name, "a function or a class to call", repr(value)[:80])
    factor = schedule if callable(schedule) else SCHEDULES[schedule]
    trained = _trained(model)
    place = choose_device(device)
    half = uses_bfloat16(precision, place, model)
    channels_last = convolves(model) if channels_last is None else channels_last
    model.to(place, memory_format=torch.channels_last if channels_last else torch.preserve_format)
    feed = Feed(batches, seed, resumable=resume is not None)
    descent = optimiser(list(trained.values()), lr=lr)
    rates = [group["lr"] for group in descent.param_groups]
    history, processes = History(), Processes.joined(place)
    settings = {
        "steps": steps, "seed": seed, "lr": lr, "schedule": schedule, "clip": clip,
        "optimiser": descent, "precision": precision, "channels_last": channels_last,
        "model": model, "loss": loss, **(recipe or {}),
    }  # fmt: skip

    def made_from() -> dict[str, Part]:
        return origins(loss, "loss") | origins(batches, "batches") | origins(factor, "schedule")

    with seeded(seed):
        run = {"optimiser": descent, "batches": feed, "history": history}
        writes = processes.rank == 0
        checkpoints = Checkpoints(
            resume, _texts(settings), model, run, origins=made_from, writes=writes
        )
        start = checkpoints.load(again_after=steps if retrain() else None)
        objective: nn.Module = _Objective(model, loss)
        if processes.count > 1:
            objective = DistributedDataParallel(objective)
        if start == 0:
            checkpoints.save(0)  # a cell that is run again begins with these weights again
        saved, before = history.seconds, time.perf_counter()
        model.train()
        with Display(steps, history, show if writes else False) as display:
            for step in range(start, steps):
                reseed(seed, step)
                batch = processes.share(feed(step))
                if processes.rank > 0:  # all drew the same data; dropout differs
                    reseed(seed, step, processes.rank)
                batch = each_tensor(batch, lambda tensor: _moved(tensor, place, channels_last))
                for group, rate in zip(descent.param_groups, rates, strict=True):
                    group["lr"] = rate * factor(step / steps)

                with torch.autocast(place.type, torch.bfloat16, enabled=half):
                    parts = objective(batch)
                values = torch.stack([part.detach().float() for part in parts.values()])
                losses = dict(zip(parts, processes.mean(values).tolist(), strict=True))
                _require_finite(step, losses, batch, model)
                descent.zero_grad()
                parts["loss"].backward()
                _clip(step, trained, clip)
                descent.step()

                done = step + 1
                history.record(losses)
                if evaluate and writes and (done % every == 0 or done == steps):
                    history.measure(done, _evaluated(evaluate, model))
                now = time.perf_counter()
                history.seconds, before = history.seconds + now - before, now
                if done == steps or history.seconds - saved >= save_seconds:
                    _require_finite_weights(done, model)
                    checkpoints.save(done)
                    saved = history.seconds
                display.update()
    model.eval()
    return history


class _Objective(nn.Module):
    """Model and loss in one module, so that several processes see all that a loss does with it."""

    def __init__(self, model: nn.Module, loss: Loss) -> None:
        super().__init__()
        self.model = model
        self.loss = lambda batch: loss(model, batch)  # not a part of it, if it is a module

    def forward(self, batch: Any) -> dict[str, Tensor]:
        value = self.loss(batch)
        parts = {"loss": value} if isinstance(value, Tensor) else value
        if not isinstance(parts, Mapping) or "loss" not in parts:
            fail("loss", "a scalar, or a dict of scalars with 'loss'", repr(value)[:80])
        for name, part in parts.items():
            if not isinstance(part, Tensor) or part.ndim:
                shown = f"shape {tuple(part.shape)}" if isinstance(part, Tensor) else repr(part)
                fail(f"loss[{name!r}]", "a tensor without dimensions", shown)
        if not parts["loss"].requires_grad:
            fail("loss", "a value that depends on the model's parameters", "one that does not")
        return dict(parts)


def _trained(model: nn.Module) -> dict[str, nn.Parameter]:
    named = dict(model.named_parameters()) if isinstance(model, nn.Module) else {}
    trained = {name: parameter for name, parameter in named.items() if parameter.requires_grad}
    if not trained:
        fail("model", "a module with parameters to train", type(model).__name__)
    return trained


def _moved(tensor: Tensor, place: torch.device, channels_last: bool) -> Tensor:
    images = channels_last and tensor.ndim == 4 and tensor.is_floating_point()
    return tensor.to(place, memory_format=torch.channels_last if images else torch.preserve_format)


def _require_finite(step: int, losses: dict[str, float], batch: Any, model: nn.Module) -> None:
    wrong = [f"{value} in {name!r}" for name, value in losses.items() if not math.isfinite(value)]
    if wrong:
        inputs = batch if isinstance(batch, Mapping) else {"the batch": batch}
        seen: dict[str, list[Tensor]] = {name: [] for name in inputs}
        for name, value in inputs.items():
            each_tensor(value, seen[name].append)
        seen |= {name: [value] for name, value in model.named_parameters()}
        causes = [name for name, some in seen.items() if not all(t.isfinite().all() for t in some)]
        words = f"{', '.join(wrong)}; not finite before: {', '.join(causes) or 'nothing'}"
        fail("loss", f"finite values at step {step}", words)


def _require_finite_weights(done: int, model: nn.Module) -> None:
    wrong = [name for name, value in model.named_parameters() if not value.isfinite().all()]
    if wrong:
        fail("lr", f"one that leaves weights finite; after {done} steps", f"others in {wrong}")


def _clip(step: int, trained: dict[str, nn.Parameter], clip: float) -> None:
    """Shorten the gradients to a norm of `clip`, once they are known to be finite."""
    norm = get_total_norm([p.grad for p in trained.values() if p.grad is not None])
    if not math.isfinite(norm):
        named = {name: p.grad for name, p in trained.items() if p.grad is not None}
        wrong = [name for name, gradient in named.items() if not gradient.isfinite().all()]
        words = f"others in {', '.join(wrong)}" if wrong else "a norm too large for numbers"
        fail("loss", f"finite gradients at step {step}", words)
    if norm > clip:
        clip_grads_with_norm_(trained.values(), clip, norm)


@torch.no_grad()
def _evaluated(evaluate: Evaluate, model: nn.Module) -> dict[str, float]:
    model.eval()
    values = evaluate(model)
    model.train()
    if not isinstance(values, Mapping):
        fail("evaluate", "a function that gives numbers by name", repr(values)[:80])
    try:
        return {name: float(value) for name, value in values.items()}
    except (TypeError, ValueError, RuntimeError):  # the last of a tensor of several numbers
        fail("evaluate", "a function that gives numbers by name", repr(dict(values))[:80])


def _texts(settings: Mapping[str, Any]) -> dict[str, str]:
    """Settings in words that stay the same from one Python to the next."""

    def text(value: Any) -> str:
        if isinstance(value, torch.optim.Optimizer):
            options = {key: v for key, v in value.defaults.items() if key != "lr"}
            return f"{type(value).__name__} {options}"
        if isinstance(value, nn.Module):
            count = sum(parameter.numel() for parameter in value.parameters())
            return f"{type(value).__name__} of {count} weights"
        if callable(value):
            return getattr(value, "__qualname__", type(value).__qualname__)
        return str(value)

    return {name: text(value) for name, value in settings.items()}
