"""The recipe: which networks are trained, with which numbers.

recipe = replace(RECIPES["book"], kind="invariant")
clouds = recipe.prepared(seen_clouds(data, recipe.points))
net = recipe.new_net(clouds.seen.mean_size())
fit(net, recipe.batches(clouds), recipe.new_loss(), steps=recipe.steps, **recipe.fit)
found = predict_poses(net, recipe.prepared(others), ROADS_OF[recipe.kind])
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from data_tools.batches import Batches
from posecore.arrays import require_choice
from posecore.methods.invariant_gcn.backbone import LEVELS, WIDTHS
from posecore.methods.invariant_gcn.category_clouds import CategoryClouds, Variation
from posecore.methods.invariant_gcn.network import Cloud, InvariantGCN
from posecore.methods.invariant_gcn.seen_clouds import SeenClouds
from posecore.methods.invariant_gcn.total_loss import TotalLoss
from posecore.methods.net_training import FitNumbers
from posecore.nets.graph3d import Graph, build_graph
from posecore.randomness import seeded
from posecore.training.muon import Muon

__all__ = ["NETS", "RECIPES", "ROADS_OF", "CloudLoss", "Recipe", "flat_then_cosine"]

_F1: dict[str, Any] = {"form": "printed"}
_FORMS: Mapping[str, dict[str, Any]] = {
    "printed": {"f1": _F1},
    "a1": {},
    "gpv": {"branches": ("axes", "faces")},
    "nocs": {"branches": ("canonical",)},
    "invariant": {"backbone": "invariant", "branches": ("canonical",)},
}
NETS: Mapping[str, Callable[..., nn.Module]] = {
    name: partial(InvariantGCN, **options) for name, options in _FORMS.items()
}
"""The networks by their names:

- "printed": the paper's, with f1 in the convolution;
- "a1": f1 out of it, all losses kept (Table 2);
- "gpv": GPV-Pose rebuilt, without f1 and without L_PC (Table 1);
- "nocs": canonical coordinates on a plain 3D-GCN, to which a similarity is fitted;
- "invariant": the same from invariants alone, the determinants among them.
"""
ROADS_OF = {
    "printed": "direct", "a1": "direct", "gpv": "direct", "nocs": "weighted",
    "invariant": "weighted",
}  # fmt: skip
"""The road to a pose of each, one of `poses.ROADS`."""


def flat_then_cosine(done: float) -> float:
    """The factor on the learning rate: 1 for the first half, then half a wave of a cosine to 0."""
    return 1.0 if done < 0.5 else (1 + math.cos(math.pi * (2 * done - 1))) / 2


@dataclass(frozen=True)
class CloudLoss:
    """The loss of a step, as `fit` calls it.

    Attributes:
        loss: of what the network says.
    """

    loss: TotalLoss

    def __call__(self, net: nn.Module, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch by `CategoryClouds.draw`."""
        return self.loss(net(Cloud.of(batch)), batch)


