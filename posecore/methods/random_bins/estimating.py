"""`estimate random_bins`: the pose of the glasses in each infrared picture."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from data_tools.views import View
from posecore.arrays import fail
from posecore.methods import estimating
from posecore.methods.infrared.triples import reduced
from posecore.methods.random_bins.runs import RandomBinsRun
from posecore.methods.runs import read_net_run

__all__ = ["PictureEstimator", "estimate"]


def estimate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    estimating.estimate(options, partial(read_net_run, kind=RandomBinsRun), _estimator)


class PictureEstimator:
    """The pose of the glasses in each view, from its infrared picture.

    Args:
        net: trained, in evaluation mode.
        image: (width, height) in pixels of the pictures that it takes.
        objects: that it was trained on.
    """

    def __init__(self, net: nn.Module, image: tuple[int, int], objects: Sequence[int]) -> None:
        self.net, self.image, self.objects = net, tuple(image), objects

    def look(self, view: View) -> tuple[Tensor, int]:
        """The picture (1, 1, h, w) float32, 0 to 1, and which glasses are worn.

        Raises:
            ValueError: if there is no infrared image, or it is not known which glasses.
        """
        if view.ir is None:
            fail("--data", "data with infrared images", f"{view}")
        whole = view.ir if view.ir.dtype == np.uint8 else view.ir >> 8  # as in training
        picture = reduced(whole.astype(np.float32), self.image)
        return picture[None, None].float() / 255, estimating.known_object(view, self.objects)

    @torch.no_grad()
    def estimate(self, picture: Tensor, object_id: int) -> list[estimating.PlainEstimate]:
        """The pose of the glasses in the camera's frame."""
        said = self.net(picture.to(next(self.net.parameters()).device))
        R, t = (values[0].double().cpu().numpy() for values in (said.R, said.t))
        return [estimating.PlainEstimate(object_id, R, t)]


def _estimator(
    run: RandomBinsRun, options: argparse.Namespace, device: torch.device
) -> PictureEstimator:
    return PictureEstimator(run.load_net().to(device), run.image, run.object_ids)
