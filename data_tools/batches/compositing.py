"""Other backgrounds and occluders: from other images, random patterns and shapes.

All functions change one cut-out image in place. In `instance` a pixel has the object that is seen,
or NONE, or OUTSIDE where the image that it was cut from had no pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from data_tools.batches.decoding import NONE, OUTSIDE

__all__ = ["Layers", "add_occluder", "replace_background"]

PATTERN_PROBABILITY = 0.3  # of the new backgrounds are patterns, the others come from other images
CUTOUT_PROBABILITY = 0.5  # of the occluders are what another image shows, if that is allowed


@dataclass
class Layers:
    """One image: colours (H, W, C) uint8 by kind, depth (H, W) uint16 or None, instance uint8."""

    colours: dict[str, np.ndarray]
    depth: np.ndarray | None
    instance: np.ndarray

    def copy(self) -> Layers:
        """One that can be changed."""
        depth = None if self.depth is None else self.depth.copy()
        colours = {kind: image.copy() for kind, image in self.colours.items()}
        return Layers(colours, depth, self.instance.copy())


def replace_background(
    image: Layers, other: Layers | None, only_outside: bool, rng: np.random.Generator
) -> None:
    """Replace the background, which is every pixel of no object.

    What comes from another image keeps its relief, and its median depth becomes up to half more
    than that of the objects. Where the other image shows an object, there is a pattern.

    Args:
        image: is changed; nothing is OUTSIDE in it any more.
        other: an image to take from; None for a pattern everywhere.
        only_outside: leave what the image has for a background, and fill up the rest.
        rng: decides what.
    """
    free = image.instance == OUTSIDE if only_outside else image.instance >= OUTSIDE
    if not free.any():
        return
    theirs = np.zeros_like(free)
    if other is not None and rng.random() >= PATTERN_PROBABILITY:
        theirs = free & (other.instance == NONE)
    for kind, colours in image.colours.items():
        new = _pattern(colours, rng)
        if theirs.any():
            _paste(other.colours[kind], theirs, new)
        _paste(new, free, colours)
    if image.depth is not None:
        distance = _median(image.depth, image.instance < OUTSIDE) * rng.uniform(1.02, 1.5)
        new = _plane(free.shape, distance, 0.2, rng)
        if theirs.any():
            moved = _moved(other.depth, distance - _median(other.depth, theirs))
            _paste(moved, theirs, new)
        _paste(new, free, image.depth)
    image.instance[free] = NONE


def add_occluder(
    image: Layers,
    target: int,
    other: Layers | None,
    cut_out: int | None,
    keep: float,
    rng: np.random.Generator,
) -> bool:
    """Put something in front of an object, unless too little of an object would be left.

    Args:
        image: is changed.
        target: the object in `image.instance`.
        other: an image to take colours from; None for a pattern.
        cut_out: an object of the other image that may be put there as a whole; None for none.
        keep: share of each object's seen pixels that has to be left.
        rng: decides what, and where.

    Returns:
        Whether something was put there.
    """
    seen = image.instance == target
    if not seen.any():
        return False
    middle, extent = _frame(seen)
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.1)
    place = middle + far * extent / 2 * [np.cos(angle), np.sin(angle)]
    shape = None if cut_out is None else other.instance == cut_out
    if shape is not None and rng.random() < CUTOUT_PROBABILITY and shape.any():
        shift = np.round(place - _frame(shape)[0]).astype(int)
    else:
        shape, shift = _blob(seen.shape, place, rng.uniform(0.2, 0.5) * extent.max(), rng), (0, 0)
        cut_out = None
    covered = _shifted(shape, shift)
    before = np.bincount(image.instance.ravel(), minlength=256)[:OUTSIDE]
    after = np.bincount(image.instance[~covered], minlength=256)[:OUTSIDE]
    if (after < keep * before).any() or not covered.any():
        return False
    textured = other is not None and rng.random() < 0.5
    nearest = _nearest(image.depth, covered | seen) * rng.uniform(0.7, 0.97)
    for kind, colours in image.colours.items():
        if cut_out is not None:
            new = _shifted(other.colours[kind], shift)
        else:
            new = _pattern(colours, rng)
            if textured:
                _paste(other.colours[kind], other.instance == NONE, new)
        _paste(new, covered, colours)
    if image.depth is not None:
        if cut_out is not None:
            theirs = _shifted(other.depth, shift)
            high = theirs[covered].max(initial=0)
            new = _moved(theirs, nearest - high)
        else:
            new = _plane(seen.shape, nearest, 0.02, rng)
        _paste(new, covered, image.depth)
    image.instance[covered] = NONE
    return True


def _pattern(like: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Smooth noise, coarse and fine, about a colour near the mean of an image, and of its shape."""
    height, width, channels = like.shape
    image = rng.normal(0, 30) + rng.normal(0, 10, channels) + cv2.mean(like)[:channels]
    for cells in (rng.integers(2, 6), rng.integers(6, 24)):
        grid = rng.uniform(-35, 35, (cells, cells, 1)) + rng.uniform(
            -8, 8, (cells, cells, channels)
        )
        grid = cv2.resize(grid, (32, 32), interpolation=cv2.INTER_CUBIC)
        image = image + grid.reshape(32, 32, channels)
    image = np.clip(image, 0, 255).astype(np.uint8)
    return cv2.resize(image, (width, height)).reshape(like.shape)


