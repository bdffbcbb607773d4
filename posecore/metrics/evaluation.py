"""Estimates against ground truth: matched, then measured with every metric, object by object.

A pose without an estimate counts as wrong: its errors are infinite.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from posecore import poses, rotations
from posecore.arrays import fail
from posecore.metrics import boxes, detection, model_errors, pose_errors, summaries
from posecore.metrics.pose_table import PoseTable

__all__ = [
    "HEAD_ANGLES",
    "IOU_THRESHOLDS",
    "ObjectErrors",
    "ObjectModel",
    "evaluate",
    "match",
    "pool",
]

HEAD_ANGLES = ("yaw", "pitch", "roll")  # intrinsic YXZ, the book's convention for single angles
IOU_THRESHOLDS = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class ObjectModel:
    """What has to be known of an object to measure poses on it; all lengths in metres.

    Attributes:
        points: (N, 3) model points.
        diameter: the largest distance between two points of the model.
        centre, size: (3,) the middle and the edges of the box around the model, in its frame.
        symmetries: (S, 4, 4) transforms that leave the object as it is, identity included, or None.
    """

    points: np.ndarray
    diameter: float
    centre: np.ndarray
    size: np.ndarray
    symmetries: np.ndarray | None = None


@dataclass(frozen=True)
class ObjectErrors:
    """The errors of one object (or of several, pooled), one entry for each ground-truth pose.

    Attributes:
        found: (n,) whether there is an estimate; errors are infinite (`iou`: minus infinity) where
            there is none.
        values: name -> (n,) errors in metres, radians and pixels: `translation`, `rotation`, `add`,
            `add_s`, `add_or_s` (ADD-S if the object has symmetries, else ADD), `mssd`, `mspd`,
            `projection`, `iou`, `yaw`, `pitch`, `roll` (signed differences), `true_yaw`,
            `true_pitch`, `true_roll`, and `diameter`. A name is absent if it could not be computed:
            on the model without a model, in pixels without intrinsics, in angles and boxes where a
            matrix is not a rotation.
        precision: IoU threshold -> average precision, of one object only.
    """

    found: np.ndarray
    values: dict[str, np.ndarray]
    precision: dict[float, float]


def match(estimates: PoseTable, ground_truth: PoseTable) -> np.ndarray:
    """For every ground-truth pose the row of its estimate, -1 where there is none: (G,) integers.

    An image with n instances of an object takes the n surest estimates of it; if n > 1 they are
    assigned so that the sum of the distances between the centres is smallest.
    """
    estimated, true = _rows_by_key(estimates), _rows_by_key(ground_truth)
    matched = np.full(len(ground_truth), -1)
    for key, rows in true.items():
        candidates = np.array(estimated.get(key, []), dtype=int)
        surest = np.argsort(-estimates.score[candidates], kind="stable")[: len(rows)]
        candidates = candidates[surest]
        gaps = ground_truth.t[rows][:, None] - estimates.t[candidates][None]
        row, column = linear_sum_assignment(np.linalg.norm(gaps, axis=-1))
        matched[np.array(rows)[row]] = candidates[column]
    return matched


def evaluate(
    estimates: PoseTable,
    ground_truth: PoseTable,
    models: Mapping[int, ObjectModel],
    K: np.ndarray | None = None,
    objects: Sequence[int] | None = None,
) -> dict[int, ObjectErrors]:
    """Measure all estimates with every metric.

    Args:
        estimates: what a method says; estimates of objects that an image does not hold count only
            against the average precision.
        ground_truth: what is there.
        models: object id -> model; objects without one get the errors that need none.
        K: (3, 3) intrinsics of all images, (G, 3, 3) of each ground-truth pose, or None.
        objects: the ids to evaluate, default all of the ground truth.

    Returns:
        object id -> errors, in the order of the ids.

    Raises:
        ValueError: if there is no ground truth, or an id of `objects` is not in it.
    """
    if not len(ground_truth):
        fail("ground_truth", "at least one pose", "none")
    known = np.unique(ground_truth.object_id).tolist()
    wanted = known if objects is None else sorted(set(objects))
    if unknown := [i for i in wanted if i not in known]:
        fail("objects", f"ids of the ground truth {known}", unknown)
    if K is not None:
        K = np.asarray(K, dtype=np.float64)
        if K.shape not in ((3, 3), (len(ground_truth), 3, 3)):
            fail("K", f"shape (3, 3) or ({len(ground_truth)}, 3, 3)", f"shape {K.shape}")
        K = np.broadcast_to(K, (len(ground_truth), 3, 3))
    # Published ground truth is not always a rotation; then angles and boxes are left out.
    proper = all(rotations.is_rotation(table.R).all() for table in (estimates, ground_truth))
    result = {}
    for object_id in wanted:
        rows = ground_truth.object_id == object_id
        result[object_id] = _measure(
            estimates[estimates.object_id == object_id],
            ground_truth[rows],
            models.get(object_id),
            None if K is None else K[rows],
            proper,
        )
    return result


def pool(errors: Sequence[ObjectErrors]) -> ObjectErrors:
    """All poses of several objects as one list; a name that an object lacks covers the others."""
    names = dict.fromkeys(name for one in errors for name in one.values)
    values = {n: np.concatenate([o.values[n] for o in errors if n in o.values]) for n in names}
    return ObjectErrors(np.concatenate([o.found for o in errors]), values, {})


def _measure(
    estimates: PoseTable,
    truth: PoseTable,
    model: ObjectModel | None,
    K: np.ndarray | None,
    proper: bool,
) -> ObjectErrors:
    """All errors of one object; those that need rotations only if all matrices are `proper`."""
    matched = match(estimates, truth)
    found = matched >= 0
    est, gt = estimates[matched[found]], truth[found]
    pair = (est.R, est.t, gt.R, gt.t)
    symmetries = None if model is None else model.symmetries
    values = {"translation": pose_errors.translation_error(est.t, gt.t)}
    precision = {}
    if proper:
        values |= _angle_errors(est.R, gt.R, symmetries)
    if model is not None:
        values["add"] = model_errors.add(*pair, model.points)
        values["add_s"] = model_errors.add_s(*pair, model.points)
        values["add_or_s"] = values["add" if symmetries is None else "add_s"]
        values["mssd"] = model_errors.mssd(*pair, model.points, symmetries)
    if model is not None and K is not None:
        values["projection"] = model_errors.projection_2d(K[found], *pair, model.points)
        values["mspd"] = model_errors.mspd(K[found], *pair, model.points, symmetries)
    values = {name: _fill(found, error, np.inf) for name, error in values.items()}
    if model is not None:
        values["diameter"] = np.full(len(truth), model.diameter)
    if model is not None and proper:
        overlap = boxes.oriented_iou_3d(*_box(est, model), *_box(gt, model))
        values["iou"] = _fill(found, overlap, -np.inf)
        precision = _box_precision(estimates, truth, model)
    return ObjectErrors(found, values, precision)


def _angle_errors(
    R_est: np.ndarray, R_gt: np.ndarray, symmetries: np.ndarray | None
) -> dict[str, np.ndarray]:
    if symmetries is not None:
        R_gt = pose_errors.closest_symmetry(R_est, R_gt, symmetries)
    estimated, true = rotations.matrix_to_euler(R_est), rotations.matrix_to_euler(R_gt)
    difference = summaries.angle_difference(estimated, true)
    values = {"rotation": pose_errors.rotation_error(R_est, R_gt)}
    for axis, name in enumerate(HEAD_ANGLES):
        values[name] = difference[:, axis]
        values[f"true_{name}"] = true[:, axis]
    return values


def _box_precision(
    estimates: PoseTable, truth: PoseTable, model: ObjectModel
) -> dict[float, float]:
    """Average precision of the object's box, over all estimates in all images."""
    estimated, true = _rows_by_key(estimates), _rows_by_key(truth)
    correct = {threshold: np.zeros(len(estimates), bool) for threshold in IOU_THRESHOLDS}
    for key, rows in estimated.items():
        there = truth[np.array(true.get(key, []), dtype=int)]
        here = estimates[np.array(rows)]
        R, t, size = _box(here, model)
        overlaps = boxes.oriented_iou_3d(R[:, None], t[:, None], size, *_box(there, model))
        for threshold in IOU_THRESHOLDS:
            correct[threshold][rows] = detection.match_by_overlap(overlaps, here.score, threshold)
    return {
        threshold: detection.average_precision(estimates.score, hits, len(truth))
        for threshold, hits in correct.items()
    }


def _box(table: PoseTable, model: ObjectModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose and size of the model's box in every row."""
    centre = poses.apply(table.R, table.t, model.centre[None])[:, 0]
    return table.R, centre, model.size


def _fill(found: np.ndarray, values: np.ndarray, missing: float) -> np.ndarray:
    filled = np.full(len(found), missing)
    filled[found] = values
    return filled


def _rows_by_key(table: PoseTable) -> dict[tuple[int, int, int], list[int]]:
    """(scene, image, object) -> its rows."""
    rows = defaultdict(list)
    keys = np.stack([table.scene_id, table.image_id, table.object_id], axis=-1)
    for row, key in enumerate(keys.tolist()):
        rows[tuple(key)].append(row)
    return rows
