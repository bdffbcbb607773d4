"""Rigid transforms: a pose is a pair `(R, t)` that takes a point of the object to the camera.

`X_cam = R @ X_obj + t`, with `R` (..., 3, 3) and `t` (..., 3) in metres. Two poses are combined in
the order in which matrices are written: `compose(R_ab, t_ab, R_bc, t_bc)` maps from c to a.

Six numbers for a pose are a twist (v, w): first the three of the translation, metres, then the
rotation vector, radians, as in Sophus and PyTorch3D. Others, such as Modern Robotics, have w first.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_finite, somewhere
from posecore.rotations import axis_angle_to_matrix, hat, matrix_to_axis_angle, require_rotation

__all__ = [
    "apply",
    "compose",
    "from_matrix",
    "invert",
    "relative",
    "se3_exp",
    "se3_log",
    "to_matrix",
]


@array_function(R="... 3 3", t="... 3", points="... N 3", scale="...")
def apply(R: Array, t: Array, points: Array, scale: Array | float | None = None) -> Array:
    """Move points by a pose, `R @ x + t`, or by a similarity, `scale * R @ x + t`.

    `R` may be any matrix: published ground truth is not always exactly a rotation.

    Args:
        R: (..., 3, 3) rotation from object to camera.
        t: (..., 3) translation, in the unit of `points`.
        points: (..., N, 3) points in the object's frame.
        scale: (...) factor of a similarity transform, as `registration.umeyama` gives it.

    Returns:
        (..., N, 3) points in the camera's frame.
    """
    moved = points @ R.mT
    if scale is not None:
        moved = scale[..., None, None] * moved
    return moved + t[..., None, :]


@array_function(R_ab="... 3 3", t_ab="... 3", R_bc="... 3 3", t_bc="... 3")
def compose(R_ab: Array, t_ab: Array, R_bc: Array, t_bc: Array) -> tuple[Array, Array]:
    """Chain two poses: first (R_bc, t_bc), then (R_ab, t_ab).

    Args:
        R_ab, t_ab: (..., 3, 3) and (..., 3), the pose of frame b in frame a.
        R_bc, t_bc: (..., 3, 3) and (..., 3), the pose of frame c in frame b.

    Returns:
        `R_ac` (..., 3, 3) and `t_ac` (..., 3), the pose of frame c in frame a.
    """
    R_ac = R_ab @ R_bc
    t_ac = (R_ab @ t_bc[..., None])[..., 0] + t_ab
    return R_ac, t_ac


@array_function(R="... 3 3", t="... 3")
def invert(R: Array, t: Array) -> tuple[Array, Array]:
    """The pose of the camera in the object's frame: `(R^T, -R^T t)`.

    Args:
        R: (..., 3, 3) rotation.
        t: (..., 3) translation.

    Raises:
        ValueError: if `R` is not a rotation to 1e-3; the transpose is no inverse then.
    """
    require_rotation("R", R)
    return R.mT.clone(), -(R.mT @ t[..., None])[..., 0]


@array_function(R_1="... 3 3", t_1="... 3", R_2="... 3 3", t_2="... 3")
def relative(R_1: Array, t_1: Array, R_2: Array, t_2: Array) -> tuple[Array, Array]:
    """The pose (R, t) of the second frame in the first: `compose(R_1, t_1, R, t) = (R_2, t_2)`.

    Args:
        R_1, t_1: (..., 3, 3) and (..., 3), for example the pose of a camera in the world.
        R_2, t_2: (..., 3, 3) and (..., 3), for example the pose of an object in the same world.

    Returns:
        (..., 3, 3) and (..., 3); in the example, the pose of the object in the camera.

    Raises:
        ValueError: if `R_1` is not a rotation to 1e-3.
    """
    require_rotation("R_1", R_1)
    return R_1.mT @ R_2, (R_1.mT @ (t_2 - t_1)[..., None])[..., 0]


@array_function(R="... 3 3", t="... 3")
def to_matrix(R: Array, t: Array) -> Array:
    """The pose as one homogeneous matrix (..., 4, 4), last row 0 0 0 1."""
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = R.new_zeros(*batch, 4, 4)
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1
    return T


@array_function(T="... 4 4")
def from_matrix(T: Array) -> tuple[Array, Array]:
    """Split a homogeneous matrix (..., 4, 4) into `R` (..., 3, 3) and `t` (..., 3).

    Raises:
        ValueError: if the last row is not 0 0 0 1.
    """
    last = T.new_tensor([0.0, 0.0, 0.0, 1.0])
    if somewhere(T[..., 3, :] != last):
        wrong = (T[..., 3, :] != last).any(-1)
        fail("T", "a last row 0 0 0 1", T[..., 3, :][wrong][0].tolist())
    return T[..., :3, :3].clone(), T[..., :3, 3].clone()


@array_function(twist="... 6")
def se3_exp(twist: Array) -> tuple[Array, Array]:
    """The pose that a twist leads to: the exponential map of SE(3).

    With the angle a = |w| and W = hat(w), `R = exp(W)` and `t = V v`, where
    `V = I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2`. The translation is not v: the object
    moves along a screw.

    Args:
        twist: (..., 6) as (v, w), the rotation vector w last. Zero is the identity.

    Returns:
        `R` (..., 3, 3) and `t` (..., 3), differentiable, at zero too.

    Raises:
        ValueError: if an angle is so large that its square overflows, or a translation overflows.

    Source:
        Sola, Deray, Atchuthan 2018, "A micro Lie theory for state estimation in robotics",
        appendix D.
    """
    v, w = twist.split(3, -1)
    squared = (w * w).sum(-1, keepdim=True)
    require_finite("twist", squared, "angles whose square is finite")
    once = torch.linalg.cross(w, v)
    t = v + _stumpff(2, squared) * once + _stumpff(3, squared) * torch.linalg.cross(w, once)
    require_finite("twist", t, "twists whose translation is finite")
    return axis_angle_to_matrix(w), t


@array_function(R="... 3 3", t="... 3")
def se3_log(R: Array, t: Array) -> Array:
    """The twist that leads to a pose: the logarithm of SE(3), which `se3_exp` undoes.

    The rotation is between 0 and pi; of a half turn, which has two, as in `matrix_to_axis_angle`.

    Args:
        R: (..., 3, 3) rotation.
        t: (..., 3) translation.

    Returns:
        (..., 6) as (v, w), the rotation vector w last. Gradients are finite everywhere.

    Raises:
        ValueError: if `R` is not a rotation to 1e-3, or a twist overflows.
    """
    w = matrix_to_axis_angle(R)
    squared = (w * w).sum(-1, keepdim=True)
    # V^-1 = I - W / 2 + d W^2 with d = (1 - a sin(a) / (2 (1 - cos a))) / a^2, here without the
    # difference of what is nearly equal near 0; at pi, nothing is divided by zero.
    cosine = _stumpff(2, squared)
    d = (_stumpff(3, squared) - 2 * _stumpff(4, squared)) / (2 * cosine)
    W = hat(w)
    once = (W @ t[..., None])[..., 0]
    v = t - once / 2 + d * (W @ once[..., None])[..., 0]
    require_finite("t", v, "translations whose twist is finite")
    return torch.cat(torch.broadcast_tensors(v, w), -1)


def _stumpff(k: int, squared: Tensor) -> Tensor:
    """The Stumpff function c_k of a^2, for k = 2, 3, 4: 1 / k! - a^2 / (k + 2)! + ...

    c_2 = (1 - cos a) / a^2, c_3 = (a - sin a) / a^3, c_4 = (a^2 / 2 - 1 + cos a) / a^4; small
    angles by the series, since of these differences nothing would be left.
    """
    small = squared < 1
    x = torch.where(small, squared, 0)
    series = torch.zeros_like(x)
    for i in reversed(range(10)):
        series = 1 / math.factorial(k + 2 * i) - x * series
    # The branch that is not taken must not divide by zero either: its gradient would be NaN.
    x = torch.where(small, 1, squared)
    a = x.sqrt()
    c_2 = 2 * ((a / 2).sin() / a) ** 2
    closed = {2: c_2, 3: (1 - a.sin() / a) / x, 4: (0.5 - c_2) / x}
    return torch.where(small, series, closed[k])
