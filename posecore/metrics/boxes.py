"""Oriented 3D boxes and how much they overlap.

A box is given by the pose `(R, t)` of its centre and its `size` along its own axes, all in metres.
"""

from __future__ import annotations

import itertools

import numpy as np
import torch
from scipy.spatial import ConvexHull, QhullError

from posecore import poses
from posecore.arrays import Array, array_function, fail, require_finite, require_integer, somewhere
from posecore.rotations import axis_angle_to_matrix, require_rotation

__all__ = ["box_corners", "nocs_legacy_iou", "oriented_iou_3d", "turned_iou_3d"]

SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # (8, 3) corners of [-1, 1]^3
EDGES = np.array(  # (12, 2) corners that differ in one coordinate
    [(i, j) for i, j in itertools.combinations(range(8), 2) if (SIGNS[i] != SIGNS[j]).sum() == 1]
)
SMALLEST = float(np.finfo(np.float64).tiny)  # volume, below which numbers lose their digits
BOXES = {
    "R_1": "... 3 3", "t_1": "... 3", "size_1": "... 3",
    "R_2": "... 3 3", "t_2": "... 3", "size_2": "... 3",
}  # fmt: skip


@array_function(R="... 3 3", t="... 3", size="... 3")
def box_corners(R: Array, t: Array, size: Array) -> Array:
    """The eight corners of a box, in the frame that its pose leads to.

    Args:
        R: (..., 3, 3) rotation of the box.
        t: (..., 3) its centre, metres.
        size: (..., 3) edge lengths along its own axes, metres.

    Returns:
        (..., 8, 3) corners; the signs of (x, y, z) count up in binary: ---, --+, -+-, ..., +++.

    Raises:
        ValueError: if a size is negative.
    """
    _require_size("size", size)
    signs = torch.from_numpy(SIGNS).to(size)
    return poses.apply(R, t, signs * size[..., None, :] / 2)


@array_function(**BOXES)
def oriented_iou_3d(
    R_1: Array, t_1: Array, size_1: Array, R_2: Array, t_2: Array, size_2: Array
) -> Array:
    """Intersection over union of two oriented boxes, exact.

    The intersection of two boxes is convex; its corners are corners of one box inside the other and
    points where an edge of one meets a face of the other. Their convex hull gives the volume.

    Args:
        R_1, t_1, size_1, R_2, t_2, size_2: (..., 3, 3), (..., 3) and (..., 3), metres.

    Returns:
        (...) in [0, 1], float64. Not differentiable.

    Raises:
        ValueError: if a size is not positive, or so large or small that the volume is no number;
            if R is off a rotation by more than 1e-3.
    """
    require_rotation("R_1", R_1)
    require_rotation("R_2", R_2)
    _require_size("size_1", size_1, positive=True)
    _require_size("size_2", size_2, positive=True)
    for name, x in (("t_1", t_1), ("t_2", t_2), ("size_1", size_1), ("size_2", size_2)):
        require_finite(name, x)  # what is no number would be no overlap
    arguments = ((R_1, 2), (t_1, 1), (size_1, 1), (R_2, 2), (t_2, 1), (size_2, 1))
    batch = np.broadcast_shapes(*(x.shape[: x.ndim - core] for x, core in arguments))
    boxes = [
        x.detach().cpu().double().expand(*batch, *(3,) * core).reshape(-1, *(3,) * core).numpy()
        for x, core in arguments
    ]
    with np.errstate(over="ignore"):  # boxes so far apart that the squared distance is infinite
        overlap = np.array([_intersection(*pair) for pair in zip(*boxes, strict=True)])
        volume_1, volume_2 = boxes[2].prod(-1), boxes[5].prod(-1)
        volumes = torch.from_numpy(volume_1 + volume_2)
    require_finite("size_1 and size_2", volumes, "boxes whose volumes are finite")
    if (least := np.minimum(volume_1, volume_2).min(initial=np.inf)) < SMALLEST:
        fail("size_1 and size_2", f"boxes of at least {SMALLEST} cubic metres", least)
    iou = overlap / (volume_1 + volume_2 - overlap)
    return torch.from_numpy(iou.reshape(batch)).to(t_1.device)


