"""`train random_bins` and `estimate random_bins`: poses of infrared pictures, without clouds."""

from __future__ import annotations

import argparse

from posecore.methods import estimating, training
from posecore.methods.net_training import add_net_options
from posecore.methods.random_bins.estimating import estimate
from posecore.methods.random_bins.recipe import NETS
from posecore.methods.random_bins.training import train

__all__ = ["add_estimate", "add_train"]

SUMMARY = "RandomizedBins on infrared pictures"
TRAIN = """Train on the infrared pictures of a split, with the pose of the glasses in each camera's
frame. RUN is a folder; a command that was stopped goes on when it is given again. Several
processes: torchrun --nproc-per-node N -m posecore train ..."""
ESTIMATE = """Estimate the pose of the glasses in every infrared picture of a split, and write them
in the BOP format, which `python -m posecore evaluate` measures: a row for each picture, with the
seconds that it took. Which glasses they are is read from the data."""


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `random_bins` to the methods that can be trained."""
    parser = training.add_parser(methods, "random_bins", train, summary=SUMMARY, description=TRAIN)
    add_net_options(parser, "pictures")
    parser.add_argument("--kind", choices=list(NETS), help="of the head; default: bins")


def add_estimate(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `random_bins` to the methods that estimate poses."""
    estimating.add_parser(methods, "random_bins", estimate, summary=SUMMARY, description=ESTIMATE)
