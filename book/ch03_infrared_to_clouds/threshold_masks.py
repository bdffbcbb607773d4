"""Masks by thresholds, compared with what is truly head and glasses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
import torch

from book.ch03_infrared_to_clouds.cloud_training import CROWD, TEST, stack
from book.tools.keys import Key
from data_tools import batches
from data_tools.batches import Stack
from data_tools.batches.decoding import NONE
from data_tools.worlds.redrawn import Redrawn
from posecore.methods.infrared.masks import cuboid_mask, li_threshold
from posecore.methods.infrared.triples import first_rows
from posecore.scale import choose, scale

__all__ = ["LOST", "in_cuboid", "measure", "measure_gains", "otsu_threshold", "overlap_of"]

Seen = tuple[np.ndarray, np.ndarray, np.ndarray]
LEVELS = range(2, 120, 2)  # fixed thresholds, of which the training's best is taken
THIRDS = ("nearest third", "middle third", "farthest third")
"""Of views, by the distance from the camera to the glasses."""
LOST = {"farthest third": "nearest third", "gain 0.5": "gain 1", "gain 2": "gain 1"}
"""Groups of images, and those that they are compared with."""


def in_cuboid(name: str, metric: str, group: str) -> Key:
    """What a threshold is measured by in a group of images."""
    return Key(name, "in the cuboid", metric, group)


def otsu_threshold(image: np.ndarray) -> float:
    """Otsu's threshold of an (H, W) uint8 image: of the largest variance between both sides."""
    return cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]


def overlap_of(mask: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two (H, W) booleans; 1 if both are empty."""
    union = (mask | truth).sum()
    return float((mask & truth).sum() / union) if union else 1.0


def measure(seed: int) -> dict[Key, float]:
    """Mean overlap in % of masks of Li, Otsu and one threshold for all, with and without cuboid.

    Each seed looks at other images. The fixed threshold is the best of as many training images.
    """
    count = choose(tiny=12, book=400, paper=400)
    level = _best_level(seed, count)
    kinds = {"Li": li_threshold, "Otsu": otsu_threshold, "fixed": lambda _: level}
    values: dict[Key, list[float]] = {}
    for image, region, truth in _some(TEST, seed, count):
        for place, inside in (("in the cuboid", region), ("whole image", np.ones_like(region))):
            seen = np.where(inside, image, 0)
            for name, threshold in kinds.items():
                mask = inside & (image > threshold(seen))
                values.setdefault(Key(name, place, "overlap"), []).append(overlap_of(mask, truth))
    return {key: 100 * float(np.mean(found)) for key, found in values.items()}


def measure_gains(seed: int) -> dict[Key, float]:
    """Mean overlap in % of masks in the cuboid by distance and by gain, and what is lost of it.

    The fixed threshold is the best of training images as they are, at gain 1. "overlap lost" is in
    percentage points: from the nearest third of the views to the farthest one, and from gain 1 to
    another gain, of the same instants. Each seed looks at other images.
    """
    count = choose(tiny=12, book=400, paper=400)
    level = _best_level(seed, count)
    kinds = {"Li": li_threshold, "Otsu": otsu_threshold, "fixed": lambda _: level}
    values: dict[Key, float] = {}
    for group, (data, views) in _groups(seed, count).items():
        found: dict[str, list[float]] = {name: [] for name in kinds}
        for image, region, truth in _views(data, views):
            seen = np.where(region, image, 0)
            for name, threshold in kinds.items():
                found[name].append(overlap_of(region & (image > threshold(seen)), truth))
        for name, overlaps in found.items():
            values[in_cuboid(name, "overlap", group)] = 100 * float(np.mean(overlaps))
    for name in kinds:
        for after, before in LOST.items():
            first, then = (in_cuboid(name, "overlap", group) for group in (before, after))
            values[in_cuboid(name, "overlap lost", after)] = values[first] - values[then]
    return values


def _groups(seed: int, count: int) -> dict[str, tuple[Stack, Iterable[int]]]:
    """Test views by name: thirds of `count` of them by distance, and some instants by gain."""
    recorded = stack(TEST)
    views = torch.from_numpy(_order(seed, len(recorded))[:count])
    far = recorded.t[first_rows(recorded)[views]].norm(dim=-1)
    thirds = views[far.argsort()].tensor_split(3)
    groups = {name: (recorded, third) for name, third in zip(THIRDS, thirds, strict=True)}
    instants = choose(tiny=2, book=100, paper=100)
    chosen = _order(seed, len(recorded.groups))[:instants].tolist()
    groups["gain 1"] = recorded, recorded.groups[chosen].flatten()
    for gain in (0.5, 2.0):
        drawn = Redrawn(chosen, split=TEST, scale=scale(), gain=gain)
        groups[f"gain {gain:g}"] = batches.load(drawn, progress=False), range(len(drawn))
    return groups


def _best_level(seed: int, count: int) -> int:
    scores = np.zeros(len(LEVELS))
    for image, region, truth in _some(CROWD, seed, count):
        scores += [overlap_of(region & (image > level), truth) for level in LEVELS]
    return LEVELS[int(scores.argmax())]


def _order(seed: int, count: int) -> np.ndarray:
    """0 to count - 1, in another order for each seed."""
    return np.random.default_rng(seed).permutation(count)


def _some(split: str, seed: int, count: int) -> Iterator[Seen]:
    """Some views of a split, others for each seed."""
    data = stack(split)
    return _views(data, _order(seed, len(data))[:count])


def _views(data: Stack, views: Iterable[int]) -> Iterator[Seen]:
    """Image (H, W) uint8, and its cuboid and truth (H, W) bool, of views."""
    rows = first_rows(data)
    for view in map(int, views):
        row = rows[view]
        pose = data.K[view].numpy(), data.R[row].numpy(), data.t[row].numpy()
        image = data.image("ir", view)
        yield image, cuboid_mask(*pose, image.shape[::-1]), data.image("instance", view) != NONE
