"""`estimate METHOD` for every method: a view in, poses out, and all of them into a results file."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor
from tqdm.auto import tqdm

from data_tools.bop import write_results
from data_tools.views import Dataset, View
from posecore.arrays import fail
from posecore.methods import overlays
from posecore.methods.notes import note
from posecore.methods.outputs import check_outputs, say_beside
from posecore.methods.runs import Run
from posecore.methods.sources import SOURCE, new_parser, open_source
from posecore.metrics.pose_table import PoseTable
from posecore.training.machine import choose_device

__all__ = [
    "Estimate",
    "Estimator",
    "PlainEstimate",
    "add_parser",
    "estimate",
    "estimate_views",
    "known_object",
]


class Estimate(Protocol):
    """The pose of one object in one image; a method's own may know more.

    Attributes:
        object_id: the object's number in the dataset.
        R, t: (3, 3) and (3,) from object to camera, metres.
        score: the higher the surer.
    """

    object_id: int
    R: np.ndarray
    t: np.ndarray
    score: float


class PlainEstimate(NamedTuple):
    """An `Estimate` of a method that knows no more, and is as sure of one as of another."""

    object_id: int
    R: np.ndarray
    t: np.ndarray
    score: float = 1.0


class Estimator(Protocol):
    """A pose estimator, as `estimate` calls it.

    One that takes something else than colours has a method `look(view)`, which gives the arguments
    that `estimate` is called with, or refuses the view. What it does counts as reading: the seconds
    of an image are those of `estimate`.
    """

    def estimate(self, images: Tensor, K: np.ndarray) -> Sequence[Estimate]:
        """The poses in `images` (1, 3, H, W) RGB float32, 0 to 1, of the camera `K` (3, 3)."""


SomeRun = TypeVar("SomeRun", bound=Run)


def add_parser(
    methods: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    command: Callable[[argparse.Namespace], None],
    *,
    summary: str,
    description: str,
) -> argparse.ArgumentParser:
    """Add a method to those that estimate poses, with the options that all of them have.

    Args:
        methods: the parser's methods.
        name: of the method.
        command: what runs it.
        summary: a few words.
        description: a few sentences.

    Returns:
        Its parser, for options of its own.
    """
    source = f"{SOURCE}; or pictures:FOLDER, with --camera"
    words = {"summary": summary, "description": description, "source": source}
    parser = new_parser(methods, name, command, **words)
    parser.add_argument("--run", required=True, help=f"folder that `train {name}` wrote")
    parser.add_argument("--split", help="which part, if there are several")
    parser.add_argument("--targets", metavar="FILE", help="with bop:PATH: test_targets_bop19.json")
    parser.add_argument("--output", metavar="FILE.csv", required=True)
    parser.add_argument(
        "--camera",
        metavar="FILE",
        help="of pictures: BOP's camera.json, or K as JSON (default: camera.json in the folder or "
        "beside it)",
    )
    parser.add_argument(
        "--pictures",
        metavar="FOLDER",
        help="draw the poses over the images (of pictures, by default: FILE_pictures)",
    )
    return parser


def estimate(
    options: argparse.Namespace,
    read_run: Callable[[str], SomeRun],
    new_estimator: Callable[[SomeRun, argparse.Namespace, torch.device], Estimator],
    needs: str | None = None,
) -> None:
    """Estimate the poses in a dataset, and write them as a BOP results file.

    Of a folder of pictures the poses are drawn, too, and a file says which picture is which.

    Args:
        options: of the command.
        read_run: reads the folder `--run`.
        new_estimator: `new_estimator(run, options, device)` makes it, with the run's weights.
        needs: what a folder of pictures lacks for this method, in words; None for nothing.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    output = Path(options.output)
    kind, _, folder = options.data.partition(":")
    read = options.run, folder, options.targets, options.camera, getattr(options, "clouds", None)
    check_outputs({"--output": options.output}, read)
    if kind == "pictures" and needs is not None:
        fail("--data", needs, "a folder of pictures")
    beside = overlays.beside(options)
    run = read_run(options.run)
    dataset = _open(options, run)
    estimator = new_estimator(run, options, choose_device(options.device))
    table, seconds = estimate_views(estimator, dataset, options.data)
    write_results(output, table)
    spent = f", {1000 * np.median(seconds):.0f} ms an image (median)" if seconds else ""
    say_beside(f"{output}: {len(table)} poses in {len(seconds)} images{spent}", (options.output,))
    if not len(table):
        note("no object was found")
    for line in beside.write(dataset, table, getattr(run, "models", ())):
        say_beside(line, (options.output,))


