"""Clouds as samples of a surface: the distance between two, and normals."""

from __future__ import annotations

import torch

from posecore.arrays import Array, array_function, require_integer
from posecore.clouds.neighbours import root, squared_distances_to
from posecore.clouds.sampling import gather_points
from posecore.clouds.search import nearest_indices, same_batch

__all__ = ["chamfer_distance", "estimate_normals"]


@array_function(a="... N 3", b="... M 3")
def chamfer_distance(a: Array, b: Array, squared: bool = False) -> Array:
    """The mean distance of `a`'s points to their nearest in `b`, plus the same from `b` to `a`.

    Definitions differ by factors of two and by squaring; this one is a sum of two means, of
    distances in metres (Fan et al., CVPR 2017, sum squared distances without dividing).

    Args:
        a: (..., N, 3) clouds.
        b: (..., M, 3) clouds.
        squared: average squared distances instead.

    Returns:
        (...) differentiable in both clouds; the gradient is 0 where points coincide.

    Raises:
        ValueError: if points are so far apart that squared distances overflow.
    """
    a, b = same_batch(a, b)
    total = 0
    for source, target in ((a, b), (b, a)):
        nearest = nearest_indices(target, source, 1, settle_ties=False, names="a and b")
        distance = squared_distances_to(target, source, nearest)[..., 0]
        total = total + (distance if squared else root(distance)).mean(-1)
    return total


@array_function(points="... N 3", orient_to="... 3")
@torch.no_grad()
def estimate_normals(points: Array, k: int = 16, orient_to: Array | None = None) -> Array:
    """Unit normals of the surface on which the points lie.

    The normal of a point is the direction in which its `k` nearest points (itself among them)
    spread least: the last principal component (Hoppe et al., SIGGRAPH 1992). It depends on the
    neighbours as a set, not on the order of the cloud. Where they leave it open the result is still
    a unit vector: perpendicular to the line if they lie on one, arbitrary if they are all the same
    point. Clouds of depth sensors contain such points, and one should not cost the whole cloud.

    Args:
        points: (..., N, 3) clouds.
        k: number of neighbours, from 3 to N.
        orient_to: (..., 3) the side from which the surface is seen, such as the camera's centre:
            normals point to that side. By default they point away from the centroid of the cloud,
            which suits closed, roughly convex shapes; for a flat cloud give `orient_to`.

    Returns:
        (..., N, 3) normals, without gradient.

    Raises:
        ValueError: if `k` is not between 3 and N, or points are so far apart that squared distances
            overflow.
    """
    require_integer("k", k, 3, points.shape[-2])
    neighbours = gather_points(points, nearest_indices(points, points, k, names="points")).double()
    centred = neighbours - neighbours.mean(-2, keepdim=True)  # (..., N, k, 3)
    normals = torch.linalg.eigh(centred.mT @ centred).eigenvectors[..., 0]  # least spread first
    if orient_to is None:
        outward = points - points.mean(-2, keepdim=True)
    else:
        outward = orient_to[..., None, :] - points
    inward = (normals * outward).sum(-1, keepdim=True) < 0
    return torch.where(inward, -normals, normals).to(points.dtype)
