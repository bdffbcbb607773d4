"""Poses that are corrected: what a correction is, how wrong a pose is, and poses made wrong.

A correction turns an object about its centre, shifts it across the view in diameters, and
multiplies its distance. In these units a small object and a large one, a near and a far one whose
pictures differ in the same way need the same correction. (DeepIM, Li et al., ECCV 2018, has the
same units with pixels for diameters.)
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from posecore import poses
from posecore.arrays import Array, array_function
from posecore.rotations import axis_angle_to_matrix

__all__ = ["correct_pose", "perturb", "pose_loss"]


@array_function(
    R="... 3 3", t="... 3", centre="... 3", diameter="...", turn="... 3 3", shift="... 3"
)
def correct_pose(
    R: Array, t: Array, centre: Array, diameter: Array, turn: Array, shift: Array
) -> tuple[Array, Array]:
    """A pose after a correction about the object's centre, in the camera's axes.

    The centre at `c` goes to `exp(s) * (c + diameter * (dx, dy, 0))` for `shift = (dx, dy, s)`: the
    last number moves it along its ray, so that its pixel stays, and `s` is the logarithm of the
    ratio of depths.

    Args:
        R, t: (..., 3, 3) and (..., 3) the pose.
        centre: (..., 3) the object's centre in its own frame.
        diameter: (...) metres.
        turn: (..., 3, 3) rotation in the camera's axes.
        shift: (..., 3).

    Returns:
        (..., 3, 3) and (..., 3).
    """
    across = torch.cat([shift[..., :2], torch.zeros_like(shift[..., 2:])], -1)
    now = (R @ centre[..., None])[..., 0] + t
    then = shift[..., 2:].exp() * (now + diameter[..., None] * across)
    R = turn @ R
    return R, then - (R @ centre[..., None])[..., 0]


@array_function(
    points="... N 3", R="... 3 3", t="... 3", R_gt="... 3 3", t_gt="... 3", diameter="..."
)
def pose_loss(
    points: Array,
    R: Array,
    t: Array,
    R_gt: Array,
    t_gt: Array,
    diameter: Array,
    symmetric: Array | bool = False,
) -> Array:
    """ADD, of symmetric objects ADD-S, in diameters; `metrics` has them in metres and without loss.

    Args:
        points: (..., N, 3) of the model; the distances of all pairs are computed for ADD-S.
        R, t, R_gt, t_gt: (..., 3, 3) and (..., 3) estimate and ground truth.
        diameter: (...) metres.
        symmetric: (...) booleans, or one for all.

    Returns:
        (...) at least 0; the gradient is finite, also where the loss is 0.
    """
    here, there = poses.apply(R, t, points), poses.apply(R_gt, t_gt, points)
    here, there = torch.broadcast_tensors(here, there)
    symmetric = torch.as_tensor(symmetric, device=here.device, dtype=torch.bool)
    symmetric = symmetric.expand(here.shape[:-2])
    if bool(symmetric.any()):
        with torch.no_grad():
            pairs = torch.cdist(there[symmetric].detach(), here[symmetric].detach())
            nearest = pairs.argmin(-1)[..., None].expand(-1, -1, 3)
        here = here.masked_scatter(symmetric[..., None, None], here[symmetric].gather(1, nearest))
    return torch.linalg.vector_norm(here - there, dim=-1).mean(-1) / diameter


def perturb(
    R: Tensor,
    t: Tensor,
    centre: Tensor,
    diameter: Tensor,
    generator: torch.Generator,
    rotation: float = math.radians(20),
    lateral: float = 0.08,
    depth: float = 0.2,
) -> tuple[Tensor, Tensor]:
    """Poses near the given ones, as a first estimate may be wrong.

    Each is wrong in everything by the same part, drawn evenly from 0 to 1, of the sizes given: a
    refiner has to learn to leave alone what is right.

    Args:
        R, t: (B, 3, 3) and (B, 3).
        centre: (B, 3) of the objects in their frames.
        diameter: (B,) metres.
        generator: of the random numbers.
        rotation: radians about any axis.
        lateral: diameters; standard deviation across the view, in x and in y.
        depth: diameters; standard deviation along the ray.

    Returns:
        (B, 3, 3) and (B, 3), always in front of the camera.
    """
    part = torch.rand(len(R), 1, generator=generator, dtype=torch.float64)
    noise = torch.randn(len(R), 6, generator=generator, dtype=torch.float64)
    part, noise = part.to(R), noise.to(R)
    turn = nn.functional.normalize(noise[:, :3], dim=-1) * rotation * part
    distance = (R @ centre[..., None])[:, 2, 0] + t[:, 2]
    away = (depth * part[:, 0] * noise[:, 5] * diameter / distance).clamp(min=-0.5)
    shift = torch.cat([lateral * part * noise[:, 3:5], torch.log1p(away)[:, None]], -1)
    return correct_pose(R, t, centre, diameter, axis_angle_to_matrix(turn), shift)
