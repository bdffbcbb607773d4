"""Bottles, bowls, cameras, cans, laptops and mugs, no two splits of which share an instance.

Stands in for CAMERA25 and REAL275 (Wang et al., "Normalized Object Coordinate Space for
Category-Level 6D Object Pose and Size Estimation", 2019). `train` and `synthetic` are of one kind
and differ in their instances; `shifted` has other instances too, and other floors, harder light and
worse sensors. At `tiny` and `book` a view is a crop around one object, which other things may cover
in part; at `paper` it is a scene of several, all of them labelled.

Each object carries its category, its pose, its size, the symmetries of its shape and its
`coordinates`. Frames are those of `data_tools.shapes.categories`: the origin is the middle of the
bounding box and y is up. `View.depth` is what a structured-light camera measured, with its noise
and holes; coordinates are exact.
"""

from __future__ import annotations

import functools

import numpy as np

from data_tools.renderer import render_labels
from data_tools.shapes import CATEGORIES, make_category
from data_tools.views import ObjectView, View
from data_tools.worlds.category_scenes import INSTANCES, draw_scene, photographs
from data_tools.worlds.world import Recipe, Size, World, WorldModels, generator
from posecore.arrays import fail, require_choice, require_integer
from posecore.poses import to_matrix

__all__ = [
    "INSTANCES",
    "WORLD",
    "handle_visible",
    "nocs_map",
    "object_coordinates",
    "object_id",
]

DEPTH_STEP = 1e-4  # metres
FARTHEST = 6.5  # metres, that the depth camera measures
LEVELS = 65535  # in which exact depths are kept, between the nearest and the farthest of an object
HIDDEN = 0.1  # of an object that is seen less than this, nobody asks the pose
FIRST = 0.4  # what is seen at least of the object whose turn it is
HANDLE = 0.01  # the share of a mug's pixels that its handle has at least where one sees it


def object_coordinates(view: View, index: int = 0) -> np.ndarray:
    """Where each pixel of an object lies on it.

    Args:
        view: a view whose objects have coordinates, as those of this world.
        index: which of its objects.

    Returns:
        (H, W, 3) float32 metres in the object's frame, 0 outside the object's mask.

    Raises:
        ValueError: if there is no such object, or its coordinates are not known.
    """
    if not view.objects:
        fail("view", "one with objects", "none")
    item = view.objects[require_integer("index", index, 0, len(view.objects) - 1)]
    if item.coordinates is None:
        fail("view", "objects with coordinates", repr(item))
    return item.coordinates


def nocs_map(view: View, index: int = 0) -> np.ndarray:
    """Normalised object coordinates: the bounding box is centred on 1/2, its diagonal is 1.

    Args:
        view, index: as in `object_coordinates`.

    Returns:
        (H, W, 3) float32, 0 to 1, and 0 outside the object's mask.

    Raises:
        ValueError: as `object_coordinates`, or if the object's size or mask is not known.

    Source: Wang et al., 2019, section 3.
    """
    coordinates, item = object_coordinates(view, index), view.objects[index]
    if item.size is None or item.mask is None:
        fail("view", "objects with size and mask", repr(item))
    scaled = coordinates / np.float32(np.linalg.norm(item.size)) + np.float32(0.5)
    return scaled * item.mask[..., None]


def handle_visible(view: View, index: int = 0) -> bool:
    """Whether one sees a mug's handle; without it nobody can tell how the mug is turned.

    In NOCS people said so of each mug. Here the handle is seen if at least a hundredth of the mug's
    pixels lie on it: farther from the axis of the round body than its wall is.

    Args:
        view, index: as in `object_coordinates`.

    Raises:
        ValueError: as `object_coordinates`, or if the object is no mug, or its size or mask is not
            known.
    """
    coordinates, item = object_coordinates(view, index), view.objects[index]
    if item.category != "mug" or item.size is None or item.mask is None:
        fail("view", "a mug with size and mask", repr(item))
    width, _, diameter = item.size  # the handle points along +x
    x, _, z = coordinates[item.mask].T
    beyond = np.hypot(x + (width - diameter) / 2, z) > 1.02 * diameter / 2
    return bool(beyond.mean() >= HANDLE) if len(beyond) else False


def object_id(category: str, instance: int) -> int:
    """The number of an instance, 1000 for each category and one for each of its instances.

    Args:
        category: one of `CATEGORIES`.
        instance: its seed, as in `INSTANCES`.

    Raises:
        ValueError: if there is no such category or instance.
    """
    require_choice("category", category, CATEGORIES)
    require_integer("instance", instance, 0, _COUNT - 1)
    return 1000 * (CATEGORIES.index(category) + 1) + instance


