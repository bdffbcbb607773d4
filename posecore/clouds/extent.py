"""How large a cloud is."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from posecore.arrays import Array, array_function, require_finite

__all__ = ["diameter"]

SWEEPS = 4  # from a point to the farthest one; after a few of them it is nearly the diameter
BLOCK = 1024  # points that look for their farthest one at once
SLACK = 1e-12  # of the extent: what rounding may do to a bound


@array_function(points="... N 3")
def diameter(points: Array) -> Array:
    """The largest distance between two points of a cloud, exact to rounding.

    BOP's `diameter` of an object is that of the vertices of its mesh.

    Args:
        points: (..., N, 3).

    Returns:
        (...) in the unit of the points; 0 for a single point. Gradients flow to the two points.

    Raises:
        ValueError: if distances are so large that their squares overflow.
    """
    require_finite("points", points)  # what is no number would be nearest and farthest of all
    clouds = points.reshape(-1, *points.shape[-2:])
    ends = [_farthest_pair(cloud) for cloud in clouds.detach().cpu().double().numpy()]
    one, other = torch.tensor(ends, dtype=torch.int64, device=points.device).reshape(-1, 2).T
    row = torch.arange(len(clouds), device=points.device)
    found = torch.linalg.vector_norm(clouds[row, one] - clouds[row, other], dim=-1)
    require_finite("points", found, "points whose squared distances are finite")
    return found.reshape(points.shape[:-2])


def _farthest_pair(points: np.ndarray) -> tuple[int, int]:
    """The indices of two points, (N, 3), that are farthest from each other.

    Seen from some middle, |p - q|^2 = |p|^2 + |q|^2 - 2 p q. The q farthest from p has the smallest
    |p|^2 + 2 p q - |q|^2 + C = |p + q|^2 + (C - 2 |q|^2), which is a squared distance in four
    dimensions: a tree finds it. Only a few p near the rim are worth it, as no point is farther from
    p than |p| + max |q|.
    """
    unit = np.abs(points).max()
    points = points / (unit if unit > 0 else 1.0)
    points = points - points.mean(0)
    best, pair = _swept(points)
    if best == 0:
        return pair
    # The smaller the ball around all points, the fewer are near its rim.
    middles = ((points.min(0) + points.max(0)) / 2, points[list(pair)].mean(0))
    points = min((points - middle for middle in middles), key=lambda p: np.square(p).sum(1).max())
    squared = np.square(points).sum(1)
    kept = np.flatnonzero(np.sqrt(squared) + np.sqrt(squared.max()) >= np.sqrt(best) * (1 - SLACK))
    kept = kept[np.argsort(-squared[kept], kind="stable")]
    rim, squared = points[kept], squared[kept]
    tree = cKDTree(np.column_stack([-rim, np.sqrt(2 * (squared[0] - squared))]))
    for begin in range(0, len(rim), BLOCK):
        # A pair that is farther apart than the best one is nearer than this in four dimensions.
        limit = 2 * (squared[begin] + squared[0]) - best + SLACK
        if limit < 0:
            break  # and so the others, which are nearer to the middle
        block = rim[begin : begin + BLOCK]
        flat = np.column_stack([block, np.zeros(len(block))])
        _, index = tree.query(flat, distance_upper_bound=np.sqrt(limit))
        seen = np.flatnonzero(index < len(rim))
        if len(seen) == 0:
            continue
        distances = np.square(block[seen] - rim[index[seen]]).sum(1)
        i = int(distances.argmax())
        if distances[i] > best:
            best, pair = (
                float(distances[i]),
                (int(kept[begin + seen[i]]), int(kept[index[seen[i]]])),
            )
    return pair


def _swept(points: np.ndarray) -> tuple[float, tuple[int, int]]:
    """The squared distance of a pair that is nearly the farthest, and that pair."""
    one, best, pair = int(np.square(points).sum(1).argmax()), 0.0, (0, 0)
    for _ in range(SWEEPS):
        distances = np.square(points - points[one]).sum(1)
        other = int(distances.argmax())
        if distances[other] > best:
            best, pair = float(distances[other]), (one, other)
        one = other
    return best, pair
