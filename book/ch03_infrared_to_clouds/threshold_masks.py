"""Masks by thresholds, compared with what is truly head and glasses."""

from __future__ import annotations

import cv2
import numpy as np

from book.ch03_infrared_to_clouds.cloud_training import CROWD, TEST, stack
from book.tools.keys import Key
from data_tools.batches.decoding import NONE
from posecore.methods.infrared.masks import cuboid_mask, li_threshold
from posecore.methods.infrared.triples import first_rows
from posecore.scale import choose

__all__ = ["measure", "otsu_threshold", "overlap_of"]

LEVELS = range(2, 120, 2)  # fixed thresholds, of which the training's best is taken


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


def _best_level(seed: int, count: int) -> int:
    scores = np.zeros(len(LEVELS))
    for image, region, truth in _some(CROWD, seed, count):
        scores += [overlap_of(region & (image > level), truth) for level in LEVELS]
    return LEVELS[int(scores.argmax())]


def _some(split: str, seed: int, count: int):  # noqa: ANN202
    """(image, cuboid, truth) of some views, others for each seed."""
    data = stack(split)
    rows = first_rows(data)
    order = np.random.default_rng(seed).permutation(len(data))[:count]
    for view in map(int, order):
        row = rows[view]
        pose = data.K[view].numpy(), data.R[row].numpy(), data.t[row].numpy()
        image = data.image("ir", view)
        yield image, cuboid_mask(*pose, image.shape[::-1]), data.image("instance", view) != NONE
