"""The recipe of CloudPose: what is trained, with which numbers.

recipe = RECIPES["book"]
clouds = recipe.prepared(visible_clouds(data, recipe.points))
net = recipe.new_net()
fit(net, recipe.batches(clouds), recipe.new_loss(), steps=recipe.steps, **recipe.fit)
R, t = predict_poses(net, recipe.prepared(others))
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from posecore.arrays import require_choice
from posecore.methods.cloudpose.network import POINTS, CloudPose, cloudpose_loss
from posecore.methods.points_to_pose.centred_clouds import CentredClouds
from posecore.methods.points_to_pose.pose_clouds import PoseClouds
from posecore.methods.points_to_pose.recipe import CloudRecipe
from posecore.nets.pointnet2 import Geometry
from posecore.randomness import seeded
from posecore.training.muon import Muon

__all__ = ["NETS", "RECIPES", "CloudPoseLoss", "Recipe"]

NETS: Mapping[str, Callable[..., nn.Module]] = {"cloudpose": CloudPose}
"""The one network by its name."""


@dataclass(frozen=True)
class CloudPoseLoss:
    """The loss of a step, as `fit` calls it.

    Attributes:
        weight: of the translation, for `cloudpose_loss`.
    """

    weight: float = 10.0

    def __call__(self, net: nn.Module, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch by `CentredClouds.draw`."""
        return cloudpose_loss(net(batch["points"]), batch["R"], batch["t"], self.weight)


@dataclass(frozen=True, kw_only=True)
class Recipe(CloudRecipe):
    """The numbers of a scale, and what is made of them.

    Attributes:
        points, turn, batch, steps, optimiser, lr, schedule, clip: as of `CloudRecipe`.
        kind: "cloudpose".
        widths, dense, unit: of `CloudPose`.
        loss: what is made without arguments is the loss of a step.

    Raises:
        ValueError: for another kind.
    """

    kind: str = "cloudpose"
    points: int = POINTS
    widths: tuple[int, ...] = (64, 64, 64, 128, 1024)
    dense: tuple[int, ...] = (512, 256)
    unit: float = 1.0
    loss: Callable[[], CloudPoseLoss] = CloudPoseLoss

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, list(NETS))

    @property
    def net(self) -> dict[str, Any]:
        """The keyword arguments of the network."""
        return {"widths": self.widths, "dense": self.dense, "unit": self.unit}

    def new_net(self, seed: int = 0) -> CloudPose:
        """The network with its first weights."""
        with seeded(seed):
            return CloudPose(**self.net)

    def prepared(self, clouds: PoseClouds) -> CentredClouds:
        """Clouds of which nothing but their points is known.

        Raises:
            ValueError: if they do not fit into memory.
        """
        return CentredClouds(clouds, lambda points: Geometry(points, ()))

    def new_loss(self) -> CloudPoseLoss:
        """The loss of a step."""
        return self.loss()


SMALL = {"turn": 30.0, "optimiser": Muon, "lr": 4e-3, "clip": 1.0}
RECIPES = {
    "tiny": Recipe(points=64, widths=(16, 32, 64), dense=(32, 16), batch=8, steps=40, **SMALL),
    "book": Recipe(widths=(32, 64, 256), dense=(128, 64), batch=32, steps=2000, **SMALL),
    # Sizes of the original; batch and steps are those of `points_to_pose`.
    "paper": Recipe(batch=32, steps=200_000, schedule="constant"),
}
"""By the names of scales."""
