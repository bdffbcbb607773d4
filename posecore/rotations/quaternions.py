"""Arithmetic of quaternions, the other order of their numbers, and the way between two rotations.

Quaternions are (w, x, y, z). `q` and `-q`, and any positive multiple, are the same rotation.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_finite, somewhere
from posecore.rotations.conversions import (
    _sine_over_angle,
    _unit,
    matrix_to_quaternion,
    quaternion_multiply,
    quaternion_to_matrix,
)
from posecore.rotations.validity import require_rotation

__all__ = [
    "quaternion_apply",
    "quaternion_inverse",
    "quaternion_slerp",
    "slerp",
    "wxyz_to_xyzw",
    "xyzw_to_wxyz",
]


@array_function(q="... 4")
def quaternion_inverse(q: Array) -> Array:
    """The quaternion that undoes `q`: the conjugate divided by the squared length.

    Args:
        q: (..., 4) as (w, x, y, z), of any length but zero.

    Returns:
        (..., 4), the product of which with `q` is (1, 0, 0, 0); of unit length if `q` is.

    Raises:
        ValueError: if a quaternion is zero, or so small that its inverse overflows.
    """
    unit = _unit("q", q)
    # The length by way of the largest entry: squares of small and large numbers are 0 or infinite.
    largest = q.detach().abs().amax(-1, keepdim=True)
    length = torch.linalg.vector_norm(q / largest, dim=-1, keepdim=True)
    inverse = _conjugate(unit) / length / largest
    require_finite("q", inverse, "quaternions whose inverse is finite")
    return inverse


@array_function(q="... 4", points="... N 3")
def quaternion_apply(q: Array, points: Array) -> Array:
    """Rotate points: the vector part of `q (0, x) q^-1`.

    Args:
        q: (..., 4) as (w, x, y, z), of any length but zero; as a rotation it has none.
        points: (..., N, 3).

    Returns:
        (..., N, 3), as long as `points` are.

    Raises:
        ValueError: if a quaternion is zero, or a rotated point overflows.
    """
    rotated = points @ quaternion_to_matrix(q).mT
    require_finite("points", rotated, "points that stay finite when they are rotated")
    return rotated


@array_function(q="... 4")
def wxyz_to_xyzw(q: Array) -> Array:
    """From this library's order of a quaternion to that of SciPy, ROS, Eigen and RoMa.

    Args:
        q: (..., 4) as (w, x, y, z).

    Returns:
        (..., 4) as (x, y, z, w).
    """
    return q.roll(-1, -1)


@array_function(q="... 4")
def xyzw_to_wxyz(q: Array) -> Array:
    """From the order of SciPy, ROS, Eigen and RoMa to this library's.

    Args:
        q: (..., 4) as (x, y, z, w), not as elsewhere here.

    Returns:
        (..., 4) as (w, x, y, z).
    """
    return q.roll(1, -1)


@array_function(p="... 4", q="... 4", fraction="...")
def quaternion_slerp(p: Array, q: Array, fraction: float | Array) -> Array:
    """Spherical linear interpolation: from `p` to `q` by the shorter way, at constant speed.

    Of `q` and `-q` the one nearer to `p` is gone to. Half a turn apart both are equally near, and
    there are two ways: the one is taken whose axis, seen from `p`, has its first entry that is not
    zero positive, as in `matrix_to_axis_angle`. So `p` and `-p` stay where they are, and the sign
    of `q` changes nothing.

    Args:
        p, q: (..., 4) as (w, x, y, z), of any length but zero.
        fraction: (...) of the way, from 0 to 1.

    Returns:
        (..., 4) unit quaternions; at 0 exactly the direction of `p`, at 1 exactly that of `q` or
        `-q`. Gradients are finite, where `p` and `q` are the same rotation too.

    Raises:
        ValueError: if a quaternion is zero or a fraction is not in [0, 1].

    Source:
        Shoemake 1985, "Animating Rotation with Quaternion Curves", section 3.3.
    """
    _require_fraction(fraction)
    p, q = torch.broadcast_tensors(_unit("p", p), _unit("q", q))
    q = q * _sign(quaternion_multiply(_conjugate(p), q))
    # |q - p| = 2 sin(a / 2), exact where a cosine near 1 has lost the angle.
    squared = _squared_angle(((q - p) ** 2).sum(-1) / 4)
    return sum(
        (share * _sine_over_angle(share**2 * squared) / _sine_over_angle(squared))[..., None] * end
        for share, end in ((1 - fraction, p), (fraction, q))
    )


@array_function(R_1="... 3 3", R_2="... 3 3", fraction="...")
def slerp(R_1: Array, R_2: Array, fraction: float | Array) -> Array:
    """From one rotation to another about a fixed axis, by the smaller angle, at constant speed.

    Args:
        R_1, R_2: (..., 3, 3) rotations. Half a turn apart the axis is the one that
            `quaternion_slerp` describes.
        fraction: (...) of the way, from 0 to 1. For all steps of one way give it a dimension:
            `slerp(R_1, R_2, np.linspace(0, 1, 9))` has nine.

    Returns:
        (..., 3, 3), exactly `R_1` at 0 and `R_2` at 1.

    Raises:
        ValueError: if a matrix is not a rotation to 1e-3, or a fraction is not in [0, 1].
    """
    require_rotation("R_1", R_1)
    require_rotation("R_2", R_2)
    _require_fraction(fraction)
    between = quaternion_to_matrix(
        quaternion_slerp(matrix_to_quaternion(R_1), matrix_to_quaternion(R_2), fraction)
    )
    share = fraction[..., None, None]
    return torch.where(share == 0, R_1, torch.where(share == 1, R_2, between))


def _require_fraction(fraction: Tensor) -> None:
    if somewhere(~((fraction >= 0) & (fraction <= 1))):
        got = f"from {fraction.min().item():g} to {fraction.max().item():g}"
        fail("fraction", "numbers from 0 to 1", got)


def _conjugate(q: Tensor) -> Tensor:
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def _sign(q: Tensor) -> Tensor:
    """(..., 1): the sign of the first component that is not zero."""
    w, x, y, z = q.detach().unbind(-1)
    first = torch.where(w != 0, w, torch.where(x != 0, x, torch.where(y != 0, y, z)))
    return first.sign()[..., None]


def _squared_angle(haversine: Tensor) -> Tensor:
    """a^2 from sin(a / 2)^2, with a derivative at 0."""
    small = haversine < 1e-8
    angle = 2 * torch.where(small, 0.5, haversine).sqrt().asin()
    return torch.where(small, 4 * haversine * (1 + haversine / 3), angle**2)
