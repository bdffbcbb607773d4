"""The recipe of RandomizedBins, and of the same trunk with regression.

recipe = replace(RECIPES["book"], kind="regression")
pictures = recipe.pictures(batches.load(data_tools.open("headset", split="train")))
net = recipe.new_net(pictures)
fit(net, recipe.batches(pictures), recipe.new_loss(), steps=recipe.steps, **recipe.fit)
said = net(images)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from data_tools.batches import Batches, Stack
from posecore.arrays import require_choice
from posecore.methods.net_training import FitNumbers
from posecore.methods.random_bins.losses import bins_loss, regression_loss
from posecore.methods.random_bins.network import PictureRegression, RandomBins
from posecore.methods.random_bins.pictures import Pictures
from posecore.randomness import seeded
from posecore.training.muon import Muon

__all__ = ["NETS", "RECIPES", "PictureLoss", "Recipe"]

NETS: Mapping[str, Callable[..., nn.Module]] = {"bins": RandomBins, "regression": PictureRegression}
"""The networks by their names."""

LOSSES = {"bins": bins_loss, "regression": regression_loss}


@dataclass(frozen=True)
class PictureLoss:
    """The loss of a step, as `fit` calls it.

    Attributes:
        kind: of the network, a name in `NETS`.
    """

    kind: str

    def __call__(self, net: nn.Module, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch by `Pictures.draw`."""
        return LOSSES[self.kind](net, net(batch["images"]), batch["values"])


@dataclass(frozen=True, kw_only=True)
class Recipe(FitNumbers):
    """The numbers of a scale, and what is made of them.

    Attributes:
        kind: "bins" or "regression".
        image: (width, height) in pixels of the pictures that the network is given.
        sets, bins: M and L of `RandomBins`.
        trunk, width, blocks: of both networks.
        batch: pictures in a step.
        steps, optimiser, lr, schedule, clip: as for `fit`.

    Raises:
        ValueError: for another kind.
    """

    kind: str = "bins"
    image: tuple[int, int]
    sets: int = 30
    bins: int = 40
    trunk: str = "bottleneck"
    width: int = 64
    blocks: tuple[int, ...] = (3, 4, 6, 3)

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, list(NETS))

    @property
    def net(self) -> dict[str, Any]:
        """The keyword arguments of the network, but for the range of the labels."""
        shared = {"trunk": self.trunk, "width": self.width, "blocks": self.blocks}
        return shared | ({"sets": self.sets, "bins": self.bins} if self.kind == "bins" else {})

    def pictures(self, data: Stack) -> Pictures:
        """Pictures of a dataset at the size of the recipe.

        Raises:
            ValueError: as of `Pictures`.
        """
        return Pictures(data, self.image)

    def new_net(self, pictures: Pictures, seed: int = 0) -> nn.Module:
        """The network with its first weights, and range and brightness of a training's pictures.

        Raises:
            ValueError: if the labels' range is too small for so many classes.
        """
        own = {"seed": seed} if self.kind == "bins" else {}
        with seeded(seed):
            net = NETS[self.kind](
                pictures.values.amin(0), pictures.values.amax(0), **self.net, **own
            )
        mean, std = pictures.brightness()
        net.mean.fill_(mean)
        net.std.fill_(std)
        return net

    def batches(
        self,
        pictures: Pictures,
        *,
        steps: int | None = None,
        batch: int | None = None,
        seed: int = 0,
    ) -> Batches:
        """The batches of a training; `steps` and `batch` are the recipe's if they are not given."""
        count = self.batch if batch is None else batch
        steps = self.steps if steps is None else steps
        return Batches(pictures.draw, None, count, steps=steps, seed=seed)

    def new_loss(self) -> PictureLoss:
        """The loss of a step."""
        return PictureLoss(self.kind)


SMALL = {"trunk": "basic", "optimiser": Muon, "lr": 4e-3, "clip": 1.0}
RECIPES = {
    "tiny": Recipe(
        image=(80, 47), sets=5, bins=10, width=8, blocks=(1, 1, 1, 1), batch=8, steps=20, **SMALL
    ),
    "book": Recipe(
        image=(160, 94), width=16, blocks=(2, 2, 2, 2), batch=32, steps=2000, **SMALL
    ),
    # ResNet-50; batch and steps are those of `points_to_pose`.
    "paper": Recipe(image=(320, 188), batch=32, steps=200_000, lr=1e-4, schedule="constant"),
}  # fmt: skip
"""By the names of scales."""
