"""A driver with one of four AR glasses, seen by three infrared cameras in a dark car.

Stands in for HMDPose (Firintepe et al., "HMDPose: A large-scale trinocular IR augmented reality
glasses pose dataset", 2020). A record is an instant, seen from the left, the centre and the right:
three views with the same `group`. Their `scene_id` is the driver, and no driver is in both splits.

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
with the square of the distance. By day some comes through the windows as well.

Depth. No camera here measures it: `View.depth` is a label, that of head, glasses and torso in steps
of 0.1 mm, and 0 where the car is seen.
"""

from __future__ import annotations

import functools

import numpy as np

from data_tools.renderer import Light, PreparedMesh, prepare, render_infrared, render_labels
from data_tools.sensors import infrared_sensor
from data_tools.shapes import GLASSES, PIVOT, make_glasses, make_subject
from data_tools.shapes.mesh import Mesh
from data_tools.views import ObjectView, View
from data_tools.worlds.cabin import make_cabin, windows
from data_tools.worlds.world import Recipe, Size, World, WorldModels, generator
from posecore.arrays import fail, require_integer, to_numbers
from posecore.poses import compose, from_matrix, relative, to_matrix
from posecore.rotations import euler_to_matrix, matrix_to_euler, require_rotation

__all__ = ["CAMERAS", "HEAD", "SUBJECTS", "WORLD", "cameras", "foreground", "head_angles"]

CAMERAS = ("left", "centre", "right")  # as they lie in the image of the centre camera
HEAD = 5  # the object id of the head
SUBJECTS = {"train": tuple(range(12)), "test": tuple(range(12, 16))}

DEPTH_STEP = 1e-4  # metres
LAMP = 0.55  # power of a camera's lamp
LIMITS = np.radians([75.0, 35.0, 25.0])  # of yaw, pitch and roll
# What drivers do: how often, where they look and how much that varies (yaw, pitch, roll, degrees).
_HABITS = (
    (0.60, (0, 0, 0), (7, 5, 3)),  # the road
    (0.10, (-28, 2, -2), (8, 4, 4)),  # the mirror outside
    (0.10, (30, -4, 2), (9, 4, 4)),  # the mirror inside
    (0.08, (6, 19, 0), (10, 5, 4)),  # the instruments
    (0.12, (0, 0, 0), (45, 18, 13)),  # anything else
)
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


def _glasses(view: View) -> ObjectView:
    for item in view.objects:
        if item.object_id < HEAD:
            return item
    fail("view", "one with glasses", [item.object_id for item in view.objects])


def _record(recipe: Recipe, index: int) -> dict:
    """One instant: what the three cameras see, and where the glasses are in the car."""
    rng = generator(recipe, index)
    subject, glasses = _who_wears_what(recipe["split"], index)
    seat, lean = _seat(subject), _lean(rng)
    angles = _angles(rng)
    head = _about_pivot(angles, seat + lean)
    torso = _about_pivot(angles * [0.25, 0, 0], seat + lean)
    objects = [_worn(glasses), *_driver(subject), *make_cabin()]
    poses = [head, head, torso, (np.eye(3), seat), (np.eye(3), np.zeros(3))]
    daylight = _daylight(rng)

    width, height = size = recipe["width"], recipe["height"]
    infrared, depth, boxes, fractions = [], [], [], []
    masks = np.zeros((2, 3, 2, height, width), bool)  # visible and full, of each camera
    for number, (K, T) in enumerate(cameras(*size)):
        seen = [relative(*from_matrix(T), *pose) for pose in poses]
        # The car is behind the driver, so without it the labels are the same.
        labels = render_labels(objects[:3], seen[:3], K, size)
        linear = render_infrared(
            objects,
            seen,
            K,
            size,
            _lights(T, daylight),
            ambient=0.004 + 0.03 * daylight,
            background=windows(rng, daylight, height, width),
            casters=(0, 1, 2),
            shadow_texels=2 * width,
        )
        infrared.append(infrared_sensor(linear, rng, read_noise=0.008, column_noise=0.002))
        depth.append(np.round(labels.depth / DEPTH_STEP).astype(np.uint16))
        masks[:, number] = labels.visible_masks[:2], labels.full_masks[:2]
        boxes.append(labels.visible_boxes[:2])
        fractions.append(labels.visible_fraction[:2])
    return {
        "subject": subject,
        "glasses": glasses + 1,
        "sizes": np.stack([item.mesh.size for item in objects[:2]]),
        "R": head[0],
        "t": head[1],
        # Cameras one below the other, since records are compressed along the first axis.
        "ir": np.concatenate(infrared),
        "depth": np.concatenate(depth),
        "masks": masks[0],
        "full_masks": masks[1],
        "boxes": np.stack(boxes),
        "visible_fractions": np.stack(fractions),
    }