def _record(recipe: Recipe, index: int) -> dict:
    """One image and its labels."""
    rng = generator(recipe, index)
    while True:
        scene = draw_scene(recipe, index, rng)
        labels = render_labels(scene.things, scene.poses, scene.K, scene.size)
        fractions = labels.visible_fraction[: len(scene.which)]
        if fractions[0] >= FIRST:
            break
    rgb, depth = photographs(scene, labels, recipe["split"], rng)
    rows = np.flatnonzero(fractions >= HIDDEN)
    exact = [labels.depth[labels.visible_masks[row]].astype(np.float64) for row in rows]
    ranges = np.array([(z.min(), max(z.max(), z.min() + 1e-6)) for z in exact])
    return {
        "rgb": rgb,
        "depth": np.where(depth < FARTHEST, np.round(depth / DEPTH_STEP), 0).astype(np.uint16),
        "K": scene.K,
        "T_world_cam": to_matrix(*scene.camera),
        "ids": [object_id(*scene.which[row]) for row in rows],
        "R": np.stack([scene.poses[row][0] for row in rows]),
        "t": np.stack([scene.poses[row][1] for row in rows]),
        "sizes": np.stack([scene.things[row].mesh.size for row in rows]),
        "boxes": labels.visible_boxes[rows],
        "visible_fractions": fractions[rows],
        "masks": labels.visible_masks[rows],
        "full_masks": labels.full_masks[rows],
        # Exact depths are kept instead of coordinates, which follow from them and the pose.
        "ranges": ranges,
        "levels": np.concatenate(
            [
                np.round((z - low) / (high - low) * LEVELS)
                for z, (low, high) in zip(exact, ranges, strict=True)
            ]
        ).astype(np.uint16),
    }


def _views(recipe: Recipe, index: int, record: dict) -> list[View]:
    K, masks = record["K"], record["masks"]
    ends = np.cumsum(masks.sum((1, 2)))
    back = np.linalg.inv(K)
    objects = []
    for row, levels in enumerate(np.split(record["levels"], ends[:-1])):
        mask, (nearest, farthest) = masks[row], record["ranges"][row]
        R, t = record["R"][row], record["t"][row]
        y, x = np.nonzero(mask)
        z = nearest + (farthest - nearest) / LEVELS * levels
        # In NumPy, as this is called so often: torch takes several times as long for so few points.
        points = np.stack([x * z, y * z, z], axis=1) @ back.T
        coordinates = np.zeros((*mask.shape, 3), np.float32)
        coordinates[mask] = (points - t) @ R  # R^T (X - t)
        category = CATEGORIES[record["ids"][row] // 1000 - 1]
        item = ObjectView(
            object_id=record["ids"][row],
            category=category,
            R=R,
            t=t,
            box=record["boxes"][row],
            mask=mask,
            full_mask=record["full_masks"][row],
            visible_fraction=float(record["visible_fractions"][row]),
            size=record["sizes"][row],
            symmetries=_symmetries(category),
            coordinates=coordinates,
        )
        objects.append(item)
    view = View(
        scene_id=0,
        image_id=index,
        K=K,
        T_world_cam=record["T_world_cam"],
        rgb=record["rgb"],
        depth=record["depth"].astype(np.float32) * np.float32(DEPTH_STEP),
        objects=tuple(objects),
    )
    return [view]


@functools.cache
def _symmetries(category: str) -> np.ndarray:
    """Those of its shape, which its instances share."""
    return make_category(category, 0).symmetries


_COUNT = max(instances.stop for instances in INSTANCES.values())
_ALL = {object_id(c, instance): (c, instance) for c in CATEGORIES for instance in range(_COUNT)}


WORLD = World(
    name="categories",
    sizes={
        "tiny": Size(64, 64, {"train": 6 * 12, "synthetic": 6 * 4, "shifted": 6 * 4}),
        "book": Size(128, 128, {"train": 6 * 600, "synthetic": 6 * 60, "shifted": 6 * 60}),
        "paper": Size(640, 480, {"train": 20_000, "synthetic": 2000, "shifted": 2000}),
    },
    record=_record,
    views=_views,
    object_ids=tuple(_ALL),
    models=WorldModels(
        {number: functools.partial(make_category, *which) for number, which in _ALL.items()}
    ),
)
