"""Cameras with sizes that are fitted: shifts, other resolutions, other focal lengths."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from data_tools.checking.blobs import drawn_blob, given_blob, whole_instances
from data_tools.checking.corrections import Correction, Place
from data_tools.checking.drawing import Placement
from data_tools.checking.sample import Instance

__all__ = ["camera_fits", "half_words", "usual_sizes"]


def camera_fits(instances: Sequence[Instance]) -> list[Correction]:
    """Images that were shifted, resized, or seen with another focal length than K says."""
    pairs = []
    for instance in whole_instances(instances):
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


def half_words(shift: np.ndarray) -> str:
    """What is wrong with a camera matrix where masks lie half a pixel off, in words."""
    size = "large" if shift.sum() < 0 else "small"
    words = f"cx and cy are half a pixel too {size}"
    if size == "large":
        words += ": they count the centre of the first pixel as (0.5, 0.5), here it is (0, 0)"
    return words


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