def _views(recipe: Recipe, index: int, record: dict) -> list[View]:
    width, height = recipe["width"], recipe["height"]
    infrared = record["ir"].reshape(3, height, width)
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
            ir=infrared[number],
            depth=depth[number],
            objects=tuple(objects),
        )
        result.append(view)
    return result


def _who_wears_what(split: str, index: int) -> tuple[int, int]:
    """Subject and glasses (from 0 on), in turns, so that all wear all equally often."""
    subjects = SUBJECTS[split]
    return subjects[index % len(subjects)], index // len(subjects) % len(GLASSES)


def _angles(rng: np.random.Generator) -> np.ndarray:
    """(3,) yaw, pitch and roll in radians: mostly straight ahead, seldom far to a side."""
    habit = _HABITS[rng.choice(len(_HABITS), p=[share for share, _, _ in _HABITS])]
    while True:
        angles = np.radians(rng.normal(habit[1], habit[2]))
        if (np.abs(angles) <= LIMITS).all():
            return angles


def _seat(subject: int) -> np.ndarray:
    """(3,) how the driver has set the seat, metres: height and distance."""
    rng = np.random.default_rng([31, subject])
    return np.array([0, rng.uniform(-0.035, 0.035), rng.uniform(-0.05, 0.12)])


def _lean(rng: np.random.Generator) -> np.ndarray:
    """(3,) where the driver leans: to a side, up and down, and now and then forward."""
    side, up = rng.normal(0, 0.02), rng.normal(0, 0.01)
    forward = min(abs(rng.normal(0, 0.035)), 0.12)
    return np.array([np.clip(side, -0.06, 0.06), np.clip(up, -0.03, 0.03), -forward])


def _about_pivot(angles: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pose in the car of what turns about the top of the neck."""
    R = euler_to_matrix(angles, "YXZ")
    return compose(R, PIVOT + shift, np.eye(3), -PIVOT)


def _daylight(rng: np.random.Generator) -> float:
    """How bright it is outside, from 0 at night to 1."""
    return float(rng.choice([0.0, rng.uniform(0, 0.25), rng.uniform(0.25, 1)], p=[0.3, 0.4, 0.3]))


def _lights(T_world_cam: np.ndarray, daylight: float) -> list[Light]:
    """The lamp beside the camera, and the daylight from the driver's window."""
    R, t = T_world_cam[:3, :3], T_world_cam[:3, 3]
    window = R.T @ (np.array([1.0, -0.35, -0.25]) - t)
    # A point: so close to a lamp beside it, no camera sees the soft rims of shadows.
    lamp = Light((0.04, 0.0, 0.0), LAMP, radius=0.0, beam=1.5)
    return [lamp, Light(window, 0.14 * daylight, shadows=False)] if daylight else [lamp]


@functools.lru_cache(maxsize=4)
def _worn(glasses: int) -> PreparedMesh:
    return prepare(make_glasses(GLASSES[glasses]))


@functools.lru_cache(maxsize=16)
def _driver(subject: int) -> tuple[PreparedMesh, PreparedMesh]:
    """Head and torso."""
    person = make_subject(subject)
    return prepare(person.head), prepare(person.torso)


def _mesh(number: int) -> Mesh:
    return _worn(number).mesh


WORLD = World(
    name="headset",
    sizes={
        "tiny": Size(80, 47, {"train": 48, "test": 16}),
        "book": Size(160, 94, {"train": 3000, "test": 400}),
        "paper": Size(320, 188, {"train": 40_000, "test": 4000}),
    },
    record=_record,
    views=_views,
    views_per_record=len(CAMERAS),
    object_ids=(1, 2, 3, 4, HEAD),
    models=WorldModels(
        {number + 1: functools.partial(_mesh, number) for number in range(len(GLASSES))}
    ),
)
