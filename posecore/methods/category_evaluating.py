"""`evaluate` of category-level results: average precision of boxes and poses, as NOCS has it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_tools.bop import has_categories, read_category_results
from data_tools.views import Dataset
from posecore.arrays import fail
from posecore.files import write_bytes
from posecore.methods.notes import note
from posecore.methods.outputs import check_outputs, say_beside
from posecore.methods.sources import open_source
from posecore.metrics import category_evaluation, report
from posecore.metrics.categories import nocs_axes
from posecore.metrics.category_report import report_categories
from posecore.metrics.matching import in_images
from posecore.metrics.pose_table import CategoryPoseTable

__all__ = ["category_poses", "evaluate_category_level", "is_category_level"]

WORLD = "categories"
UNUSED = ("targets", "models", "camera", "objects", "curve")


class _Truth(NamedTuple):
    poses: CategoryPoseTable
    images: list[tuple[int, int]]


def is_category_level(options: argparse.Namespace) -> bool:
    """Whether `evaluate` was given categories: results that name them, or the world that has them.

    Raises:
        ValueError: if the results are no file that can be read, or are empty.
    """
    if options.ground_truth == WORLD:
        return True
    # What is no file, but a pipe, can be read only once.
    return Path(options.estimates).is_file() and has_categories(options.estimates)


def evaluate_category_level(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or files that do not fit or are damaged.
        OSError: if a file cannot be read or written.
    """
    for name in UNUSED:
        if getattr(options, name):
            fail(f"--{name}", "nothing, as these are categories", getattr(options, name))
    if options.rotations != "project":
        fail("--rotations", "project, as angles are measured", options.rotations)
    check_outputs({"--json": options.json}, [options.estimates, options.ground_truth])
    estimates = read_category_results(options.estimates)
    truth = _read_truth(options)
    protocol = options.protocol or "paper"
    errors = category_evaluation.evaluate_categories(
        estimates, truth.poses, images=truth.images, protocol=protocol
    )
    for text in _oddities(estimates, truth):
        note(text)
    if protocol == "paper" and len(estimates) > 1 and len(np.unique(estimates.score)) == 1:
        note("all scores are equal, no estimate comes first: AP is precision times recall")
    lines = report_categories(errors)
    if options.json:
        write_bytes(Path(options.json), _to_json(lines))
    say_beside(report.to_text(lines), (options.json,))


def category_poses(dataset: Dataset) -> CategoryPoseTable:
    """The true poses, sizes and symmetries of a dataset whose objects have categories.

    A mug whose handle is not visible is symmetric, as in NOCS.

    Args:
        dataset: of views whose objects know their category and size; mugs also their mask and
            coordinates.

    Raises:
        ValueError: if a view does not know them, or there is no object in any.
    """
    from data_tools.worlds.categories import handle_visible  # files need no worlds

    rows, seen = [], []
    for view in dataset:
        for index, item in enumerate(view.objects):
            if item.category is None or item.size is None:
                fail("dataset", "objects with category and size", f"{item} in {view}")
            rows.append((view.scene_id, view.image_id, item))
            seen.append(item.category != "mug" or handle_visible(view, index))
    if not rows:
        fail("dataset", "views with objects", "none")
    scene_id, image_id, items = zip(*rows, strict=True)
    category = [item.category for item in items]
    return CategoryPoseTable.from_arrays(
        category,
        np.stack([item.R for item in items]),
        np.stack([item.t for item in items]),
        np.stack([item.size for item in items]),
        axis=nocs_axes(category, seen),
        scene_id=np.array(scene_id),
        image_id=np.array(image_id),
        object_id=np.array([item.object_id for item in items]),
    )


def _read_truth(options: argparse.Namespace) -> _Truth:
    if options.ground_truth == WORLD:
        try:
            dataset = open_source(WORLD, options.split, None)
        except ValueError as error:
            raise ValueError(str(error).replace("--data", "GROUND_TRUTH", 1)) from error
        poses = category_poses(dataset)
        return _Truth(poses, list(dict.fromkeys(poses.images)))
    if options.split:
        fail("--split", "nothing, as the ground truth is no dataset", options.split)
    path = Path(options.ground_truth)
    if not path.exists() and path.suffix != ".csv":
        expected = f"{WORLD}, or a CSV file with categories and axes, as the estimates have them"
        fail("GROUND_TRUTH", expected, repr(options.ground_truth))
    poses = read_category_results(path, axes=True)
    if not len(poses):
        raise ValueError(f"{path}: expected true poses, got none")
    return _Truth(poses, list(dict.fromkeys(poses.images)))


def _oddities(estimates: CategoryPoseTable, truth: _Truth) -> Iterator[str]:
    """What was left out, and what looks odd."""
    poses = truth.poses
    foreign = ~in_images(estimates, truth.images)
    if foreign.any():
        yield (
            f"{foreign.sum()} of {len(estimates)} estimates are ignored: "
            "the ground truth does not have their images"
        )
    there = np.unique(poses.category)
    strange = np.setdiff1d(estimates.category[~foreign], there).tolist()
    if strange:
        yield (
            f"estimates of {', '.join(strange)} are ignored: the ground truth holds only "
            f"{', '.join(there)}"
        )
    mugs = poses.category == "mug"
    if hidden := int((mugs & (poses.axis != 0).any(-1)).sum()):
        yield f"{hidden} of {mugs.sum()} mugs do not show their handle and count as symmetric"
    for name in ("size", "t"):
        both = (getattr(table, name) for table in (estimates, poses) if len(table))
        medians = [float(np.median(np.linalg.norm(values, axis=-1))) for values in both]
        if len(medians) == 2 and not 1 / 50 < medians[0] / max(medians[1], 1e-300) < 50:
            yield (
                f"column {name}: the estimates' is about {medians[0]:.3g} m long, the ground "
                f"truth's {medians[1]:.3g} m: files should be in millimetres"
            )


def _to_json(lines: list[report.Line]) -> bytes:
    content: dict = {}
    for line in lines:
        values = {"categories": line.objects, "mean of categories": line.mean}
        content.setdefault(line.section, {})[line.label] = values
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
