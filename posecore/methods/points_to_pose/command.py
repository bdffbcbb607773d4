"""`train points_to_pose` and `estimate points_to_pose`: chapter 4 on any data with clouds."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from posecore.methods import estimating, training
from posecore.methods.net_training import add_net_options
from posecore.methods.points_to_pose.estimating import estimate_on_clouds
from posecore.methods.points_to_pose.recipe import NETS
from posecore.methods.points_to_pose.runs import PointsToPoseRun
from posecore.methods.points_to_pose.training import train

__all__ = ["add_cloud_estimate", "add_cloud_train", "add_estimate", "add_train"]

TRAIN = """Train on the clouds of a split: the points of head and glasses that each camera truly
sees, by the data's depth and masks, or with --clouds those that `clouds infrared` made of the
images. RUN is a folder; a command that was stopped goes on when it is given again. Several
processes: torchrun --nproc-per-node N -m posecore train ..."""
ESTIMATE = """Estimate the pose of the glasses in every view of a split, from its cloud alone, and
write them in the BOP format, which `python -m posecore evaluate` measures: a row for each view,
with the seconds from its points to its pose. Which glasses they are is read from the data."""
CLOUDS = "that `clouds infrared` wrote of the same split; default: what is truly visible"


def add_cloud_train(
    methods: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    command: Callable[[argparse.Namespace], None],
    summary: str,
) -> argparse.ArgumentParser:
    """Add a method on clouds to those that can be trained; returns its parser."""
    parser = training.add_parser(methods, name, command, summary=summary, description=TRAIN)
    add_net_options(parser, "clouds")
    parser.add_argument("--clouds", metavar="FILE", help=CLOUDS)
    return parser


def add_cloud_estimate(
    methods: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    command: Callable[[argparse.Namespace], None],
    summary: str,
) -> None:
    """Add a method on clouds to those that estimate poses."""
    parser = estimating.add_parser(methods, name, command, summary=summary, description=ESTIMATE)
    parser.add_argument("--clouds", metavar="FILE", help=CLOUDS)


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `points_to_pose` to the methods that can be trained."""
    parser = add_cloud_train(methods, "points_to_pose", train, "P2P and P2R, on PointNet++")
    parser.add_argument("--kind", choices=list(NETS), help="default: p2p")


def add_estimate(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `points_to_pose` to the methods that estimate poses."""
    add_cloud_estimate(methods, "points_to_pose", _estimate, "P2P and P2R, on PointNet++")


def _estimate(options: argparse.Namespace) -> None:
    estimate_on_clouds(options, PointsToPoseRun)
