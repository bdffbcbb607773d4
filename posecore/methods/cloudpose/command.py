"""`train cloudpose` and `estimate cloudpose`: on the same clouds as `points_to_pose`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import ClassVar

from posecore.methods.cloudpose.recipe import NETS, RECIPES
from posecore.methods.points_to_pose.command import add_cloud_estimate, add_cloud_train
from posecore.methods.points_to_pose.estimating import estimate_on_clouds
from posecore.methods.points_to_pose.runs import CloudRun
from posecore.methods.points_to_pose.training import train_on_clouds

__all__ = ["CloudPoseRun", "add_estimate", "add_train"]


@dataclass(frozen=True)
class CloudPoseRun(CloudRun):
    """A run of `train cloudpose`."""

    method: ClassVar[str] = "cloudpose"
    NETS = NETS


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `cloudpose` to the methods that can be trained."""
    add_cloud_train(methods, "cloudpose", _train, "two PointNets on the points of a cloud")


def add_estimate(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `cloudpose` to the methods that estimate poses."""
    add_cloud_estimate(methods, "cloudpose", _estimate, "two PointNets on the points of a cloud")


def _train(options: argparse.Namespace) -> None:
    train_on_clouds(options, RECIPES, CloudPoseRun)


def _estimate(options: argparse.Namespace) -> None:
    estimate_on_clouds(options, CloudPoseRun)
