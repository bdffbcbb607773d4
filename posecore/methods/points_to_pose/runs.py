"""Runs of methods on clouds: `train points_to_pose`, and what others' are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from posecore.arrays import require_integer
from posecore.methods.points_to_pose.recipe import NETS
from posecore.methods.runs import NetRun

__all__ = ["CloudRun", "PointsToPoseRun"]


@dataclass(frozen=True)
class CloudRun(NetRun):
    """A run of a network on clouds.

    Attributes:
        path, options, kind, net, objects: as of every `NetRun`.
        points: N, of the clouds that it learned from.

    Raises:
        ValueError: if `points` is no number of points.
    """

    points: int

    def __post_init__(self) -> None:
        require_integer("points", self.points, 1)


@dataclass(frozen=True)
class PointsToPoseRun(CloudRun):
    """A run of `train points_to_pose`: P2P or P2R."""

    method: ClassVar[str] = "points_to_pose"
    NETS = NETS
