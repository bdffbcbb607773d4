"""An instant of the `headset` world: who sits in the car and how, and what lights it.

The same instant can be lit by the cameras' infrared lamps, as the world has it, or by what a colour
camera would see it by: the day outside, and next to nothing at night.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass, replace

import numpy as np

from data_tools.renderer import (
    Ambient,
    Light,
    PreparedMesh,
    prepare,
    render_colour,
    render_infrared,
)
from data_tools.sensors import infrared_sensor, rgb_sensor
from data_tools.shapes import GLASSES, PIVOT, make_glasses, make_subject
from data_tools.worlds.cabin import make_cabin, windows, windows_in_colour
from posecore.poses import compose, from_matrix, relative
from posecore.rotations import euler_to_matrix

__all__ = [
    "LIMITS",
    "SUBJECTS",
    "Instant",
    "about_pivot",
    "draw_angles",
    "draw_instant",
    "driver",
    "infrared_lights",
    "infrared_picture",
    "visible_picture",
    "who_wears_what",
    "worn",
    "worn_scaled",
]

SUBJECTS = {
    "train": tuple(range(12)),
    "test": tuple(range(12, 16)),
    "crowd": tuple(range(100, 850)),
}
TOGETHER = 4  # instants of the crowd in a row that are of the same subject: meshes are costly

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

# Where daylight enters, metres in the car: the driver's window, and the windscreen.
_WINDOW, _WINDSCREEN = (1.0, -0.35, -0.25), (-0.15, -0.5, -1.2)
_INSTRUMENTS = np.array([0.0030, 0.0025, 0.0020])  # their light, from all around
EXPOSURE = 1.8  # of the colour camera, by day and by night


@dataclass(frozen=True, eq=False)
class Instant:
    """Who is in the car, how, and how bright it is outside.

    Attributes:
        subject: the driver, a seed of `make_subject`.
        glasses: which of `GLASSES`, from 0 on.
        objects: glasses, head, torso, seat and cabin.
        poses: of these in the car, rotation and translation in metres.
        daylight: from 0 at night to 1.
    """

    subject: int
    glasses: int
    objects: tuple[PreparedMesh, ...]
    poses: tuple[tuple[np.ndarray, np.ndarray], ...]
    daylight: float

    def seen_from(self, T_world_cam: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The poses in a camera's frame."""
        return [relative(*from_matrix(T_world_cam), *pose) for pose in self.poses]


def draw_instant(rng: np.random.Generator, split: str, index: int) -> Instant:
    """The instant of a record; its cameras' noise comes from the same generator afterwards."""
    subject, glasses = who_wears_what(split, index)
    seat, lean = _seat(subject), _lean(rng)
    angles = draw_angles(rng)
    head = about_pivot(angles, seat + lean)
    torso = about_pivot(angles * [0.25, 0, 0], seat + lean)
    objects = (worn(glasses), *driver(subject), *make_cabin())
    poses = (head, head, torso, (np.eye(3), seat), (np.eye(3), np.zeros(3)))
    return Instant(subject, glasses, objects, poses, _daylight(rng))


def infrared_picture(
    instant: Instant,
    K: np.ndarray,
    T_world_cam: np.ndarray,
    size: tuple[int, int],
    rng: np.random.Generator,
    *,
    gain: float = 1.0,
    lamp: float = 1.0,
) -> np.ndarray:
    """What an infrared camera sees of an instant.

    Args:
        instant: the instant.
        K, T_world_cam, size: the camera, and (width, height) of its images.
        rng: the record's random numbers: of what is seen through the windows, and noise.
        gain: factor on the exposure.
        lamp: factor on the power of the camera's lamp.

    Returns:
        (H, W) uint8.
    """
    width, height = size
    daylight = instant.daylight
    linear = render_infrared(
        instant.objects,
        instant.seen_from(T_world_cam),
        K,
        size,
        infrared_lights(T_world_cam, daylight, lamp),
        ambient=0.004 + 0.03 * daylight,
        background=windows(rng, daylight, height, width),
        casters=(0, 1, 2),
        shadow_texels=2 * width,
    )
    return infrared_sensor(linear, rng, exposure=gain, read_noise=0.008, column_noise=0.002)


