"""`estimate vector_field`: one of the paper's systems, with the networks of a run."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from data_tools.batches.warps import reduced_image
from posecore.arrays import fail
from posecore.methods import estimating
from posecore.methods.vector_field.recipe import RECIPES, reduced
from posecore.methods.vector_field.runs import VectorFieldRun, read_run
from posecore.methods.vector_field.systems import SYSTEMS, Estimate, VectorFieldSystem

__all__ = ["ReducedImages", "estimate"]


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


class ReducedImages:
    """A system whose images are first resized to the width that its network was trained on.

    Args:
        system: gives the poses.
        width: in pixels, to which wider images are reduced; None leaves them as they are.
    """

    def __init__(self, system: VectorFieldSystem, width: int | None) -> None:
        self.system, self.width = system, width

    def estimate(self, images: Tensor, K: np.ndarray) -> Sequence[Estimate]:
        """The poses in `images` (1, 3, H, W) RGB float32, 0 to 1, of the camera `K` (3, 3).

        Keypoints and covariances are in pixels of the reduced image.
        """
        height, width = images.shape[2:]
        size = reduced((width, height), self.width)
        if size != (width, height):
            image, K = reduced_image(images[0].permute(1, 2, 0).numpy(), K, size)
            images = torch.from_numpy(image).permute(2, 0, 1)[None]
        return self.system.estimate(images, K)


def _system(
    run: VectorFieldRun, options: argparse.Namespace, device: torch.device
) -> ReducedImages:
    net, refiner = run.new_net(), None
    run.load_weights("net", net)
    if SYSTEMS[options.system] != "never":
        refiner = run.new_refiner()
        run.load_weights("refiner", refiner)
        refiner.to(device)
    recipe = RECIPES[run.options.get("scale") or "book"]
    changes = {} if options.threshold is None else {"threshold": options.threshold}
    system = recipe.system(
        options.system, net.to(device, memory_format=torch.channels_last), run.models, refiner,
        voting=replace(recipe.voting, seed=options.seed), **changes,
    )  # fmt: skip
    return ReducedImages(system, run.image_width)
