"""The objects of a dataset, as networks have to know them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from data_tools.views import ModelSet
from posecore.arrays import fail
from posecore.models import ObjectModel, model_keypoints, require_models

__all__ = ["object_models"]


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
        models.append(ObjectModel(object_id, drawn, info.diameter, chosen, info.symmetries()))
    return require_models(models)
