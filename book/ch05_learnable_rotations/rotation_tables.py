"""What chapter 5 measures without pictures: networks that are given a rotation and say it again.

R (9 numbers) -> 128 -> 128 -> 128 -> as many numbers as the representation has -> R, as in Table IV
of CIPE. Which loss its networks had, the paper does not say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

from book.tools.keys import Key
from posecore.nets.rotation_heads import (
    REPRESENTATIONS,
    RotationCodec,
    RotationHead,
    train_codec,
)
from posecore.rotations import geodesic_distance, random_rotations
from posecore.scale import choose
from posecore.training import History, fit, seeded

__all__ = [
    "CROSSED",
    "SideBySide",
    "codec_of",
    "crossed",
    "crossed_self_regression",
    "degrees_off",
    "mlp",
    "self_regression",
    "table_iv",
    "tested_rotations",
    "train_self_regression",
]

CROSSED = (
    *((name, loss) for name in ("quaternion", "6d", "procrustes")
      for loss in ("output", "chordal", "geodesic")),
    ("quaternion", "sign_free"),
    ("learnable", "output"),
)  # fmt: skip
"""Representation and loss, crossed. With a loss on R the learnable one is Procrustes."""


class SideBySide(nn.Module):
    """One network for each head, all trained at once on the same batches.

    Adam treats every weight by itself, so the sum of their losses trains each as if it were alone.
    They differ in their last layer only, and the layers before it start equal.

    Args:
        heads: name -> head.
        network: `network(size)` makes a network that says so many numbers.
        seed: of the first weights.
    """

    def __init__(
        self, heads: Mapping[str, RotationHead], network: Callable[[int], nn.Module], seed: int
    ) -> None:
        super().__init__()
        self.heads = nn.ModuleDict(heads)
        self.networks = nn.ModuleDict()
        for name, head in heads.items():
            with seeded(seed):
                self.networks[name] = network(head.size)

    def losses(self, inputs: Tensor, R: Tensor) -> dict[str, Tensor]:
        """The mean loss of each network, and their sum as "loss"."""
        parts = {
            name: head.loss(self.networks[name](inputs), R).mean()
            for name, head in self.heads.items()
        }
        return {"loss": torch.stack(list(parts.values())).sum(), **parts}

    def forward(self, inputs: Tensor) -> dict[str, Tensor]:
        """name -> (B, 3, 3) what each network says."""
        return {name: head(self.networks[name](inputs)) for name, head in self.heads.items()}


@torch.no_grad()
def degrees_off(networks: SideBySide, inputs: Tensor, R: Tensor) -> dict[str, np.ndarray]:
    """name -> (B,) the angle in degrees by which each network errs."""
    said = networks.eval()(inputs)
    return {
        name: np.degrees(geodesic_distance(guess.double(), R.double()).numpy())
        for name, guess in said.items()
    }


def mlp(size: int) -> nn.Sequential:
    """(B, 3, 3) -> (B, size), the network of Table IV."""
    return nn.Sequential(
        nn.Flatten(),
        nn.Linear(9, 128), nn.LeakyReLU(),
        nn.Linear(128, 128), nn.LeakyReLU(),
        nn.Linear(128, 128), nn.LeakyReLU(),
        nn.Linear(128, size),
    )  # fmt: skip


@lru_cache(maxsize=8)
def codec_of(seed: int) -> RotationCodec:
    """The learnable representation that goes with a seed."""
    return train_codec(seed=seed, steps=choose(tiny=30, book=3000, paper=20_000))


def table_iv(codec: RotationCodec) -> dict[str, RotationHead]:
    """A head for each representation.

    The losses are squared distances, as of Zhou et al., whose experiment the paper repeats: between
    rotations, and of the learnable one between codes.
    """
    return {
        name: RotationHead(name, squared=True, codec=codec if name == "learnable" else None)
        for name in REPRESENTATIONS
    }


def crossed(codec: RotationCodec) -> dict[str, RotationHead]:
    """A head for each pair of `CROSSED`, by the name "representation, loss"; losses as in Eq. 10,
    distances that are not squared."""
    return {
        f"{name}, {loss}": RotationHead(name, loss, codec=codec if name == "learnable" else None)
        for name, loss in CROSSED
    }


def train_self_regression(
    heads: Mapping[str, RotationHead], seed: int, steps: int, show: bool | None = False
) -> tuple[SideBySide, History]:
    """Train a network for each head to say the rotation that it is given.

    Args:
        heads: name -> head.
        seed: of first weights and rotations.
        steps: each with 256 new rotations.
        show: as for `fit`.
    """
    networks = SideBySide(heads, mlp, seed)
    history = fit(
        networks,
        lambda generator: random_rotations(256, generator=generator, dtype=torch.float32),
        lambda networks, R: networks.losses(R, R),
        steps=steps,
        lr=2e-3,
        seed=seed,
        device="cpu",
        show=show,
    )
    return networks, history


def tested_rotations(seed: int) -> Tensor:
    """(N, 3, 3) rotations that are no training's."""
    count = choose(tiny=200, book=20_000, paper=20_000)
    return random_rotations(count, generator=1_000_000 + seed, dtype=torch.float32)


def self_regression(seed: int) -> dict[Key, float]:
    """Table IV: degrees on new rotations, their mean, extremes and percentiles."""
    networks, _ = train_self_regression(table_iv(codec_of(seed)), seed, _steps())
    R = tested_rotations(seed)
    numbers = {}
    for name, off in degrees_off(networks, R, R).items():
        numbers[Key(name, metric="rotation")] = off.mean()
        numbers[Key(name, metric="rotation smallest")] = off.min()
        numbers[Key(name, metric="rotation largest")] = off.max()
        for part in (50, 90, 99, 99.9):
            numbers[Key(name, metric=f"rotation percentile {part}")] = np.percentile(off, part)
    return {key: float(value) for key, value in numbers.items()}


def crossed_self_regression(seed: int) -> dict[Key, float]:
    """Representation and loss crossed: mean and median in degrees on new rotations."""
    networks, _ = train_self_regression(crossed(codec_of(seed)), seed, _steps())
    R = tested_rotations(seed)
    numbers = {}
    for name, off in degrees_off(networks, R, R).items():
        numbers[Key(name, metric="rotation")] = float(off.mean())
        numbers[Key(name, metric="rotation median")] = float(np.median(off))
    return numbers


def _steps() -> int:
    return choose(tiny=20, book=4000, paper=50_000)
