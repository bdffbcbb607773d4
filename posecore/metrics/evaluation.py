"""Estimates against ground truth: matched, then measured with every metric, object by object.

A pose without an estimate counts as wrong: its errors are infinite.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from posecore import poses, rotations
from posecore.arrays import fail
from posecore.metrics import boxes, detection, model_errors, pose_errors, summaries
from posecore.metrics.detection import Detections
from posecore.metrics.matching import groups, in_images, match, rows_by_key
from posecore.metrics.pose_table import PoseTable
from posecore.models import ObjectModel
from posecore.symmetry import closest_symmetry

__all__ = [
    "HEAD_ANGLES",
    "IOU_THRESHOLDS",
    "ObjectErrors",
    "evaluate",
    "in_images",
    "match",
]

HEAD_ANGLES = ("yaw", "pitch", "roll")  # intrinsic YXZ, the book's convention for single angles
IOU_THRESHOLDS = (0.25, 0.5, 0.75)
BOP_ERRORS = ("mssd", "mspd")
PIXELS = ("projection", "mspd")


@dataclass(frozen=True, eq=False)
class ObjectErrors:
    """How wrong the estimates of one object are, one entry for each of its n true poses.

    The translation, the angles and the box are compared with the true pose after that symmetry of
    the object which brings it nearest; MSSD and MSPD take the best symmetry by their definition,
    ADD and the 2D projection know none by theirs.

    Attributes:
        found: (n,) whether there is an estimate.
        errors: name -> (n,) metres, radians or pixels, infinite where there is no estimate:
            `translation`, `rotation`, `yaw`, `pitch`, `roll` (signed), `add`, `add_s`, `add_or_s`
            (ADD-S if the object has symmetries, else ADD), `mssd`, `mspd`, `projection`. A name is
            absent if it could not be computed: on the model without a model, in pixels without
            intrinsics, in angles where a matrix of the object is not a rotation. Errors in pixels
            are infinite also where a true pose is not in front of the camera. `vsd` (n, T), for T
            tolerances, comes from `bop_errors.add_bop_errors`.
        true_angles: `yaw`, `pitch`, `roll` -> (n,) radians; empty if there are no angles.
        overlap: (n,) 3D IoU of the boxes, 0 where there is no estimate; None without a model, for
            a flat box, or where a matrix is not a rotation.
        precision: IoU threshold -> average precision of the box; empty if `overlap` is None.
        diameter: of the model in metres, None without a model.
        in_front: (n,) whether the camera can see all of the model in its true pose: errors in
            pixels mean something there only. None if there are no such errors, or for all.
        pairs: `mssd`, `mspd` -> for each image with the object (D, G) errors of its surest
            estimates, surest first, against its true poses (those in front, in pixels), for BOP's
            own pairs; of `vsd` (T, D, G). A name is absent if every true pose is alone in its
            image.
        detections: all estimates in each image that holds the object, for BOP's detection; from
            `bop_errors.add_bop_errors`, else empty.
    """

    found: np.ndarray
    errors: dict[str, np.ndarray]
    true_angles: dict[str, np.ndarray]
    overlap: np.ndarray | None
    precision: dict[float, float]
    diameter: float | None
    in_front: np.ndarray | None = None
    pairs: dict[str, list[np.ndarray]] = field(default_factory=dict)
    detections: list[Detections] = field(default_factory=list)

    def measured(self, name: str) -> np.ndarray:
        """The true poses (n,) for which an error has a meaning, whatever the estimate."""
        if name in PIXELS and self.in_front is not None:
            return self.in_front
        return np.ones(len(self.found), dtype=bool)


def evaluate(
    estimates: PoseTable,
    ground_truth: PoseTable,
    models: Mapping[int, ObjectModel],
    K: np.ndarray | None = None,
    objects: Sequence[int] | None = None,
    images: Collection[tuple[int, int]] | None = None,
    others: PoseTable | None = None,
) -> dict[int, ObjectErrors]:
    """Measure all estimates with every metric.

    Args:
        estimates: what a method says. Those of images that are not evaluated are ignored; those of
            objects that an image does not hold count against the average precision.
        ground_truth: what is there.
        models: object id -> model; objects without one get the errors that need none.
        K: (3, 3) intrinsics of all images, (G, 3, 3) of each ground-truth pose, or None.
        objects: the ids to evaluate, default all of the ground truth.
        images: (scene id, image id) of the images to evaluate, default those of the ground truth;
            give them if some hold no object at all.
        others: what is there as well, but is no target. Nobody has to find it; the average
            precision leaves out the estimates that do.

    Returns:
        object id -> errors, in the order of the ids.

    Raises:
        ValueError: if there is no ground truth in the images, or an id of `objects` is not in it;
            or for what is wrong with one object, whose id it names.
    """
    images = set(ground_truth.images if images is None else images)
    rows = in_images(ground_truth, images)
    if K is not None:
        K = np.asarray(K, dtype=np.float64)
        if K.shape not in ((3, 3), (len(ground_truth), 3, 3)):
            fail("K", f"shape (3, 3) or ({len(ground_truth)}, 3, 3)", f"shape {K.shape}")
        K = np.broadcast_to(K, (len(ground_truth), 3, 3))[rows]
    estimates, ground_truth = estimates[in_images(estimates, images)], ground_truth[rows]
    known = np.unique(ground_truth.object_id).tolist()
    wanted = known if objects is None else sorted(set(objects))
    if not known:
        fail("ground_truth", "at least one pose in the images", "none")
    if not wanted or not set(wanted) <= set(known):
        fail("objects", f"ids of the ground truth {known}", wanted)
    result = {}
    for object_id in wanted:
        rows = ground_truth.object_id == object_id
        try:
            with model_errors.threads_for_searches():
                result[object_id] = _measure(
                    estimates[estimates.object_id == object_id],
                    ground_truth[rows],
                    models.get(object_id),
                    None if K is None else K[rows],
                    None if others is None else others[others.object_id == object_id],
                )
        except ValueError as error:
            raise ValueError(f"object {object_id}: {error}") from error
    return result


def _measure(
    estimates: PoseTable,
    truth: PoseTable,
    model: ObjectModel | None,
    K: np.ndarray | None,
    others: PoseTable | None,
) -> ObjectErrors:
    """All errors of one object."""
    matched = match(estimates, truth)
    found = matched >= 0
    est, gt = estimates[matched[found]], truth[found]
    near = _at_closest_symmetry(est, gt, model)
    # Published ground truth is not always a rotation, and then has no angles.
    proper = all(rotations.is_rotation(table.R).all() for table in (estimates, truth))
    errors = {"translation": pose_errors.translation_error(est.t, near.t)}
    true_angles, overlap, precision, pairs, in_front = {}, None, {}, {}, None
    if proper:
        errors["rotation"] = pose_errors.rotation_error(est.R, near.R)
        estimated, true = rotations.matrix_to_euler(est.R), rotations.matrix_to_euler(near.R)
        difference = summaries.angle_difference(estimated, true)
        for axis, name in enumerate(HEAD_ANGLES):
            errors[name] = difference[:, axis]
            true_angles[name] = _fill(found, true[:, axis], 0.0)
    if model is not None:
        pair = (est.R, est.t, gt.R, gt.t)
        errors["add"] = model_errors.add(*pair, model.points)
        errors["add_s"] = model_errors.add_s(*pair, model.points)
        errors["add_or_s"] = errors["add" if model.symmetries is None else "add_s"]
        if K is not None:
            in_front = _in_front(truth, model)
            seen = in_front[found]
            errors["projection"] = np.full(len(gt), np.inf)
            errors["projection"][seen] = model_errors.projection_2d(
                K[found][seen], *(x[seen] for x in pair), model.points
            )
        for name in BOP_ERRORS if K is not None else ("mssd",):
            errors[name], pairs[name] = _bop_errors(name, estimates, truth, matched, model, K)
        if proper and (model.size > 0).all():
            iou = boxes.oriented_iou_3d(*_box(est, model), *_box(near, model))
            overlap = _fill(found, iou, 0.0)
            precision = _box_precision(estimates, truth, model, others)
    return ObjectErrors(
        found,
        {name: _fill(found, error, np.inf) for name, error in errors.items()},
        true_angles,
        overlap,
        precision,
        None if model is None else model.diameter,
        in_front,
        {name: images for name, images in pairs.items() if images is not None},
    )


def _in_front(truth: PoseTable, model: ObjectModel) -> np.ndarray:
    """Which true poses (n,) have the whole model in front of the camera."""
    depths = [model.points @ R[2] + t[2] for R, t in zip(truth.R, truth.t, strict=True)]
    return np.array([depth.min() > 0 for depth in depths], dtype=bool)


def _bop_errors(
    name: str,
    estimates: PoseTable,
    truth: PoseTable,
    matched: np.ndarray,
    model: ObjectModel,
    K: np.ndarray | None,
) -> tuple[np.ndarray, list[np.ndarray] | None]:
    """MSSD or MSPD of each matched pose, and of all pairs in each image that has several."""
    images = list(groups(estimates, truth))
    several = any(len(rows) > 1 for _, rows in images)
    in_front = _in_front(truth, model) if name == "mspd" else np.ones(len(truth), bool)
    grids = [np.meshgrid(one, rows[in_front[rows]], indexing="ij") for one, rows in images]
    found = np.flatnonzero(matched >= 0)
    # Each pair is measured once: those of the images hold whatever is matched.
    one = np.concatenate([matched[found], *(grid[0].ravel() for grid in grids)])
    other = np.concatenate([found, *(grid[1].ravel() for grid in grids)])
    keys, where = np.unique(one * len(truth) + other, return_inverse=True)
    one, other = keys // len(truth), keys % len(truth)
    seen = in_front[other]
    one, other = one[seen], other[seen]
    values = np.full(len(keys), np.inf)
    arguments = (estimates.R[one], estimates.t[one], truth.R[other], truth.t[other])
    if name == "mspd":
        values[seen] = model_errors.mspd(K[other], *arguments, model.points, model.symmetries)
    else:
        values[seen] = model_errors.mssd(*arguments, model.points, model.symmetries)
    values = values[where]
    if not several:
        return values[: len(found)], None
    shapes = [grid[0].shape for grid in grids]
    ends = len(found) + np.cumsum([0, *map(math.prod, shapes)])
    pairs = [
        values[begin:end].reshape(shape)
        for begin, end, shape in zip(ends, ends[1:], shapes, strict=False)
    ]
    return values[: len(found)], pairs


def _at_closest_symmetry(est: PoseTable, gt: PoseTable, model: ObjectModel | None) -> PoseTable:
    """The true poses, each after the symmetry that brings it nearest to its estimate."""
    if model is None or model.symmetries is None:
        return gt
    R, t = closest_symmetry(est.R, gt.R, gt.t, model.symmetries)
    return replace(gt, R=R, t=t)


def _box_precision(
    estimates: PoseTable, truth: PoseTable, model: ObjectModel, others: PoseTable | None
) -> dict[float, float]:
    """Average precision of the object's box, over all estimates in all images."""
    there = truth if others is None else _joined(truth, others)
    estimated, true = rows_by_key(estimates), rows_by_key(there)
    images = [(np.array(rows), np.array(true.get(key, []), int)) for key, rows in estimated.items()]
    # Every estimate of an image beside every true pose in it.
    grids = [np.meshgrid(*pair, indexing="ij") for pair in images]
    one, other = (
        np.concatenate([np.zeros(0, int), *(grid[i].ravel() for grid in grids)]) for i in (0, 1)
    )
    est = estimates[one]
    near = _at_closest_symmetry(est, there[other], model)
    iou = boxes.oriented_iou_3d(*_box(est, model), *_box(near, model))
    ends = np.cumsum([0, *(grid[0].size for grid in grids)])
    precision = {}
    for threshold in IOU_THRESHOLDS:
        paired = np.full(len(estimates), -1)
        for (rows, targets), begin, end in zip(images, ends, ends[1:], strict=False):
            overlaps, scores = iou[begin:end].reshape(len(rows), -1), estimates.score[rows]
            column = detection.pair_by_overlap(overlaps, scores, threshold)
            paired[rows[column >= 0]] = targets[column[column >= 0]]
        counted = paired < len(truth)  # what finds something that is no target is left out
        precision[threshold] = detection.average_precision(
            estimates.score[counted], paired[counted] >= 0, len(truth)
        )
    return precision


def _joined(one: PoseTable, other: PoseTable) -> PoseTable:
    columns = (column.name for column in fields(PoseTable))
    return PoseTable(*(np.concatenate([getattr(one, n), getattr(other, n)]) for n in columns))


def _box(table: PoseTable, model: ObjectModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose and size of the model's box in every row."""
    centre = poses.apply(table.R, table.t, model.centre[None])[:, 0]
    return table.R, centre, model.size


def _fill(found: np.ndarray, values: np.ndarray, missing: float) -> np.ndarray:
    filled = np.full(len(found), missing)
    filled[found] = values
    return filled
