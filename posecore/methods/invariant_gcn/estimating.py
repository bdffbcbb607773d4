"""`estimate invariant_gcn`: poses and sizes of things never seen, from their depth and kind."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.views import View
from posecore.arrays import fail, require_choice
from posecore.methods import estimating
from posecore.methods.invariant_gcn.category_clouds import normals_and_view
from posecore.methods.invariant_gcn.network import Cloud, InvariantGCN, Prediction
from posecore.methods.invariant_gcn.poses import ROADS, estimated_pose
from posecore.methods.invariant_gcn.recipe import ROADS_OF
from posecore.methods.invariant_gcn.runs import InvariantGCNRun
from posecore.methods.invariant_gcn.seen_clouds import SPARE, masked_points, spread_points
from posecore.methods.runs import read_net_run
from posecore.nets.graph3d import build_graph

__all__ = ["CategoryEstimator", "SizedEstimate", "Thing", "estimate"]


class Thing(NamedTuple):
    """What is seen of one thing."""

    object_id: int
    category: int  # as the network knows it
    points: np.ndarray  # (M, 3) metres in the camera's frame


class SizedEstimate(NamedTuple):
    """A pose, and the edges of its box."""

    object_id: int
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,) metres
    score: float
    size: np.ndarray  # (3,) metres


class CategoryEstimator:
    """Poses and sizes of all things in a view, from depth, masks and categories.

    Args:
        run: of the training, which says what the network is given.
        net: trained, in evaluation mode.
        road: one of `ROADS`; None for that of the run's kind.
        seed: of the points that are drawn, for one view after the other.

    Raises:
        ValueError: for another road.
    """

    def __init__(
        self, run: InvariantGCNRun, net: InvariantGCN, road: str | None = None, seed: int = 0
    ) -> None:
        self.run, self.net, self.road = run, net, road or ROADS_OF[run.kind]
        require_choice("--road", self.road, ROADS)
        direct = self.road == "direct"
        if (direct and net.axes is None) or (not direct and net.canonical is None):
            fail("--road", f"one that a network of kind {run.kind} has", self.road)
        self._rng = np.random.default_rng(seed)
        self._revolution = torch.tensor([name in run.revolution for name in run.categories])

    def look(self, view: View) -> tuple[list[Thing]]:
        """The things of a view of which enough is seen.

        Raises:
            ValueError: if the data lack depth, masks or categories, or have another category.
        """
        things = []
        for item in view.objects:
            if view.depth is None or item.mask is None or item.category is None:
                fail("--data", "data with depth, masks and categories", f"{view}")
            if item.category not in self.run.categories:
                known = ", ".join(self.run.categories)
                fail("--data", f"things of the categories {known}", item.category)
            drawn = math.ceil(SPARE * self.run.points)
            found = masked_points(view.depth, item.mask, view.K, drawn, self._rng)
            if found is not None:
                category = self.run.categories.index(item.category)
                things.append(Thing(item.object_id, category, found[0]))
        return (things,)

    @torch.no_grad()
    def estimate(self, things: list[Thing]) -> list[SizedEstimate]:
        """Poses in the camera's frame; none of what tells none."""
        if not things:
            return []
        drawn = torch.from_numpy(np.stack([thing.points for thing in things])).float()
        order = spread_points(drawn, self.run.points)
        seen = drawn.gather(1, order[..., None].expand(-1, -1, 3))
        centre = seen.mean(1)
        graph = build_graph(seen - centre[:, None], self.run.sizes, self.run.near)
        category = torch.tensor([thing.category for thing in things])
        device = next(self.net.parameters()).device
        cloud = Cloud(graph, *normals_and_view(seen), category).to(device)
        said = self.net(cloud)
        symmetric = self._revolution[category]
        found = estimated_pose(said, cloud.graph.points, self.road, symmetric.to(device))
        scores = _scores(said, self.road, symmetric.to(device)).tolist()
        R, t, size, there = (part.cpu() for part in found)
        t = t + centre
        return [
            SizedEstimate(
                thing.object_id, R[i].double().numpy(), t[i].double().numpy(), scores[i],
                size[i].double().numpy(),
            )
            for i, thing in enumerate(things)
            if there[i]
        ]  # fmt: skip


def estimate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    estimating.estimate(options, partial(read_net_run, kind=InvariantGCNRun), _estimator)


def _estimator(
    run: InvariantGCNRun, options: argparse.Namespace, device: torch.device
) -> CategoryEstimator:
    return CategoryEstimator(run, run.load_net().to(device), options.road)


def _scores(said: Prediction, road: str, symmetric: Tensor) -> Tensor:
    """(B,) how sure a network is, 0 to 1."""
    if road == "direct":
        sure = torch.minimum(said.x_confidence, said.y_confidence)
        return torch.where(symmetric, said.y_confidence, sure)
    return said.canonical_confidence.sigmoid().mean(1)
