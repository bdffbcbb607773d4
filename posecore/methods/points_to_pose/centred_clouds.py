"""Clouds about their own mean, as networks learn from them: prepared once, turned at every step.

What is said of a centred cloud is along the world's axes and relative to its mean, and the mean is
added again: the paper's "sum of the predicted relative translation and the translation of the input
cloud". A network that is told where in the car a head is learns the seat as well as the pose.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.3.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor, nn

from data_tools.batches.memory import require_bytes
from posecore.arrays import fail, require_integer, require_number
from posecore.methods.points_to_pose.pose_clouds import PoseClouds
from posecore.nets.pointnet2 import Geometry
from posecore.rotations import axis_angle_to_matrix

__all__ = ["CentredClouds", "PoseNet", "pose_of_clouds", "predict_poses"]

AT_ONCE = 256  # clouds whose geometry is built, or poses are said, together


class PoseNet(Protocol):
    """A network that says a pose of a cloud."""

    def geometry(self, points: Tensor) -> Geometry:
        """What it has to know of clouds (B, N, 3)."""

    def pose(self, geometry: Geometry) -> tuple[Tensor, Tensor]:
        """R (B, 3, 3) and t (B, 3), metres, in the frame of the clouds."""


class CentredClouds:
    """Clouds with their poses relative to their means, and with all that a network has to know.

    Args:
        clouds: in the world.
        build: makes the geometry of clouds (B, N, 3).

    Attributes:
        geometry: of the V centred clouds.
        centre: (V, 3) metres in the world, their means.
        R: (V, 3, 3), t: (V, 3) metres, the poses; t relative to `centre`.
        object_id, scene_id, view: (V,) as of the clouds.

    Raises:
        ValueError: if clouds have too few points for the geometry, or it does not fit into memory.
    """

    def __init__(self, clouds: PoseClouds, build: Callable[[Tensor], Geometry]) -> None:
        self.centre = clouds.points.mean(1)
        self.R, self.t = clouds.R, clouds.t - self.centre
        self.object_id, self.scene_id, self.view = clouds.object_id, clouds.scene_id, clouds.view
        points = clouds.points - self.centre[:, None]
        one = sum(values[0].nbytes for values in build(points[:1]).tensors().values())
        # While the parts are joined, each number is there twice.
        require_bytes(
            "clouds", "geometry that fits into", f"{len(clouds)} clouds", 2.0 * one * len(clouds)
        )
        parts = [build(part).tensors() for part in points.split(AT_ONCE)]
        self.geometry = Geometry.of(
            {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        )

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.centre)

    def only(self, chosen: Tensor) -> CentredClouds:
        """Some of the clouds: those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        part = copy.copy(self)
        for name in ("centre", "R", "t", "object_id", "scene_id", "view"):
            setattr(part, name, getattr(self, name)[chosen])
        if not len(part):
            fail("chosen", "one cloud or more", "none")
        part.geometry = self.geometry.select(chosen)
        return part

    def draw(
        self, count: int, *, generator: torch.Generator, turn: float = 0.0
    ) -> dict[str, Tensor]:
        """A batch of `count` clouds, each turned about its mean, and its pose with it.

        Neither centres nor balls change when a cloud is turned, so its geometry stays valid.

        Args:
            count: B.
            generator: of random numbers.
            turn: degrees by which a cloud is turned at most, about an axis of any direction.

        Returns:
            "R" (B, 3, 3) and "t" (B, 3), metres, relative to the clouds' means, and what
            `Geometry.tensors` names, the "points" (B, N, 3) among it.

        Raises:
            ValueError: for numbers that cannot be.
        """
        require_integer("count", count, 1)
        turn = math.radians(require_number("turn", turn, 0, 180))
        rows = torch.randint(len(self), (count,), generator=generator)
        axis = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
        Q = axis_angle_to_matrix(axis * turn * torch.rand(count, 1, generator=generator))
        turned = self.geometry.select(rows).turned(Q)
        t = (Q @ self.t[rows][..., None])[..., 0]
        return {"R": Q @ self.R[rows], "t": t, **turned.tensors()}


@torch.no_grad()
def predict_poses(net: nn.Module, clouds: CentredClouds) -> tuple[Tensor, Tensor]:
    """What a network says of many clouds.

    Args:
        net: a `PoseNet` in evaluation mode; it stays where it is.
        clouds: with the geometry that it needs.

    Returns:
        R (V, 3, 3) and t (V, 3), metres, in the world, on the CPU.

    Raises:
        ValueError: if the geometry is of another network.
    """
    device = next(net.parameters()).device
    said = [
        net.pose(clouds.geometry.select(rows).to(device))
        for rows in torch.arange(len(clouds)).split(AT_ONCE)
    ]
    R, t = (torch.cat([part[k].cpu() for part in said]) for k in range(2))
    return R, t + clouds.centre


@torch.no_grad()
def pose_of_clouds(net: nn.Module, points: Tensor) -> tuple[Tensor, Tensor]:
    """What a network says of clouds of which nothing is prepared.

    Args:
        net: a `PoseNet` in evaluation mode; it stays where it is.
        points: (B, N, 3) float32 metres.

    Returns:
        R (B, 3, 3) and t (B, 3), metres, in the frame of the points, on the CPU.

    Raises:
        ValueError: if there are too few points.
    """
    device = next(net.parameters()).device
    points = points.to(device)
    centre = points.mean(1)
    R, t = net.pose(net.geometry(points - centre[:, None]))
    return R.cpu(), (t + centre).cpu()
