"""The mistakes that people make with poses, models and cameras, each with what undoes it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_tools.checking.drawing import Placement
from data_tools.checking.sample import Instance, Sample

__all__ = [
    "AS_GIVEN",
    "Correction",
    "camera_corrections",
    "mask_corrections",
    "pose_corrections",
]

Place = Callable[[Instance], Placement | None]
"""Where a correction draws the object of an instance; None where it does not apply."""


@dataclass(frozen=True, eq=False)
class Correction:
    """A mistake, and the data as they would be without it.

    Attributes:
        key: names the mistake, such as "inverse poses".
        mistake: what is wrong, a sentence without its full stop.
        remedy: what was done about it, to follow "with".
        place: where objects are then.
        cost: how much freedom it has: numbers that were fitted to the data, and 1 for each further
            mistake. Of two corrections that repair equally well the one with less is believed.
        factor: by which models were enlarged, or translations divided, which looks the same.
        owner: which of them it was, "models" or "translations"; None if that is open.
        targets: the instances with whose masks one is compared, the best of which counts; None for
            its own.
        depth: by which measured depth was divided.
        vary: the same with its fitted size times a number near 1; None where none was fitted.
    """

    key: str
    mistake: str
    remedy: str
    place: Place
    cost: float = 0
    factor: float = 1.0
    owner: str | None = None
    targets: Callable[[Instance], Sequence[Instance]] | None = None
    depth: float = 1.0
    vary: Callable[[float], Correction] | None = None


AS_GIVEN = Correction("as given", "nothing", "the data as given", lambda instance: instance.place)


def pose_corrections(sample: Sample) -> list[Correction]:
    """What may be wrong with poses, with units aside."""
    found = [
        _pose(
            "inverse poses",
            "the poses are inverse: from the camera to the object, where they should lead from the "
            "object to the camera",
            "each pose inverted",
            lambda R, t: (R.T, -R.T @ t),
        ),
        _pose(
            "transposed rotations",
            "the rotations are transposed: written column by column, or their inverses",
            "each rotation transposed, translations kept",
            lambda R, t: (R.T, t),
        ),
        _pose(
            "flipped axes",
            "the camera's axes are OpenGL's (y up, z backwards), where they should be OpenCV's "
            "(y down, z forward)",
            "y and z of the camera's frame negated",
            lambda R, t: (OPENGL @ R, OPENGL @ t),
        ),
        _pose(
            "turned axes",
            "x and y of the camera's frame have the wrong sign, or the images are upside down",
            "x and y of the camera's frame negated",
            lambda R, t: (UPSIDE_DOWN @ R, UPSIDE_DOWN @ t),
        ),
    ]
    for offset in (1, -1):
        found.append(
            Correction(
                "shifted by one image",
                "the poses belong to another image: to each image belong those of the "
                f"{'next' if offset > 0 else 'previous'} one",
                f"the poses of the {'next' if offset > 0 else 'previous'} image",
                _of_neighbour(sample, offset),
            )
        )
    for name, turn in _turns():
        found.append(
            Correction(
                "turned model",
                f"the models' axes are others than those of the poses: {name}",
                "the models turned so",
                _with_turn(turn),
                cost=1,
            )
        )
    return found


def camera_corrections() -> list[Correction]:
    """What may be wrong with camera matrices and images, without anything fitted."""
    return [
        _camera(
            "swapped fx and fy",
            "fx and fy of the camera matrix are swapped",
            "fx and fy swapped",
            lambda K, _: _matrix(K[1, 1], K[0, 0], K[0, 2], K[1, 2]),
        ),
        _camera(
            "swapped cx and cy",
            "cx and cy of the camera matrix are swapped",
            "cx and cy swapped",
            lambda K, _: _matrix(K[0, 0], K[1, 1], K[1, 2], K[0, 2]),
        ),
        _camera(
            "swapped x and y",
            "x and y of the camera matrix are swapped: fx and fy, cx and cy",
            "fx and fy, cx and cy swapped",
            lambda K, _: _matrix(K[1, 1], K[0, 0], K[1, 2], K[0, 2]),
        ),
        _camera(
            "mirrored images",
            "the images are mirrored, left to right",
            "columns counted from the right",
            lambda K, size: np.array([[-1, 0, size[0] - 1], [0, 1, 0], [0, 0, 1]]) @ K,
        ),
        _camera(
            "images upside down",
            "the images are mirrored, top to bottom",
            "rows counted from below",
            lambda K, size: np.array([[1, 0, 0], [0, -1, size[1] - 1], [0, 0, 1]]) @ K,
        ),
    ]


def mask_corrections(sample: Sample) -> list[Correction]:
    """What may be wrong with masks."""
    by_view: dict[int, list[Instance]] = {}
    for instance in sample.instances:
        by_view.setdefault(instance.view, []).append(instance)

    def of_others(instance: Instance) -> list[Instance]:
        return [other for other in by_view[instance.view] if other is not instance]

    def inverted(instance: Instance) -> list[Instance]:
        parts = {"mask": ~instance.mask, "small": ~instance.small}
        return [replace(instance, **parts, others=None, small_others=None)]

    return [
        Correction(
            "masks of another object",
            "the masks are those of other objects in the image",
            "each object compared with the best of the others' masks",
            AS_GIVEN.place,
            cost=1,
            targets=of_others,
        ),
        Correction(
            "inverted masks",
            "the masks are inverted: white where the object is not",
            "black and white swapped",
            AS_GIVEN.place,
            targets=inverted,
        ),
    ]


OPENGL, UPSIDE_DOWN = np.diag([1.0, -1, -1]), np.diag([-1.0, -1, 1])


def _pose(key: str, mistake: str, remedy: str, change: Callable) -> Correction:
    def place(instance: Instance) -> Placement:
        R, t = change(instance.item.R, instance.item.t)
        return Placement(instance.K, R, t)

    return Correction(key, mistake, remedy, place)


def _camera(key: str, mistake: str, remedy: str, change: Callable) -> Correction:
    def place(instance: Instance) -> Placement:
        K = change(instance.K, instance.size)
        return Placement(K, instance.item.R, instance.item.t)

    return Correction(key, mistake, remedy, place)


def _of_neighbour(sample: Sample, offset: int) -> Place:
    def place(instance: Instance) -> Placement | None:
        item = sample.neighbour(instance, offset)
        if item is None:
            return None
        view = sample.neighbour_view(instance.view, offset)
        return Placement(view.K, item.R, item.t)

    return place


def _with_turn(turn: np.ndarray) -> Place:
    return lambda instance: Placement(instance.K, instance.item.R @ turn, instance.item.t)


def _turns() -> Iterator[tuple[str, np.ndarray]]:
    """The 23 rotations that permute the axes, with what to call them."""
    for axes in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turn = np.zeros((3, 3))
            turn[axes, range(3)] = signs  # the model's axis k becomes the axis axes[k]
            if np.linalg.det(turn) > 0 and not np.array_equal(turn, np.eye(3)):
                names = [
                    f"{'' if s > 0 else '-'}{'xyz'[a]}" for a, s in zip(axes, signs, strict=True)
                ]
                yield f"x, y, z of the models are {', '.join(names)} of the poses", turn


def _matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
