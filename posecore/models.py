"""What has to be known of an object: its points, its size, its keypoints and its symmetries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_integer,
    require_number,
    to_numbers,
)
from posecore.clouds import farthest_point_sampling
from posecore.symmetry import require_symmetries

__all__ = ["ObjectModel", "model_keypoints", "require_models"]


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object in its own frame; lengths in metres.

    Attributes:
        object_id: its number in the dataset.
        points: (P, 3) points of the model: for errors the vertices of its mesh, as datasets define
            them; for networks as many points of its surface as they need.
        diameter: the largest distance between two points of the model.
        keypoints: (K, 3) what a network is to find, or None; the last one is the object's centre.
        symmetries: (S, 4, 4) transforms that leave it as it is, identity included, or None.
        centre, size: (3,) the middle and the edges of the box around it, along the axes of its
            frame; if they are not given, of the box around `points`.

    Raises:
        ValueError: naming the attribute that cannot be.
    """

    object_id: int
    points: np.ndarray
    diameter: float
    keypoints: np.ndarray | None = None
    symmetries: np.ndarray | None = None
    centre: np.ndarray | None = None
    size: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = _cloud("points", self.points, 1)
        low, high = points.min(0), points.max(0)
        values = {
            "object_id": require_integer("object_id", self.object_id, 0),
            "points": points,
            "diameter": require_number("diameter", self.diameter, above=0),
            "centre": (low + high) / 2 if self.centre is None else _vector("centre", self.centre),
            "size": high - low if self.size is None else _vector("size", self.size),
        }
        if self.keypoints is not None:
            values["keypoints"] = _cloud("keypoints", self.keypoints, 4)
        if self.symmetries is not None:
            symmetries = to_numbers("symmetries", self.symmetries)
            if symmetries.ndim != 3 or symmetries.shape[1:] != (4, 4) or not len(symmetries):
                fail("symmetries", "shape (S, 4, 4)", f"shape {symmetries.shape}")
            require_symmetries(torch.from_numpy(symmetries))
            values["symmetries"] = symmetries
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def symmetric(self) -> bool:
        """Whether another pose looks the same."""
        return self.symmetries is not None and len(self.symmetries) > 1


def require_models(models: Sequence[ObjectModel]) -> list[ObjectModel]:
    """Models with keypoints as a list.

    Raises:
        ValueError: if there are none, one is none, two have the same id, or they have no keypoints
            or not equally many.
    """
    models = list(models)
    if not models or not all(isinstance(model, ObjectModel) for model in models):
        fail("models", "at least one ObjectModel", [type(model).__name__ for model in models])
    ids = [model.object_id for model in models]
    if len(set(ids)) < len(ids):
        fail("models", "different object ids", ids)
    counts = [0 if model.keypoints is None else len(model.keypoints) for model in models]
    if 0 in counts or len(set(counts)) > 1:
        fail("models", "equally many keypoints each", counts)
    return models


@array_function(points="P 3")
def model_keypoints(points: Array, count: int = 8) -> Array:
    """Points spread over the object's surface, and the centre of its box.

    Each is the point farthest from the centre and from those before it. On the surface a network
    finds them better than the corners of the box (Peng et al., PVNet, CVPR 2019, section 3.1).

    Args:
        points: (P, 3) points on the surface, in the object's frame.
        count: how many of them, at most P.

    Returns:
        (count + 1, 3), the centre of the bounding box last.

    Raises:
        ValueError: if `count` is not between 1 and P.
    """
    chosen = farthest_point_sampling(points, count, start="farthest_from_centre")
    centre = (points.amin(0) + points.amax(0)) / 2
    return torch.cat([points[chosen], centre[None]])


def _cloud(name: str, values: object, least: int) -> np.ndarray:
    points = to_numbers(name, values)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        fail(name, f"shape (N, 3) with N of at least {least}", f"shape {points.shape}")
    if not np.isfinite(points).all():
        fail(name, "finite numbers", f"{int((~np.isfinite(points)).sum())} that are not")
    return points


def _vector(name: str, values: object) -> np.ndarray:
    vector = to_numbers(name, values)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        fail(name, "three finite numbers", vector.tolist())
    return vector
