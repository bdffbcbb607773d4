"""Category-level estimates against ground truth, by the protocol of NOCS.

Wang et al., Normalized Object Coordinate Space for Category-Level 6D Object Pose and Size
Estimation (NOCS), CVPR 2019, section 6: average precision (AP) of the 3D box at thresholds of its
IoU, and of the pose at n degrees and m centimetres, for each category; the mean over the categories
(mAP) is what tables print. What a bottle, bowl, can or a mug without a visible handle is turned
about its axis costs nothing. The AP of the pose puts detection aside: it is taken over the pairs of
an estimate and an object whose boxes overlap by 10 %. So **an object that is not found at all costs
nothing there**, and a method gains by saying nothing where it is not sure; `pose_of_all` counts
what is missed and what is said too much.

The public code of NOCS, whose numbers fill the tables, does other things than the paper says, and
`protocol="code"` does them too:

- its "3D IoU" takes extremes over the wrong axis, see `nocs_legacy_iou`; this decides pairs, too;
- symmetric objects are turned in 20 steps that begin at the estimate's own angle, so that the best
  turn is missed by up to 9 degrees; `turned_iou_3d` begins at the best one;
- pairs that overlap by 10 % are torn apart: at each threshold of the pose the surest estimate
  chooses anew, among the objects of the image that were found, the one with the smallest sum of
  degrees and centimetres of those within both limits;
- an error that equals its limit is right (paper: "less than");
- estimates with equal scores enter the precision-recall curve one by one, as sorting happens to
  leave them. Here they enter together, and the order of a file does not matter.

Both count a category's AP as 0 if there are no estimates. (Two things of the code are not followed:
an arc cosine of a rounded trace is not a number, which counts as right at every threshold; and the
AP of a category of which no object is there is not a number, nor then the mean.)
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from posecore.arrays import fail, require_choice, require_number
from posecore.metrics import boxes, detection, pose_errors, summaries
from posecore.metrics.categories import instance_rotation_error
from posecore.metrics.matching import each_with_each, in_images
from posecore.metrics.pose_table import CategoryPoseTable

__all__ = ["IOU_OF_PAIRS", "CategoryErrors", "evaluate_categories"]

IOU_OF_PAIRS = 0.1
IOU_THRESHOLDS = (0.25, 0.5, 0.75)
POSE_THRESHOLDS = ((5, 2), (5, 5), (10, 2), (10, 5), (10, 10))
PROTOCOLS = ("paper", "code")


@dataclass(frozen=True, eq=False)
class CategoryErrors:
    """How well the objects of one category are found, and how wrong the poses of pairs are.

    A pair is an estimate and an object whose boxes overlap by more than `IOU_OF_PAIRS`; of M pairs
    the surest estimate of an image chose first.

    Attributes:
        count: how many objects there are to be found.
        estimated: how many estimates of them there are.
        iou: threshold of the 3D IoU -> average precision of the box, in [0, 1].
        pose: (degrees, centimetres) -> average precision of the pose over the pairs.
        pose_of_all: the same over all estimates, of which those without a pair are wrong, and of
            all objects.
        pairs: (M, 2) rows of estimate and object in the tables that came in.
        rotation, translation: (M,) errors of the pairs, radians and metres.
        overlap: (M,) 3D IoU of the pairs.
        scale: (M,) the length of the estimated box's diagonal over that of the true one.
    """

    count: int
    estimated: int
    iou: dict[float, float]
    pose: dict[tuple[float, float], float]
    pose_of_all: dict[tuple[float, float], float]
    pairs: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    overlap: np.ndarray
    scale: np.ndarray


def evaluate_categories(
    estimates: CategoryPoseTable,
    ground_truth: CategoryPoseTable,
    *,
    images: Collection[tuple[int, int]] | None = None,
    targets: np.ndarray | None = None,
    protocol: str = "paper",
    iou_thresholds: Sequence[float] = IOU_THRESHOLDS,
    pose_thresholds: Sequence[tuple[float, float]] = POSE_THRESHOLDS,
) -> dict[str, CategoryErrors]:
    """Measure category-level estimates: AP of boxes and poses, category by category.

    Args:
        estimates: what a method says; its `axis` is not looked at. Estimates of other images are
            ignored, and so are those of categories of which nothing is there.
        ground_truth: what is there, with the symmetry of each instance.
        images: (scene id, image id) of the images to evaluate, default those of the ground truth;
            give them if some hold no object at all.
        targets: (G,) which rows of the ground truth count, default all. Nobody has to find the
            others; estimates that do are left out.
        protocol: "paper", or "code" to get the numbers of NOCS's public code, see above.
        iou_thresholds: in [0, 1); an overlap must exceed them.
        pose_thresholds: pairs of degrees and centimetres.

    Returns:
        category -> errors, in alphabetical order.

    Raises:
        ValueError: if there is no ground truth in the images, a matrix is off a rotation by more
            than 1e-3, or a threshold is none; with "code" for another axis than y.
    """
    for name, table in (("estimates", estimates), ("ground_truth", ground_truth)):
        if not isinstance(table, CategoryPoseTable):
            fail(name, "a CategoryPoseTable", type(table).__name__)
    require_choice("protocol", protocol, PROTOCOLS)
    for threshold in iou_thresholds:
        require_number("iou_thresholds", threshold, 0, 1)
    for pair in pose_thresholds:
        for limit in pair:
            require_number("pose_thresholds", limit, above=0)
    wanted = np.ones(len(ground_truth), bool) if targets is None else np.asarray(targets)
    if wanted.shape != (len(ground_truth),) or wanted.dtype != bool:
        expected = f"booleans of shape ({len(ground_truth)},)"
        fail("targets", expected, f"{wanted.dtype} of shape {wanted.shape}")
    if protocol == "code" and (ground_truth.axis[:, [0, 2]] != 0).any():
        fail("ground_truth", "axes along y, as NOCS's code knows no other", "others")
    images = set(ground_truth.images if images is None else images)
    inside = in_images(ground_truth, images)
    names = np.unique(ground_truth.category[inside & wanted]).tolist()
    if not names:
        fail("ground_truth", "at least one pose in the images", "none")
    said = in_images(estimates, images)
    measure = _Measure(estimates, ground_truth, wanted, protocol)
    return {
        name: measure(
            np.flatnonzero(said & (estimates.category == name)),
            np.flatnonzero(inside & (ground_truth.category == name)),
            iou_thresholds,
            pose_thresholds,
        )
        for name in names
    }


class _Measure:
    """Two tables, and how a category in them is measured.

    Args:
        estimates, truth: the tables; rows below are rows of these.
        wanted: (G,) whether an object counts.
        protocol: one of `PROTOCOLS`.
    """

    def __init__(
        self,
        estimates: CategoryPoseTable,
        truth: CategoryPoseTable,
        wanted: np.ndarray,
        protocol: str,
    ) -> None:
        self.estimates, self.truth, self.wanted = estimates, truth, wanted
        self.literal = protocol == "code"

    def __call__(
        self,
        estimated: np.ndarray,
        true: np.ndarray,
        iou_thresholds: Sequence[float],
        pose_thresholds: Sequence[tuple[float, float]],
    ) -> CategoryErrors:
        images = self._images(estimated, true)
        order = np.concatenate([np.zeros(0, int), *(rows for rows, _ in images)])
        overlaps = self._overlaps(images)
        count = int(self.wanted[true].sum())

        precision = {}
        for threshold in iou_thresholds:
            found, _ = self._pair(images, overlaps, threshold)
            counted = (found < 0) | self.wanted[found]
            precision[threshold] = self._average_precision(
                order[counted], found[counted] >= 0, count
            )
        found, overlap = self._pair(images, overlaps, IOU_OF_PAIRS)
        counted = (found < 0) | self.wanted[found]
        order, found, overlap = order[counted], found[counted], overlap[counted]
        paired = found >= 0
        pairs = np.stack([order[paired], found[paired]], axis=1)
        rotation, translation = self._errors(*pairs.T)
        pose, of_all = {}, {}
        right_at = self._judge(pairs, rotation, translation)
        for limits in pose_thresholds:
            right = np.zeros(len(order), bool)
            right[paired] = right_at(*limits)
            pose[limits] = 0.0
            if len(pairs):
                pose[limits] = self._average_precision(order[paired], right[paired], len(pairs))
            of_all[limits] = self._average_precision(order, right, count)
        est, gt = self.estimates[pairs[:, 0]], self.truth[pairs[:, 1]]
        return CategoryErrors(
            count=count,
            estimated=len(order),
            iou=precision,
            pose=pose,
            pose_of_all=of_all,
            pairs=pairs,
            rotation=rotation,
            translation=translation,
            overlap=overlap[paired],
            scale=est.scale / gt.scale,
        )

    def _images(self, estimated: np.ndarray, true: np.ndarray) -> list[tuple]:
        """Of each image with estimates the rows of these, the surest first, and of the objects."""
        keys = [np.stack([t.scene_id, t.image_id], 1) for t in (self.estimates, self.truth)]
        groups: dict[tuple[int, int], tuple[list, list]] = {}
        for side, rows in enumerate((estimated, true)):
            for row, key in zip(rows.tolist(), keys[side][rows].tolist(), strict=True):
                groups.setdefault(tuple(key), ([], []))[side].append(row)
        images = [(np.array(est), np.array(gt, int)) for est, gt in groups.values() if est]
        return [(est[self._surest(est)], gt) for est, gt in images]

    def _surest(self, rows: np.ndarray) -> np.ndarray:
        """The order of an image's estimates; of equals the first comes first, or the last."""
        scores = self.estimates.score[rows]
        if self.literal:
            return np.argsort(scores, kind="stable")[::-1]
        return np.argsort(-scores, kind="stable")

    def _overlaps(self, images: list[tuple]) -> list[np.ndarray]:
        """(D, G) IoU of every estimate of an image with every object in it."""
        one, other, apart = each_with_each(images)
        return apart(self._iou(self.estimates[one], self.truth[other]))

    def _iou(self, est: CategoryPoseTable, gt: CategoryPoseTable) -> np.ndarray:
        sides = (est.R, est.t, est.size, gt.R, gt.t, gt.size)
        if not self.literal:
            return boxes.turned_iou_3d(*sides, gt.axis)
        turns = (gt.axis != 0).any(-1)
        iou = np.empty(len(turns))
        for symmetric in (False, True):
            rows = turns == symmetric
            some = (side[rows] for side in sides)
            iou[rows] = boxes.nocs_legacy_iou(*some, symmetric=symmetric)
        return np.nan_to_num(iou)  # which it is not of two cubes around the origin

    def _pair(
        self, images: list[tuple], overlaps: list[np.ndarray], least: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """For each estimate, image after image, the row of the object that it finds, and their IoU.

        Returns:
            (D,) rows, -1 of an estimate that finds none, and (D,) overlaps, which it has anyhow.
        """
        found, iou = [np.zeros(0, int)], [np.zeros(0)]
        for (rows, objects), overlap in zip(images, overlaps, strict=True):
            ranks = -np.arange(len(rows))
            column = detection.pair_by_overlap(overlap, ranks, least)
            found.append(np.append(objects, -1)[column])
            iou.append(np.pad(overlap, ((0, 0), (0, 1)))[np.arange(len(rows)), column])
        return np.concatenate(found), np.concatenate(iou)

    def _errors(self, estimated: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radians and metres between estimates and objects of the same number."""
        est, gt = self.estimates[estimated], self.truth[true]
        rotation = instance_rotation_error(est.R, gt.R, gt.axis)
        return rotation, pose_errors.translation_error(est.t, gt.t)

    def _judge(
        self, pairs: np.ndarray, rotation: np.ndarray, translation: np.ndarray
    ) -> Callable[[float, float], np.ndarray]:
        """What says of each pair (M,) whether it is right to n degrees and m centimetres."""
        if not len(pairs):
            return lambda *_: np.zeros(0, bool)
        if not self.literal:
            return functools.partial(summaries.within, rotation, translation)
        place = np.stack([self.estimates.scene_id, self.estimates.image_id], 1)[pairs[:, 0]]
        _, image = np.unique(place, axis=0, return_inverse=True)
        ends = np.cumsum(np.bincount(image))[:-1]
        where = np.split(np.argsort(image, kind="stable"), ends)  # the surest stay first
        one, other, apart = each_with_each([tuple(pairs[rows].T) for rows in where])
        angle, shift = self._errors(one, other)
        angle, shift = np.rad2deg(angle), 100 * shift

        def right(degrees: float, cm: float) -> np.ndarray:
            fits, found = (angle <= degrees) & (shift <= cm), np.zeros(len(pairs), bool)
            errors = apart(np.where(fits, angle + shift, np.inf))
            for rows, some in zip(where, errors, strict=True):
                found[rows] = detection.match_by_error(
                    some, -np.arange(len(rows)), degrees + cm + 1
                )
            return found

        return right

    def _average_precision(self, rows: np.ndarray, correct: np.ndarray, count: int) -> float:
        scores = self.estimates.score[rows]
        if self.literal:  # one by one
            ranks = np.empty(len(rows))
            ranks[np.argsort(scores, kind="stable")[::-1]] = -np.arange(len(rows))
            scores = ranks
        return detection.average_precision(scores, correct, count)
