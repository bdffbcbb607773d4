"""Distances, diameters and depths that cannot belong together: units that were taken for others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from data_tools.views import Dataset, View
from posecore.metrics.pose_table import PoseTable

__all__ = ["of_dataset", "of_tables"]

DIAMETERS = (1e-3, 20.0)  # metres: of anything whose pose is estimated
DISTANCES = (0.01, 100.0)  # metres from the camera
TIMES = (0.5, 300.0)  # as far as the object is large: from within it to a few pixels
FACTOR = 20  # between the depth that is measured on an object and where its pose has it
VIEWS = 3  # of a dataset are looked at
HINT = "check the units: BOP and DenseFusion have millimetres on disk, PVNet has metres"


def of_tables(tables: Mapping[str, PoseTable], diameters: Mapping[int, float]) -> Iterator[str]:
    """What looks odd in tables of poses.

    Args:
        tables: the estimates and the ground truth, by what to call them.
        diameters: of the objects that have a model, metres.

    Returns:
        Sentences.
    """
    for object_id, diameter in diameters.items():
        yield from _of_diameter(f"object {object_id}", diameter)
    medians = []
    for name, table in tables.items():
        if not len(table):
            continue
        distances = _lengths(table.t)
        medians.append(float(np.median(distances)))
        if text := _of_distance(f"the {name}: half of the objects are", medians[-1]):
            yield text
            continue
        for object_id, diameter in diameters.items():
            mine = distances[table.object_id == object_id]
            if len(mine) and (text := _of_both(float(np.median(mine)), diameter)):
                yield f"the {name}: object {object_id} is {text}"
    if len(medians) == 2 and not 1 / 50 < medians[0] / max(medians[1], 1e-300) < 50:
        first, second = (f"{name} are {m:.3g} m" for name, m in zip(tables, medians, strict=True))
        yield f"{first} from the camera, {second}: both files should be in millimetres"


def of_dataset(dataset: Dataset) -> Iterator[str]:
    """What looks odd in some views of a dataset; each kind is said once.

    A view that cannot be read is left to whoever needs it.

    Returns:
        Sentences.
    """
    count, seen = len(dataset), set()
    for index in sorted({i * (count - 1) // max(1, VIEWS - 1) for i in range(min(VIEWS, count))}):
        try:
            view = dataset[index]
        except (ValueError, OSError):
            continue
        for kind, text in _of_view(view):
            if kind not in seen:
                seen.add(kind)
                yield f"scene {view.scene_id}, image {view.image_id}: {text}"


def _of_view(view: View) -> Iterator[tuple[str, str]]:
    for item in view.objects:
        name, distance = f"object {item.object_id}", float(_lengths(item.t[None])[0])
        if item.size is not None:
            diameter = float(_lengths(item.size[None])[0])
            for text in _of_diameter(name, diameter):
                yield "diameter", text
            if text := _of_both(distance, diameter):
                yield "both", f"{name} is {text}"
        if text := _of_distance(f"{name} is", distance):
            yield "distance", text
        depth = None if view.depth is None or item.mask is None else view.depth[item.mask]
        if depth is not None and (depth > 0).any():
            measured = float(np.median(depth[depth > 0]))
            if not 1 / FACTOR < measured / max(distance, 1e-300) < FACTOR:
                yield (
                    "depth",
                    f"the depth image has {name} at {measured:.3g} m, its pose at {distance:.3g} "
                    "m: check depth_scale, the millimetres of one unit of depth images",
                )


def _of_diameter(name: str, diameter: float) -> Iterator[str]:
    if not DIAMETERS[0] < diameter < DIAMETERS[1]:
        yield f"{name} is {diameter:.3g} m large: {HINT}"


def _of_distance(name: str, distance: float) -> str | None:
    if DISTANCES[0] < distance < DISTANCES[1]:
        return None
    return f"{name} {distance:.3g} m from the camera: {HINT}"


def _of_both(distance: float, diameter: float) -> str | None:
    if TIMES[0] < distance / diameter < TIMES[1]:
        return None
    return f"{distance:.3g} m from the camera, but {diameter:.3g} m large: {HINT}"


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Of (N, 3), even where their squares overflow."""
    largest = np.abs(vectors).max(-1)
    scale = np.where(largest > 0, largest, 1.0)
    return np.linalg.norm(vectors / scale[:, None], axis=-1) * np.minimum(scale, 1e300)
