"""Which points of a cloud are near which: the nearest ones, or those in a ball."""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, require_integer, require_number
from posecore.clouds.sampling import gather_points
from posecore.clouds.search import at_least_float32, ball_indices, nearest_indices, same_batch

__all__ = ["ball_query", "nearest_neighbours"]


@array_function(keeps_half=True, points="... N 3", queries="... M 3")
def nearest_neighbours(points: Array, queries: Array, k: int = 1) -> tuple[Array, Array]:
    """The `k` nearest points of every query, nearest first, equally near ones in order of index.

    A query that is itself in the cloud finds itself (or a copy of itself).

    Args:
        points: (..., N, 3) clouds in which to search.
        queries: (..., M, 3) from where.
        k: how many, at most N.

    Returns:
        Distances (..., M, k) in the unit of the points, and int64 indices (..., M, k) into the N
        points. The search passes no gradient, the distances do (0 where the distance is 0).

    Raises:
        ValueError: if `k` is not between 1 and N, or points are so far apart that squared distances
            overflow.
    """
    require_integer("k", k, 1, points.shape[-2])
    points, queries = same_batch(points, queries)
    indices = nearest_indices(points, queries, k)
    return root(squared_distances_to(points, queries, indices)), indices


@array_function(points="... N 3", queries="... M 3")
@torch.no_grad()
def ball_query(points: Array, queries: Array, radius: float, count: int) -> Array:
    """Up to `count` points closer to each query than `radius`, the first by index.

    The rule of PointNet++ (Qi et al., NeurIPS 2017) and its implementations: a ball with fewer
    points is filled up with copies of its first. An empty ball, possible when the query is not in
    the cloud, is filled with the nearest point.

    Args:
        points: (..., N, 3) clouds in which to search.
        queries: (..., M, 3) centres of the balls.
        radius: the distance, in the unit of the points, below which a point is in the ball.
        count: how many indices to return for each ball; may be more than N.

    Returns:
        (..., M, count) int64 indices into the N points.

    Raises:
        ValueError: if `radius` is not above 0 or `count` is not at least 1, or points are so far
            apart that squared distances overflow.
    """
    require_number("radius", radius, above=0)
    require_integer("count", count, 1)
    points, queries = same_batch(at_least_float32(points), at_least_float32(queries))
    *batch, m, _ = queries.shape
    clouds, centres = points.reshape(-1, points.shape[-2], 3), queries.reshape(-1, m, 3)
    indices = ball_indices(clouds, centres, radius, count)
    empty = indices[..., 0] < 0
    for i in empty.any(1).nonzero()[:, 0]:
        indices[i, empty[i]] = nearest_indices(clouds[i], centres[i, empty[i]], 1)
    return indices.reshape(*batch, m, count)


def squared_distances_to(points: Tensor, queries: Tensor, indices: Tensor) -> Tensor:
    """Squared distances (..., M, k) from queries (..., M, 3) to points (..., N, 3) at `indices`."""
    x, y, z = (gather_points(points, indices) - queries[..., None, :]).square().unbind(-1)
    return x + y + z  # the order of operations of the search


def root(squared: Tensor) -> Tensor:
    """The square root, with gradient 0 instead of infinity at 0."""
    zero = squared == 0
    return squared.masked_fill(zero, 1).sqrt().masked_fill(zero, 0)
