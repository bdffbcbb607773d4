"""Keypoints on head and glasses, votes for them brought together, and a pose from them.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.4. How many
keypoints, and how votes are brought together, is not in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from data_tools.shapes.glasses import GLASSES, make_glasses
from data_tools.shapes.heads import make_subject
from posecore.arrays import fail, require_choice, require_finite, require_integer
from posecore.models import model_keypoints
from posecore.registration import umeyama

__all__ = ["fused_keypoints", "keypoint_pose", "robust_mean"]


def fused_keypoints(
    count: int = 8, glasses: Sequence[str] = GLASSES[:1], subject: int = 0
) -> Tensor:
    """Keypoints of a synthetic head that wears glasses, the same for every head and all glasses.

    By farthest point sampling, and the centre of the box around both last: eight and the centre are
    PVNet's number, the paper has none.

    Args:
        count: how many besides the centre.
        glasses: which are fused with the head, of `data_tools.shapes.glasses.GLASSES`; the paper
            has one.
        subject: whose head, as of `data_tools.shapes.heads.make_subject`.

    Returns:
        (count + 1, 3) float32, metres in the frame of the glasses, whose pose is estimated.

    Raises:
        ValueError: for other glasses, none at all, or a number that cannot be.
    """
    if isinstance(glasses, str) or not glasses:
        fail("glasses", "a sequence of names", repr(glasses))
    for name in glasses:
        require_choice("glasses", name, GLASSES)
    # The glasses' frame is the head's.
    meshes = [make_subject(subject).head, *(make_glasses(name) for name in glasses)]
    points = torch.cat([torch.from_numpy(mesh.vertices) for mesh in meshes])
    return model_keypoints(points, count).float()


def robust_mean(votes: Tensor, iterations: int = 1) -> Tensor:
    """The mean of votes for each keypoint, in which those far from most count little.

    Each vote is weighed by 1 / (1 + (d / m)^2), d its distance from the present answer, at first
    the median of every coordinate, and m the median of these distances (Cauchy's weights, reweighed
    `iterations` times). The weights pass no gradient: a vote is not asked to move to be heard.

    Args:
        votes: (B, S, K, 3) metres, of S seeds.
        iterations: 0 is the mean of all, each as much as the other.

    Returns:
        (B, K, 3).

    Raises:
        ValueError: if `votes` has another shape or is not finite, or `iterations` is no integer of
            at least 0.
    """
    require_integer("iterations", iterations, 0)
    if votes.ndim != 4 or votes.shape[-1] != 3 or not votes.shape[1]:
        fail("votes", "shape (B, S, K, 3) with S of at least 1", f"shape {tuple(votes.shape)}")
    require_finite("votes", votes)
    if not iterations:
        return votes.mean(1)
    found = votes.detach().median(1).values
    for _ in range(iterations):
        with torch.no_grad():
            off = torch.linalg.vector_norm(votes - found[:, None], dim=-1)  # (B, S, K)
            middle = off.median(1, keepdim=True).values
            # Where most agree to the last digit, they are the answer.
            ratio = torch.where(off > 0, off / middle.clamp(min=torch.finfo(off.dtype).tiny), 0)
            weights = 1 / (1 + ratio.square())
            weights = weights / weights.sum(1, keepdim=True)
        found = (weights[..., None] * votes).sum(1)
    return found


def keypoint_pose(keypoints: Tensor, model: Tensor) -> tuple[Tensor, Tensor]:
    """The pose that brings the model's keypoints nearest to those found (Kabsch): no head needed.

    Args:
        keypoints: (..., K, 3) metres, where they were found.
        model: (K, 3) metres, in the object's frame.

    Returns:
        R (..., 3, 3) and t (..., 3).

    Raises:
        ValueError: as of `posecore.registration.umeyama`, which names them `target` and `source`.
    """
    found = umeyama(model.to(keypoints), keypoints)
    return found.R, found.t
