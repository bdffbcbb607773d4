"""How well a drawn object fits what is given of it: masks, depth, boxes."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from data_tools.checking.corrections import Correction
from data_tools.checking.drawing import Placement, draw, hull_mask, hull_of
from data_tools.checking.sample import LEAST_PIXELS, Instance

__all__ = [
    "DepthFit",
    "agreement",
    "box_iou",
    "depth_fit",
    "mask_iou",
    "quick_agreement",
]

DEPTH_TOLERANCE = 0.03  # of the measured depth: beyond sensors' noise, within an object's thickness


class DepthFit(NamedTuple):
    """Measured depth against that of the drawn model.

    Attributes:
        ratio: median of measured over drawn.
        offset: median of measured minus drawn, metres.
        share: of the compared pixels, those that differ by less than 3 %.
        ray_share: the same if the image holds the lengths of rays instead of z.
        ray: median length of the rays of these pixels, for z of 1.
    """

    ratio: float
    offset: float
    share: float
    ray_share: float
    ray: float


def mask_iou(drawn: np.ndarray, instance: Instance) -> float:
    """Intersection over union of a silhouette (H, W) with the given mask.

    Pixels in which another object is seen are left out where only the mask of what is seen is
    known: there this object may be hidden.
    """
    return _iou(drawn, instance.mask, instance.others)


def quick_agreement(instance: Instance, correction: Correction) -> float:
    """`mask_iou` of the convex hull of the silhouette, in a small image: for many candidates."""
    place = correction.place(instance)
    hull = None if place is None else hull_of(instance.shape, place)
    if hull is None:
        return 0.0
    drawn = hull_mask(hull, instance.size, instance.step)
    targets = [instance] if correction.targets is None else correction.targets(instance)
    return max((_iou(drawn, one.small, one.small_others) for one in targets), default=0.0)


def depth_fit(
    instance: Instance, drawn_depth: np.ndarray | None, measured: np.ndarray | None
) -> DepthFit | None:
    """Compare depth where the object is drawn, and seen where that is known.

    Args:
        instance: what is drawn.
        drawn_depth: (H, W) metres, 0 outside.
        measured: (H, W) metres, 0 for none.

    Returns:
        None where too few pixels can be compared.
    """
    if drawn_depth is None or measured is None or measured.shape != drawn_depth.shape:
        return None
    compared = (drawn_depth > 0) & (measured > 0)
    if instance.visible is not None:
        compared &= instance.visible
    y, x = np.nonzero(compared)
    if len(y) < LEAST_PIXELS:
        return None
    z, seen = drawn_depth[compared], measured[compared].astype(np.float64)
    rays = np.linalg.inv(instance.K) @ np.stack([x, y, np.ones(len(x))])
    lengths = np.linalg.norm(rays, axis=0)
    return DepthFit(
        ratio=float(np.median(seen / z)),
        offset=float(np.median(seen - z)),
        share=_share(seen, z),
        ray_share=_share(seen / lengths, z),
        ray=float(np.median(lengths)),
    )


def box_iou(instance: Instance, drawn: np.ndarray) -> float:
    """Intersection over union of the given box with that around a silhouette (H, W)."""
    y, x = (np.flatnonzero(drawn.any(axis)) for axis in (1, 0))
    if not len(x):
        return 0.0
    mine = np.array([x[0], y[0], x[-1] + 1, y[-1] + 1], float)
    left, top, width, height = instance.item.box
    given = np.array([left, top, left + width, top + height])
    inner = np.minimum(mine[2:], given[2:]) - np.maximum(mine[:2], given[:2])
    overlap = inner.clip(0).prod()
    return float(overlap / max(np.prod(mine[2:] - mine[:2]) + width * height - overlap, 1e-9))


def agreement(kind: str, instance: Instance, correction: Correction) -> float:
    """From 0 to 1, how well the drawn model fits what is given of it.

    Args:
        kind: "masks", `mask_iou`; "depth", the share of drawn pixels with the measured depth,
            less where that goes on around them; or "boxes", `box_iou`.
        instance: with what is given.
        correction: says where its model is drawn, and with what it is compared.
    """
    place = correction.place(instance)
    if place is None or (kind != "masks" and not _in_view(instance, place)):
        return 0.0
    drawn, depth = draw(instance.shape, place, instance.size)
    if kind == "masks":
        targets = [instance] if correction.targets is None else correction.targets(instance)
        return max((mask_iou(drawn, one) for one in targets), default=0.0)
    if kind == "boxes":
        return box_iou(instance, drawn)
    measured = instance.depth / correction.depth
    fit = depth_fit(instance, depth, measured)
    if fit is None:
        return 0.0
    # A model drawn a tenth as large lies within the object and agrees all over: where it ends the
    # object has to end, at half of the border at least, as it may stand on something.
    return fit.share * min(1.0, 2 * _ends(depth, measured))


def _in_view(instance: Instance, place: Placement) -> bool:
    """Whether all of the object is in front, and enough of it in the image."""
    hull = hull_of(instance.shape, place)
    return np.count_nonzero(hull_mask(hull, instance.size)) >= LEAST_PIXELS


def _ends(drawn: np.ndarray, measured: np.ndarray) -> float:
    """Share of the pixels around a silhouette whose depth is not that of its border."""
    inside = (drawn > 0).astype(np.uint8)
    reach = max(2, round(0.05 * np.sqrt(inside.sum())))
    size = 2 * reach + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    grown = cv2.dilate(drawn.astype(np.float32), kernel)  # the depth of the border near by
    around = (grown > 0) & (drawn == 0) & (measured > 0)
    if not around.any():
        return 0.0
    return 1 - _share(measured[around], grown[around])


def _share(seen: np.ndarray, z: np.ndarray) -> float:
    return float((np.abs(seen - z) < DEPTH_TOLERANCE * seen).mean())


def _iou(drawn: np.ndarray, mask: np.ndarray, others: np.ndarray | None) -> float:
    if others is not None:
        drawn = drawn & ~others
    both = np.count_nonzero(drawn & mask)
    either = np.count_nonzero(drawn) + np.count_nonzero(mask) - both
    return both / max(either, 1)