def _intersection(
    R_1: np.ndarray,
    t_1: np.ndarray,
    size_1: np.ndarray,
    R_2: np.ndarray,
    t_2: np.ndarray,
    size_2: np.ndarray,
) -> float:
    """The volume that two boxes share: the hull of the edges of each, cut off at the other."""
    if np.linalg.norm(t_1 - t_2) >= (np.linalg.norm(size_1) + np.linalg.norm(size_2)) / 2:
        return 0.0  # even the spheres around them do not meet
    # In units of the larger box and in the frame of the first, so that one tolerance fits all.
    unit = max(size_1.max(), size_2.max())
    half_1, half_2 = size_1 / unit / 2, size_2 / unit / 2
    R, t = R_1.T @ R_2, R_1.T @ (t_2 - t_1) / unit
    edges_2_in_1 = _clip_edges(SIGNS * half_2 @ R.T + t, half_1)
    edges_1_in_2 = _clip_edges((SIGNS * half_1 - t) @ R, half_2)
    corners = np.concatenate([edges_2_in_1, edges_1_in_2 @ R.T + t])
    try:
        volume = ConvexHull(corners).volume if len(corners) > 3 else 0.0
    except QhullError:  # the boxes touch in a face, an edge or a corner
        volume = 0.0
    return min(volume * unit**3, size_1.prod(), size_2.prod())


def _clip_edges(corners: np.ndarray, half: np.ndarray) -> np.ndarray:
    """The ends of a box's edges after cutting them off at an axis-aligned box around the origin.

    Args:
        corners: (8, 3) in the order of `SIGNS`.
        half: (3,) half the size of the axis-aligned box.

    Returns:
        (M, 3) two ends for every edge of which something is left.
    """
    start = corners[EDGES[:, 0]]
    step = corners[EDGES[:, 1]] - start
    limit = half + 1e-9  # edges that lie in a face of the other box belong to it
    flat = np.abs(step) < 1e-12  # parallel to a face: inside its slab everywhere or nowhere
    safe = np.where(flat, 1.0, step)
    first, second = (-limit - start) / safe, (limit - start) / safe
    enter = np.where(flat, -np.inf, np.minimum(first, second)).max(-1).clip(min=0)
    leave = np.where(flat, np.inf, np.maximum(first, second)).min(-1).clip(max=1)
    kept = (enter <= leave) & ~(flat & (np.abs(start) > limit)).any(-1)
    ends = [start[kept] + when[kept, None] * step[kept] for when in (enter, leave)]
    return np.concatenate(ends).clip(-half, half)


@array_function(**BOXES, axis="... 3")
def turned_iou_3d(
    R_1: Array,
    t_1: Array,
    size_1: Array,
    R_2: Array,
    t_2: Array,
    size_2: Array,
    axis: Array,
    steps: int = 20,
) -> Array:
    """Intersection over union of two boxes, the first of which may turn freely about its axis.

    So a bottle's box is measured, whose front is anywhere (Wang et al., Normalized Object
    Coordinate Space, CVPR 2019, section 6). The turns that are tried begin at the one that brings
    both boxes' axes nearest to each other: about that the result is exact where their sections
    across the axis are alike, which steps from any other angle miss (two equal cubes, 9 degrees
    from the nearest of 20 steps, would score 0.87).

    Args:
        R_1, t_1, size_1, R_2, t_2, size_2: (..., 3, 3), (..., 3) and (..., 3), metres.
        axis: (..., 3) in the frame of the boxes, of any length; zeros for a box that may not turn.
        steps: how many turns are tried.

    Returns:
        (...) in [0, 1], float64, the largest of them. Not differentiable.

    Raises:
        ValueError: as `oriented_iou_3d`; if `steps` is below 1.
    """
    steps = require_integer("steps", steps, 1)
    arguments = ((R_1, 2), (t_1, 1), (size_1, 1), (R_2, 2), (t_2, 1), (size_2, 1), (axis, 1))
    batch = np.broadcast_shapes(*(x.shape[: x.ndim - core] for x, core in arguments))
    R_1, t_1, size_1, R_2, t_2, size_2, axis = (
        x.expand(*batch, *(3,) * core).reshape(-1, *(3,) * core) for x, core in arguments
    )
    rows = (axis != 0).any(-1)
    sides = (R_1, t_1, size_1, R_2, t_2, size_2)
    iou = torch.zeros(len(rows), dtype=torch.float64, device=R_1.device)
    iou[~rows] = oriented_iou_3d(*(side[~rows] for side in sides))
    if somewhere(rows):
        unit = axis[rows] / axis[rows].abs().amax(-1, keepdim=True)  # whose square is no 0
        unit = unit / unit.norm(dim=-1, keepdim=True)
        # Half a turn about one of its own axes leaves a box as it is.
        alike = steps % 2 == 0 and bool(((unit != 0).sum(-1) == 1).all())
        angles = _nearest_turn(R_1[rows].mT @ R_2[rows], unit)[:, None]
        count = steps // 2 if alike else steps
        angles = angles + torch.arange(count).to(angles) * (2 * torch.pi / steps)
        turns = axis_angle_to_matrix(angles[..., None] * unit[:, None])  # (M, count, 3, 3)
        others = (side[rows][:, None] for side in sides[1:])
        iou[rows] = oriented_iou_3d(R_1[rows][:, None] @ turns, *others).amax(-1)
    return iou.reshape(batch)


