"""The points of an object that a network looks for, and which pose of a symmetric one it means."""

from __future__ import annotations

import torch

from posecore.arrays import Array, array_function
from posecore.clouds import farthest_point_sampling
from posecore.metrics.pose_errors import require_symmetries

__all__ = ["canonical_rotation", "model_keypoints"]

FAVOURED = (0.2, -1.0, 0.5)
"""Where the camera shall be, seen from the object: in front, a little above and to the side.

On no axis about which an ordinary model is symmetric, and at right angles to none: from there two
symmetric poses would be equally far.
"""


@array_function(points="P 3")
def model_keypoints(points: Array, count: int = 8) -> Array:
    """Points spread over the object's surface, and the centre of its box.

    Each is the point farthest from the centre and from those before it. On the surface a network
    finds them better than the corners of the box (Peng et al., PVNet, CVPR 2019, section 3.1).

    Args:
        points: (P, 3) points on the surface, in the object's frame.
        count: how many of them, at most P.

    Returns:
        (count + 1, 3), the centre of the bounding box last.

    Raises:
        ValueError: if `count` is not between 1 and P.
    """
    chosen = farthest_point_sampling(points, count, start="farthest_from_centre")
    centre = (points.amin(0) + points.amax(0)) / 2
    return torch.cat([points[chosen], centre[None]])


@array_function(R="... 3 3", t="... 3", symmetries="S 4 4")
def canonical_rotation(R: Array, t: Array, symmetries: Array) -> tuple[Array, Array]:
    """Of all poses that look like `(R, t)` the one that a network is asked for.

    A symmetric object has many poses for one picture. A network that learns now one, now another
    learns their mean, which is none. The rule: the pose in which the camera, seen from the object,
    lies farthest in one fixed direction (`FAVOURED`). Turned about its axis, a vase always shows
    the camera the same side, wherever it stands; and a picture that is turned keeps its answer.

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
    favoured = S_R @ R.new_tensor(FAVOURED)  # (S, 3)
    camera = -(R.mT @ t[..., None])[..., 0]
    height = camera @ favoured.mT - (favoured * S_t).sum(-1)  # (..., S)
    best = height.argmax(-1)
    return R @ S_R[best], (R @ S_t[best][..., None])[..., 0] + t
