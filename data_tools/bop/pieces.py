"""Pieces of a split without its views: one depth image alone, and how much is visible of each pose.

A view reads all images and masks of its scene's folders; who measures poses needs few of them.
"""

from __future__ import annotations

import numpy as np

from data_tools.bop.dataset import BopDataset, _read_scene_depth

__all__ = ["has_depth", "read_depth_image", "visible_fractions"]


def has_depth(dataset: BopDataset) -> bool:
    """Whether every scene of a split has depth images."""
    return all(files.images("depth") is not None for files in dataset._scenes.values())


def read_depth_image(dataset: BopDataset, scene_id: int, image_id: int) -> np.ndarray | None:
    """The depth image (H, W) of one image in metres, float32, 0 where there is none.

    Returns:
        None if its scene has no depth images.

    Raises:
        ValueError: if the split holds no such image, or it is damaged.
        FileNotFoundError: if its scene has depth images, but not this one.
    """
    camera, files = dataset.camera(scene_id, image_id), dataset._scenes[scene_id]
    if files.images("depth") is None:
        return None
    return _read_scene_depth(files, f"{image_id:06d}", camera)


def visible_fractions(dataset: BopDataset, targets_only: bool = True) -> np.ndarray | None:
    """How much is seen of each pose of `dataset.ground_truth`, (G,) shares of its whole silhouette.

    Args:
        dataset: the split.
        targets_only: as for `BopDataset.ground_truth`.

    Returns:
        None if one of the scenes with poses has no `scene_gt_info.json`.

    Raises:
        ValueError: if a file is damaged.
    """
    fractions = []
    for scene_id, image_id in dataset.images:
        rows = dataset._rows(scene_id, image_id, targets_only)
        known = dataset._annotations_of(scene_id).visible_fraction
        if rows and known is None:
            return None
        fractions += [known[row] for row in rows]
    return np.array(fractions, np.float64)
