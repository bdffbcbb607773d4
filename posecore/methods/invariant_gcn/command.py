"""`train invariant_gcn` and `estimate invariant_gcn`: chapter 7 on any data with categories."""

from __future__ import annotations

import argparse

from posecore.methods import estimating, training
from posecore.methods.invariant_gcn.estimating import estimate
from posecore.methods.invariant_gcn.poses import ROADS
from posecore.methods.invariant_gcn.recipe import NETS
from posecore.methods.invariant_gcn.training import train
from posecore.methods.net_training import add_net_options

__all__ = ["add_estimate", "add_train"]

SUMMARY = "things of known categories, by rotation-invariant graph convolution"
TRAIN = """Train on the depth of things of known categories: points are drawn in their masks and
back-projected. RUN is a folder; a command that was stopped goes on when it is given again. Several
processes: torchrun --nproc-per-node N -m posecore train ..."""
ESTIMATE = """Estimate the pose of every thing in every view of a split, from its depth, mask and
category, and write them in the BOP format, which `python -m posecore evaluate` measures. The things
themselves need not have been there in training."""
KIND = """printed: the paper's network (default); a1: without its invariant features; gpv: GPV-Pose
rebuilt; nocs: canonical coordinates by 3D-GCN; invariant: by what does not turn"""
ROAD = """direct: as axes, translation and size are said; plain, weighted, ransac: by canonical
coordinates; default: direct of kinds that say axes, else weighted"""


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `invariant_gcn` to the methods that can be trained."""
    parser = training.add_parser(
        methods, "invariant_gcn", train, summary=SUMMARY, description=TRAIN
    )
    add_net_options(parser, "clouds")
    parser.add_argument("--kind", choices=list(NETS), help=KIND)


def add_estimate(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `invariant_gcn` to the methods that estimate poses."""
    parser = estimating.add_parser(
        methods, "invariant_gcn", estimate, summary=SUMMARY, description=ESTIMATE
    )
    parser.add_argument("--road", choices=ROADS, help=ROAD)
