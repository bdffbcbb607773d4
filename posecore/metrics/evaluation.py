"""Estimates against ground truth: matched, then measured with every metric, object by object.

A pose without an estimate counts as wrong: its errors are infinite.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

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
    "in_images",
    "match",
]

HEAD_ANGLES = ("yaw", "pitch", "roll")  # intrinsic YXZ, the book's convention for single angles
IOU_THRESHOLDS = (0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
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
            intrinsics, in angles where a matrix of the object is not a rotation.
        true_angles: `yaw`, `pitch`, `roll` -> (n,) radians; empty if there are no angles.
        overlap: (n,) 3D IoU of the boxes, 0 where there is no estimate; None without a model, for
            a flat box, or where a matrix is not a rotation.
        precision: IoU threshold -> average precision of the box; empty if `overlap` is None.
        diameter: of the model in metres, None without a model.
    """

    found: np.ndarray
    errors: dict[str, np.ndarray]
    true_angles: dict[str, np.ndarray]
    overlap: np.ndarray | None
    precision: dict[float, float]
    diameter: float | None


def in_images(table: PoseTable, images: Collection[tuple[int, int]]) -> np.ndarray:
    """Which rows belong to one of the images, given as (scene id, image id): (N,) booleans."""
    wanted = set(images)
    return np.array([image in wanted for image in table.images], dtype=bool)


def match(estimates: PoseTable, ground_truth: PoseTable) -> np.ndarray:
    """For every ground-truth pose the row of its estimate, -1 where there is none: (G,) integers.

    An image with n instances of an object takes the n surest estimates of it; if n > 1 they are
    assigned so that the sum of the distances between the models' origins is smallest.
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
    images: Collection[tuple[int, int]] | None = None,
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
            result[object_id] = _measure(
                estimates[estimates.object_id == object_id],
                ground_truth[rows],
                models.get(object_id),
                None if K is None else K[rows],
            )
        except ValueError as error:
            raise ValueError(f"object {object_id}: {error}") from error
    return result


def _measure(
    estimates: PoseTable, truth: PoseTable, model: ObjectModel | None, K: np.ndarray | None
) -> ObjectErrors:
    """All errors of one object."""
    matched = match(estimates, truth)
    found = matched >= 0
    est, gt = estimates[matched[found]], truth[found]
    near = _at_closest_symmetry(est, gt, model)
    # Published ground truth is not always a rotation, and then has no angles.
    proper = all(rotations.is_rotation(table.R).all() for table in (estimates, truth))
    errors = {"translation": pose_errors.translation_error(est.t, near.t)}
    true_angles, overlap, precision = {}, None, {}
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
        errors["mssd"] = model_errors.mssd(*pair, model.points, model.symmetries)
        if K is not None:
            errors["projection"] = model_errors.projection_2d(K[found], *pair, model.points)
            errors["mspd"] = model_errors.mspd(K[found], *pair, model.points, model.symmetries)
        if proper and (model.size > 0).all():
            iou = boxes.oriented_iou_3d(*_box(est, model), *_box(near, model))
            overlap = _fill(found, iou, 0.0)
            precision = _box_precision(estimates, truth, model)
    return ObjectErrors(
        found,
        {name: _fill(found, error, np.inf) for name, error in errors.items()},
        true_angles,
        overlap,
        precision,
        None if model is None else model.diameter,
    )


def _at_closest_symmetry(est: PoseTable, gt: PoseTable, model: ObjectModel | None) -> PoseTable:
    """The true poses, each after the symmetry that brings it nearest to its estimate."""
    if model is None or model.symmetries is None:
        return gt
    R, t = pose_errors.closest_symmetry(est.R, gt.R, gt.t, model.symmetries)
    return replace(gt, R=R, t=t)


def _box_precision(
    estimates: PoseTable, truth: PoseTable, model: ObjectModel
) -> dict[float, float]:
    """Average precision of the object's box, over all estimates in all images."""
    estimated, true = _rows_by_key(estimates), _rows_by_key(truth)
    correct = {threshold: np.zeros(len(estimates), bool) for threshold in IOU_THRESHOLDS}
    for key, rows in estimated.items():
        there = np.array(true.get(key, []), dtype=int)
        # Every estimate of the image beside every true pose in it.
        one, other = (grid.ravel() for grid in np.meshgrid(rows, there, indexing="ij"))
        est = estimates[one.astype(int)]
        near = _at_closest_symmetry(est, truth[other.astype(int)], model)
        overlaps = boxes.oriented_iou_3d(*_box(est, model), *_box(near, model))
        overlaps, scores = overlaps.reshape(len(rows), len(there)), estimates.score[rows]
        for threshold in IOU_THRESHOLDS:
            correct[threshold][rows] = detection.match_by_overlap(overlaps, scores, threshold)
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
    for row, (image, object_id) in enumerate(zip(table.images, table.object_id, strict=True)):
        rows[*image, int(object_id)].append(row)
    return rows
