"""Pairs of neighbouring points: what of them stays as it is when a cloud is turned.

Distances and angles do, and see no difference between a cloud and its mirror image, whose distances
and angles are the same. A determinant of three directions turns with the cloud, too, but changes
its sign in a mirror.

Source: Chen et al., the rotation-invariant paper, Section 3.1, Eq. 1 (distance and two angles);
Drost et al., "Model globally, match locally: Efficient and robust 3D object recognition", CVPR 2010
(the same and the angle between the normals). The determinants are not in them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail
from posecore.clouds.neighbours import root
from posecore.clouds.sampling import gather_points, to_indices
from posecore.clouds.search import same_batch

__all__ = [
    "cross_product_normals",
    "neighbour_directions",
    "pair_determinants",
    "pair_features",
]

COLLINEAR = 64  # roundings: two directions whose cross product is no longer than this are parallel


@array_function(points="... N 3")
def neighbour_directions(points: Array, indices: Array) -> Array:
    """Unit vectors from each point to its neighbours.

    From a point to a copy of itself there is no direction: that is the zero vector, whose cosine
    with any other is 0.

    Args:
        points: (..., N, 3) metres.
        indices: (..., N, K) integers into the N points.

    Returns:
        (..., N, K, 3). Gradients flow to the points, none to and from copies.

    Raises:
        ValueError: if an index is out of range, or shapes do not fit.
    """
    return _directions(_offsets(points, _require_indices(points, indices)))


@array_function(points="... N 3", normals="... N 3")
def pair_features(points: Array, normals: Array, indices: Array, sign_free: bool = False) -> Array:
    """The distance of each point to its neighbours, and the angles of both normals with the way.

    (|p_j - p_i|, angle(n_i, p_j - p_i), angle(n_j, p_j - p_i)), Eq. 1. The same for a cloud that is
    turned, moved or mirrored, with its normals. Angles are those of a scaled cloud too; distances
    are not.

    An angle with no direction, of a zero normal or between copies of a point, is a right one.

    Args:
        points: (..., N, 3) metres.
        normals: (..., N, 3) of length one, or zero where there is none.
        indices: (..., N, K) integers into the N points.
        sign_free: take the angle with the line on which a normal lies, at most a right one: for
            normals whose sign means nothing.

    Returns:
        (..., N, K, 3) metres and radians. Differentiable; where an angle is 0 or pi it has no
        gradient, and is given none.

    Raises:
        ValueError: if an index is out of range, or shapes do not fit.
    """
    points, normals = same_batch(points, normals)
    indices = _require_indices(points, indices)
    offsets = _offsets(points, indices)
    x, y, z = offsets.square().unbind(-1)
    toward = _directions(offsets)
    angles = [
        _angle(normal, toward, sign_free)
        for normal in (normals[..., None, :], gather_points(normals, indices))
    ]
    return torch.stack([root(x + y + z), *angles], -1)


@array_function(points="... N 3", normals="... N 3", view="... 3")
def pair_determinants(
    points: Array, normals: Array, indices: Array, view: Array | None = None
) -> Array:
    """What distinguishes a pair of points from its mirror image.

    (det(n_i, u, n_j), det(n_i, u, view)) with u the direction of p_j - p_i. The same for a cloud
    that is turned or moved, with its normals and the view; of opposite sign in a mirror. Normals
    have to be oriented by what is turned with the cloud, such as the side of the camera: with the
    sign of one of them these signs change.

    Args:
        points: (..., N, 3) metres.
        normals: (..., N, 3) of length one.
        indices: (..., N, K) integers into the N points.
        view: (..., 3) a direction that is turned with the cloud, such as that of the camera; None
            for the first determinant only.

    Returns:
        (..., N, K, 2), or (..., N, K, 1) without a view; from -1 to 1.

    Raises:
        ValueError: if an index is out of range, or shapes do not fit.
    """
    batch = torch.broadcast_shapes(
        points.shape[:-2], normals.shape[:-2], () if view is None else view.shape[:-1]
    )
    points, normals = (x.expand(*batch, -1, -1) for x in (points, normals))
    indices = _require_indices(points, indices)
    toward = _directions(_offsets(points, indices))
    across = torch.linalg.cross(normals[..., None, :].expand_as(toward), toward)
    found = [(across * gather_points(normals, indices)).sum(-1)]
    if view is not None:
        found.append((across * view[..., None, None, :]).sum(-1))
    return torch.stack(found, -1)


@array_function(points="... N 3")
def cross_product_normals(points: Array, indices: Array) -> Array:
    """Normals as the paper has them: the cross product of the ways to the two nearest points.

    Their sign is that of the order of these two, so as good as a coin's, and a little noise turns
    them far. `estimate_normals` has neither fault.

    Args:
        points: (..., N, 3) metres.
        indices: (..., N, K) integers into the N points, the nearest first; two at least.

    Returns:
        (..., N, 3) of length one, or zero where both lie on one line with the point, or in its
        place.

    Raises:
        ValueError: if there are fewer than two, an index is out of range, or shapes do not fit.
    """
    indices = _require_indices(points, indices)
    if indices.shape[-1] < 2:
        fail("indices", "two neighbours or more", f"shape {tuple(indices.shape)}")
    first, second = _directions(_offsets(points, indices[..., :2])).unbind(-2)
    across = torch.linalg.cross(first, second)
    length = root(across.square().sum(-1, keepdim=True))
    none = length <= COLLINEAR * torch.finfo(points.dtype).eps
    return (across / length.masked_fill(none, 1)).masked_fill(none, 0)


def _require_indices(points: Tensor, indices: Array) -> Tensor:
    indices = to_indices(indices, points.device)
    if indices.ndim != points.ndim or indices.shape[:-1] != points.shape[:-1]:
        expected = f"shape {(*points.shape[:-1], 'K')}".replace("'", "")
        fail("indices", expected, f"shape {tuple(indices.shape)}")
    return indices


def _offsets(points: Tensor, indices: Tensor) -> Tensor:
    return gather_points(points, indices) - points[..., None, :]


def _directions(offsets: Tensor) -> Tensor:
    longest = offsets.detach().abs().amax(-1, keepdim=True)
    none = longest == 0
    # By the longest component first: the squares of tiny offsets would vanish.
    scaled = offsets / longest.masked_fill(none, 1)
    return scaled / scaled.square().sum(-1, keepdim=True).masked_fill(none, 1).sqrt()


def _angle(normal: Tensor, toward: Tensor, sign_free: bool) -> Tensor:
    """Radians, as the arc tangent, which is exact for small angles too."""
    across = torch.linalg.cross(normal.expand_as(toward), toward)
    sine = root(across.square().sum(-1))
    cosine = (normal * toward).sum(-1)
    if sign_free:
        cosine = cosine.abs()
    none = (sine == 0) & (cosine == 0)
    return torch.atan2(sine.masked_fill(none, 1), cosine)
