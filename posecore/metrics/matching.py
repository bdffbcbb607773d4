"""Which estimate belongs to which true pose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from posecore.metrics.pose_table import PoseTable

__all__ = ["each_with_each", "groups", "in_images", "match", "rows_by_key"]

FARTHEST = 1e200  # metres: squares of what is farther apart are infinite, and have no sum


def in_images(table: PoseTable, images: Collection[tuple[int, int]]) -> np.ndarray:
    """Which rows belong to one of the images, given as (scene id, image id): (N,) booleans."""
    wanted = set(images)
    return np.array([image in wanted for image in table.images], dtype=bool)


def match(estimates: PoseTable, ground_truth: PoseTable) -> np.ndarray:
    """For every ground-truth pose the row of its estimate, -1 where there is none: (G,) integers.

    An image with n instances of an object takes the n surest estimates of it; if n > 1 they are
    assigned so that the sum of the distances between the models' origins is smallest.
    """
    matched = np.full(len(ground_truth), -1)
    for candidates, rows in groups(estimates, ground_truth):
        if len(rows) == 1:
            matched[rows[: len(candidates)]] = candidates
            continue
        with np.errstate(over="ignore"):
            gaps = np.linalg.norm(ground_truth.t[rows][:, None] - estimates.t[candidates], axis=-1)
        row, column = linear_sum_assignment(np.minimum(gaps, FARTHEST))
        matched[rows[row]] = candidates[column]
    return matched


def groups(
    estimates: PoseTable,
    ground_truth: PoseTable,
    counts: Mapping[tuple[int, int, int], int] | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each object in each image the rows of its surest estimates, and of its true poses.

    Args:
        estimates, ground_truth: the tables.
        counts: (scene, image, object) -> how many estimates; as many as true poses by default.
    """
    estimated = rows_by_key(estimates)
    counts = {} if counts is None else counts
    for key, rows in rows_by_key(ground_truth).items():
        candidates = np.array(estimated.get(key, []), dtype=int)
        count = counts.get(key, len(rows))
        surest = np.argsort(-estimates.score[candidates], kind="stable")[:count]
        yield candidates[surest], np.array(rows)


def rows_by_key(table: PoseTable) -> dict[tuple[int, int, int], list[int]]:
    """(scene, image, object) -> its rows."""
    rows = defaultdict(list)
    for row, (image, object_id) in enumerate(zip(table.images, table.object_id, strict=True)):
        rows[*image, int(object_id)].append(row)
    return rows


def each_with_each(
    images: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], list[np.ndarray]]]:
    """Every estimate of an image beside every true pose in it.

    Args:
        images: of each image the rows (D,) of the estimates and (G,) of the true poses.

    Returns:
        The rows of the estimates (P,) and of the true poses (P,) of all these pairs, and a function
        that cuts their values (P,) into those of each image (D, G).
    """
    grids = [np.meshgrid(*image, indexing="ij") for image in images]
    one, other = (
        np.concatenate([np.zeros(0, int), *(grid[i].ravel() for grid in grids)]) for i in (0, 1)
    )
    shapes = [grid[0].shape for grid in grids]
    ends = np.cumsum([grid[0].size for grid in grids])[:-1]

    def apart(values: np.ndarray) -> list[np.ndarray]:
        parts = np.split(values, ends) if shapes else []
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

    return one, other, apart
