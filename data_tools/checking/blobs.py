"""Area, centre and spread of silhouettes, given and drawn: what sizes are fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from data_tools.checking.drawing import Placement, hull_of
from data_tools.checking.sample import Instance

__all__ = ["Blob", "drawn_blob", "given_blob", "whole_instances"]


class Blob:
    """Area, centre and spread of a silhouette, from the moments of a mask or a polygon."""

    def __init__(self, moments: dict[str, float]) -> None:
        self.area = moments["m00"]
        self.centre = np.array([moments["m10"], moments["m01"]]) / max(self.area, 1e-12)
        spread = np.array([moments["mu20"], moments["mu02"]]) / max(self.area, 1e-12)
        self.spread = np.sqrt(spread.clip(1e-12))


def given_blob(instance: Instance) -> Blob:
    """Of the hull of the given mask."""
    return Blob(instance.moments)


def drawn_blob(instance: Instance, place: Placement | None) -> Blob | None:
    """Of the hull of the drawn silhouette, with what is outside the image; None for none."""
    hull = None if place is None else hull_of(instance.shape, place)
    if hull is None or cv2.contourArea(hull) < 1e-6:
        return None
    return Blob(cv2.moments(hull))


def whole_instances(instances: Sequence[Instance]) -> list[Instance]:
    """Those to fit to: seen whole if there are some."""
    known = [i for i in instances if i.mask is not None]
    whole = [i for i in known if i.whole]
    return whole if len(whole) >= min(4, len(known)) else known
