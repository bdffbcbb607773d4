"""Estimates compared with the truth, by view and object, and how many of them are right.

Who is not found is wrong. Symmetric objects are measured by ADD-S, and against the nearest of the
poses that look alike.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data_tools.batches import Stack
from posecore import metrics
from posecore.arrays import fail
from posecore.models import ObjectModel

__all__ = ["LEAST_VISIBLE", "Outcome", "outcomes", "recall", "recall_by"]

LEAST_VISIBLE = 0.1
"""Of an object, to be counted in a test, as BOP has it."""
PROJECTION = 5 / 640
"""Of an image's width: where the 2D projection metric draws its line, 5 px in LINEMOD's images."""

Pose = tuple[np.ndarray, np.ndarray]
Key = tuple[int, int]
"""The view, as the data count them, and the object's id."""


@dataclass(frozen=True)
class Outcome:
    """How the estimate of one object in one test image compares with the truth.

    Attributes:
        object_id: which object.
        row: of it in the table of the data.
        visible: the part of its silhouette that is seen.
        add: ADD, or ADD-S for a symmetric object, in diameters; infinite where nothing was found.
        projection: the mean error in the picture, as part of the image's width.
        t: distance of the translations in diameters.
    """

    object_id: int
    row: int
    visible: float
    add: float
    projection: float
    t: float

    @property
    def right(self) -> bool:
        """ADD(-S) below a tenth of the diameter."""
        return self.add < 0.1

    @property
    def projected_right(self) -> bool:
        """A 2D projection error of less than 5 pixels in an image 640 wide."""
        return self.projection < PROJECTION


def outcomes(
    data: Stack,
    models: Sequence[ObjectModel],
    found: Mapping[Key, Pose],
    visible: float = LEAST_VISIBLE,
) -> dict[Key, Outcome]:
    """Compare estimates with the truth, for all objects that count; a missing one is wrong.

    Args:
        data: the test split, in which no view holds an object of the models twice.
        models: of the objects that are tested.
        found: (view, object id) -> R (3, 3) and t (3,).
        visible: the least visible fraction of what counts.

    Returns:
        (view, object id) -> `Outcome`, in order of the models, then of the views.

    Raises:
        ValueError: if a view holds an object twice.
    """
    result: dict[Key, Outcome] = {}
    for model in models:
        for row in data.rows(object_id=model.object_id, visible=visible).tolist():
            key = int(data.view[row]), model.object_id
            if key in result:
                fail("data", "an object once in a view", f"object {key[1]} twice in view {key[0]}")
            errors = (np.inf, np.inf, np.inf)
            if (estimate := found.get(key)) is not None:
                truth = data.R[row].numpy(), data.t[row].numpy()
                errors = _errors(model, estimate, truth, data.K[key[0]].numpy(), data.size[0])
            result[key] = Outcome(model.object_id, row, float(data.visible_fraction[row]), *errors)
    return result


def recall(
    found: Iterable[Outcome], right: Callable[[Outcome], bool] = lambda one: one.right
) -> float:
    """The percentage that is right, of each object first, then their mean.

    Args:
        found: of one or more objects.
        right: which are; by ADD(-S) if it is not given.
    """
    shares = recall_by(found, lambda one: one.object_id, right)
    return 100 * float(np.mean([shares[object_id] for object_id in sorted(shares)]))


def recall_by(
    found: Iterable[Outcome],
    group: Callable[[Outcome], Hashable],
    right: Callable[[Outcome], bool] = lambda one: one.right,
) -> dict[Hashable, float]:
    """The part, 0 to 1, that is right in each group; groups in the order in which they come.

    Args:
        found: outcomes.
        group: of an outcome; those in group None are left out.
        right: which are; by ADD(-S) if it is not given.
    """
    members: dict[Hashable, list[bool]] = {}
    for one in found:
        if (name := group(one)) is not None:
            members.setdefault(name, []).append(right(one))
    return {name: float(np.mean(some)) for name, some in members.items()}


def _errors(
    model: ObjectModel, estimate: Pose, truth: Pose, K: np.ndarray, width: int
) -> tuple[float, float, float]:
    R, t = truth
    distance = metrics.add_s if model.symmetric else metrics.add
    add = float(distance(*estimate, R, t, model.points)) / model.diameter
    if model.symmetric:
        R, t = metrics.closest_symmetry(estimate[0], R, t, model.symmetries)
    moved = float(metrics.projection_2d(K, *estimate, R, t, model.points))
    away = float(np.linalg.norm(estimate[1] - t)) / model.diameter
    return add, moved / width, away