def _nearest_turn(relative: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """The angle (...) of the turn about a unit axis that is nearest to a rotation (..., 3, 3)."""
    along = (axis * (relative @ axis[..., None])[..., 0]).sum(-1)
    trace = relative.diagonal(dim1=-2, dim2=-1).sum(-1)
    skew = relative - relative.mT
    sine = (torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1) * axis).sum(-1)
    return torch.atan2(sine, trace - along)


@array_function(**BOXES)
def nocs_legacy_iou(
    R_1: Array,
    t_1: Array,
    size_1: Array,
    R_2: Array,
    t_2: Array,
    size_2: Array,
    symmetric: bool = False,
    steps: int = 20,
) -> Array:
    """The "3D IoU" of the NOCS evaluation, which is no intersection over union; for old tables.

    The public function of Wang et al., Normalized Object Coordinate Space, CVPR 2019, takes
    extremes over the wrong axis of its corner array: over x, y and z of one corner instead of over
    the corners. So every corner yields one interval, from its smallest to its largest coordinate,
    and the "volume" is the product of eight such lengths. A 10 cm cube at 0.8 m, shifted by 5 cm,
    scores 0.885 (true: 1/3). A cube around the origin has corners with three equal coordinates,
    intervals of no length: two such boxes score 0 / 0, not a number, there as here. Published
    tables hold such numbers; use `oriented_iou_3d` otherwise.

    Args:
        R_1, t_1, size_1, R_2, t_2, size_2: (..., 3, 3), (..., 3) and (..., 3), metres.
        symmetric: take the best of `steps` turns of box 1 about its y axis, as that evaluation does
            for bottles, bowls and cans.
        steps: how many turns.

    Returns:
        (...) the legacy score.

    Raises:
        ValueError: if a size is not positive, or so large that products of eight lengths overflow.
    """
    _require_size("size_1", size_1, positive=True)
    _require_size("size_2", size_2, positive=True)
    steps = require_integer("steps", steps, 1) if symmetric else 1
    turn = torch.zeros(steps, 3, dtype=R_1.dtype, device=R_1.device)
    turn[:, 1] = torch.arange(steps).to(R_1) * (2 * torch.pi / steps)
    R_turned = R_1[..., None, :, :] @ axis_angle_to_matrix(turn)  # (..., steps, 3, 3)
    one = box_corners(R_turned, t_1[..., None, :], size_1[..., None, :])
    two = box_corners(R_2, t_2, size_2)[..., None, :, :]
    low_1, high_1 = one.amin(-1), one.amax(-1)  # (..., steps, 8): over the axes of each corner
    low_2, high_2 = two.amin(-1), two.amax(-1)
    shared = torch.minimum(high_1, high_2) - torch.maximum(low_1, low_2)
    overlap = torch.where((shared < 0).any(-1), 0.0, shared.prod(-1))
    union = (high_1 - low_1).prod(-1) + (high_2 - low_2).prod(-1) - overlap
    require_finite("size_1 and size_2", union, "boxes whose products of lengths are finite")
    return (overlap / union).amax(-1)


def _require_size(name: str, size: torch.Tensor, positive: bool = False) -> None:
    wrong = size <= 0 if positive else size < 0
    if somewhere(wrong):
        fail(name, "positive lengths" if positive else "lengths of at least 0", float(size.min()))
