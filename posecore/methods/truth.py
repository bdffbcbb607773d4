"""What estimates are measured against: a results file, or the poses of a dataset."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

import data_tools
from data_tools.bop import Models, read_results
from data_tools.bop.files import has_file, read_json, read_number
from data_tools.views import Dataset, ModelSet
from posecore.arrays import fail
from posecore.cameras import require_intrinsics
from posecore.methods.notes import note
from posecore.metrics.pose_table import PoseTable

__all__ = ["Truth", "kind_of", "read_truth"]

WIDTH = 640.0  # pixels, of BOP's thresholds on MSPD, which grow with the images
DATASETS = ("bop", "linemod", "hmdpose")


class Truth(NamedTuple):
    """What the estimates are measured against."""

    poses: PoseTable
    images: list[tuple[int, int]]
    """(scene id, image id) of the evaluated images, some of which may hold no object."""
    models: ModelSet
    K: np.ndarray | None
    """(3, 3), or (G, 3, 3) for each pose."""
    width: float
    """Of the images, in pixels."""
    others: PoseTable | None = None
    """What is in the images as well, but is no target."""


def read_truth(options: argparse.Namespace) -> Truth:
    """Read what the options of `evaluate` name.

    Raises:
        ValueError: for an option that cannot be, or files that do not fit or are damaged.
        OSError: if a file cannot be read.
    """
    kind = kind_of(options.ground_truth)
    return _from_files(options) if kind is None else _from_dataset(options, kind)


def kind_of(source: str) -> str | None:
    """The layout of a dataset, one of `DATASETS`; None for a file."""
    kind, colon, _ = source.partition(":")
    return kind if colon and kind in DATASETS else None


def _from_dataset(options: argparse.Namespace, kind: str) -> Truth:
    if options.camera:
        fail("--camera", f"nothing, as every image of {kind}:PATH has a camera", options.camera)
    choices = {"rotations": options.rotations}
    if kind == "hmdpose":
        if choices.pop("rotations") != "project":
            fail("--rotations", "project, as hmdpose:PATH has quaternions", options.rotations)
    elif kind == "bop":
        choices["targets"] = options.targets
    if kind != "bop" and options.targets:
        fail("--targets", "nothing, as the ground truth is no bop:PATH", options.targets)
    with _called("path", "GROUND_TRUTH"):
        dataset = data_tools.open(options.ground_truth, split=options.split, **choices)
    poses = dataset.ground_truth()
    others = None
    if options.targets:
        others = _without(dataset.ground_truth(targets_only=False), poses)
    for scene, image in dict.fromkeys(poses.images):
        where = f"{options.ground_truth}: scene {scene}, image {image}: K"
        require_intrinsics(where, dataset.camera(scene, image).K)
    K = np.reshape([dataset.camera(*image).K for image in poses.images], (-1, 3, 3))
    models = _models(options.models) if options.models else dataset.models()
    return Truth(poses, dataset.images, models, K, _width_of(dataset, kind), others)


def _without(table: PoseTable, some: PoseTable) -> PoseTable:
    """The rows of a table but for some of them."""

    def keys(table: PoseTable) -> list[tuple]:
        poses = zip(table.R, table.t, strict=True)
        return [
            (*image, object_id, R.tobytes(), t.tobytes())
            for image, object_id, (R, t) in zip(
                table.images, table.object_id.tolist(), poses, strict=True
            )
        ]

    left = Counter(keys(some))
    kept = []
    for row, key in enumerate(keys(table)):
        if left[key]:
            left[key] -= 1
        else:
            kept.append(row)
    return table[np.array(kept, int)]


def _width_of(dataset: Dataset, kind: str) -> float:
    """Of the images, in pixels."""
    if kind == "linemod":
        return float(dataset[0].shape[1])
    if kind == "hmdpose":
        return float(dataset.cameras["centre"].width)
    path = dataset.path / "camera.json"
    if has_file(path):
        return _read_camera(path, "width")[0]
    note(f"no {path}: images are taken to be {WIDTH:.0f} pixels wide (thresholds of MSPD)")
    return WIDTH


def _read_camera(path: Path, *names: str) -> list[float]:
    """Entries of a camera.json.

    Raises:
        ValueError: naming the file and the entry that cannot be.
    """
    camera = read_json(path)
    numbers = [read_number(str(path), camera, name) for name in names]
    for name, number in zip(names, numbers, strict=True):
        if name == "width" and number < 1:
            raise ValueError(f"{path}: width: expected at least 1 pixel, got {number}")
        if name in ("fx", "fy") and not 1e-3 < abs(number) < 1e9:
            raise ValueError(f"{path}: {name}: expected a focal length in pixels, got {number}")
    return numbers


@contextmanager
def _called(argument: str, option: str) -> Iterator[None]:
    """Let errors that begin with an argument of a function begin with the option it came from."""
    try:
        yield
    except ValueError as error:
        if not str(error).startswith(f"{argument}: "):
            raise
        raise ValueError(option + str(error)[len(argument) :]) from error


def _models(folder: str) -> Models:
    with _called("path", "--models"):
        return Models(folder)


def _from_files(options: argparse.Namespace) -> Truth:
    if not Path(options.ground_truth).exists() and Path(options.ground_truth).suffix != ".csv":
        expected = "a CSV file that is there, bop:PATH, linemod:PATH or hmdpose:PATH"
        fail("GROUND_TRUTH", expected, repr(options.ground_truth))
    if not options.models:
        fail("--models", "a folder of models", "none")
    for name in ("split", "targets"):
        if getattr(options, name):
            fail(f"--{name}", "nothing, as the ground truth is no dataset", getattr(options, name))
    poses = read_results(options.ground_truth, rotations=options.rotations)
    if not len(poses):
        raise ValueError(f"{options.ground_truth}: expected true poses, got none")
    models = _models(options.models)
    path = Path(options.camera or Path(options.models).resolve().parent / "camera.json")
    if not options.camera and not has_file(path):
        note(f"no {path}, so no errors in pixels (--camera names another)")
        return Truth(poses, poses.images, models, None, WIDTH)
    fx, fy, cx, cy, width = _read_camera(path, "fx", "fy", "cx", "cy", "width")
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Truth(poses, poses.images, models, K, width)
