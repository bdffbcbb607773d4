"""What chapter 8 counts as right: poses of three objects against the truth.

Whoever is not found is wrong. Symmetric objects are measured by ADD-S, and against the nearest of
the poses that look alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from book.ch08_vector_fields import field_training as training
from data_tools import batches
from posecore import metrics
from posecore.methods.vector_field.models import ObjectModel

__all__ = ["LEAST_VISIBLE", "PIXELS", "Outcome", "outcomes", "recall"]

LEAST_VISIBLE = 0.1
"""Of an object, to be counted in a test, as BOP has it."""
PIXELS = 5 / 640
"""Of an image's width: where the 2D projection metric draws its line, 5 px in LINEMOD's images."""


@dataclass(frozen=True)
class Outcome:
    """What became of one object in one test image.

    Attributes:
        object_id: which object.
        visible: the part of its silhouette that is seen.
        add: ADD, or ADD-S for a symmetric object, in diameters; infinite where nothing was found.
        projection: the mean error in the picture, as part of the image's width.
        t: distance of the translations in diameters.
    """

    object_id: int
    visible: float
    add: float
    projection: float
    t: float

    @property
    def right(self) -> bool:
        """ADD(-S) below a tenth of the diameter."""
        return self.add < 0.1


def outcomes(
    data: batches.Stack, found: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]
) -> list[Outcome]:
    """Estimates against the truth; what is not found counts as wrong.

    Args:
        data: the test split.
        found: `(view, object id)` to R (3, 3) and t (3,).
    """
    result = []
    for model in training.models():
        for row in data.rows(object_id=model.object_id, visible=LEAST_VISIBLE).tolist():
            view = int(data.view[row])
            visible = float(data.visible_fraction[row])
            estimate = found.get((view, model.object_id))
            errors = (np.inf, np.inf, np.inf)
            if estimate is not None:
                truth = data.R[row].numpy(), data.t[row].numpy()
                errors = _errors(model, estimate, truth, data.K[view].numpy(), data.size[0])
            result.append(Outcome(model.object_id, visible, *errors))
    return result


def recall(found: Sequence[Outcome], what: str = "right") -> float:
    """The percentage that is right, of each object first, then their mean.

    Args:
        found: of one or more objects.
        what: "right" by ADD(-S), or "projection".
    """
    shares = []
    for object_id in sorted({outcome.object_id for outcome in found}):
        of_it = [outcome for outcome in found if outcome.object_id == object_id]
        good = [o.right if what == "right" else o.projection < PIXELS for o in of_it]
        shares.append(np.mean(good))
    return 100 * float(np.mean(shares))


def _errors(
    model: ObjectModel,
    estimate: tuple[np.ndarray, np.ndarray],
    truth: tuple[np.ndarray, np.ndarray],
    K: np.ndarray,
    width: int,
) -> tuple[float, float, float]:
    R, t = truth
    distance = metrics.add_s if model.symmetric else metrics.add
    add = float(distance(*estimate, R, t, model.points)) / model.diameter
    if model.symmetric:
        R, t = metrics.closest_symmetry(estimate[0], R, t, model.symmetries)
    moved = float(metrics.projection_2d(K, *estimate, R, t, model.points))
    away = float(np.linalg.norm(estimate[1] - t)) / model.diameter
    return add, moved / width, away
