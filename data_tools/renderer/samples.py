"""Where to look: one point of most pixels, several where one is not enough (anti-aliasing)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data_tools.renderer.visibility import Scene, Visibility

__all__ = ["Samples", "all_in_pixels", "contrasting", "one_per_pixel", "refined"]

STEP = 0.05  # share by which the depths within a pixel may differ
CONTRAST = 0.12  # (light - dark) / (light + dark) of neighbours above which both are refined
UNSEEN = 0.03  # added to light + dark, since nobody sees the edges of the dark


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Points of an image that see an object.

    Attributes:
        x, y: (S,) float64 where in the image, in pixels.
        instance: (S,) index of the object.
        face: (S,) index of its prepared face.
        inverse_depth: (S,) 1 / z.
    """

    x: np.ndarray
    y: np.ndarray
    instance: np.ndarray
    face: np.ndarray
    inverse_depth: np.ndarray

    def __len__(self) -> int:
        return len(self.x)


def refined(scene: Scene, fineness: int) -> Scene:
    """The same scene in an image with `fineness` times as many pixels along each side."""
    shift = (fineness - 1) / 2
    scale = np.array([[fineness, 0, shift], [0, fineness, shift], [0, 0, 1]])
    width, height = scene.size
    return replace(scene, K=scale @ scene.K, size=(fineness * width, fineness * height))


def one_per_pixel(fine: Visibility, fineness: int) -> tuple[np.ndarray, Samples]:
    """The centres of the pixels in which a refined image sees one surface only.

    Args:
        fine: what the refined image sees.
        fineness: how many of its pixels lie along the side of one pixel.

    Returns:
        (H, W) bool, those pixels; and their samples, in the order of `np.nonzero`.
    """
    middle = fineness // 2
    instance = fine.instance[middle::fineness, middle::fineness]
    nearest = farthest = fine.inverse_depth[middle::fineness, middle::fineness]
    total = np.zeros_like(nearest)
    whole = instance >= 0
    for row in range(fineness):
        for column in range(fineness):
            part = np.s_[row::fineness, column::fineness]
            whole &= fine.instance[part] == instance
            inverse_depth = fine.inverse_depth[part]
            nearest = np.maximum(nearest, inverse_depth)
            farthest = np.minimum(farthest, inverse_depth)
            total += inverse_depth
    whole &= nearest - farthest <= STEP * nearest
    y, x = np.nonzero(whole)
    at = y * fineness + middle, x * fineness + middle
    # On a plane 1 / z is affine in the pixel: its mean is the one of the centre.
    mean = total[whole] / fineness**2
    samples = Samples(x.astype(float), y.astype(float), instance[whole], fine.face[at], mean)
    return whole, samples


def all_in_pixels(
    fine: Visibility, fineness: int, wanted: np.ndarray
) -> tuple[np.ndarray, Samples]:
    """All samples of the wanted pixels that see an object.

    Args:
        fine: what the refined image sees.
        fineness: how many of its pixels lie along the side of one pixel.
        wanted: (H, W) bool.

    Returns:
        (S,) the pixel of each sample, counted through the image, and the samples.
    """
    every = np.arange(fineness)
    y, x = np.nonzero(wanted)
    row = (y[:, None, None] * fineness + every[:, None]).repeat(fineness, axis=2).ravel()
    column = (x[:, None, None] * fineness + every).repeat(fineness, axis=1).ravel()
    pixel = np.repeat(np.flatnonzero(wanted), fineness**2)
    hit = fine.instance[row, column] >= 0
    row, column = row[hit], column[hit]
    samples = Samples(
        (column + 0.5) / fineness - 0.5,
        (row + 0.5) / fineness - 0.5,
        fine.instance[row, column],
        fine.face[row, column],
        fine.inverse_depth[row, column],
    )
    return pixel[hit], samples


def contrasting(picture: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(H, W) bool, pixels that differ from one of their four neighbours.

    Args:
        picture: (H, W, C).
        whole: (H, W) bool, the pixels that are compared.
    """
    channels = np.moveaxis(picture, 2, 0)
    brightness = sum(channels[1:], channels[0]) / len(channels)  # faster than the mean
    result = np.zeros(whole.shape, bool)
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        a, b = brightness[one], brightness[other]
        differ = np.abs(a - b) > CONTRAST * (a + b + UNSEEN)
        differ &= whole[one] & whole[other]
        result[one] |= differ
        result[other] |= differ
    return result
