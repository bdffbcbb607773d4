"""Films of drivers with AR glasses, in infrared at night: pictures in a row, and not in any order.

The `headset` world draws each of its instants anew. Real recordings are films: a picture and the
next are nearly the same. These films are there to show what follows for how data is split.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_tools.renderer import Light, PreparedMesh, prepare, render_infrared
from data_tools.sensors import infrared_sensor
from data_tools.shapes import GLASSES, PIVOT, make_glasses, make_subject
from data_tools.worlds.headset import cameras
from posecore.arrays import fail, require_integer, require_number
from posecore.poses import from_matrix, relative
from posecore.rotations import euler_to_matrix

__all__ = ["film"]

GAZE = 0.8  # seconds that a driver looks at one thing, on average
TURN = 0.12  # seconds, by which the head's way from one thing to the next is smoothed
SPREAD = np.radians([22.0, 9.0, 6.0])  # of yaw, pitch and roll


def film(
    subject: int,
    glasses: int,
    frames: int,
    generator: np.random.Generator,
    *,
    size: tuple[int, int] = (80, 47),
    rate: float = 30.0,
) -> tuple[np.ndarray, np.ndarray]:
    """A film of one driver, seen by the centre camera at night.

    The head looks here and there, for 0.8 seconds on average, and turns smoothly in between.

    Args:
        subject: who drives, a seed of `make_subject`.
        glasses: which of `GLASSES`, 1 to 4 as the world's object ids.
        frames: how many pictures.
        generator: of random numbers.
        size: (width, height) of the pictures in pixels.
        rate: pictures a second.

    Returns:
        (frames, H, W) uint8 infrared pictures, and (frames, 3, 3) the head's rotations in the car.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    require_integer("subject", subject, 0)
    require_integer("glasses", glasses, 1, len(GLASSES))
    require_integer("frames", frames, 1)
    rate = require_number("rate", rate, above=0)
    if not isinstance(generator, np.random.Generator):
        fail("generator", "a numpy.random.Generator", type(generator).__name__)
    if not isinstance(size, tuple) or len(size) != 2:
        fail("size", "a pair (width, height)", repr(size))
    width, height = size
    K, T = cameras(width, height)[1]
    camera = from_matrix(T)
    things = [_worn(glasses), *_driver(subject)]
    lamp = Light((0.04, 0.0, 0.0), 0.5, radius=0.0, beam=1.5)
    rotations = euler_to_matrix(_angles(frames, rate, generator), "YXZ")
    images = np.empty((frames, height, width), np.uint8)
    for image, R in zip(images, rotations, strict=True):
        head, body = (R, PIVOT - R @ PIVOT), (np.eye(3), np.zeros(3))
        seen = [relative(*camera, *pose) for pose in (head, head, body)]
        light = render_infrared(things, seen, K, size, [lamp], shadow_texels=2 * width)
        image[:] = infrared_sensor(light, generator)
    return images, rotations


def _angles(frames: int, rate: float, generator: np.random.Generator) -> np.ndarray:
    """(frames, 3) yaw, pitch and roll: a new goal now and then, and a smooth way there."""
    goals = generator.normal(0, SPREAD, (frames, 3))
    moves = generator.random(frames) < 1 / (GAZE * rate)
    moves[0] = True
    held = goals[np.maximum.accumulate(np.where(moves, np.arange(frames), 0))]
    return gaussian_filter1d(held, TURN * rate, axis=0, mode="nearest")


@functools.lru_cache(maxsize=4)
def _worn(glasses: int) -> PreparedMesh:
    return prepare(make_glasses(GLASSES[glasses - 1]))


@functools.lru_cache(maxsize=16)
def _driver(subject: int) -> tuple[PreparedMesh, PreparedMesh]:
    person = make_subject(subject)
    return prepare(person.head), prepare(person.torso)
