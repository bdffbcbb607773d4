"""Corrections with sizes that are fitted: units, scales, shifts, other resolutions.

Fitted are areas, widths and centres of silhouettes, by medians over the objects that are seen
whole: a mask that is wrong here and there does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import cv2
import numpy as np

from data_tools.checking.corrections import Correction, Place
from data_tools.checking.drawing import Placement, hull_of
from data_tools.checking.sample import Instance

__all__ = [
    "camera_fits",
    "half_words",
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


class _Blob:
    """Area, centre and spread of a silhouette, from the moments of a mask or a polygon."""

    def __init__(self, moments: dict[str, float]) -> None:
        self.area = moments["m00"]
        self.centre = np.array([moments["m10"], moments["m01"]]) / max(self.area, 1e-12)
        spread = np.array([moments["mu20"], moments["mu02"]]) / max(self.area, 1e-12)
        self.spread = np.sqrt(spread.clip(1e-12))


def given_blob(instance: Instance) -> _Blob:
    """Of the hull of the given mask."""
    return _Blob(instance.moments)


def drawn_blob(instance: Instance, place: Placement | None) -> _Blob | None:
    """Of the hull of the drawn silhouette, with what is outside the image; None for none."""
    hull = None if place is None else hull_of(instance.shape, place)
    if hull is None or cv2.contourArea(hull) < 1e-6:
        return None
    return _Blob(cv2.moments(hull))


def scale_fits(instances: Sequence[Instance], base: Correction) -> list[Correction]:
    """Models enlarged by the factor that fits, and by the ratio of units that is nearest to it.

    For silhouettes it is the same whether models grow or translations shrink; `depth` tells them
    apart.

    Args:
        instances: with masks, to fit to.
        base: what is done besides.
    """
    placed = [(i, base.place(i)) for i in _whole(instances)]
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


def camera_fits(instances: Sequence[Instance]) -> list[Correction]:
    """Images that were shifted, resized, or seen with another focal length than K says."""
    pairs = []
    for instance in _whole(instances):
        drawn = drawn_blob(instance, instance.place)
        if drawn is not None:
            pairs.append((given_blob(instance), drawn))
    if not pairs:
        return []
    ratio = np.median([given.spread / drawn.spread for given, drawn in pairs], 0)  # of x and y
    same = float(np.sqrt(ratio.prod()))
    shift = np.median([given.centre - drawn.centre for given, drawn in pairs], 0)
    found = [_shift(shift)]
    for scales, cost in ((np.array([same, same]), 1), (ratio, 2)):
        found.append(_focal(scales, cost))
        found.append(_resized(scales, cost))
        nice = np.array([_simple(scale) for scale in scales])
        found.append(_resized(nice, cost))
        rest = np.median([g.centre - (nice * (d.centre + 0.5) - 0.5) for g, d in pairs], 0)
        if len(pairs) >= 4:
            found.append(_cropped(nice, rest, cost + 2))
    return found


def usual_sizes() -> list[Correction]:
    """Camera matrices of images that are half, twice, three quarters, ... as large."""
    ratios = sorted({a / b for a in range(1, 5) for b in range(1, 5)} - {1.0})
    return [_resized(np.array([ratio, ratio]), 0) for ratio in ratios]


def origin_fit(instances: Sequence[Instance]) -> list[Correction]:
    """Models whose origin is elsewhere, and poses of a camera that stands elsewhere."""
    rows = []
    for instance in _whole(instances):
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


def _whole(instances: Sequence[Instance]) -> list[Instance]:
    """Those to fit to: seen whole if there are some."""
    known = [i for i in instances if i.mask is not None]
    whole = [i for i in known if i.whole]
    return whole if len(whole) >= min(4, len(known)) else known


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


def _shift(shift: np.ndarray) -> Correction:
    x, y = shift
    half = (np.abs(np.abs(shift) - 0.5) < 0.2).all()
    return Correction(
        "half a pixel" if half else "shifted images",
        half_words(shift)
        if half
        else f"the images are shifted by ({x:+.1f}, {y:+.1f}) pixels against the camera matrix: "
        "cut out without changing cx and cy",
        f"cx and cy moved by ({x:+.1f}, {y:+.1f})",
        _mapped(np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])),
        cost=2,
    )


def half_words(shift: np.ndarray) -> str:
    """What is wrong with a camera matrix where masks lie half a pixel off, in words."""
    size = "large" if shift.sum() < 0 else "small"
    words = f"cx and cy are half a pixel too {size}"
    if size == "large":
        words += ": they count the centre of the first pixel as (0.5, 0.5), here it is (0, 0)"
    return words


def _focal(scales: np.ndarray, cost: float) -> Correction:
    x, y = scales
    text = f"{x:.3g}" if x == y else f"{x:.3g} and {y:.3g}"

    def place(instance: Instance) -> Placement:
        K = np.diag([x, y, 1]) @ instance.K
        K[:2, 2] = instance.K[:2, 2]
        return Placement(K, instance.item.R, instance.item.t)

    return Correction(
        "wrong focal length",
        "the focal lengths do not belong to these images",
        f"fx and fy times {text}",
        place,
        cost=cost,
        vary=lambda f: _focal(scales * f, cost),
    )


def _resized(scales: np.ndarray, cost: float) -> Correction:
    x, y = scales
    text = f"{x:.4g}" if x == y else f"{x:.4g} (x) and {y:.4g} (y)"
    return Correction(
        "wrong image size",
        "the camera matrix belongs to images of another size than these",
        f"the camera matrix resized by {text}",
        _mapped(np.array([[x, 0, (x - 1) / 2], [0, y, (y - 1) / 2], [0, 0, 1]])),
        cost=cost,
        vary=(lambda f: _resized(scales * f, cost)) if cost else None,
    )


def _cropped(scales: np.ndarray, rest: np.ndarray, cost: float) -> Correction:
    x, y = scales
    to = np.array([[x, 0, (x - 1) / 2 + rest[0]], [0, y, (y - 1) / 2 + rest[1]], [0, 0, 1]])
    return Correction(
        "cut and resized images",
        "the images were cut and resized without changing the camera matrix",
        f"the camera matrix resized by {x:.4g} and {y:.4g}, then cx and cy moved by "
        f"({rest[0]:+.1f}, {rest[1]:+.1f})",
        _mapped(to),
        cost=cost,
    )


def _mapped(pixels: np.ndarray) -> Place:
    return lambda i: Placement(pixels @ i.K, i.item.R, i.item.t)


def _simple(scale: float) -> float:
    """The fraction of small numbers that a scale is, if it is near to one."""
    near = Fraction(scale).limit_denominator(6) if 0.05 < scale < 20 else None
    return float(near) if near and abs(np.log(float(near) / scale)) < 0.03 else float(scale)


def _robust(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Least squares without the worst quarter of the rows of a first solution."""
    solution = np.linalg.lstsq(matrix, values, rcond=None)[0]
    left = np.abs(matrix @ solution - values)
    kept = left <= np.quantile(left, 0.75)
    return np.linalg.lstsq(matrix[kept], values[kept], rcond=None)[0]


def _metres(vector: np.ndarray) -> str:
    return "(" + ", ".join(f"{1000 * x:+.1f}" for x in vector) + ") mm"
