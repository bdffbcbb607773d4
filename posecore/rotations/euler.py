"""Euler angles: three rotations about coordinate axes, one after the other.

A convention is three letters, as in SciPy. Upper case is intrinsic, each axis as turned by the
rotations before it: "YXZ" is Ry(a) Rx(b) Rz(c). Lower case is extrinsic, all axes fixed: "yxz" is
Rz(c) Rx(b) Ry(a). In both, the angles stand in the order of the letters.

The default "YXZ" is that of the head: yaw, pitch, roll.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail
from posecore.rotations.conversions import matrix_to_quaternion

__all__ = ["euler_to_matrix", "matrix_to_euler"]


@array_function(angles="... 3")
def euler_to_matrix(angles: Array, convention: str = "YXZ") -> Array:
    """The rotation of three Euler angles.

    Args:
        angles: (..., 3) in radians.
        convention: three axes, upper case intrinsic, lower case extrinsic.

    Returns:
        (..., 3, 3).

    Raises:
        ValueError: if `convention` is not of that form or names an axis twice in a row.
    """
    axes = _axes(convention)
    turns = [_about(axis, angle) for axis, angle in zip(axes, angles.unbind(-1), strict=True)]
    first, second, third = turns if convention.isupper() else turns[::-1]
    return first @ second @ third


@array_function(R="... 3 3")
def matrix_to_euler(R: Array, convention: str = "YXZ") -> Array:
    """The three Euler angles of a rotation.

    The first and third are between -pi and pi, the second between -pi/2 and pi/2, or between 0 and
    pi where the first axis comes again as third. At either end of the second (gimbal lock, to eight
    roundings) only one of the others can be told: the third is zero then, and so is the gradient of
    what cannot be told. The angles give `R` back always.

    Args:
        R: (..., 3, 3) rotation.
        convention: three axes, upper case intrinsic, lower case extrinsic.

    Returns:
        (..., 3) in radians, in the order of `convention`.

    Raises:
        ValueError: if `R` is not a rotation to 1e-3, or on a wrong `convention`.

    Source:
        Bernardes and Viollet 2022, "Quaternion to Euler angles conversion".
    """
    i, j, last = _axes(convention)
    intrinsic = convention.isupper()
    if not intrinsic:
        i, last = last, i  # fixed axes are turned axes in the opposite order
    q = matrix_to_quaternion(R)
    k = 3 - i - j  # the third axis, which `last` is too unless it is i again
    sign = 1 if (j - i) % 3 == 1 else -1  # whether i, j, k is right-handed
    w, x, y, z = q[..., 0], q[..., 1 + i], q[..., 1 + j], sign * q[..., 1 + k]
    if last != i:
        # R Rj(pi/2) = Ri(a) Rj(b + pi/2) Ri(-sign c): a convention that ends with its first axis.
        w, x, y, z = (part / math.sqrt(2) for part in (w - y, x - z, y + w, z + x))
    # The quaternion of Ri(a) Rj(b) Ri(c) is two pairs: cos(b/2) times cosine and sine of (a + c)/2,
    # sin(b/2) times cosine and sine of (a - c)/2.
    cosine = torch.linalg.vector_norm(torch.stack([w, x], -1), dim=-1)
    sine = torch.linalg.vector_norm(torch.stack([y, z], -1), dim=-1)
    b = 2 * torch.atan2(sine, cosine)
    lock = 8 * torch.finfo(R.dtype).eps
    half_sum, half_difference = torch.atan2(x, w), torch.atan2(z, y)
    free = 1 if intrinsic else -1
    half_sum, half_difference = (
        torch.where(cosine > lock, half_sum, free * half_difference),
        torch.where(sine > lock, half_difference, free * half_sum),
    )
    a, c = _wrap(half_sum + half_difference), half_sum - half_difference
    if last != i:
        b, c = b - math.pi / 2, -sign * c
    c = _wrap(c)
    return torch.stack([a, b, c] if intrinsic else [c, b, a], -1)


def _axes(convention: str) -> list[int]:
    axes = ["xyz".find(letter) for letter in str(convention).lower()]
    one_case = isinstance(convention, str) and (convention.isupper() or convention.islower())
    if not one_case or len(axes) != 3 or min(axes) < 0 or axes[1] in (axes[0], axes[2]):
        fail(
            "convention",
            'three letters of "XYZ" (intrinsic) or "xyz" (extrinsic), no two neighbours equal',
            repr(convention),
        )
    return axes


def _about(axis: int, angle: Tensor) -> Tensor:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = angle.new_zeros(*angle.shape, 3, 3)
    R[..., axis, axis] = 1
    R[..., j, j] = R[..., k, k] = angle.cos()
    R[..., k, j] = angle.sin()
    R[..., j, k] = -R[..., k, j]
    return R


def _wrap(angle: Tensor) -> Tensor:
    return angle - 2 * math.pi * torch.round(angle / (2 * math.pi))
