"""What has to be known of an object to estimate its pose from a vector field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh

from data_tools.views import ModelSet
from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.methods.vector_field.keypoints import model_keypoints
from posecore.metrics.pose_errors import require_symmetries

__all__ = ["ObjectModel", "object_models", "require_models"]


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object of a system, in its own frame; lengths in metres.

    Attributes:
        object_id: its number in the dataset.
        points: (P, 3) points of its surface.
        keypoints: (K, 3) what the field points at; the last one is the object's centre.
        diameter: the largest distance between two of its points.
        symmetries: (S, 4, 4) transforms that leave it as it is, identity included, or None.

    Raises:
        ValueError: naming the attribute that cannot be.
    """

    object_id: int
    points: np.ndarray
    keypoints: np.ndarray
    diameter: float
    symmetries: np.ndarray | None = None

    def __post_init__(self) -> None:
        values = {
            "object_id": require_integer("object_id", self.object_id, 0),
            "points": _cloud("points", self.points, 1),
            "keypoints": _cloud("keypoints", self.keypoints, 4),
            "diameter": require_number("diameter", self.diameter, above=0),
        }
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


def object_models(
    known: ModelSet, object_ids: Sequence[int], *, points: int = 2000, keypoints: int = 8
) -> list[ObjectModel]:
    """Models of a dataset's objects.

    Args:
        known: what a dataset gives for `models()`.
        object_ids: which.
        points: drawn evenly from each surface, the same ones every time.
        keypoints: on the surface; the centre comes to them.

    Raises:
        ValueError: if there is no such object, or one has no surface.
    """
    models = []
    for object_id in object_ids:
        mesh, info = known.mesh(object_id), known.info(object_id)
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        if not surface.area > 0:
            fail("known", f"a surface of object {object_id}", f"{len(mesh.faces)} faces of area 0")
        drawn, _ = trimesh.sample.sample_surface(surface, points, seed=object_id)
        drawn = np.asarray(drawn, np.float64)
        chosen = model_keypoints(drawn, keypoints)
        models.append(ObjectModel(object_id, drawn, chosen, info.diameter, info.symmetries()))
    return require_models(models)


def require_models(models: Sequence[ObjectModel]) -> list[ObjectModel]:
    """The models as a list.

    Raises:
        ValueError: if there are none, one is none, two have the same id, or their numbers of
            keypoints differ.
    """
    models = list(models)
    if not models or not all(isinstance(model, ObjectModel) for model in models):
        fail("models", "at least one ObjectModel", [type(model).__name__ for model in models])
    ids = [model.object_id for model in models]
    if len(set(ids)) < len(ids):
        fail("models", "different object ids", ids)
    counts = [len(model.keypoints) for model in models]
    if len(set(counts)) > 1:
        fail("models", "equally many keypoints each", counts)
    return models


def _cloud(name: str, values: object, least: int) -> np.ndarray:
    points = to_numbers(name, values)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        fail(name, f"shape (N, 3) with N of at least {least}", f"shape {points.shape}")
    if not np.isfinite(points).all():
        fail(name, "finite numbers", f"{int((~np.isfinite(points)).sum())} that are not")
    return points
