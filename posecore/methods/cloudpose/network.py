"""CloudPose's BaseNet, twice, and its loss.

Source: Gao et al., "6D Object Pose Regression via Supervised Learning on Point Clouds", ICRA 2020,
the benchmark of Firintepe et al., "From IR images to point clouds to pose", 2021, Section 4.2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_finite, require_number
from posecore.nets.pointnet2 import Geometry, shared_mlp
from posecore.nets.rotation_heads import RotationHead

__all__ = ["POINTS", "BaseNet", "CloudPose", "CloudPoseOutput", "cloudpose_loss"]

POINTS = 256
"""How many points of a cloud the original takes."""

_ROTATION = RotationHead("axis_angle", "geodesic")


class BaseNet(nn.Module):
    """A PointNet without its transforms: every point alone, the maximum of all, three numbers.

    Args:
        widths: of the layers that every point goes through.
        dense: of those after the maximum, before the last.

    Raises:
        ValueError: if a size is no positive integer, or there are none.
    """

    def __init__(
        self,
        widths: Sequence[int] = (64, 64, 64, 128, 1024),
        dense: Sequence[int] = (512, 256),
    ) -> None:
        super().__init__()
        if not widths or not dense:
            fail("widths and dense", "at least one each", f"{tuple(widths)} and {tuple(dense)}")
        self.each = shared_mlp(3, *widths)
        self.whole = shared_mlp(widths[-1], *dense)
        self.last = nn.Linear(dense[-1], 3)

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, 3) to (B, 3); the order of the points does not matter."""
        return self.last(self.whole(self.each(points).max(1).values))


class CloudPoseOutput(NamedTuple):
    """What the network says of B clouds."""

    axis_angle: Tensor  # (B, 3) radians
    t: Tensor  # (B, 3) metres, in the frame of the cloud

    @property
    def R(self) -> Tensor:
        """(B, 3, 3)."""
        return _ROTATION.decode(self.axis_angle)


class CloudPose(nn.Module):
    """Two BaseNets that share nothing, on the points relative to their mean.

    Args:
        widths, dense: of both.
        unit: metres that count as one for the networks; 1 in the original.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(
        self,
        widths: Sequence[int] = (64, 64, 64, 128, 1024),
        dense: Sequence[int] = (512, 256),
        *,
        unit: float = 1.0,
    ) -> None:
        super().__init__()
        self.unit = require_number("unit", unit, above=0)
        self.rotation, self.translation = BaseNet(widths, dense), BaseNet(widths, dense)

    def forward(self, points: Tensor) -> CloudPoseOutput:
        """The poses of clouds.

        Args:
            points: (B, N, 3) metres; the original takes 256.

        Raises:
            ValueError: for another shape, or numbers that are not finite.
        """
        if points.ndim != 3 or points.shape[-1] != 3 or not points.shape[1]:
            fail("points", "shape (B, N, 3), N at least 1", f"shape {tuple(points.shape)}")
        require_finite("points", points)
        mean = points.mean(1, keepdim=True)
        x = (points - mean) / self.unit
        return CloudPoseOutput(self.rotation(x), mean[:, 0] + self.unit * self.translation(x))

    def geometry(self, points: Tensor) -> Geometry:
        """What it has to know of clouds (B, N, 3), metres: the points, and nothing of levels."""
        return Geometry(points, ())

    def pose(self, geometry: Geometry) -> tuple[Tensor, Tensor]:
        """R (B, 3, 3) and t (B, 3), metres, in the frame of the clouds."""
        said = self(geometry.points)
        return said.R, said.t


def cloudpose_loss(
    said: CloudPoseOutput, R: Tensor, t: Tensor, weight: float = 10.0
) -> dict[str, Tensor]:
    """Angle between the rotations, in radians, and `weight` times the distance in metres.

    Args:
        said: by the network.
        R: (B, 3, 3) the true rotations.
        t: (B, 3) metres, the true translations.
        weight: 10 in the original.

    Returns:
        "loss", and what it is the sum of, each a mean over the batch.

    Raises:
        ValueError: if `t` has another shape, `R` is none of rotations, or the weight is negative.
    """
    if t.shape != said.t.shape:
        fail("t", f"shape {tuple(said.t.shape)}", f"shape {tuple(t.shape)}")
    if R.shape != (len(t), 3, 3) or not len(t):
        fail("R", f"shape ({len(t)}, 3, 3), at least one", f"shape {tuple(R.shape)}")
    require_number("weight", weight, 0)
    rotation = _ROTATION.loss(said.axis_angle, R).mean()
    translation = torch.linalg.vector_norm(said.t - t, dim=-1).mean()
    return {
        "loss": rotation + weight * translation, "rotation": rotation, "translation": translation,
    }  # fmt: skip
