"""`estimate vector_field`: one of the paper's systems, with the networks of a run."""

from __future__ import annotations

import argparse

import torch

from posecore.arrays import fail
from posecore.methods import estimating
from posecore.methods.vector_field.runs import VectorFieldRun, read_run
from posecore.methods.vector_field.systems import SYSTEMS, VectorFieldSystem

__all__ = ["estimate"]

THRESHOLD = 0.8  # of the overlap above which OPEPL-DR refines


def estimate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    if options.threshold is not None and SYSTEMS[options.system] != "overlap":
        fail(
            "--threshold", f"nothing, as {options.system} decides nothing by it", options.threshold
        )
    estimating.estimate(options, read_run, _system)


def _system(
    run: VectorFieldRun, options: argparse.Namespace, device: torch.device
) -> VectorFieldSystem:
    net, refiner = run.new_net(), None
    run.load_weights("net", net)
    if SYSTEMS[options.system] != "never":
        refiner = run.new_refiner()
        run.load_weights("refiner", refiner)
        refiner.to(device)
    return VectorFieldSystem.named(
        options.system, net.to(device, memory_format=torch.channels_last), run.models, refiner,
        threshold=THRESHOLD if options.threshold is None else options.threshold,
        seed=options.seed,
    )  # fmt: skip