def estimate_views(
    estimator: Estimator, dataset: Dataset, source: str
) -> tuple[PoseTable, list[float]]:
    """Estimate the poses in every view, and time each image.

    Args:
        estimator: is given one image at a time.
        dataset: of views with colour images, or with what the estimator's `look` takes.
        source: its name, for an error.

    Returns:
        The poses of all views, `time` the seconds of their image, and the seconds of each image.

    Raises:
        ValueError: if a view has no colour image, or the estimator refuses one.
    """
    look = getattr(estimator, "look", partial(_colours, source))
    rows, seconds = [], []
    for view in tqdm(dataset, desc="estimates", total=len(dataset), disable=None):
        seen = look(view)
        began = time.perf_counter()
        found = estimator.estimate(*seen)
        seconds.append(time.perf_counter() - began)
        rows += [(view.scene_id, view.image_id, seconds[-1], item) for item in found]
    return _table(rows), seconds


def known_object(view: View, objects: Sequence[int]) -> int:
    """Which object a view shows, for a method that tells none from another.

    Args:
        view: with labels or without.
        objects: those that the method was trained on.

    Returns:
        The view's first object, in `headset` the glasses; without labels the one of the training.

    Raises:
        ValueError: if there are no labels, and there were several in the training.
    """
    if view.objects:
        return view.objects[0].object_id
    if len(objects) > 1:
        fail("--data", f"data that say which of the objects {list(objects)} is seen", f"{view}")
    return objects[0]


def _colours(source: str, view: View) -> tuple[Tensor, np.ndarray]:
    if view.rgb is None:
        fail("--data", "data with colour images", f"{view} in {source}")
    image = torch.from_numpy(view.rgb).permute(2, 0, 1)[None].float() / 255  # (1, 3, H, W)
    return image, view.K


def _open(options: argparse.Namespace, run: Run) -> Dataset:
    """The data, if they hold an object of the run."""
    choices = {}
    if options.targets:
        if not options.data.startswith("bop:"):
            fail("--targets", "nothing, as the data are no bop:PATH", options.targets)
        choices["targets"] = options.targets
    if options.camera:
        if not options.data.startswith("pictures:"):
            fail("--camera", "nothing, as the data are no pictures:FOLDER", options.camera)
        choices["camera"] = options.camera
    dataset = open_source(options.data, options.split, run.options.get("scale"), **choices)
    ids = run.object_ids
    if dataset.object_ids and not set(ids) & set(dataset.object_ids):
        fail("--data", f"data with one of the run's objects {ids}", list(dataset.object_ids))
    return dataset


def _table(rows: list[tuple[int, int, float, Estimate]]) -> PoseTable:
    scene_id, image_id, seconds, found = zip(*rows, strict=True) if rows else ((),) * 4
    return PoseTable(
        scene_id=np.array(scene_id, np.int64),
        image_id=np.array(image_id, np.int64),
        object_id=np.array([item.object_id for item in found], np.int64),
        R=np.reshape([item.R for item in found], (-1, 3, 3)),
        t=np.reshape([item.t for item in found], (-1, 3)),
        score=np.array([item.score for item in found], np.float64),
        time=np.array(seconds, np.float64),
    )
