"""Corrections with sizes that are fitted: units and scales, and where origins are.

Fitted are areas, widths and centres of silhouettes, by medians over the objects that are seen
whole: a mask that is wrong here and there does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from data_tools.checking.blobs import drawn_blob, given_blob, whole_instances
from data_tools.checking.corrections import Correction, Place
from data_tools.checking.drawing import Placement
from data_tools.checking.sample import Instance

__all__ = [
    "origin_fit",
    "rescaled",
    "scale_fits",
    "snapped",
    "with_owner",
]

UNITS = (10.0, 100.0, 1000.0, 10_000.0, 1e6, 25.4)
"""Ratios of units that are mistaken for each other."""
NEAR_UNIT = 0.04  # relative: a fitted size that is so near to a ratio of units is taken for it
LIKE_UNIT = 0.3  # the same, where it is tried beside the fitted size
LEAST_SCALE, MOST_SCALE = 1e-7, 1e7


def scale_fits(instances: Sequence[Instance], base: Correction) -> list[Correction]:
    """Models enlarged by the factor that fits, and by the ratio of units that is nearest to it.

    For silhouettes it is the same whether models grow or translations shrink; `depth` tells them
    apart.

    Args:
        instances: with masks, to fit to.
        base: what is done besides.
    """
    placed = [(i, base.place(i)) for i in whole_instances(instances)]
    placed = [(i, p) for i, p in placed if p is not None and p.t[2] > 0]
    if not placed:
        return []
    factor = float(np.median([_first_scale(i, p) for i, p in placed]))
    for _ in range(3):
        ratios = []
        for instance, place in placed:
            drawn = drawn_blob(instance, _grown(place, factor))
            if drawn is not None:
                ratios.append(np.sqrt(given_blob(instance).area / drawn.area))
        if ratios:
            factor = float(np.clip(factor * np.median(ratios), LEAST_SCALE, MOST_SCALE))
    if snapped(factor) is not None:
        return [rescaled(base, factor)]
    units = [r for unit in UNITS for r in (unit, 1 / unit) if abs(np.log(factor / r)) < LIKE_UNIT]
    return [rescaled(base, one) for one in (factor, *units)]


def rescaled(base: Correction, factor: float, owner: str | None = None) -> Correction:
    """Models enlarged by `factor`; by the ratio of two units, if it is near to one.

    Args:
        base: what is done besides.
        factor: of the models' lengths.
        owner: "models", or "translations" to divide these by it; None leaves it open which.
    """
    unit = snapped(factor)
    size = factor if unit is None else unit
    more = base.key != "as given"
    return replace(
        base,
        key=f"{base.key} and scale" if more else "scale",
        remedy=f"{base.remedy}, " * more + f"models times {size:.4g}",
        place=_scaled_place(base.place, size, owner),
        cost=base.cost + (unit is None) + more,
        factor=size,
        owner=owner,
        vary=None if unit else lambda f: rescaled(base, factor * f, owner),
    )


def with_owner(correction: Correction, owner: str | None) -> Correction:
    """The same for silhouettes, where it is known whether models or translations are wrong."""
    if owner != "translations" or correction.owner == owner:
        return replace(correction, owner=owner)

    def place(instance: Instance) -> Placement | None:
        grown = correction.place(instance)
        if grown is None:
            return None
        factor = correction.factor
        return Placement(grown.K, grown.R, grown.t / factor, grown.scale / factor)

    return replace(correction, place=place, owner=owner)


def snapped(factor: float) -> float | None:
    """The ratio of two units that a factor is; None if it is near to none."""
    for unit in UNITS:
        for ratio in (unit, 1 / unit):
            if abs(np.log(factor / ratio)) < NEAR_UNIT:
                return ratio
    return None


def origin_fit(instances: Sequence[Instance]) -> list[Correction]:
    """Models whose origin is elsewhere, and poses of a camera that stands elsewhere."""
    rows = []
    for instance in whole_instances(instances):
        drawn, place = drawn_blob(instance, instance.place), instance.place
        if drawn is None:
            continue
        # A point moved by d in the camera's frame moves by f (d_xy - d_z xy / z) / z in the image.
        centre = np.linalg.inv(place.K) @ [*drawn.centre, 1]
        jacobian = place.K[:2, :2] @ np.column_stack([np.eye(2), -centre[:2]]) / place.t[2]
        off = given_blob(instance).centre - drawn.centre
        rows.append((jacobian, place.R, off))
    if len(rows) < 4:
        return []
    off = np.concatenate([o for _, _, o in rows])
    in_camera = np.concatenate([J for J, _, _ in rows])
    in_model = np.concatenate([J @ R for J, R, _ in rows])
    moved, origin = _robust(in_camera, off), _robust(in_model, off)
    return [
        Correction(
            "moved camera",
            f"the poses are those of a camera beside this one: all are off by {_metres(moved)} in "
            "the camera's frame",
            f"translations moved by {_metres(moved)}",
            lambda i: Placement(i.K, i.item.R, i.item.t + moved),
            cost=3,
        ),
        Correction(
            "moved origin",
            "the models' origin is not that of the poses: it is off by "
            f"{_metres(origin)} in the model's frame",
            f"models moved by {_metres(origin)}",
            lambda i: Placement(i.K, i.item.R, i.item.t + i.item.R @ origin),
            cost=3,
        ),
    ]


def _first_scale(instance: Instance, place: Placement) -> float:
    """By the area of the model seen from far away, whatever its distance is."""
    flat = (instance.shape.points @ place.R.T)[:, :2] / instance.shape.diameter
    area = cv2.contourArea(cv2.convexHull(flat.astype(np.float32)))
    focal = np.sqrt(abs(np.linalg.det(place.K[:2, :2])))
    seen = np.sqrt(given_blob(instance).area) / focal * place.t[2]
    return seen / (np.sqrt(max(area, 1e-6)) * instance.shape.diameter)


def _grown(place: Placement, factor: float) -> Placement:
    return Placement(place.K, place.R, place.t, place.scale * factor)


def _scaled_place(base: Place, factor: float, owner: str | None) -> Place:
    def place(instance: Instance) -> Placement | None:
        before = base(instance)
        if before is not None and owner == "translations":
            return Placement(before.K, before.R, before.t / factor, before.scale)
        return None if before is None else _grown(before, factor)

    return place


def _robust(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Least squares without the worst quarter of the rows of a first solution."""
    solution = np.linalg.lstsq(matrix, values, rcond=None)[0]
    left = np.abs(matrix @ solution - values)
    kept = left <= np.quantile(left, 0.75)
    return np.linalg.lstsq(matrix[kept], values[kept], rcond=None)[0]


def _metres(vector: np.ndarray) -> str:
    return "(" + ", ".join(f"{1000 * x:+.1f}" for x in vector) + ") mm"