@dataclass(frozen=True, kw_only=True)
class Recipe(FitNumbers):
    """The numbers of a scale, and what is made of them.

    Attributes:
        kind: a name in `NETS`.
        points: N, of a cloud.
        sizes: points of its coarser clouds.
        near: neighbours in the graph of each cloud, of which a network takes its K first.
        net_sizes: keyword arguments of all networks but `mean_size`.
        graph_sizes: those of networks with graph convolutions besides.
        net_options: of the network that is made, over those of its kind, such as `f1` or `form`.
        vary: what is varied in a batch.
        loss: what is made with `pc=` where it is 0 is a `TotalLoss`.
        batch: clouds in a step.
        steps, optimiser, lr, schedule, clip: as for `fit`.

    Raises:
        ValueError: for another kind.
    """

    kind: str = "printed"
    points: int
    sizes: tuple[int, ...]
    near: tuple[int, ...]
    net_sizes: Mapping[str, Any]
    graph_sizes: Mapping[str, Any] = field(default_factory=dict)
    net_options: Mapping[str, Any] = field(default_factory=dict)
    vary: Variation = field(default_factory=Variation)
    loss: Callable[..., TotalLoss] = TotalLoss

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, list(NETS))

    @property
    def net(self) -> dict[str, Any]:
        """The keyword arguments of the network, but for the mean sizes."""
        own = {} if self.kind == "invariant" else self.graph_sizes
        return {**self.net_sizes, **own, **self.net_options}

    def new_net(self, mean_size: Tensor, seed: int = 0) -> InvariantGCN:
        """The network with its first weights, for categories of these sizes, (C, 3) metres."""
        with seeded(seed):
            return NETS[self.kind](mean_size.tolist(), **self.net)

    def build(self, points: Tensor) -> Graph:
        """The graph of clouds (B, N, 3)."""
        return build_graph(points, self.sizes, self.near)

    def prepared(self, seen: SeenClouds) -> CategoryClouds:
        """Clouds with the graphs that all kinds need, of the first N of their points.

        Raises:
            ValueError: if they have too few points, or it does not fit into memory.
        """
        return CategoryClouds(seen.thinned(self.points), self.build)

    def batches(
        self,
        clouds: CategoryClouds,
        *,
        steps: int | None = None,
        batch: int | None = None,
        seed: int = 0,
    ) -> Batches:
        """The batches of a training; `steps` and `batch` are the recipe's if they are not given."""
        return Batches(
            clouds.draw, None, self.batch if batch is None else batch,
            steps=self.steps if steps is None else steps, seed=seed, vary=self.vary,
        )  # fmt: skip

    def new_loss(self) -> CloudLoss:
        """The loss of a step; of GPV-Pose rebuilt without L_PC."""
        return CloudLoss(self.loss(pc=0.0) if self.kind == "gpv" else self.loss())


# A tenth of a metre counts as one in its losses, so that places weigh about as much as axes; and
# what a point knows of its own error is not to be learned before where it is.
SMALL: dict[str, Any] = {
    "optimiser": Muon, "lr": 4e-3, "clip": 1.0,
    "loss": partial(TotalLoss, unit=0.1, reconstruction=2.0, confidence=0.02, proportions=0.2),
    "vary": Variation(turn=15.0, scale=0.15),
}  # fmt: skip
RECIPES = {
    "tiny": Recipe(
        points=64, sizes=(16, 6), near=(6, 5, 4), batch=8, steps=40,
        net_sizes={
            "widths": (8, 8, 12, 12, 16), "neighbours": 5, "norm": "layer", "context": 12,
            "pooled": ((16, 16), (12,)), "dense": (16, 16), "faces": (16,), "dropout": 0.0,
            "places": True,
        },
        graph_sizes={"supports": 2}, **SMALL,
    ),
    "book": Recipe(
        points=128, sizes=(32, 8), near=(8, 8, 7), batch=16, steps=6000,
        net_sizes={
            "widths": (24, 24, 48, 48, 96), "neighbours": 8, "norm": "layer", "context": 96,
            "pooled": ((96, 96), (96,)), "dense": (96, 96), "faces": (96, 96), "dropout": 0.0,
            "places": True,
        },
        graph_sizes={"supports": 3}, **SMALL,
    ),
    # As printed; what is not is GPV-Pose's. Ranger, which PyTorch has not, is RAdam that looks
    # ahead: the first of both is here. 150 epochs of 90 000 things, about those of `categories`.
    "paper": Recipe(
        points=512, sizes=(128, 32), near=(20, 10, 10), batch=16, steps=150 * 90_000 // 16,
        net_sizes={"widths": WIDTHS, "levels": LEVELS, "neighbours": 10, "norm": "batch"},
        graph_sizes={"supports": 7}, optimiser=torch.optim.RAdam, lr=1e-3,
        schedule=flat_then_cosine, vary=Variation(turn=15.0, scale=0.2, noise=0.001),
    ),
}  # fmt: skip
"""By the names of scales."""
