"""From views to what is kept of them: a table, and images of few bytes."""

from __future__ import annotations

import numpy as np

from data_tools.batches.compositing import NONE, OUTSIDE
from data_tools.batches.files import PIECE
from data_tools.storage.records import Record
from data_tools.views import Dataset, ObjectView, View
from posecore.arrays import fail

__all__ = ["make_piece"]


def make_piece(dataset: Dataset, depth_step: float, number: int) -> tuple[Record, dict]:
    """The table and the images of a piece."""
    indices = range(len(dataset))[number * PIECE : (number + 1) * PIECE]
    views = [dataset[index] for index in indices]
    images: dict[str, list[np.ndarray]] = {}
    for index, view in zip(indices, views, strict=True):
        new = _images(view, depth_step, index)
        if index > indices[0] and {k: i.shape for k, i in new.items()} != {
            k: i[0].shape for k, i in images.items()
        }:
            fail(f"view {index}", f"images as in view {indices[0]}, {views[0]}", view)
        for kind, image in new.items():
            images.setdefault(kind, []).append(image)
    objects = [item for view in views for item in view.objects]
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
    return table, {kind: np.stack(images[kind]) for kind in images}


def _images(view: View, depth_step: float, index: int) -> dict[str, np.ndarray]:
    """The images of a view: "rgb", "ir" uint8; "depth", "surface" uint16; "instance" uint8."""
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
    if all(item.mask is not None for item in view.objects):
        images["instance"] = np.full(view.shape, NONE, np.uint8)
        # Masks of real data may overlap by some pixels: those are the nearer object's.
        for slot in sorted(range(len(view.objects)), key=lambda s: -view.objects[s].t[2]):
            images["instance"][view.objects[slot].mask] = slot
        if view.objects and all(o.coordinates is not None for o in view.objects):
            surface = np.zeros(view.shape)
            for item in view.objects:
                surface[item.mask] = item.coordinates[item.mask] @ item.R[2] + item.t[2]
            images["surface"] = _steps(surface, depth_step)
    return images


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
    if item.visible_fraction is None:
        return float(item.full_mask.sum())
    return float(item.mask.sum() / item.visible_fraction) if item.visible_fraction else 0.0
