"""From one representation of a rotation to another: matrix, quaternion, axis-angle, 6D.

Quaternions are (w, x, y, z); SciPy and RoMa put w last. An axis-angle is a vector along the axis
whose length is the angle in radians. Euler angles have a module of their own.

All are differentiable, with finite gradients at the identity and at half turns too.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_finite, values_known
from posecore.rotations.validity import blocks, entries, many, require_rotation

__all__ = [
    "axis_angle_to_matrix",
    "axis_angle_to_quaternion",
    "matrix_to_axis_angle",
    "matrix_to_quaternion",
    "matrix_to_rotation_6d",
    "quaternion_multiply",
    "quaternion_to_axis_angle",
    "quaternion_to_matrix",
    "rotation_6d_to_matrix",
]


@array_function(q="... 4")
def quaternion_to_matrix(q: Array) -> Array:
    """The rotation of a quaternion, whatever its length.

    Args:
        q: (..., 4) as (w, x, y, z), not zero; `q` and `-q` are the same rotation.

    Returns:
        (..., 3, 3).

    Raises:
        ValueError: if a quaternion is zero.
    """
    w, x, y, z = _unit("q", q).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


@array_function(R="... 3 3")
def matrix_to_quaternion(R: Array) -> Array:
    """The unit quaternion of a rotation, (w, x, y, z) with w >= 0.

    Half turns have w = 0; then the first of x, y, z that is not zero is positive.

    The entries of `R` give all ten products of two components. Of the four rows w q, x q, y q, z q
    the one with the largest factor is taken, so that nothing small is divided by.

    Args:
        R: (..., 3, 3) rotation.

    Returns:
        (..., 4).

    Raises:
        ValueError: if `R` is not a rotation to 1e-3.

    Source:
        Shepperd 1978, "Quaternion from Rotation Matrix".
    """
    require_rotation("R", R)
    if values_known() and many(R):
        parts = [_matrix_to_quaternion(block) for block in blocks(R)]
        return torch.cat(parts).reshape(*R.shape[:-2], 4)
    return _matrix_to_quaternion(R)


def _matrix_to_quaternion(R: Tensor) -> Tensor:
    (r_xx, r_xy, r_xz), (r_yx, r_yy, r_yz), (r_zx, r_zy, r_zz) = entries(R)
    # Four times the products.
    ww, xx = 1 + r_xx + r_yy + r_zz, 1 + r_xx - r_yy - r_zz
    yy, zz = 1 - r_xx + r_yy - r_zz, 1 - r_xx - r_yy + r_zz
    wx, wy, wz = r_zy - r_yz, r_xz - r_zx, r_yx - r_xy
    xy, xz, yz = r_xy + r_yx, r_xz + r_zx, r_yz + r_zy
    # The largest of four, the first of equal ones: of w and x, of y and z, and of these two.
    x_wins, z_wins = xx > ww, zz > yy
    late = torch.where(z_wins, zz, yy) > torch.where(x_wins, xx, ww)
    row = [
        torch.where(late, torch.where(z_wins, z, y), torch.where(x_wins, x, w))
        for w, x, y, z in ((ww, wx, wy, wz), (wx, xx, xy, xz), (wy, xy, yy, yz), (wz, xz, yz, zz))
    ]
    q = torch.stack(row, -1)
    return _standard_sign(q / torch.linalg.vector_norm(q, dim=-1, keepdim=True))


@array_function(p="... 4", q="... 4")
def quaternion_multiply(p: Array, q: Array) -> Array:
    """Hamilton's product: the rotation of `q` followed by that of `p`.

    Args:
        p, q: (..., 4) as (w, x, y, z).

    Returns:
        (..., 4); unit if both are.

    Raises:
        ValueError: if products overflow.
    """
    p, q = torch.broadcast_tensors(p, q)
    p_w, p_v = p[..., :1], p[..., 1:]
    q_w, q_v = q[..., :1], q[..., 1:]
    w = p_w * q_w - (p_v * q_v).sum(-1, keepdim=True)
    v = p_w * q_v + q_w * p_v + torch.linalg.cross(p_v, q_v)
    require_finite("p and q", w, "quaternions whose products are finite")
    require_finite("p and q", v, "quaternions whose products are finite")
    return torch.cat([w, v], -1)


@array_function(axis_angle="... 3")
def axis_angle_to_quaternion(axis_angle: Array) -> Array:
    """The unit quaternion of a rotation vector: cos(a / 2), sin(a / 2) times the axis.

    Args:
        axis_angle: (..., 3) axis times angle in radians.

    Returns:
        (..., 4) as (w, x, y, z); w >= 0 for angles up to pi.

    Raises:
        ValueError: if an angle is so large that its square overflows.
    """
    squared = (axis_angle * axis_angle).sum(-1, keepdim=True)
    if values_known() and not bool(torch.isfinite(squared).all()):
        fail("axis_angle", "angles whose square is finite", float(axis_angle.abs().max()))
    # 1 - cos(a / 2) = 2 sin^2(a / 4): a function of the squared angle, smooth at 0.
    w = 1 - squared / 8 * _sine_over_angle(squared / 16) ** 2
    return torch.cat([w, _sine_over_angle(squared / 4) * axis_angle / 2], -1)


@array_function(q="... 4")
def quaternion_to_axis_angle(q: Array) -> Array:
    """The rotation vector of a quaternion, of a length from 0 to pi.

    Half turns have two; `q` and `-q` give the same one, the first entry that is not zero positive.

    Args:
        q: (..., 4) as (w, x, y, z), of any length but zero.

    Returns:
        (..., 3) axis times angle in radians.

    Raises:
        ValueError: if a quaternion is zero.
    """
    q = _standard_sign(_unit("q", q))
    w, v = q[..., :1], q[..., 1:]
    squared = (v * v).sum(-1, keepdim=True)
    # The branch that is not taken must not divide by zero either: its gradient would be NaN.
    small = squared < 1e-8
    sine = torch.where(small, 1, squared).sqrt()
    tangent_squared = squared / torch.where(small, w, 1) ** 2
    series = (1 - tangent_squared / 3) / torch.where(small, w, 1)
    return 2 * torch.where(small, series, torch.atan2(sine, w) / sine) * v


@array_function(axis_angle="... 3")
def axis_angle_to_matrix(axis_angle: Array) -> Array:
    """The rotation about a vector by its length in radians.

    Args:
        axis_angle: (..., 3) axis times angle in radians.

    Returns:
        (..., 3, 3).

    Raises:
        ValueError: if an angle is so large that its square overflows.
    """
    return quaternion_to_matrix(axis_angle_to_quaternion(axis_angle))


@array_function(R="... 3 3")
def matrix_to_axis_angle(R: Array) -> Array:
    """The rotation vector of a rotation, of a length from 0 to pi.

    Half turns have two; it is the one whose first entry that is not zero is positive.

    Args:
        R: (..., 3, 3) rotation.

    Returns:
        (..., 3) axis times angle in radians.

    Raises:
        ValueError: if `R` is not a rotation to 1e-3.
    """
    return quaternion_to_axis_angle(matrix_to_quaternion(R))


@array_function(columns="... 6")
def rotation_6d_to_matrix(columns: Array) -> Array:
    """Make two vectors the first two columns of a rotation (Gram-Schmidt).

    The first keeps its direction, the second its side of the first.

    Args:
        columns: (..., 6) first vector, then second vector, of any length. (PyTorch3D has rows.)

    Returns:
        (..., 3, 3).

    Raises:
        ValueError: if a vector is zero or both are parallel to rounding.

    Source:
        Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural
        Networks".
    """
    first, second = (
        _unit("columns", v, "two vectors that are not zero") for v in columns.split(3, -1)
    )
    rest = _without(second, first)
    if values_known():
        parallel = torch.linalg.vector_norm(rest, dim=-1) <= 8 * torch.finfo(rest.dtype).eps
        if bool(parallel.any()):
            fail("columns", "two vectors that are not parallel", "parallel ones" + _at(parallel))
    # A second time, as nearly parallel vectors leave much of the first behind.
    second = _unit("columns", _without(_unit("columns", rest), first))
    return torch.stack([first, second, torch.linalg.cross(first, second)], -1)


@array_function(R="... 3 3")
def matrix_to_rotation_6d(R: Array) -> Array:
    """The first two columns of a rotation, one after the other.

    Args:
        R: (..., 3, 3) rotation.

    Returns:
        (..., 6).

    Raises:
        ValueError: if `R` is not a rotation to 1e-3.
    """
    require_rotation("R", R)
    return torch.cat([R[..., 0], R[..., 1]], -1)


def _unit(name: str, v: Tensor, expected: str = "quaternions that are not zero") -> Tensor:
    # Largest entry first: the squares of very small or large numbers are 0 or infinite.
    largest = v.detach().abs().amax(-1, keepdim=True)
    if values_known() and bool((largest == 0).any()):
        fail(name, expected, "zero" + _at(largest[..., 0] == 0))
    v = v / largest
    return v / torch.linalg.vector_norm(v, dim=-1, keepdim=True)


def _at(bad: Tensor) -> str:
    first = tuple(bad.nonzero()[0].tolist())
    return f" at index {first}" if first else ""


def _standard_sign(q: Tensor) -> Tensor:
    """Of q and -q, the one whose first component that is not zero is positive."""
    w, x, y, z = q.detach().unbind(-1)
    first = torch.where(w != 0, w, torch.where(x != 0, x, torch.where(y != 0, y, z)))
    return q * first.sign()[..., None]


def _sine_over_angle(squared: Tensor) -> Tensor:
    """sin(a) / a from a^2, with a derivative at 0."""
    small = squared < 1e-8
    angle = torch.where(small, 1, squared).sqrt()
    return torch.where(small, 1 - squared / 6, angle.sin() / angle)


def _without(v: Tensor, unit: Tensor) -> Tensor:
    return v - (v * unit).sum(-1, keepdim=True) * unit
