"""Any finite outputs of a network as a rotation, with finite gradients.

The functions of `rotations` refuse what is no rotation: a zero quaternion, two parallel vectors. A
network may say anything, so here such outputs have a stated answer, of zero gradient in what could
not be told. All zeros give the identity. Numbers of a size below 1e-24 in float32 (1e-276 in
float64) count as zero: a gradient, which is inverse to the size, would soon overflow.

Outputs in half precision, as autocast leaves them, give rotations in float32.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function
from posecore.rotations import (
    axis_angle_to_matrix,
    euler_to_matrix,
    quaternion_to_matrix,
    rotation_6d_to_matrix,
    special_procrustes,
)

__all__ = [
    "decode_6d",
    "decode_axis_angle",
    "decode_euler",
    "decode_procrustes",
    "decode_quaternion",
    "full_precision",
]


def full_precision(x: Tensor) -> Tensor:
    """Half precision as float32, since it is too coarse for a rotation."""
    return x if x.dtype in (torch.float32, torch.float64) else x.float()


@array_function(outputs="... 4")
def decode_quaternion(outputs: Array) -> Array:
    """The rotation of a quaternion of any length.

    Args:
        outputs: (..., 4) as (w, x, y, z); zero is the identity.

    Returns:
        (..., 3, 3) rotation.
    """
    q = full_precision(outputs)
    return quaternion_to_matrix(torch.where(_is_zero(q), q.new_tensor([1, 0, 0, 0]), q))


@array_function(outputs="... 6")
def decode_6d(outputs: Array) -> Array:
    """Two vectors made the first two columns of a rotation (Gram-Schmidt).

    Args:
        outputs: (..., 6) the first vector, then the second. A zero first is the x axis. A second
            that is zero, or parallel to the first to rounding, is the coordinate axis that is the
            farthest from the first.

    Returns:
        (..., 3, 3) rotation.

    Source:
        Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural Networks",
        Section 4.2.
    """
    first, second = full_precision(outputs).split(3, -1)
    axes = torch.eye(3).to(first)
    first = torch.where(_is_zero(first), axes[0], first)
    with torch.no_grad():
        unit_1, unit_2 = _unit(first), _unit(second)
        rest = unit_2 - (unit_1 * unit_2).sum(-1, keepdim=True) * unit_1
        # Twice the bound at which rotation_6d_to_matrix refuses.
        parallel = torch.linalg.vector_norm(rest, dim=-1, keepdim=True) <= 16 * _eps(first)
        farthest = axes[first.abs().argmin(-1)]
    second = torch.where(parallel | _is_zero(second), farthest, second)
    return rotation_6d_to_matrix(torch.cat([first, second], -1))


@array_function(outputs="... 9")
def decode_procrustes(outputs: Array) -> Array:
    """The rotation nearest to a matrix, `rotations.special_procrustes`.

    Args:
        outputs: (..., 9) the matrix, row by row.

    Returns:
        (..., 3, 3) rotation.

    Source:
        Levinson et al. 2020, "An Analysis of SVD for Deep Rotation Estimation". Brégier 2021, "Deep
        Regression on Manifolds: A 3D Rotation Case Study".
    """
    return special_procrustes(outputs.unflatten(-1, (3, 3)))


@array_function(outputs="... 3")
def decode_axis_angle(outputs: Array) -> Array:
    """The rotation about a vector by its length.

    Args:
        outputs: (..., 3) in radians. Entries beyond 1 / eps (8e6 in float32), where the next number
            is more than half a radian away, are clipped to it.

    Returns:
        (..., 3, 3) rotation.
    """
    v = full_precision(outputs)
    return axis_angle_to_matrix(v.clamp(-1 / _eps(v), 1 / _eps(v)))


@array_function(outputs="... 3")
def decode_euler(outputs: Array) -> Array:
    """The rotation of three Euler angles, intrinsic y, x, z: the yaw, pitch and roll of a head.

    Args:
        outputs: (..., 3) in radians.

    Returns:
        (..., 3, 3) rotation.
    """
    return euler_to_matrix(full_precision(outputs))


def _is_zero(v: Tensor) -> Tensor:  # (..., n) -> (..., 1)
    number = torch.finfo(v.dtype)
    return v.abs().amax(-1, keepdim=True) < number.tiny / number.eps**2


def _unit(v: Tensor) -> Tensor:
    # Largest entry first: the squares of very small or large numbers are 0 or infinite.
    v = v / v.abs().amax(-1, keepdim=True).clamp_min(torch.finfo(v.dtype).tiny)
    return torch.nn.functional.normalize(v, dim=-1)


def _eps(v: Tensor) -> float:
    return torch.finfo(v.dtype).eps
