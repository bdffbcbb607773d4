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
from data_tools.bop import BopDataset, Models, read_results
from data_tools.bop.files import has_file, read_json, read_number
from data_tools.bop.pieces import has_depth, visible_fractions
from data_tools.views import Dataset, ModelSet
from posecore.arrays import fail, require_number
from posecore.cameras import require_intrinsics
from posecore.methods.notes import note
from posecore.metrics.bop_errors import Present
from posecore.metrics.bop_scores import LEAST_VISIBLE
from posecore.metrics.pose_table import PoseTable

__all__ = ["Truth", "kind_of", "read_truth"]

WIDTH = 640.0  # pixels, of BOP's thresholds on MSPD, which grow with the images
DATASETS = ("bop", "linemod", "hmdpose")


class Truth(NamedTuple):
    """What the estimates are measured against."""

    present: Present
    """All poses in the images, and which of them are to be found."""
    images: list[tuple[int, int]]
    """(scene id, image id) of the evaluated images, some of which may hold no object."""
    models: ModelSet
    width: float
    """Of the images, in pixels."""
    dataset: BopDataset | None = None
    """Where its depth images are, if it has them."""
    without_depth: str = ""
    """Else why there are none."""

    @property
    def poses(self) -> PoseTable:
        """What is to be found."""
        return self.present.truth

    @property
    def K(self) -> np.ndarray | None:
        """(G, 3, 3) of these poses; None without errors in pixels."""
        return None if self.present.K is None else self.present.K[: len(self.poses)]


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
    for name in ("targets", "visible") if kind != "bop" else ():
        if (value := getattr(options, name)) is not None:
            fail(f"--{name}", "nothing, as the ground truth is no bop:PATH", value)
    with _called("path", "GROUND_TRUTH"), _called("split", "--split"):
        dataset = data_tools.open(options.ground_truth, split=options.split, **choices)
    present = _present_in(dataset, options)
    for scene, image in dict.fromkeys(present.truth.images + present.others.images):
        where = f"{options.ground_truth}: scene {scene}, image {image}: K"
        require_intrinsics(where, dataset.camera(scene, image).K)
    models = _models(options.models) if options.models else _own_models(dataset)
    with_depth, why = None, f"{kind}:PATH is read without them"
    if kind == "bop":
        with_depth = dataset if has_depth(dataset) else None
        why = f"{dataset.path / dataset.split} has none"
    return Truth(present, dataset.images, models, _width_of(dataset, kind), with_depth, why)


def _present_in(dataset: Dataset, options: argparse.Namespace) -> Present:
    """The poses of a dataset, and which of them are to be found.

    As the BOP toolkit has it: without `--visible` those that the targets are, the most visible
    ones; with it, all poses of target objects that are visible enough, of which an image's
    estimates are as many of the surest as it has targets. Detection wants what is visible enough,
    target or not.
    """
    targets, least = getattr(options, "targets", None), options.visible
    if least is not None:
        least = require_number("--visible", least, 0, 1)
    shares, counts = None, {}
    if isinstance(dataset, BopDataset):
        there = dataset.ground_truth(targets_only=False)
        shares = visible_fractions(dataset, targets_only=False)
    else:
        there = dataset.ground_truth()
    wanted = np.ones(len(there), bool)
    if targets:
        chosen = dataset.ground_truth()
        wanted = _among(there, chosen)
    if least is not None:
        if shares is None:
            fail("--visible", "a scene_gt_info.json in every scene, which says it", least)
        if targets:
            counts = Counter(_keys(chosen))
            wanted = np.array([key in counts for key in _keys(there)], bool)
        wanted &= shares >= least
        if not wanted.any():
            fail("--visible", "a share that some true pose has", least)
    elif shares is not None and not targets and (hidden := int((shares < LEAST_VISIBLE).sum())):
        note(
            f"{hidden} of {len(there)} true poses are less than {LEAST_VISIBLE:.0%} visible: all "
            f"but BOP's detection wants them found (--visible {LEAST_VISIBLE} leaves them out)"
        )
    counted = np.ones(len(there), bool)
    if shares is not None:
        counted = shares >= (LEAST_VISIBLE if least is None else least)
    order = np.concatenate([np.flatnonzero(wanted), np.flatnonzero(~wanted)])
    K = np.reshape([dataset.camera(*image).K for image in there.images], (-1, 3, 3))
    return Present(there[wanted], there[~wanted], K[order], counted[order], counts)


def _keys(table: PoseTable) -> list[tuple[int, int, int]]:
    """Scene, image and object of every row."""
    ids = table.object_id.tolist()
    return [(*image, object_id) for image, object_id in zip(table.images, ids, strict=True)]


def _among(table: PoseTable, some: PoseTable) -> np.ndarray:
    """Which rows of a table are those of another one, which it holds."""

    def poses(table: PoseTable) -> list[tuple]:
        rows = zip(_keys(table), table.R, table.t, strict=True)
        return [(*key, R.tobytes(), t.tobytes()) for key, R, t in rows]

    left = Counter(poses(some))
    found = []
    for pose in poses(table):
        found.append(left[pose] > 0)
        left[pose] -= 1
    return np.array(found, bool)


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


def _own_models(dataset: Dataset) -> ModelSet:
    """Those of a dataset; with a note if BOP itself measures with others."""
    models = dataset.models()
    if isinstance(dataset, BopDataset):
        names = [f"obj_{i:06d}.ply" for i in models.ids]
        used, others = dataset.models().path, dataset.path / "models_eval"
        pairs = [(used / name, others / name) for name in names]
        sizes = [[x.stat().st_size for x in pair] for pair in pairs if all(map(has_file, pair))]
        if any(one != other for one, other in sizes):
            note(f"models are those of {used}; BOP measures with {others} (--models names them)")
    return models


def _from_files(options: argparse.Namespace) -> Truth:
    if not Path(options.ground_truth).exists() and Path(options.ground_truth).suffix != ".csv":
        expected = (
            "a CSV file that is there, bop:PATH, linemod:PATH or hmdpose:PATH (of a world: the "
            "folder that `python -m data_tools export` writes)"
        )
        fail("GROUND_TRUTH", expected, repr(options.ground_truth))
    if not options.models:
        fail("--models", "a folder of models", "none")
    for name in ("split", "targets", "visible"):
        if (value := getattr(options, name)) is not None:
            fail(f"--{name}", "nothing, as the ground truth is no dataset", value)
    poses = read_results(options.ground_truth, rotations=options.rotations)
    if not len(poses):
        raise ValueError(f"{options.ground_truth}: expected true poses, got none")
    models = _models(options.models)
    path = Path(options.camera or Path(options.models).resolve().parent / "camera.json")
    K, width, why = None, WIDTH, "a CSV file has none"
    if not options.camera and not has_file(path):
        note(f"no {path}, so no errors in pixels (--camera names another)")
    else:
        fx, fy, cx, cy, width = _read_camera(path, "fx", "fy", "cx", "cy", "width")
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    present = Present(poses, poses[:0], K, np.ones(len(poses), bool), {})
    return Truth(present, poses.images, models, width, without_depth=why)
