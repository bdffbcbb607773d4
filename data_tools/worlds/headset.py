"""A driver with one of four AR glasses, seen by three infrared cameras in a dark car.

Stands in for HMDPose (Firintepe et al., "HMDPose: A large-scale trinocular IR augmented reality
glasses pose dataset", 2020). A record is an instant, seen from the left, the centre and the right:
three views with the same `group`. Their `scene_id` is the driver, and no driver is in two splits:
"train" has 12 of them, as many as such a dataset can afford, "test" 4 others, and "crowd" 750, for
what cannot be learned from twelve.

Frames. The car's frame is the world's: its origin is where the glasses of an average driver are who
looks straight ahead, x points to the driver's left (right in the image), y down and z to the back
of the car. The glasses' frame (`data_tools.shapes.glasses`) is the same for that driver, so the
rotation from glasses to car is `R = Ry(yaw) Rx(pitch) Rz(roll)`: the head's angles, which
`head_angles` reads off a view. A positive yaw turns the face to the driver's right, a positive
pitch lowers it, a positive roll tilts the head clockwise in the image.

Objects. 1 to 4 are the four glasses in the order of `GLASSES`, and 5 is the head that wears them,
whose frame, and so whose pose, is the glasses'; neck and torso belong to neither. Masks of the two
are apart; `foreground` is both.

Light. Each camera has a lamp beside it and is exposed while only this one shines; its light falls
with the square of the distance. By day some comes through the windows as well: a record keeps its
"daylight", from 0 at night to 1 (`WORLD.open(split="train").store[index]["daylight"]`). `draw`
shows the same instants in other light, `data_tools.worlds.redrawn` many of them.

Depth. No camera here measures it: `View.depth` is a label, that of head, glasses and torso in steps
of 0.1 mm, and 0 where the car is seen.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_tools.renderer import render_labels
from data_tools.shapes import GLASSES
from data_tools.shapes.mesh import Mesh
from data_tools.views import ObjectView, View
from data_tools.worlds.headset_scenes import (
    SUBJECTS,
    Instant,
    draw_instant,
    infrared_picture,
    visible_picture,
    worn,
    worn_scaled,
)
from data_tools.worlds.world import Recipe, Size, World, WorldModels, generator
from posecore.arrays import fail, require_choice, require_integer, require_number, to_numbers
from posecore.poses import from_matrix, relative, to_matrix
from posecore.rotations import matrix_to_euler, require_rotation

__all__ = [
    "CAMERAS",
    "GLASSES_SCALES",
    "HEAD",
    "SUBJECTS",
    "WORLD",
    "cameras",
    "draw",
    "foreground",
    "head_angles",
    "require_glasses_scale",
]

CAMERAS = ("left", "centre", "right")  # as they lie in the image of the centre camera
HEAD = 5  # the object id of the head

DEPTH_STEP = 1e-4  # metres
GLASSES_SCALES = (0.7, 1.4)
"""Of `draw`: smaller glasses would be within the head, larger ones beside it."""
# Where the lens of each camera is in the car, and where it looks.
_EYES = ((-0.36, 0.03, -0.68), (0.0, 0.09, -0.76), (0.36, 0.03, -0.68))
_TARGET = (0.0, 0.01, 0.02)
_FOCAL = 1.17  # in widths of the image


def cameras(width: int, height: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The calibration of the three cameras: (K, T_world_cam) of each, in the order of `CAMERAS`.

    Args:
        width, height: of the images in pixels.

    Raises:
        ValueError: if one of them is not a positive integer.
    """
    require_integer("width", width, 1)
    require_integer("height", height, 1)
    f = _FOCAL * width
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    result = []
    for eye in np.array(_EYES):
        z = np.array(_TARGET) - eye
        z /= np.linalg.norm(z)
        x = np.cross((0, 1, 0), z)
        x /= np.linalg.norm(x)
        result.append((K, to_matrix(np.stack([x, np.cross(z, x), z], axis=1), eye)))
    return result


