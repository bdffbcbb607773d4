"""`estimate points_to_pose`, and the same for every method on clouds."""

from __future__ import annotations

import argparse
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from data_tools.views import View
from posecore.arrays import fail, require_integer
from posecore.methods import estimating
from posecore.methods.infrared.clouds import CloudSet
from posecore.methods.points_to_pose.centred_clouds import pose_of_clouds
from posecore.methods.points_to_pose.pose_clouds import visible_points
from posecore.methods.points_to_pose.runs import CloudRun
from posecore.methods.points_to_pose.training import clouds_of
from posecore.methods.runs import read_net_run
from posecore.poses import apply, from_matrix, relative

__all__ = ["CloudEstimator", "SeenCloud", "estimate_on_clouds"]


NEEDS = (
    "clouds of points, from depth, masks and the poses of the cameras, as headset and hmdpose:PATH "
    "have them"
)
"""What `--data` has to hold."""


class SeenCloud(NamedTuple):
    """What a `CloudEstimator` is given of a view."""

    points: np.ndarray  # (N, 3) metres in the camera's frame; (0, 3) if nothing is seen
    T_world_cam: np.ndarray  # (4, 4)
    object_id: int


class CloudEstimator:
    """The pose of the glasses in each view, from what is seen of head and glasses there.

    The network is asked in the world's frame, which is the car's, as it was trained there on the
    clouds of all cameras. What it says is brought into the frame of the view's camera.

    Args:
        net: a `PoseNet`, trained.
        points: N, of each cloud, drawn at random.
        objects: that it was trained on.
        clouds: those that were predicted; None for the points that are truly visible, by the data's
            depth and masks.
        seed: of what is drawn. Each view has draws of its own: an answer does not depend on which
            views were looked at before.

    Raises:
        ValueError: if `seed` is no integer of at least 0.
    """

    def __init__(
        self,
        net: nn.Module,
        points: int,
        objects: list[int],
        clouds: CloudSet | None = None,
        seed: int = 0,
    ) -> None:
        self.net, self.points, self.objects, self.clouds = net, points, objects, clouds
        self._seed = require_integer("seed", seed, 0)
        self._rows = {}
        if clouds is not None:
            names = zip(clouds.scene_id.tolist(), clouds.image_id.tolist(), strict=True)
            self._rows = {name: row for row, name in enumerate(names)}

    def look(self, view: View) -> SeenCloud:
        """The cloud of a view.

        Raises:
            ValueError: if there is none, as the data lack depth, masks or the camera's pose, or the
                clouds are of other views; or it is not known which glasses are worn.
        """
        if view.T_world_cam is None:
            fail("--data", "calibrated cameras (T_world_cam)", f"{view} without")
        points = self._visible(view) if self.clouds is None else self._predicted(view)
        return SeenCloud(points, view.T_world_cam, estimating.known_object(view, self.objects))

    def estimate(
        self, points: np.ndarray, T_world_cam: np.ndarray, object_id: int
    ) -> list[estimating.PlainEstimate]:
        """The pose of the glasses in the camera's frame; none where nothing is seen."""
        if not len(points):
            return []
        camera = from_matrix(T_world_cam)
        seen = torch.from_numpy(apply(*camera, points)).float()
        R, t = (said[0].double().numpy() for said in pose_of_clouds(self.net, seen[None]))
        return [estimating.PlainEstimate(object_id, *relative(*camera, R, t))]

    def _visible(self, view: View) -> np.ndarray:
        masks = [item.mask for item in view.objects]
        if view.depth is None or not masks or any(mask is None for mask in masks):
            fail("--data", "data with depth and masks, or --clouds", f"{view}")
        seen = np.logical_or.reduce(masks)
        found = visible_points(view.depth, seen, view.K, self.points, self._draws(view))
        return np.zeros((0, 3)) if found is None else found[0]

    def _predicted(self, view: View) -> np.ndarray:
        row = self._rows.get((view.scene_id, view.image_id))
        if row is None:
            fail("--clouds", f"a cloud of {view}", "none")
        clouds = self.clouds
        if not np.array_equal(clouds.T_world_cam[row].numpy(), view.T_world_cam):
            fail("--clouds", f"a cloud of the camera of {view}", "one of another pose")
        points = clouds.points[row].double() + clouds.t[row].double()
        chosen = self._draws(view).choice(len(points), self.points, replace=False)
        return points[chosen].numpy()

    def _draws(self, view: View) -> np.random.Generator:
        return np.random.default_rng([self._seed, view.scene_id, view.image_id])


def estimate_on_clouds(options: argparse.Namespace, kind: type[CloudRun]) -> None:
    """Run the command of a method on clouds.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    estimating.estimate(options, partial(read_net_run, kind=kind), _estimator, NEEDS)


def _estimator(run: CloudRun, options: argparse.Namespace, device: torch.device) -> CloudEstimator:
    net = run.load_net().to(device)
    clouds = None if options.clouds is None else clouds_of(options.clouds, run.points)
    return CloudEstimator(net, run.points, run.object_ids, clouds)
