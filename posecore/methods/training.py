"""`train METHOD` for every method: the options that all have, the data, and a network trained."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from data_tools.batches import Stack, load
from data_tools.linemod.folders import find_objects, lists_of
from data_tools.storage.locks import claim
from data_tools.views import ModelSet
from posecore.arrays import fail, require_integer
from posecore.command_line import lacks_memory
from posecore.methods.notes import note
from posecore.methods.runs import Run
from posecore.methods.sources import new_parser, open_source
from posecore.scale import SCALES, scale
from posecore.training import fit
from posecore.training.machine import choose_device, launched

__all__ = [
    "Data",
    "Job",
    "add_parser",
    "chosen_objects",
    "default_split",
    "integer_option",
    "open_data",
]


def add_parser(
    methods: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    command: Callable[[argparse.Namespace], None],
    *,
    summary: str,
    description: str,
) -> argparse.ArgumentParser:
    """Add a method to those that can be trained, with the options that all of them have.

    Args:
        methods: the parser's methods.
        name: of the method.
        command: what runs it. If it is interrupted, the user is told how to go on.
        summary: a few words.
        description: a few sentences.

    Returns:
        Its parser, for options of its own.
    """
    run = partial(_interruptible, command)
    parser = new_parser(methods, name, run, summary=summary, description=description)
    parser.add_argument(
        "--split", help="default: train; of an own object without lists all of its images"
    )
    parser.add_argument("--out", metavar="RUN", required=True, help="folder, new or to go on in")
    parser.add_argument("--objects", metavar="ID", type=int, nargs="+", help="default: all")
    parser.add_argument("--scale", choices=SCALES, help="sizes; default: POSECORE_SCALE")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def _interruptible(
    command: Callable[[argparse.Namespace], None], options: argparse.Namespace
) -> None:
    try:
        command(options)
    except (RuntimeError, MemoryError) as error:
        if not lacks_memory(error):
            raise
        words = " ".join(str(error).split()) or "not enough memory"
        raise ValueError(f"--batch: expected one that fits into memory: {words:.200}") from error
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        sys.exit(130)


def integer_option(name: str, value: int | None, default: int | None, low: int) -> int | None:
    """An option that is an integer of at least `low`, or `default` if it was not given.

    Raises:
        ValueError: if it is smaller.
    """
    return default if value is None else require_integer(name, value, low)


class Job(NamedTuple):
    """How a training is run: its folder, scale, device and processes.

    Attributes:
        path: of the run.
        scale: the name of the sizes.
        device: of this process.
        processes: that train together, one unless torchrun started several.
        first: of them: the one that writes and shows.
    """

    path: Path
    scale: str
    device: torch.device
    processes: int
    first: bool

    @classmethod
    def asked(cls, options: argparse.Namespace) -> Job:
        """The job that the options of `add_parser` ask for.

        Raises:
            ValueError: naming an option or a variable of torchrun that cannot be.
        """
        require_integer("--seed", options.seed, 0)
        path, device = Path(options.out), choose_device(options.device)
        if path.exists() and not path.is_dir():
            fail("--out", "a folder", f"the file {options.out!r}")
        rank, processes = launched()
        return cls(path, options.scale or scale(), device, processes, rank == 0)

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Let no other training into the folder; made if it is not there.

        Raises:
            ValueError: if another process trains in it.
            OSError: if it cannot be written to.
        """
        if not self.first:  # the first process stands for all of them
            yield
            return
        new = [path for path in (self.path, *self.path.parents) if not path.exists()]
        self.path.mkdir(parents=True, exist_ok=True)
        try:
            with claim(self.path / "training") as claimed:
                if not claimed.mine:
                    fail(
                        "--out", "a folder of its own", f"{self.path}: another process trains there"
                    )
                yield
        finally:
            with contextlib.suppress(OSError):  # where something was written they stay
                for path in new:
                    path.rmdir()

    def fit(
        self,
        run: Run,
        name: str,
        model: nn.Module,
        batches: Iterable[Any] | Callable[[torch.Generator], Any],
        loss: Callable[..., Tensor | Mapping[str, Tensor]],
        **options: Any,
    ) -> None:
        """Train a network of a run, and keep it there as `NAME.safetensors`.

        Args:
            run: to which it belongs; its option `seed` is that of the training.
            name: of the network.
            model, batches, loss, options: as for `posecore.training.fit`.
        """
        history = fit(
            model,
            batches,
            loss,
            seed=run.options["seed"],
            device=str(self.device),
            resume=run.path / "checkpoints" / name,
            **options,
        )
        if self.first:
            run.write_weights(name, model)
            print(f"{name}: {history!r}")


class Data(NamedTuple):
    """The training data: images, models, and which objects."""

    stack: Stack
    models: ModelSet
    objects: list[int]
    """Those that were asked for, ascending."""


def open_data(options: argparse.Namespace, job: Job, kinds: Mapping[str, str]) -> Data:
    """Open and read the data that the options of `add_parser` ask for.

    Args:
        options: of the command; `split` becomes the one that is read, if none was asked for.
        job: of these options.
        kinds: of images that the method needs, as a `Stack` names them, and in words.

    Raises:
        ValueError: if there are no such data or objects, or the data lack a kind of images.
    """
    if options.split is None:
        options.split = default_split(options.data)
    dataset = open_source(options.data, options.split, job.scale, show=job.first)
    models = dataset.models()
    objects = chosen_objects(options, dataset.object_ids)
    if options.data.startswith("linemod:"):
        dataset = open_source(options.data, options.split, job.scale, object_id=objects)
        if len(objects) > 1 and job.first:
            note("linemod names one object of each image, and others count as background")
    stack = load(dataset, progress=job.first and sys.stderr.isatty())
    for kind, words in kinds.items():
        if kind not in stack.kinds:
            fail("--data", f"data with {words}", f"{options.data} with {', '.join(stack.kinds)}")
    return Data(stack, models, objects)


def default_split(source: str) -> str | None:
    """The part that is trained with unless another is asked for; None for all there is."""
    kind, _, path = source.partition(":")
    if (
        kind == "linemod"
        and Path(path).is_dir()
        and not lists_of(find_objects(Path(path)).values())
    ):
        return None
    return "train"


def chosen_objects(options: argparse.Namespace, there: Sequence[int]) -> list[int]:
    """Those of the data's objects that were asked for, ascending; all of them by default.

    Raises:
        ValueError: if the data have none, or not one that was asked for.
    """
    there = list(there)
    if not there:
        fail("--data", "data with known poses", options.data)
    missing = sorted(set(options.objects or there) - set(there))
    if missing:
        shown = ", ".join(map(str, there[:20])) + (", ..." if len(there) > 20 else "")
        fail("--objects", f"some of {shown}, which {options.data} has", missing)
    return sorted(set(options.objects or there))
