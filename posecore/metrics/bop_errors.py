"""What the BOP challenges measure besides: VSD, and all estimates of an image for detection.

Localisation looks at as many of an image's surest estimates as it has targets of an object,
detection at all of them. `evaluation.evaluate` knows the errors of the former but VSD; each pair
that it has not measured is measured here, once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np

from posecore.arrays import fail
from posecore.metrics import model_errors
from posecore.metrics.bop_scores import surest_of_images
from posecore.metrics.detection import Detections
from posecore.metrics.evaluation import ObjectErrors, _in_front, _joined
from posecore.metrics.matching import groups, in_images, match, rows_by_key
from posecore.metrics.pose_table import PoseTable
from posecore.models import ObjectModel

__all__ = ["Present", "SurfaceErrors", "add_bop_errors"]

Key = tuple[int, int, int]
"""Scene, image and object."""
Measured = tuple[np.ndarray, np.ndarray]
"""Pairs (P,), each the number `estimate * poses + pose` of two rows; and their errors."""


class SurfaceErrors(Protocol):
    """What draws models and compares them with depth images: VSD of pairs of poses."""

    object_ids: Collection[int]
    """Of what it can draw."""

    def __call__(self, estimates: PoseTable, truth: PoseTable) -> np.ndarray:
        """(P, T) errors, for P pairs of rows and the T of `visible_surface.VSD_TAUS`."""
        ...


@dataclass(frozen=True, eq=False)
class Present:
    """What is in the images.

    Attributes:
        truth: what localisation wants to be found, as `evaluation.evaluate` had it.
        others: what is there as well.
        K: (3, 3) intrinsics, or (G + O, 3, 3) of the truth and the others; None without pixels.
        counted: (G + O,) bool, which of them detection wants to be found.
        counts: how many of the surest estimates localisation looks at, where that is another number
            than that of the true poses.

    Raises:
        ValueError: naming what has another shape.
    """

    truth: PoseTable
    others: PoseTable
    K: np.ndarray | None
    counted: np.ndarray
    counts: Mapping[Key, int]

    def __post_init__(self) -> None:
        total = len(self.truth) + len(self.others)
        counted = np.asarray(self.counted)
        if counted.shape != (total,) or counted.dtype != bool:
            fail("counted", f"booleans of shape ({total},)", f"{counted.dtype} {counted.shape}")
        object.__setattr__(self, "counted", counted)
        if self.K is not None:
            K = np.asarray(self.K, np.float64)
            if K.shape not in ((3, 3), (total, 3, 3)):
                fail("K", f"shape (3, 3) or ({total}, 3, 3)", f"shape {K.shape}")
            object.__setattr__(self, "K", np.broadcast_to(K, (total, 3, 3)))

    def of_object(self, object_id: int, images: Collection[tuple[int, int]]) -> Present:
        """What is there of one object in some images."""
        one, other = (
            in_images(table, images) & (table.object_id == object_id)
            for table in (self.truth, self.others)
        )
        both = np.concatenate([one, other])
        K = None if self.K is None else self.K[both]
        return Present(self.truth[one], self.others[other], K, self.counted[both], self.counts)

    @property
    def poses(self) -> PoseTable:
        """The truth, then the others."""
        return _joined(self.truth, self.others)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Which estimates of an object are compared with which of its poses.

    Attributes:
        poses: how many there are.
        matched: (F,) the pairs of the true poses that have an estimate, see `matching.match`.
        localised: of each image (D, G) pairs of its surest estimates with its true poses; empty if
            every true pose is alone in its image.
        detected: of each image (D,) and (G,) rows, its estimates and its poses.
    """

    poses: int
    matched: np.ndarray
    localised: list[np.ndarray]
    detected: list[tuple[np.ndarray, np.ndarray]]

    def local(self) -> np.ndarray:
        """(P,) the pairs of localisation, ascending."""
        return np.unique(np.concatenate([self.matched, *(x.ravel() for x in self.localised)]))

    def every(self) -> np.ndarray:
        """(P,) all pairs, ascending."""
        blocks = [self.beside(*rows).ravel() for rows in self.detected]
        return np.unique(np.concatenate([self.local(), *blocks]))

    def beside(self, estimates: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """The pairs (D, G) of all of some rows with all of others."""
        return estimates[:, None] * self.poses + poses

    def rows(self, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rows of the estimates and of the poses."""
        return np.divmod(pairs, self.poses)


def add_bop_errors(
    errors: Mapping[int, ObjectErrors],
    estimates: PoseTable,
    present: Present,
    models: Mapping[int, ObjectModel],
    images: Collection[tuple[int, int]],
    surface: SurfaceErrors | None = None,
) -> dict[int, ObjectErrors]:
    """Add what BOP's scores need to the errors that `evaluation.evaluate` has measured.

    MSSD is measured however far estimate and truth are apart. The toolkit calls it infinite from
    one diameter between their origins on, which is beyond all thresholds for an origin inside the
    object. So it is with VSD where the two do not overlap in the image.

    Args:
        errors: object id -> errors, of `estimates` and `present.truth`.
        estimates: what a method says.
        present: what is in the images.
        models: object id -> model; nothing is added to objects without one.
        images: (scene id, image id) of the images that were evaluated.
        surface: what measures VSD; None if there are no depth images.

    Returns:
        object id -> errors, in the same order.

    Raises:
        ValueError: for what is wrong with one object, whose id it names.
    """
    images = set(images)
    estimates = estimates[in_images(estimates, images)]
    surest = surest_of_images(estimates)
    tables, parts, pairs = {}, {}, {}
    for i in (i for i in errors if i in models):
        mine = estimates.object_id == i
        tables[i], parts[i] = estimates[mine], present.of_object(i, images)
        pairs[i] = _pair(tables[i], parts[i], surest[mine])
    surfaces = {} if surface is None else _surfaces(tables, parts, pairs, surface)
    result = dict(errors)
    for i in parts:
        try:
            with model_errors.threads_for_searches():
                result[i] = _add(
                    errors[i], tables[i], parts[i], pairs[i], models[i], surfaces.get(i)
                )
        except ValueError as error:
            raise ValueError(f"object {i}: {error}") from error
    return result


def _pair(estimates: PoseTable, present: Present, surest: np.ndarray) -> _Pairs:
    """The pairs of one object; detection looks at the `surest` (N,) of its estimates."""
    truth, others = present.truth, present.others
    poses = len(truth) + len(others)
    matched = match(estimates, truth)
    found = np.flatnonzero(matched >= 0)
    blocks = list(groups(estimates, truth, present.counts))
    several = any(len(one) > 1 or len(other) > 1 for one, other in blocks)
    there: dict[Key, list[int]] = {}
    for table, first in ((truth, 0), (others, len(truth))):
        for key, rows in rows_by_key(table).items():
            there.setdefault(key, []).extend(first + row for row in rows)
    of_image = rows_by_key(estimates)
    detected = []
    for key, rows in sorted(there.items()):  # in order of the images, see `detection_precision`
        one = np.array([row for row in of_image.get(key, []) if surest[row]], int)
        detected.append((one, np.array(rows)))
    return _Pairs(
        poses,
        matched[found] * poses + found,
        [one[:, None] * poses + other for one, other in blocks] if several else [],
        detected,
    )


def _surfaces(
    tables: Mapping[int, PoseTable],
    parts: Mapping[int, Present],
    pairs: Mapping[int, _Pairs],
    surface: SurfaceErrors,
) -> dict[int, np.ndarray]:
    """Object id -> VSD of its pairs of localisation; asked for at once, to read an image once."""
    ids = [i for i in parts if i in surface.object_ids]
    if not ids:
        return {}
    rows = [pairs[i].rows(pairs[i].local()) for i in ids]
    estimates = [tables[i][one] for i, (one, _) in zip(ids, rows, strict=True)]
    truth = [parts[i].truth[other] for i, (_, other) in zip(ids, rows, strict=True)]
    values = surface(reduce(_joined, estimates), reduce(_joined, truth))
    ends = np.cumsum([len(one) for one, _ in rows])
    return dict(zip(ids, np.split(values, ends[:-1]), strict=True))


def _add(
    errors: ObjectErrors,
    estimates: PoseTable,
    present: Present,
    pairs: _Pairs,
    model: ObjectModel,
    surface: np.ndarray | None,
) -> ObjectErrors:
    """One object's errors with what was missing."""
    poses, every = present.poses, pairs.every()
    seen = None if present.K is None else _in_front(poses, model)
    measured: dict[str, Measured] = {}
    for name in ("mssd",) if seen is None else ("mssd", "mspd"):
        values = np.full(len(every), np.nan)
        for some, known in _known(errors, name, estimates, present.truth, pairs, seen):
            where = np.searchsorted(every, some)
            there = every[np.minimum(where, len(every) - 1)] == some
            values[where[there]] = known[there]
        if name == "mspd":
            values[~seen[pairs.rows(every)[1]]] = np.inf
        new = np.isnan(values)
        one, other = pairs.rows(every[new])
        arguments = (estimates.R[one], estimates.t[one], poses.R[other], poses.t[other])
        if name == "mspd":
            arguments = (present.K[other], *arguments)
        measure = model_errors.mspd if name == "mspd" else model_errors.mssd
        values[new] = measure(*arguments, model.points, model.symmetries)
        measured[name] = every, values
    detections = [
        Detections(
            estimates.score[rows[0]],
            present.counted[rows[1]],
            {name: _at(x, pairs.beside(*rows)) for name, x in measured.items()},
        )
        for rows in pairs.detected
    ]
    if surface is not None:
        measured["vsd"] = pairs.local(), surface
    of_images = {}
    if pairs.localised:
        for name, x in measured.items():
            blocks = [_at(x, block) for block in pairs.localised]
            of_images[name] = [np.moveaxis(y, 2, 0) if y.ndim == 3 else y for y in blocks]
    found = dict(errors.errors)
    if surface is not None:
        found["vsd"] = np.full((len(errors.found), surface.shape[1]), np.inf)
        found["vsd"][errors.found] = _at(measured["vsd"], pairs.matched)
    return replace(errors, errors=found, pairs=of_images, detections=detections)


def _known(
    errors: ObjectErrors,
    name: str,
    estimates: PoseTable,
    truth: PoseTable,
    pairs: _Pairs,
    seen: np.ndarray | None,
) -> Iterator[Measured]:
    """Pairs whose errors were measured before, and these."""
    yield pairs.matched, errors.errors[name][errors.found]
    if name in errors.pairs:
        blocks = groups(estimates, truth)
        for (one, other), known in zip(blocks, errors.pairs[name], strict=True):
            other = other[seen[other]] if name == "mspd" else other
            yield pairs.beside(one, other).ravel(), known.ravel()


def _at(measured: Measured, wanted: np.ndarray) -> np.ndarray:
    pairs, values = measured
    return values[np.searchsorted(pairs, wanted)]
