"""The recipe of P2R and P2P: what is trained, with which numbers.

The command line, chapter 4 and its ledger call this, and differ by arguments only.

    recipe = replace(RECIPES["book"], kind="p2r")
    clouds = recipe.prepared(visible_clouds(data, recipe.points))
    net = recipe.new_net()
    fit(net, recipe.batches(clouds), recipe.new_loss(), steps=recipe.steps, **recipe.fit)
    R, t = predict_poses(net, recipe.prepared(others))
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from torch import Tensor, nn

from data_tools.batches import Batches
from posecore.arrays import require_choice
from posecore.methods.net_training import FitNumbers
from posecore.methods.points_to_pose.centred_clouds import CentredClouds
from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.network import PointsToPose, PointsToRotation
from posecore.methods.points_to_pose.pose_clouds import PoseClouds
from posecore.methods.points_to_pose.voting import fused_keypoints
from posecore.nets.pointnet2 import LAYERS, PROPAGATIONS, Abstraction, Geometry, build_geometry
from posecore.randomness import seeded
from posecore.training.muon import Muon

__all__ = ["NETS", "RECIPES", "CloudRecipe", "KeypointLoss", "Recipe"]

NETS: Mapping[str, Callable[..., nn.Module]] = {"p2p": PointsToPose, "p2r": PointsToRotation}
"""The networks by their names."""


@dataclass(frozen=True, kw_only=True)
class CloudRecipe(FitNumbers):
    """What the recipes of all methods on clouds have in common.

    Attributes:
        points: N, of a cloud.
        turn: degrees by which a cloud is turned at most, for `CentredClouds.draw`.
        batch: clouds in a step.
        steps, optimiser, lr, schedule, clip: as for `fit`.
    """

    points: int
    turn: float = 0.0

    def batches(
        self,
        clouds: CentredClouds,
        *,
        steps: int | None = None,
        batch: int | None = None,
        seed: int = 0,
    ) -> Batches:
        """The batches of a training; `steps` and `batch` are the recipe's if they are not given."""
        return Batches(
            clouds.draw, None, self.batch if batch is None else batch,
            steps=self.steps if steps is None else steps, seed=seed,
            turn=self.turn,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class KeypointLoss:
    """The loss of a step of P2R or P2P, as `fit` calls it.

    Attributes:
        loss: of what the network says.
        keypoints: (K, 3) metres in the frame of the glasses.
    """

    loss: PoseLoss
    keypoints: Tensor

    def __call__(self, net: nn.Module, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch by `CentredClouds.draw`."""
        said = net(Geometry.of(batch))
        return self.loss(said, batch["R"], batch["t"], self.keypoints.to(batch["t"].device))


@dataclass(frozen=True, kw_only=True)
class Recipe(CloudRecipe):
    """The numbers of a scale, and what is made of them.

    Attributes:
        points, turn, batch, steps, optimiser, lr, schedule, clip: as of `CloudRecipe`.
        kind: "p2p" or "p2r".
        layers, propagations: of the backbone.
        keypoints: K, of P2P, the centre among them.
        widths: of P2P's voting module, and of P2R's convolutions before the last.
        hidden: of P2P's heads.
        last: width of P2R's last convolution.
        dense: of P2R's first dense layer.
        translation: whether P2R says one. In the paper it does not, and has that of its cloud.
        options: of the network besides, such as `representation` or `places`.
        loss: what is made without arguments is a `PoseLoss`.

    Raises:
        ValueError: for another kind.
    """

    kind: str = "p2p"
    layers: tuple[Abstraction, ...] = LAYERS
    propagations: tuple[tuple[int, ...], ...] = PROPAGATIONS
    keypoints: int = 9
    widths: tuple[int, ...] = (256, 256)
    hidden: tuple[int, ...] = (256, 256)
    last: int = 4
    dense: int = 512
    translation: bool = True
    options: Mapping[str, Any] = field(default_factory=dict)
    loss: Callable[[], PoseLoss] = PoseLoss

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, list(NETS))

    @property
    def net(self) -> dict[str, Any]:
        """The keyword arguments of the network."""
        shared = {"layers": self.layers, "propagations": self.propagations, **self.options}
        if self.kind == "p2p":
            own = {"keypoints": self.keypoints, "widths": self.widths, "hidden": self.hidden}
        else:
            own = {
                "widths": (*self.widths, self.last), "dense": self.dense,
                "translation": self.translation,
            }  # fmt: skip
        return shared | own

    def new_net(self, seed: int = 0) -> nn.Module:
        """The network with its first weights."""
        with seeded(seed):
            return NETS[self.kind](**self.net)

    def prepared(self, clouds: PoseClouds) -> CentredClouds:
        """Clouds with the geometry of the recipe's layers; for both kinds the same.

        Raises:
            ValueError: if they have too few points, or it does not fit into memory.
        """
        return CentredClouds(
            clouds, lambda points: build_geometry(points, self.layers, len(self.propagations))
        )

    def new_loss(self) -> KeypointLoss:
        """The loss of a step."""
        return KeypointLoss(self.loss(), fused_keypoints(self.keypoints - 1))


# A tenth of a metre counts as one in its losses, so that places weigh about as much as quaternions.
SMALL = {
    "widths": (128, 128), "hidden": (128, 128), "dense": 256, "turn": 30.0, "optimiser": Muon,
    "lr": 4e-3, "clip": 1.0, "loss": partial(PoseLoss, unit=0.1),
}  # fmt: skip
RECIPES = {
    "tiny": Recipe(
        points=64,
        layers=(
            Abstraction(32, 0.05, 8, (16, 32)), Abstraction(16, 0.1, 8, (32, 32)),
            Abstraction(8, 0.2, 8, (32, 32)),
        ),
        propagations=((32, 32),), batch=8, steps=40, **{**SMALL, "widths": (32, 32)},
    ),
    "book": Recipe(
        points=256,
        layers=(
            Abstraction(64, 0.05, 16, (32, 32, 64)), Abstraction(32, 0.1, 16, (64, 64, 128)),
            Abstraction(16, 0.2, 16, (64, 64, 128)),
        ),
        propagations=((128, 128),), batch=32, steps=2000, **SMALL,
    ),
    # The paper's Tables 1 and 2; batch and steps are not in it.
    "paper": Recipe(points=2000, batch=32, steps=200_000, schedule="constant"),
}  # fmt: skip
"""By the names of scales."""