def head_angles(view: View, R: np.ndarray | None = None) -> np.ndarray:
    """Yaw, pitch and roll of the head in the car.

    Args:
        view: a view with `T_world_cam`.
        R: (..., 3, 3) rotations from glasses to camera, such as estimates; None takes the view's
            own.

    Returns:
        (..., 3) radians.

    Raises:
        ValueError: if the view has no glasses or no `T_world_cam`, or `R` is no rotation.
    """
    if view.T_world_cam is None:
        fail("view", "one with T_world_cam", "none")
    R = _glasses(view).R if R is None else to_numbers("R", R)
    require_rotation("R", R)
    return matrix_to_euler(view.T_world_cam[:3, :3] @ R, "YXZ")


def foreground(view: View) -> np.ndarray:
    """(H, W) bool, where the head or the glasses are seen.

    Raises:
        ValueError: if the view has no glasses, or no masks.
    """
    _glasses(view)
    masks = [item.mask for item in view.objects]
    if any(mask is None for mask in masks):
        fail("view", "one with masks", "none")
    return np.logical_or.reduce(masks)


def require_glasses_scale(value: float) -> float:
    """Return a `glasses_scale` for `draw`, or refuse it; 0.7 in float32 is a little less.

    Raises:
        ValueError: if it is no number from the least to the largest of `GLASSES_SCALES`.
    """
    value = require_number("glasses_scale", value)
    return require_number("glasses_scale", round(value, 6), *GLASSES_SCALES)


def _glasses(view: View) -> ObjectView:
    for item in view.objects:
        if item.object_id < HEAD:
            return item
    fail("view", "one with glasses", [item.object_id for item in view.objects])


