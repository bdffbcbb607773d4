"""Views decoded for the cache: into a table, and images of few bytes."""

from __future__ import annotations

import numpy as np

from data_tools.batches.files import CHUNK_SIZE
from data_tools.storage.records import Record
from data_tools.views import Dataset, ObjectView, View
from posecore.arrays import fail

__all__ = ["NONE", "OUTSIDE", "make_chunk"]

NONE, OUTSIDE = 255, 254  # in an image of instances: no object; beyond the border, once it is cut


def make_chunk(dataset: Dataset, depth_step: float, number: int) -> tuple[Record, dict]:
    """The table and the images of a chunk.

    Raises:
        ValueError: naming the view whose images differ in kind or size from those of the first.
    """
    indices = range(len(dataset))[number * CHUNK_SIZE : (number + 1) * CHUNK_SIZE]
    views = [dataset[index] for index in indices]
    objects = [item for view in views for item in view.objects]
    masked = all(item.mask is not None for item in objects)
    located = masked and all(item.coordinates is not None for item in objects)
    images = []
    for index, view in zip(indices, views, strict=True):
        new = _images(view, depth_step, index)
        new |= _labels(view, depth_step, located) if masked else {}
        images.append(new)
        if {k: i.shape for k, i in new.items()} != {k: i.shape for k, i in images[0].items()}:
            fail(f"view {index}", f"images as in view {indices[0]}, {views[0]}", view)
    table: Record = {
        "K": np.stack([view.K for view in views]),
        "scene_id": np.array([view.scene_id for view in views]),
        "image_id": np.array([view.image_id for view in views]),
        "groups": [repr(view.group) for view in views],
        "counts": np.array([len(view.objects) for view in views]),
        "object_id": np.array([item.object_id for item in objects], np.int64),
        "categories": [item.category for item in objects],
        "R": np.reshape([item.R for item in objects], (-1, 3, 3)),
        "t": np.reshape([item.t for item in objects], (-1, 3)),
        "box": np.reshape([_box(item) for item in objects], (-1, 4)),
    }
    known = {
        "T_world_cam": ([view.T_world_cam for view in views], (4, 4)),
        "size": ([item.size for item in objects], (3,)),
        "visible_fraction": ([item.visible_fraction for item in objects], ()),
        "full_pixels": ([_full_pixels(item) for item in objects], ()),
    }
    for name, (values, shape) in known.items():
        if all(value is not None for value in values):
            table[name] = np.reshape(np.array(values, np.float64), (-1, *shape))
    return table, {kind: np.stack([new[kind] for new in images]) for kind in images[0]}


def _images(view: View, depth_step: float, index: int) -> dict[str, np.ndarray]:
    """What the cameras saw: "rgb" and "ir" uint8, "depth" uint16."""
    if view.shape is None:
        fail(f"view {index}", "images", view)
    images = {}
    if view.rgb is not None:
        images["rgb"] = view.rgb
    if view.ir is not None:
        images["ir"] = view.ir if view.ir.dtype == np.uint8 else (view.ir >> 8).astype(np.uint8)
    if view.depth is not None:
        images["depth"] = _steps(view.depth, depth_step)
    if len(view.objects) > OUTSIDE:
        fail(f"view {index}", f"at most {OUTSIDE} objects", len(view.objects))
    return images


def _labels(view: View, depth_step: float, located: bool) -> dict[str, np.ndarray]:
    """Which object each pixel shows, "instance" uint8, and if asked its depth, "surface" uint16."""
    instance, surface = np.full(view.shape, NONE, np.uint8), np.zeros(view.shape)
    # Masks of real data may overlap by some pixels: those are the nearer object's.
    for slot in sorted(range(len(view.objects)), key=lambda s: -view.objects[s].t[2]):
        item = view.objects[slot]
        instance[item.mask] = slot
        if located:
            surface[item.mask] = item.coordinates[item.mask] @ item.R[2] + item.t[2]
    labels = {"instance": instance}
    return labels | {"surface": _steps(surface, depth_step)} if located else labels


def _steps(depth: np.ndarray, depth_step: float) -> np.ndarray:
    steps = np.round(depth / depth_step)
    return np.where(steps <= 65535, steps, 0).astype(np.uint16)


def _box(item: ObjectView) -> np.ndarray:
    if item.box is not None:
        return item.box
    if item.mask is None or not item.mask.any():
        return np.zeros(4)
    x, y = np.flatnonzero(item.mask.any(0)), np.flatnonzero(item.mask.any(1))
    return np.array([x[0], y[0], x[-1] - x[0] + 1, y[-1] - y[0] + 1], np.float64)


def _full_pixels(item: ObjectView) -> float | None:
    """How many pixels the whole silhouette has; 0 where nobody knows, as nothing of it is seen."""
    if item.mask is None or (item.visible_fraction is None and item.full_mask is None):
        return None
    if item.visible_fraction:
        return float(item.mask.sum() / item.visible_fraction)
    return 0.0 if item.full_mask is None else float(item.full_mask.sum())
