"""Eight objects on tables, in colour and depth: in place of LINEMOD, LM-O and YCB-Video.

Splits:

- `train`, in turns as `KINDS` has them: "single", one object before a random background; "fused",
  several objects anywhere before one; "table", a table as in the tests. Such images one trains on
  for LINEMOD: rendered ones, fused ones, and fewer real ones (Peng et al., PVNet, 2019, section 5).
- `easy`: three to five objects on a table, some distance between them.
- `occluded`: six to eight, packed, seen from low down, with other things in front of them.

Tests have other tables, and other unlabelled things on them, than the training images.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from data_tools.renderer import Ambient, Light, material_images, render_colour, render_labels
from data_tools.sensors import depth_sensor, rgb_sensor
from data_tools.views import ObjectView, View
from data_tools.worlds.tabletop_scenes import (
    IDS,
    LINEMOD,
    Scene,
    draw_floating,
    draw_table,
    make_object,
    prepared,
)
from data_tools.worlds.world import Recipe, Size, World, WorldModels, generator

__all__ = ["DEPTH_SCALE", "KINDS", "WORLD", "intrinsics", "record", "silhouettes", "views"]

KINDS = ("single", "fused", "single", "fused", "table")
"""What training images show, in turns."""

DEPTH_SCALE = 0.1
"""Millimetres of a step in depth, as in BOP's files."""

SPLITS = ("train", "easy", "occluded")
SIZES = {
    "tiny": Size(96, 72, {"train": 40, "easy": 10, "occluded": 10}),
    "book": Size(320, 240, {"train": 2000, "easy": 150, "occluded": 150}),
    "paper": Size(640, 480, {"train": 20_000, "easy": 1000, "occluded": 1000}),
}


MODELS = WorldModels({object_id: functools.partial(make_object, object_id) for object_id in IDS})


def intrinsics(width: int, height: int) -> np.ndarray:
    """The camera matrix (3, 3): LINEMOD's camera with other pixels, whose centres are integers."""
    scale = np.diag([width / 640, height / 480, 1])
    to_corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return np.linalg.inv(to_corner) @ scale @ to_corner @ LINEMOD


def record(recipe: Recipe, index: int) -> dict[str, Any]:
    """One image and all that is known of it.

    Returns:
        "kind", one of `KINDS` or the split; "ids" of the N objects; "rgb" (H, W, 3) and "depth"
        (H, W) in steps of `DEPTH_SCALE`; poses "R" (N, 3, 3) and "t" (N, 3); "T_world_cam" (4, 4);
        "instance" (H, W), row of the object that is seen or -1; "full_masks" (N, H, W) and
        "full_pixels" (N,), of the silhouettes; "boxes" (N, 4) of what is seen.

    Raises:
        ValueError: if `recipe` has no usable size.
    """
    rng = generator(recipe, index)
    split = recipe["split"]
    kind = KINDS[index % len(KINDS)] if split == "train" else split
    scene = _draw(rng, kind)
    size = recipe["width"], recipe["height"]
    K = intrinsics(*size)
    R, t = scene.camera
    poses = [(R @ A, R @ b + t) for A, b in scene.poses]
    labels = render_labels(scene.things, poses, K, size)
    picture = render_colour(
        scene.things,
        poses,
        K,
        size,
        [_seen(light, R, t) for light in scene.lights],
        ambient=Ambient(*scene.ambient, up=R[:, 2]),
        casters=range(scene.casters),
    )
    infrared, specular = material_images(scene.things, labels)
    depth = depth_sensor(
        labels.depth,
        K,
        rng,
        normals=labels.normals,
        reflectance=infrared,
        specular=specular,
        disparity_noise=0.08 * size[0] / 640,
        disparity_step=0.125 * size[0] / 640,
    )
    # A camera sets its exposure by what it sees, and not always well.
    exposure = 0.24 / picture.mean() * np.exp(rng.normal(0, 0.22))
    rgb = rgb_sensor(
        picture,
        rng,
        exposure=exposure,
        shot_noise=rng.uniform(0.01, 0.035),
        blur=rng.uniform(0.3, 0.7),
    )
    units = np.round(depth * (1000 / DEPTH_SCALE))
    count = len(scene.ids)
    return {
        "kind": kind,
        "ids": scene.ids,
        "rgb": rgb,
        "depth": np.where(units <= 65535, units, 0).astype(np.uint16),
        "R": np.array([R for R, _ in poses[:count]]),
        "t": np.array([t for _, t in poses[:count]]),
        "T_world_cam": _to_world(R, t),
        "instance": np.where(labels.instance < count, labels.instance, -1).astype(np.int8),
        "full_masks": labels.full_masks[:count],
        "full_pixels": labels.full_pixels[:count],
        "boxes": labels.visible_boxes[:count],
    }


def views(recipe: Recipe, index: int, record: dict[str, Any]) -> list[View]:
    """The view of a record."""
    objects = []
    for row, object_id in enumerate(record["ids"]):
        info = MODELS.info(object_id)
        mask = record["instance"] == row
        pixels = int(mask.sum())
        objects.append(
            ObjectView(
                object_id=object_id,
                R=record["R"][row],
                t=record["t"][row],
                box=record["boxes"][row] if pixels else None,
                mask=mask,
                full_mask=record["full_masks"][row],
                visible_fraction=pixels / max(1, int(record["full_pixels"][row])),
                size=info.size,
                symmetries=_symmetries(object_id),
            )
        )
    view = View(
        K=intrinsics(recipe["width"], recipe["height"]),
        scene_id=1 + SPLITS.index(recipe["split"]),
        image_id=index,
        rgb=record["rgb"],
        depth=(record["depth"] * DEPTH_SCALE / 1000).astype(np.float32),
        T_world_cam=record["T_world_cam"],
        objects=objects,
    )
    return [view]


def silhouettes(view: View) -> tuple[np.ndarray, np.ndarray]:
    """How large the objects of a view are with what is outside the image, as BOP files say it.

    Returns:
        (N,) pixels, and (N, 4) boxes x, y, width, height.
    """
    things = [prepared(item.object_id) for item in view.objects]
    height, width = view.shape
    labels = render_labels(things, [(o.R, o.t) for o in view.objects], view.K, (width, height))
    return labels.full_pixels, labels.full_boxes


def _draw(rng: np.random.Generator, kind: str) -> Scene:
    if kind == "single":
        return draw_floating(rng, 1)
    if kind == "fused":
        return draw_floating(rng, int(rng.integers(4, 9)))
    if kind == "table":
        return draw_table(rng, packed=bool(rng.random() < 0.5), tests=False)
    return draw_table(rng, packed=kind == "occluded", tests=True)


def _seen(light: Light, R: np.ndarray, t: np.ndarray) -> Light:
    """A lamp of the world in the camera's frame."""
    return Light(R @ light.position + t, light.power, light.radius, light.shadows)


def _to_world(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.T, -R.T @ t
    return T


@functools.cache
def _symmetries(object_id: int) -> np.ndarray:
    return MODELS.info(object_id).symmetries()


WORLD = World(
    name="tabletop",
    sizes=SIZES,
    record=record,
    views=views,
    object_ids=IDS,
    models=MODELS,
)
