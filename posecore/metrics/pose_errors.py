"""How far an estimated pose is from the true one, in angle and in position.

The angle of what is not a rotation depends on the formula, and published ground truth is not always
exactly a rotation: matrices that are off by more than 1e-3 are refused here.

A symmetric object looks the same after a transform S of its own frame. Its symmetries come as
homogeneous matrices (S, 4, 4) that include the identity; the error is then that of the best one.
"""

from __future__ import annotations

import torch

from posecore.arrays import Array, array_function, fail, somewhere
from posecore.rotations import require_rotation
from posecore.rotations.so3 import relative_angle
from posecore.symmetry import closest_symmetry

__all__ = ["axis_error", "rotation_error", "translation_error"]


@array_function(R_est="... 3 3", R_gt="... 3 3", symmetries="S 4 4")
def rotation_error(R_est: Array, R_gt: Array, symmetries: Array | None = None) -> Array:
    """The angle between two rotations, in radians.

    Args:
        R_est, R_gt: (..., 3, 3) rotations.
        symmetries: (S, 4, 4) or None; the smallest angle over the symmetric views counts.

    Returns:
        (...) angles in [0, pi].

    Raises:
        ValueError: if an argument is off a rotation by more than 1e-3. Project it first.
    """
    require_rotation("R_est", R_est)
    require_rotation("R_gt", R_gt)
    if symmetries is not None:
        R_gt, _ = closest_symmetry(R_est, R_gt, R_gt.new_zeros(3), symmetries)
    return relative_angle(R_est, R_gt)


@array_function(R_est="... 3 3", R_gt="... 3 3", axis="3")
def axis_error(R_est: Array, R_gt: Array, axis: Array) -> Array:
    """The angle between the two images of one axis of the object, in radians.

    This is the rotation error of an object that any turn about `axis` leaves as it is (bottles,
    bowls and cans in NOCS, whose axis is y).

    Args:
        R_est, R_gt: (..., 3, 3) rotations.
        axis: (3,) direction in the object's frame, of any length but zero.

    Returns:
        (...) angles in [0, pi].

    Raises:
        ValueError: if `axis` is zero or an R is off a rotation by more than 1e-3.
    """
    require_rotation("R_est", R_est)
    require_rotation("R_gt", R_gt)
    if somewhere((axis == 0).all()):
        fail("axis", "a direction", "the zero vector")
    axis = axis / axis.abs().amax()  # so that squares of tiny numbers do not vanish
    a, b = torch.broadcast_tensors(R_est @ axis, R_gt @ axis)
    # atan2 of sine and cosine is precise at every angle; acos is not, near 0 and pi.
    return torch.atan2(torch.linalg.cross(a, b).norm(dim=-1), (a * b).sum(-1))


@array_function(t_est="... 3", t_gt="... 3")
def translation_error(t_est: Array, t_gt: Array) -> Array:
    """The distance |t_est - t_gt| (...) of two translations (..., 3), in their unit."""
    return (t_est - t_gt).norm(dim=-1)