def visible_picture(
    instant: Instant,
    K: np.ndarray,
    T_world_cam: np.ndarray,
    size: tuple[int, int],
    rng: np.random.Generator,
    *,
    gain: float = 1.0,
) -> np.ndarray:
    """What a colour camera in the same place sees: no lamp of the car is visible light.

    Daylight comes through windscreen and driver's window; instruments light the cabin faintly. The
    exposure is fixed: at daylight 1 faces are well exposed, at 0 the picture is nearly black.

    Args:
        instant, K, T_world_cam, size, gain: as in `infrared_picture`.
        rng: the record's random numbers, as they were before the infrared picture; they are left as
            after it, so that what is outside is the same for all cameras.

    Returns:
        (H, W, 3) uint8, sRGB.
    """
    width, height = size
    daylight = instant.daylight
    R, t = T_world_cam[:3, :3], T_world_cam[:3, 3]
    lights = [
        Light(R.T @ (np.array(place) - t), daylight * np.array(power), radius=radius)
        for place, power, radius in (
            (_WINDOW, (0.75, 0.72, 0.65), 0.2),
            (_WINDSCREEN, (0.6, 0.63, 0.68), 0.35),
        )
    ]
    ambient = Ambient(
        above=daylight * np.array([0.16, 0.17, 0.19]) + _INSTRUMENTS,
        below=daylight * np.array([0.09, 0.085, 0.08]) + _INSTRUMENTS,
        up=R.T @ [0.0, -1.0, 0.0],
    )
    linear = render_colour(
        instant.objects,
        instant.seen_from(T_world_cam),
        K,
        size,
        lights if daylight else [],
        ambient=ambient,
        background=windows_in_colour(rng, daylight, height, width),
        casters=(0, 1, 2),
        shadow_texels=2 * width,
    )
    picture = rgb_sensor(linear, copy.deepcopy(rng), exposure=gain * EXPOSURE)
    infrared_sensor(np.zeros((height, width)), rng)  # as many random numbers as it takes
    return picture


def who_wears_what(split: str, index: int) -> tuple[int, int]:
    """Subject and glasses (from 0 on), in turns, so that all wear all about equally often."""
    subjects = SUBJECTS[split]
    if split == "crowd":
        return subjects[index // TOGETHER % len(subjects)], index % len(GLASSES)
    return subjects[index % len(subjects)], index // len(subjects) % len(GLASSES)


def draw_angles(rng: np.random.Generator) -> np.ndarray:
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


def about_pivot(angles: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pose in the car of what turns about the top of the neck."""
    R = euler_to_matrix(angles, "YXZ")
    return compose(R, PIVOT + shift, np.eye(3), -PIVOT)


def _daylight(rng: np.random.Generator) -> float:
    """How bright it is outside, from 0 at night to 1."""
    return float(rng.choice([0.0, rng.uniform(0, 0.25), rng.uniform(0.25, 1)], p=[0.3, 0.4, 0.3]))


def infrared_lights(T_world_cam: np.ndarray, daylight: float, lamp: float = 1.0) -> list[Light]:
    """The lamp beside the camera, `lamp` times as bright, and daylight from the driver's window."""
    R, t = T_world_cam[:3, :3], T_world_cam[:3, 3]
    window = R.T @ (np.array(_WINDOW) - t)
    # A point: so close to a lamp beside it, no camera sees the soft rims of shadows.
    beside = Light((0.04, 0.0, 0.0), LAMP * lamp, radius=0.0, beam=1.5)
    return [beside, Light(window, 0.14 * daylight, shadows=False)] if daylight else [beside]


@functools.lru_cache(maxsize=4)
def worn(glasses: int) -> PreparedMesh:
    """Glasses, from 0 on."""
    return prepare(make_glasses(GLASSES[glasses]))


@functools.lru_cache(maxsize=8)
def worn_scaled(glasses: int, factor: float) -> PreparedMesh:
    """Glasses, from 0 on, that are `factor` times as large about the origin of their frame."""
    mesh = make_glasses(GLASSES[glasses])
    return prepare(replace(mesh, vertices=factor * mesh.vertices))


@functools.lru_cache(maxsize=16)
def driver(subject: int) -> tuple[PreparedMesh, PreparedMesh]:
    """Head and torso."""
    person = make_subject(subject)
    return prepare(person.head), prepare(person.torso)