def draw(
    index: int,
    *,
    split: str,
    scale: str | None = None,
    daylight: float | None = None,
    gain: float = 1.0,
    lamp: float = 1.0,
    light: str = "infrared",
    glasses_scale: float = 1.0,
) -> list[View]:
    """The three views of an instant of the world, drawn again in other light or with other glasses.

    Driver, poses, and the random numbers of the noise are those of the record; as it is by default,
    pictures and labels are, too, bit for bit.

    Args:
        index: of the instant, from 0 on: views 3 * index to 3 * index + 2 of the split.
        split: "train", "test" or "crowd".
        scale: "tiny", "book" or "paper"; None for the one in force.
        daylight: from 0 at night to 1; None for that of the record.
        gain: factor on the exposure of the cameras, above 0.
        lamp: factor on the power of the infrared lamps, at least 0.
        light: "infrared"; or "visible" for `rgb` in the place of `ir`: colour cameras without
            lamps, whose exposure is the same by day and by night.
        glasses_scale: of the glasses, from 0.7 to 1.4 times as large, about the origin of their
            frame. The four that there are are alike in width (17 to 19 cm).

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    recipe = WORLD.recipe(split, scale)
    count = WORLD.sizes[recipe["scale"]].counts[split]
    index = require_integer("index", index, 0, count - 1)
    gain = require_number("gain", gain, above=0)
    lamp = require_number("lamp", lamp, 0)
    require_choice("light", light, ("infrared", "visible"))
    if light == "visible" and lamp != 1:
        fail("lamp", "1, as infrared lamps are no visible light", lamp)
    glasses_scale = require_glasses_scale(glasses_scale)
    rng = generator(recipe, index)
    instant = draw_instant(rng, split, index)
    if daylight is not None:
        instant = replace(instant, daylight=require_number("daylight", daylight, 0, 1))
    if glasses_scale != 1:
        other = worn_scaled(instant.glasses, glasses_scale)
        instant = replace(instant, objects=(other, *instant.objects[1:]))
    size = recipe["width"], recipe["height"]
    if light == "infrared":
        images = [
            {"ir": infrared_picture(instant, *camera, size, rng, gain=gain, lamp=lamp)}
            for camera in cameras(*size)
        ]
    else:
        images = [
            {"rgb": visible_picture(instant, *camera, size, rng, gain=gain)}
            for camera in cameras(*size)
        ]
    return _assembled(recipe, index, _known(instant, size), images)


def _record(recipe: Recipe, index: int) -> dict:
    """One instant: what the three cameras see, and where the glasses are in the car."""
    rng = generator(recipe, index)
    instant = draw_instant(rng, recipe["split"], index)
    size = recipe["width"], recipe["height"]
    pictures = [infrared_picture(instant, *camera, size, rng) for camera in cameras(*size)]
    # Cameras one below the other, since records are compressed along the first axis.
    return _known(instant, size) | {"ir": np.concatenate(pictures)}


def _known(instant: Instant, size: tuple[int, int]) -> dict:
    """What a record has besides its pictures: what is known of an instant and of its views."""
    width, height = size
    depth, boxes, fractions = [], [], []
    masks = np.zeros((2, 3, 2, height, width), bool)  # visible and full, of each camera
    for number, (K, T) in enumerate(cameras(*size)):
        # The car is behind the driver, so without it the labels are the same.
        labels = render_labels(instant.objects[:3], instant.seen_from(T)[:3], K, size)
        depth.append(np.round(labels.depth / DEPTH_STEP).astype(np.uint16))
        masks[:, number] = labels.visible_masks[:2], labels.full_masks[:2]
        boxes.append(labels.visible_boxes[:2])
        fractions.append(labels.visible_fraction[:2])
    return {
        "subject": instant.subject,
        "glasses": instant.glasses + 1,
        "daylight": instant.daylight,
        "sizes": np.stack([item.mesh.size for item in instant.objects[:2]]),
        "R": instant.poses[0][0],
        "t": instant.poses[0][1],
        "depth": np.concatenate(depth),
        "masks": masks[0],
        "full_masks": masks[1],
        "boxes": np.stack(boxes),
        "visible_fractions": np.stack(fractions),
    }


def _views(recipe: Recipe, index: int, record: dict) -> list[View]:
    pictures = record["ir"].reshape(3, recipe["height"], recipe["width"])
    return _assembled(recipe, index, record, [{"ir": picture} for picture in pictures])


def _assembled(
    recipe: Recipe, index: int, record: dict, images: Sequence[dict[str, np.ndarray]]
) -> list[View]:
    """The views of a record with these images, "ir" or "rgb", of each camera."""
    width, height = recipe["width"], recipe["height"]
    depth = record["depth"].reshape(3, height, width).astype(np.float32) * np.float32(DEPTH_STEP)
    result = []
    for number, (K, T) in enumerate(cameras(width, height)):
        R, t = relative(*from_matrix(T), record["R"], record["t"])
        objects = [
            ObjectView(
                object_id=object_id,
                category=category,
                R=R,
                t=t,
                box=record["boxes"][number, row],
                mask=record["masks"][number, row],
                full_mask=record["full_masks"][number, row],
                visible_fraction=float(record["visible_fractions"][number, row]),
                size=record["sizes"][row],
            )
            for row, (object_id, category) in enumerate(
                ((record["glasses"], "glasses"), (HEAD, "head"))
            )
        ]
        view = View(
            scene_id=record["subject"],
            image_id=3 * index + number,
            group=(record["subject"], index),
            K=K,
            T_world_cam=T,
            depth=depth[number],
            objects=tuple(objects),
            **images[number],
        )
        result.append(view)
    return result


def _mesh(number: int) -> Mesh:
    return worn(number).mesh


WORLD = World(
    name="headset",
    sizes={
        "tiny": Size(80, 47, {"train": 48, "test": 16, "crowd": 32}),
        "book": Size(160, 94, {"train": 3000, "test": 400, "crowd": 3000}),
        "paper": Size(320, 188, {"train": 40_000, "test": 4000, "crowd": 40_000}),
    },
    record=_record,
    views=_views,
    views_per_record=len(CAMERAS),
    object_ids=(1, 2, 3, 4, HEAD),
    models=WorldModels(
        {number + 1: functools.partial(_mesh, number) for number in range(len(GLASSES))}
    ),
)
