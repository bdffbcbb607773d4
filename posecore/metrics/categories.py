"""Objects known by their category: symmetry of the instance, similarity transforms, errors.

The rules are those of Wang et al., Normalized Object Coordinate Space for Category-Level 6D Object
Pose and Size Estimation (NOCS), CVPR 2019: canonical frames of a category have y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, require_finite, somewhere
from posecore.metrics.pose_errors import rotation_error
from posecore.rotations import require_rotation

__all__ = ["Similarity", "instance_rotation_error", "nocs_axes", "split_similarity"]

SYMMETRIC = ("bottle", "bowl", "can")
HANDLED = "mug"
UP = np.array([0.0, 1.0, 0.0])


class Similarity(NamedTuple):
    """A similarity transform apart: `X_cam = scale * R @ X + t`, and the size of what it places."""

    R: Array
    """(..., 3, 3) rotation."""
    t: Array
    """(..., 3) metres."""
    scale: Array
    """(...) metres for each unit of normalised coordinates."""
    size: Array
    """(..., 3) metres."""


@array_function(T="... 4 4", size="... 3")
def split_similarity(T: Array, size: Array) -> Similarity:
    """What NOCS's files hold, in metres: rotation, translation, scale and the size of the box.

    These files (`pred_RTs`, `pred_scales`; `gt_RTs`, `gt_scales`) have the scale within the matrix,
    and sizes in normalised coordinates, in which the box's diagonal is about 1.

    Args:
        T: (..., 4, 4) similarity transform from normalised coordinates to the camera's metres.
        size: (..., 3) lengths of the box in normalised coordinates.

    Returns:
        Rotation, translation, scale and size, the last in metres.

    Raises:
        ValueError: if `T` has another last row than 0 0 0 1, mirrors, or is no rotation times one
            positive number to 1e-3.
    """
    if somewhere(T[..., 3, :] != T.new_tensor([0, 0, 0, 1])):
        fail("T", "matrices with a last row 0 0 0 1", "others")
    # Of the lengths of the columns, as a determinant of tiny scales would have no digits left.
    scale = T[..., :3, :3].norm(dim=-2).mean(-1)
    if somewhere(scale <= 0):
        fail("T", "a scale above 0", float(scale.min()))
    R = T[..., :3, :3] / scale[..., None, None]
    require_finite("T", R, "a scale that is a number")
    require_rotation("T", R)
    return Similarity(R, T[..., :3, 3], scale, size * scale[..., None])


def nocs_axes(
    category: Sequence[str], handle_visible: Sequence[bool] | np.ndarray | None = None
) -> np.ndarray:
    """The axes of symmetry of instances, by NOCS's rule.

    Bottles, bowls and cans turn freely about y; so does a mug whose handle is not seen, as then
    nobody can tell how it is turned. All else has no symmetry, whatever it is.

    Args:
        category: N names.
        handle_visible: (N,) whether the handle of each is seen, which matters for mugs only; None
            if every mug shows its handle.

    Returns:
        (N, 3) directions in the objects' frames, zeros where there is no symmetry: the `axis` of a
        `CategoryPoseTable`.

    Raises:
        ValueError: if `handle_visible` has another length, or is neither true nor false.
    """
    names = np.asarray(category, dtype=str).reshape(-1)
    seen = np.ones(len(names), bool) if handle_visible is None else np.asarray(handle_visible)
    if seen.shape != names.shape:
        fail("handle_visible", f"shape {names.shape} as category has", f"shape {seen.shape}")
    if not np.isin(seen, (0, 1)).all():
        fail("handle_visible", "true or false", seen.tolist())
    turns = np.isin(names, SYMMETRIC) | ((names == HANDLED) & ~seen.astype(bool))
    return turns[:, None] * UP


@array_function(R_est="... 3 3", R_gt="... 3 3", axis="... 3")
def instance_rotation_error(R_est: Array, R_gt: Array, axis: Array) -> Array:
    """The angle between two rotations; of what turns freely about an axis, between both axes.

    As `rotation_error` and `axis_error`, but each pair has a symmetry of its own.

    Args:
        R_est, R_gt: (..., 3, 3) rotations.
        axis: (..., 3) in the object's frame, of any length; zeros for an object without symmetry.

    Returns:
        (...) radians in [0, pi].

    Raises:
        ValueError: if an R is off a rotation by more than 1e-3.
    """
    whole = rotation_error(R_est, R_gt)
    turns = (axis != 0).any(-1)
    unit = axis / axis.abs().amax(-1, keepdim=True).where(turns[..., None], 1)
    one, other = torch.broadcast_tensors(*((R @ unit[..., None])[..., 0] for R in (R_est, R_gt)))
    # atan2 of sine and cosine is precise at every angle; acos is not, near 0 and pi.
    between = torch.atan2(torch.linalg.cross(one, other).norm(dim=-1), (one * other).sum(-1))
    return torch.where(turns, between, whole)
