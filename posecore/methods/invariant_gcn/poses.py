"""Two roads from what a network says to a pose and a size.

Source: Chen et al., the rotation-invariant paper, whose abstract has the second and whose method
the first: axes that are said; canonical coordinates, to which a similarity is fitted (Umeyama
1991), as in NOCS (Wang et al., CVPR 2019).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from posecore.arrays import fail, require_choice
from posecore.methods.invariant_gcn.axes import rotation_from_axes
from posecore.methods.invariant_gcn.category_clouds import CategoryClouds
from posecore.methods.invariant_gcn.network import InvariantGCN, Prediction
from posecore.registration import ransac_umeyama, umeyama

__all__ = [
    "ROADS",
    "PoseEstimate",
    "canonical_pose",
    "direct_pose",
    "estimated_pose",
    "predict_poses",
]

ROADS = ("direct", "plain", "weighted", "ransac")
"""The axes that are said; canonical coordinates, all alike, by confidence, or those that agree."""

AT_ONCE = 64  # clouds that a network is given together
LEAST_SIZE = 1e-3  # metres: no box has an edge below it, or none
LEAST_SHARE = 0.02  # of the diagonal


class PoseEstimate(NamedTuple):
    """Poses of B clouds, in the frame in which their points are."""

    R: Tensor  # (B, 3, 3)
    t: Tensor  # (B, 3) metres
    size: Tensor  # (B, 3) metres
    found: Tensor  # (B,) bool; where it is False, the rest is the identity, 0 and the least size


def estimated_pose(
    said: Prediction, points: Tensor, road: str, symmetric: Tensor | None = None
) -> PoseEstimate:
    """What a network says by one of `ROADS`.

    Args:
        said: by the network.
        points: (B, N, 3) metres, seen, about their mean.
        road: one of `ROADS`.
        symmetric: (B,) bool, as of `direct_pose`.

    Raises:
        ValueError: for another road, or one whose branch the network has not.
    """
    require_choice("road", road, ROADS)
    if road == "direct":
        return direct_pose(said, symmetric)
    return canonical_pose(said, points, road)


@torch.no_grad()
def predict_poses(net: InvariantGCN, clouds: CategoryClouds, road: str) -> PoseEstimate:
    """What a network says of many clouds.

    Args:
        net: in evaluation mode; it stays where it is.
        clouds: with the graphs that it needs.
        road: one of `ROADS`.

    Returns:
        Poses in the frames of the cameras, on the CPU.

    Raises:
        ValueError: for another road, or graphs of another network.
    """
    device, parts = next(net.parameters()).device, []
    for rows in torch.arange(len(clouds)).split(AT_ONCE):
        cloud = clouds.clouds(rows).to(device)
        symmetric = clouds.seen.revolution[rows].to(device)
        parts.append(estimated_pose(net(cloud), cloud.graph.points, road, symmetric))
    found = PoseEstimate(*(torch.cat(part).cpu() for part in zip(*parts, strict=True)))
    return found._replace(t=found.t + clouds.centre)


@torch.no_grad()
def direct_pose(said: Prediction, symmetric: Tensor | None = None) -> PoseEstimate:
    """By the axes, translation and size that are said.

    Args:
        said: by a network with the branch "axes".
        symmetric: (B,) bool, of which the x axis means nothing, and leaves all of the turn to
            itself; None for none.

    Raises:
        ValueError: without that branch.
    """
    if said.x is None:
        fail("road", "one of a branch that the network has", "direct, and no axes")
    sure = said.x_confidence
    if symmetric is not None:
        sure = torch.where(symmetric, 0.0, sure)
    R = rotation_from_axes(said.x, said.y, sure, said.y_confidence)
    found = torch.ones(len(R), dtype=torch.bool, device=R.device)
    return PoseEstimate(R, said.t, said.size.clamp(min=LEAST_SIZE), found)


@torch.no_grad()
def canonical_pose(
    said: Prediction, points: Tensor, road: str = "weighted", threshold: float = 0.012
) -> PoseEstimate:
    """By the similarity from canonical coordinates to the points that were seen.

    Its scale is the diagonal of the box, since coordinates are over that.

    Args:
        said: by a network with the branch "canonical".
        points: (B, N, 3) metres, seen.
        road: "plain", "weighted" or "ransac"; confidences weigh in the last two.
        threshold: metres, of the last one.

    Returns:
        Nothing is found where coordinates do not tell one rotation, as when all are in one place.

    Raises:
        ValueError: without that branch, or for another road.
    """
    require_choice("road", road, ROADS[1:])
    if said.canonical is None:
        fail("road", "one of a branch that the network has", f"{road}, and no canonical points")
    b = len(points)
    R = torch.eye(3).repeat(b, 1, 1).to(points)
    t, size = points.new_zeros(b, 3), points.new_full((b, 3), LEAST_SIZE)
    found = torch.zeros(b, dtype=torch.bool, device=points.device)
    weights = said.canonical_confidence.sigmoid()
    for i in range(b):  # each by itself: one that cannot be told is not to cost the others
        pair = said.canonical[i].to(points), points[i]
        try:
            if road == "ransac":
                fit = ransac_umeyama(*pair, threshold, weights[i], with_scale=True)
            else:
                fit = umeyama(*pair, weights[i] if road == "weighted" else None, with_scale=True)
        except ValueError:
            continue
        if not bool(fit.scale > 0):
            continue
        R[i], t[i], found[i] = fit.R, fit.t, True
        size[i] = (fit.scale * said.proportions[i].clamp(min=LEAST_SHARE)).clamp(min=LEAST_SIZE)
    return PoseEstimate(R, t, size, found)