def _paste(source: np.ndarray, where: np.ndarray, target: np.ndarray) -> None:
    """`target[where] = source[where]`, many times faster."""
    cv2.copyTo(source, where.view(np.uint8), target)


def _blob(
    shape: tuple[int, int], place: np.ndarray, radius: float, rng: np.random.Generator
) -> np.ndarray:
    """(H, W) bool: a polygon of three to twelve corners, more or less round, turned anyhow."""
    corners = rng.integers(3, 13)
    angle = 2 * np.pi * np.arange(corners) / corners
    reach = radius * rng.uniform(0.6, 1, corners) * np.where(corners > 8, 1, 1.2)
    ring = np.stack([reach * np.cos(angle), reach * rng.uniform(0.5, 1) * np.sin(angle)], 1)
    slant = rng.uniform(0, np.pi)
    c, s = np.cos(slant), np.sin(slant)
    ring = ring @ np.array([[c, s], [-s, c]]) + place
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.round(ring).astype(np.int32)], 1)
    return mask.astype(bool)


def _frame(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and extent, (x, y) each, of the pixels that are true."""
    x, y = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
    return (low + high) / 2, high - low + 1


def _shifted(image: np.ndarray, shift: np.ndarray | tuple[int, int]) -> np.ndarray:
    """The image moved by whole pixels (x, y), 0 where nothing comes from."""
    (dx, dy), (height, width) = shift, image.shape[:2]
    if dx == dy == 0:
        return image
    result = np.zeros_like(image)
    if abs(dx) < width and abs(dy) < height:
        to = np.s_[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
        of = np.s_[max(-dy, 0) : height - max(dy, 0), max(-dx, 0) : width - max(dx, 0)]
        result[to] = image[of]
    return result


def _plane(
    shape: tuple[int, int], distance: float, slope: float, rng: np.random.Generator
) -> np.ndarray:
    """Depths of a tilted plane, from (1 - slope) to (1 + slope) times the distance."""
    x, y = np.linspace(-1, 1, shape[1]), np.linspace(-1, 1, shape[0])[:, None]
    tilt = rng.uniform(-slope / 2, slope / 2, 2)
    return np.clip(distance * (1 + tilt[0] * x + tilt[1] * y), 0, 65535).astype(np.uint16)


def _moved(depth: np.ndarray, distance: float) -> np.ndarray:
    """Depths farther away; what has none, or would come too near or too far, has none then."""
    moved = depth + np.float32(distance)
    return np.where((depth > 0) & (moved >= 1) & (moved <= 65535), moved, 0).astype(np.uint16)


def _median(depth: np.ndarray | None, where: np.ndarray) -> float:
    """The median of the depths that are known there; 10 000 steps if none is."""
    values = () if depth is None else depth[where]
    values = values[values > 0] if len(values) else values
    return float(np.median(values)) if len(values) else 1e4


def _nearest(depth: np.ndarray | None, where: np.ndarray) -> float:
    values = () if depth is None else depth[where]
    values = values[values > 0] if len(values) else values
    return float(values.min()) if len(values) else 1e4
