"""Whether a dataset fits together, and what is off if it does not."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from data_tools.checking import boxes, colours, depths, geometry, shifts
from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.drawing import Shape
from data_tools.checking.explaining import scores_of
from data_tools.checking.report import Finding, Report
from data_tools.checking.sample import Instance, Sample, chosen_views, read_sample
from data_tools.views import Dataset
from posecore.arrays import fail, require_integer

__all__ = ["check_dataset"]

DIAMETER = 0.03  # relative: a mesh against what is said of it


def check_dataset(dataset: Dataset, count: int = 30) -> Report:
    """Compare a dataset's models, poses and cameras with its images, and say what is off.

    Args:
        dataset: with models, and masks, depth or boxes to compare them with.
        count: how many of its views are looked at.

    Raises:
        ValueError: if there is nothing to compare: no models, no view that can be read, or neither
            masks nor depth nor boxes.
    """
    require_integer("count", count, 1)
    shapes, notes = _shapes(dataset)
    sample = read_sample(dataset, chosen_views(len(dataset), count), shapes)
    if not sample.views:
        raise ValueError(sample.unreadable[0] if sample.unreadable else "the dataset has no views")
    kind = _kind(sample)
    # Numbered anew, since lists go by the numbers.
    usable = [i for i in sample.instances if _has(kind, i)]
    sample.instances = [replace(i, number=number) for number, i in enumerate(usable)]
    scores = scores_of(kind, sample.instances)
    report = Report(sample, kind, scores, [AS_GIVEN] * len(usable), scores.copy(), notes=notes)
    if sample.without_model:
        ids = sorted(sample.without_model)
        report.notes.append(f"objects {ids} have no model, and are left out")
    if sample.unreadable:
        lost, all_of = len(sample.unreadable), len(sample.unreadable) + len(sample.views)
        words = f"{lost} of {all_of} views cannot be read: {sample.unreadable[0]}"
        report.findings.append(Finding("unreadable views", words))
    geometry.check(report)
    if kind == "masks":
        shifts.check(report)
    depths.check(report)
    colours.check(report)
    boxes.check(report)
    _check_diameters(report, dataset, shapes)
    return report


def _shapes(dataset: Dataset) -> tuple[dict[int, Shape], list[str]]:
    """The models that there are, and what is to be said of the others."""
    models, shapes, lost = dataset.models(), {}, []
    for object_id in models.ids:
        try:
            shapes[object_id] = Shape(object_id, models.mesh(object_id))
        except (ValueError, OSError) as error:
            lost.append((object_id, " ".join(str(error).split())))
    if not shapes:
        raise ValueError(lost[0][1] if lost else "models: expected at least one")
    notes = []
    if lost:
        ids = ", ".join(str(object_id) for object_id, _ in lost)
        notes.append(f"no model of objects {ids}, which are left out: {lost[0][1]}")
    return shapes, notes


def _kind(sample: Sample) -> str:
    for kind in ("masks", "depth", "boxes"):
        if any(_has(kind, instance) for instance in sample.instances):
            return kind
    if not sample.total:
        fail("path", "images with poses of objects", "none in those that were looked at")
    if sample.without_model and not sample.instances:
        fail("path", "models of the objects", f"none of {sorted(sample.without_model)}")
    fail("path", "masks, depth or boxes to compare models with", "none that are large enough")


def _has(kind: str, instance: Instance) -> bool:
    given = {"masks": instance.mask, "depth": instance.depth, "boxes": instance.item.box}
    return given[kind] is not None


def _check_diameters(report: Report, dataset: Dataset, shapes: dict[int, Shape]) -> None:
    """Whether meshes are as large as is said of them."""
    wrong = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing is said of a model
        for object_id, shape in shapes.items():
            stated = dataset.models().info(object_id).diameter
            if abs(np.log(stated / max(shape.diameter, 1e-300))) > DIAMETER:
                wrong[object_id] = (stated, shape.diameter)
    if not wrong:
        return
    object_id, (stated, own) = next(iter(wrong.items()))
    more = f"; {len(wrong)} objects alike" if len(wrong) > 1 else ""
    words = (
        f"the diameter of object {object_id} is said to be {_length(stated)}, its mesh measures "
        f"{_length(own)}, {own / stated:.4g} times as much{more}"
    )
    if any("scale" in key for key in report.keys):
        report.notes.append(words)
    else:
        evidence = "errors that are measured in diameters need the right one (models_info.json)"
        report.findings.append(Finding("diameters", words, (evidence,)))


def _length(metres: float) -> str:
    return f"{1000 * metres:.4g} mm" if metres < 1 else f"{metres:.4g} m"
