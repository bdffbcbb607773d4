"""`train vector_field` and `estimate vector_field`: the systems of chapter 8 on any dataset."""

from __future__ import annotations

import argparse

from posecore.methods import estimating, training
from posecore.methods.vector_field.estimating import estimate
from posecore.methods.vector_field.losses import PROJECTIONS
from posecore.methods.vector_field.systems import SYSTEMS
from posecore.methods.vector_field.training import train

__all__ = ["add_estimate", "add_train"]

TRAIN = """Train PVNet with the projection loss on windows of images, then a refiner on its fields.
Needed are colour images, masks, poses and models. RUN is a folder; a command that was stopped goes
on when it is given again. Several processes: torchrun --nproc-per-node N -m posecore train ..."""
ESTIMATE = """Estimate the poses of a run's objects, and write them in the BOP format, which
`python -m posecore evaluate` measures: a row for each object found in an image, with its score and
the seconds that the image took."""


def add_train(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `vector_field` to the methods that can be trained."""
    command = training.add_parser(
        methods, "vector_field", train, summary="PVNet and a refiner", description=TRAIN
    )
    command.add_argument("--steps", type=int, help="of the field; default: by the scale")
    command.add_argument(
        "--refiner-steps", type=int, help="default: by the scale; 0 for no refiner"
    )
    command.add_argument("--batch", type=int, help="windows in a step; default: by the scale")
    command.add_argument("--projection", choices=PROJECTIONS, help="loss of Eq 1; default: pixel")
    command.add_argument(
        "--weight", help="of that loss: dynamic, or a number; default: by the scale"
    )
    command.add_argument(
        "--warmup",
        metavar="FRACTION",
        type=float,
        help="of the training, before that loss comes in; default: by the scale",
    )
    command.add_argument(
        "--ignore-reversed",
        action=argparse.BooleanOptionalAction,
        help="leave vectors that point away out of that loss; default: by the scale",
    )
    command.add_argument("--imagenet", metavar="FILE", help="torchvision's resnet18, at width 64")


def add_estimate(methods: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `vector_field` to the methods that estimate poses."""
    command = estimating.add_parser(
        methods, "vector_field", estimate, summary="OPEPL, -R, -DR", description=ESTIMATE
    )
    command.add_argument("--system", choices=list(SYSTEMS), default="OPEPL-DR")
    command.add_argument("--threshold", type=float, help="of the overlap, for -DR; default: 0.8")
    command.add_argument("--seed", type=int, default=0, help="of the vote")
