"""Symmetric objects: which of the poses that look alike is meant.

Symmetries are rigid motions (S, 4, 4) of the object's frame that leave the object as it is, the
identity among them, as `ModelInfo.symmetries` of `data_tools.bop` gives them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore import poses
from posecore.arrays import Array, array_function, fail, require_finite, somewhere
from posecore.rotations import axis_angle_to_matrix, require_rotation

__all__ = ["canonical_rotation", "closest_symmetry", "require_symmetries", "turned_to_camera"]

PREFERRED_VIEW = (0.2, -1.0, 0.5)
"""Where the camera shall be, seen from the object: in front, a little above and to the side.

On no axis about which an ordinary model is symmetric, and at right angles to none: from there two
symmetric poses would be equally far.
"""


@array_function(R="... 3 3", t="... 3", symmetries="S 4 4")
def canonical_rotation(R: Array, t: Array, symmetries: Array) -> tuple[Array, Array]:
    """Of all poses that look like `(R, t)` the one that a network is asked for.

    A symmetric object has many poses for one picture. A network that learns now one, now another
    learns their mean, which is none. The rule: the pose in which the camera, seen from the object,
    lies farthest in one fixed direction (`PREFERRED_VIEW`). Turned about its axis, a vase always
    shows the camera the same side, wherever it stands; and a picture that is turned keeps its
    answer.

    The answer cannot follow the picture everywhere without a jump: no rule's can. For a solid of
    revolution this one jumps only where the camera is on the axis, exactly above or below. For an
    object that is the same after half a turn it jumps where the camera goes from one half of the
    space around the object to the other, so where both poses are equally good.

    Args:
        R: (..., 3, 3) rotations from object to camera.
        t: (..., 3) translations, metres.
        symmetries: (S, 4, 4) motions that leave the object as it is, the identity among them, as
            `ModelInfo.symmetries` has them. Between two steps of a rotation the rule jumps by one.

    Returns:
        `R` (..., 3, 3) and `t` (..., 3). Gradients flow through the pose that was chosen.

    Raises:
        ValueError: if `symmetries` are no rigid motions.
    """
    require_symmetries(symmetries)
    S_R, S_t = symmetries[:, :3, :3], symmetries[:, :3, 3]
    # The pose (R S_R, R S_t + t) sees the camera at S_R^T (c - S_t), if (R, t) sees it at c.
    favoured = S_R @ R.new_tensor(PREFERRED_VIEW)  # (S, 3)
    camera = -(R.mT @ t[..., None])[..., 0]
    height = camera @ favoured.mT - (favoured * S_t).sum(-1)  # (..., S)
    best = height.argmax(-1)
    return R @ S_R[best], (R @ S_t[best][..., None])[..., 0] + t


@array_function(R_est="... 3 3", R_gt="... 3 3", t_gt="... 3", symmetries="S 4 4")
def closest_symmetry(
    R_est: Array, R_gt: Array, t_gt: Array, symmetries: Array
) -> tuple[Array, Array]:
    """Of all poses that look like the ground truth, the one whose rotation is nearest to `R_est`.

    What is measured against it, an angle, a translation, a box, respects the symmetry. Nearest is
    meant in the Frobenius norm, which for rotations has the order of the angles.

    Args:
        R_est: (..., 3, 3) estimated rotation.
        R_gt, t_gt: (..., 3, 3) and (..., 3) true pose.
        symmetries: (S, 4, 4) in the unit of `t_gt`.

    Returns:
        `R` (..., 3, 3) and `t` (..., 3), the true pose after the best symmetry.

    Raises:
        ValueError: if `symmetries` are no rigid motions, or products of the rotations not finite.
    """
    require_symmetries(symmetries)
    nearness = (R_gt.mT @ R_est).flatten(-2) @ symmetries[:, :3, :3].flatten(-2).T  # (..., S)
    # The largest of what is no number would be any of them.
    require_finite("R_est and R_gt", nearness, "matrices whose products are finite")
    best = symmetries[nearness.argmax(-1, keepdim=True)][..., 0, :, :]
    return poses.compose(R_gt, t_gt, best[..., :3, :3], best[..., :3, 3])


@array_function(R="... 3 3", t="... 3", axis="3", front="3")
def turned_to_camera(R: Array, t: Array, axis: Array, front: Array) -> Array:
    """Of all poses of a solid of revolution the one that shows the camera its front.

    What `canonical_rotation` is for the steps of a rotation, for all of it: the object is turned
    about its axis until the camera stands on the side of `front`. So what a network is asked
    follows from what it sees. It jumps only where the camera is on the axis.

    Args:
        R: (..., 3, 3) rotations from object to camera.
        t: (..., 3) translations, metres.
        axis: (3,) of the object's frame, through its origin, of any length.
        front: (3,) a direction of the object's frame; what of it is along the axis does not count.

    Returns:
        (..., 3, 3) the rotation. The translation stays as it is.

    Raises:
        ValueError: if the axis is zero, or the front is along it.
    """
    unit = axis / torch.linalg.vector_norm(axis)
    ahead = front - (front @ unit) * unit
    length = torch.linalg.vector_norm(ahead)
    if somewhere(~(length > 1e-6 * torch.linalg.vector_norm(front))):
        fail("axis and front", "an axis, and a direction that is not along it", "others")
    ahead = ahead / length
    camera = -(R.mT @ t[..., None])[..., 0]
    angle = torch.atan2(camera @ torch.linalg.cross(unit, ahead), camera @ ahead)
    return R @ axis_angle_to_matrix(angle[..., None] * unit)


def require_symmetries(symmetries: Tensor) -> None:
    """Refuse what are not rigid transforms (S, 4, 4).

    Raises:
        ValueError: if a last row is not 0 0 0 1, or a matrix is off a rotation by more than 1e-3.
    """
    if somewhere(symmetries[:, 3] != symmetries.new_tensor([0, 0, 0, 1])):
        fail("symmetries", "matrices with a last row 0 0 0 1", "others")
    require_rotation("symmetries", symmetries[:, :3, :3])
