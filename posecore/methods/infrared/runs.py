"""A run of `train infrared`: one network `net`, or with folds `net0`, `net1`, ... one for each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from posecore.arrays import require_choice, require_integer
from posecore.methods import runs
from posecore.methods.infrared.network import SIZES, CloudNet
from posecore.scale import SCALES

__all__ = ["InfraredRun", "read_run"]


@dataclass(frozen=True)
class InfraredRun(runs.Run):
    """A run as its folder has it.

    Attributes:
        path, options: as of every `Run`.
        image: (width, height) in pixels of the images that the networks take.
        points, width, blocks, max_channels, hidden, cube, max_scale: of `CloudNet`.
        scenes: for each network the scenes (in `headset` the drivers) that it was trained on.
    """

    method: ClassVar[str] = "infrared"

    image: tuple[int, int]
    points: int
    width: int
    blocks: int
    max_channels: int | None
    hidden: int
    cube: float
    max_scale: float
    scenes: list[list[int]]

    @property
    def object_ids(self) -> list[int]:
        """None: it finds clouds, and no poses."""
        return []

    @property
    def names(self) -> list[str]:
        """Of the networks."""
        return ["net"] if len(self.scenes) == 1 else [f"net{k}" for k in range(len(self.scenes))]

    def new_net(self) -> CloudNet:
        """A network, untrained."""
        return CloudNet(self.image, **{name: getattr(self, name) for name in SIZES})

    def load_nets(self) -> list[CloudNet]:
        """The networks, trained.

        Raises:
            ValueError: if one is not there, or damaged.
        """
        nets = []
        for name in self.names:
            net = self.new_net()
            self.load_weights(name, net)
            nets.append(net)
        return nets

    def net_of(self, scene_id: Tensor, group: Tensor) -> Tensor:
        """Which network makes the cloud of a view: one that was not trained on its scene.

        Args:
            scene_id, group: (V,) of the views.

        Returns:
            (V,) int64, the network's number. A scene that no network knows is divided among them
            by its groups; one that all of them know, as without folds, gets the first.
        """
        knows = torch.stack(
            [torch.isin(scene_id, torch.tensor(s, dtype=scene_id.dtype)) for s in self.scenes], 1
        )
        turn = group[:, None] + torch.arange(len(self.scenes))
        order = turn % len(self.scenes)  # (V, F) the networks in the order in which they are asked
        unknown = ~knows.gather(1, order)
        first = unknown.int().argmax(1, keepdim=True)  # the first that does not know it, else 0
        chosen = order.gather(1, first)[:, 0]
        return torch.where(unknown.any(1), chosen, 0)


def read_run(path: str | Path) -> InfraredRun:
    """Read what `InfraredRun.write` wrote.

    Raises:
        ValueError: naming the file, if there is none or it is damaged.
    """
    return runs.read_run(path, InfraredRun, _run)


def _run(path: Path, content: dict[str, Any]) -> InfraredRun:
    require_choice("scale", content["options"].get("scale"), SCALES)
    sizes = {name: content[name] for name in SIZES}
    scenes = [[require_integer("scenes", s, 0) for s in some] for some in content["scenes"]]
    if not scenes:
        raise ValueError("scenes: expected those of one network or more, got none")
    run = InfraredRun(path, content["options"], tuple(content["image"]), scenes=scenes, **sizes)
    run.new_net()  # refuses sizes that cannot be
    return run
