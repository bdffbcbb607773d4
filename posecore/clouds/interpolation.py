"""Features between the points that carry them, as PointNet++ propagates them."""

from __future__ import annotations

import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, require_finite, require_number
from posecore.clouds.neighbours import nearest_neighbours
from posecore.clouds.sampling import table, to_indices

__all__ = ["interpolate", "interpolation_weights", "three_nearest_interpolation"]


@array_function(keeps_half=True, points="... N 3", queries="... M 3")
def interpolation_weights(points: Array, queries: Array, power: float = 2.0) -> tuple[Array, Array]:
    """The three nearest points of every query and the share of each, from the geometry alone.

    The weights are `1 / d^power`, scaled to sum 1 (Qi et al., PointNet++, NeurIPS 2017, Eq. 2, with
    power 2; the backbone of VoteNet, Qi et al., ICCV 2019, has power 1 in its published code). They
    are computed from ratios to the nearest distance, so no small constant keeps them finite: a
    query that coincides with a point has weight 1 there (copies of the point share it equally).

    Args:
        points: (..., N, 3) points that carry features. With fewer than three, all are used.
        queries: (..., M, 3) points that want them.
        power: how fast the share falls with the distance, above 0.

    Returns:
        int64 indices (..., M, 3) into the N points, and weights (..., M, 3), nearest first. The
        last dimension is N where N is smaller than 3.

    Raises:
        ValueError: if `power` is not above 0, or distances are so large that their squares
            overflow.
    """
    power = require_number("power", power, above=0)
    distances, indices = nearest_neighbours(points, queries, min(3, points.shape[-2]))
    require_finite("points and queries", distances, "distances whose squares are finite")
    coincident = distances == 0
    ratio = distances[..., :1] / distances.masked_fill(coincident, 1)
    closeness = ratio.pow(power).masked_fill(coincident, 1)
    return indices, closeness / closeness.sum(-1, keepdim=True)


@array_function(keeps_half=True, features="... N C", weights="... M K")
def interpolate(features: Array, indices: Array, weights: Array) -> Array:
    """Weighted sums of features: what `interpolation_weights` prepared, applied.

    Args:
        features: (..., N, C).
        indices: (..., M, K) integers into the N points.
        weights: (..., M, K).

    Returns:
        (..., M, C), differentiable in features and weights.

    Raises:
        ValueError: if indices and weights differ in shape, or an index is out of range.
    """
    indices = to_indices(indices, features.device)
    if indices.shape != weights.shape:
        fail("indices", f"shape {tuple(weights.shape)} as weights", f"shape {tuple(indices.shape)}")
    *batch, m, k = np.broadcast_shapes((*features.shape[:-2], 1, 1), weights.shape)
    rows, positions = table(features.expand(*batch, -1, -1), indices.expand(*batch, m, k))
    # Sums over rows of a table: no copy of every row for every query.
    sums = torch.nn.functional.embedding_bag(
        positions.reshape(-1, k),
        rows,
        per_sample_weights=weights.expand(*batch, m, k).reshape(-1, k),
        mode="sum",
    )
    return sums.reshape(*batch, m, features.shape[-1])


@array_function(keeps_half=True, points="... N 3", features="... N C", queries="... M 3")
def three_nearest_interpolation(
    points: Array, features: Array, queries: Array, power: float = 2.0
) -> Array:
    """Features at new places, interpolated between the three nearest points that carry them.

    For many passes over one geometry compute `interpolation_weights` once and call `interpolate`.

    Args:
        points: (..., N, 3) where the features are.
        features: (..., N, C).
        queries: (..., M, 3) where they are wanted.
        power: as in `interpolation_weights`.

    Returns:
        (..., M, C), exactly the feature of a point at that point; differentiable.
    """
    return interpolate(features, *interpolation_weights(points, queries, power))
