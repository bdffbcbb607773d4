"""What chapter 2 measures: how a split of films decides what a test says."""

from __future__ import annotations

import cv2
import numpy as np

from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from data_tools.worlds.films import film
from posecore import metrics
from posecore.scale import choose

SMALL = (40, 24)  # pixels that pictures are compared in
SHUFFLED = Key("memory", "shuffled frames", "rotation")
NEW_DRIVERS = Key("memory", "new drivers", "rotation")
AHEAD = Key("always straight ahead", metric="rotation")


def films(drivers: int, frames: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A film of each driver, glasses in turns.

    Returns:
        (N, 40 * 24) pictures, (N, 3, 3) rotations of the head, (N,) drivers.
    """
    rng = np.random.default_rng(seed)
    shots = [film(driver, 1 + driver % 4, frames, rng) for driver in range(drivers)]
    pictures = np.concatenate([images for images, _ in shots])
    small = [cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA) for image in pictures]
    rotations = np.concatenate([R for _, R in shots])
    return (
        np.reshape(small, (len(small), -1)).astype(np.float32),
        rotations,
        np.repeat(np.arange(drivers), frames),
    )


def most_similar(pictures: np.ndarray, known: np.ndarray) -> np.ndarray:
    """For each picture (M, D) the index of the most similar among the known (N, D)."""
    square = (known**2).sum(1) - 2 * pictures @ known.T  # without |picture|^2, the same for all
    return square.argmin(axis=1)


def split_of_films(seed: int) -> dict[Key, float]:
    """Degrees by which a memory of pictures errs on shuffled frames, and on new drivers.

    The shuffled split is the infrared paper's, 94 % for training and 3 % for testing.
    """
    drivers, frames = choose(tiny=4, book=12, paper=12), choose(tiny=10, book=120, paper=1200)
    pictures, rotations, who = films(drivers, frames, seed)

    def errors(test: np.ndarray, train: np.ndarray) -> np.ndarray:
        answers = rotations[train[most_similar(pictures[test], pictures[train])]]
        return np.degrees(metrics.rotation_error(answers, rotations[test]))

    shuffled = np.random.default_rng(seed).permutation(len(who))
    few, many = max(1, round(0.03 * len(who))), round(0.94 * len(who))
    left_out = [
        errors(np.flatnonzero(who == driver), np.flatnonzero(who != driver)) for driver in set(who)
    ]
    ahead = np.broadcast_to(np.eye(3), rotations.shape)
    ahead_off = np.degrees(metrics.rotation_error(ahead, rotations))
    return {
        SHUFFLED: float(errors(shuffled[:few], shuffled[-many:]).mean()),
        NEW_DRIVERS: float(np.concatenate(left_out).mean()),
        AHEAD: float(ahead_off.mean()),
    }


CLAIMS = [
    Claim(
        id="shuffled_split",
        statement="A method that only remembers pictures passes on shuffled frames of films, and "
        "fails on new drivers",
        source="errata; infrared paper, 3.1.3, shuffles before splitting",
        measurement="split_of_films",
        favoured=SHUFFLED,
        other=NEW_DRIVERS,
        better="lower",
        unit="degrees",
        ours=True,
    ),
]
MEASUREMENTS = {"split_of_films": Measurement(split_of_films, range(5))}
