"""From a picture to six numbers: by classes drawn at random, or by regression with the same trunk.

The six are yaw, pitch and roll in radians (R = Ry(yaw) Rx(pitch) Rz(roll)) and x, y and z in
metres, in the camera's frame.

Source: Berg et al., "Deep Ordinal Regression with Label Diversity", ICPR 2020, as Firintepe et al.
have extended it to positions, "From IR images to point clouds to pose", 2021, Section 4.2.1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_choice, require_finite, require_integer, require_number
from posecore.nets.bottleneck import BottleneckResNet
from posecore.nets.resnet import ResNet
from posecore.rotations import euler_to_matrix, matrix_to_euler

__all__ = [
    "STEPS",
    "PictureRegression",
    "PoseNumbers",
    "RandomBins",
    "draw_bins",
    "pose_numbers",
]

STEPS = (math.radians(0.01),) * 3 + (1e-4,) * 3
"""Those in which a label's range is divided: 0.01 degrees and 0.01 cm."""


class PoseNumbers(NamedTuple):
    """What a network says of B pictures."""

    values: Tensor  # (B, 6) yaw, pitch, roll in radians; x, y, z in metres
    logits: Tensor | None = None  # (B, 6, M, L) of the classes

    @property
    def R(self) -> Tensor:
        """(B, 3, 3) object to camera."""
        return euler_to_matrix(self.values[:, :3])

    @property
    def t(self) -> Tensor:
        """(B, 3) metres."""
        return self.values[:, 3:]


def pose_numbers(R: Tensor, t: Tensor) -> Tensor:
    """(B, 6) the six numbers of rotations (B, 3, 3) and translations (B, 3)."""
    return torch.cat([matrix_to_euler(R), t], -1)


def draw_bins(
    low: Tensor,
    high: Tensor,
    *,
    sets: int = 30,
    bins: int = 40,
    steps: Sequence[float] = STEPS,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Classes of every number: values drawn from its range, divided in steps, none twice in a set.

    Args:
        low: (n,) the least label of each number.
        high: (n,) the largest.
        sets: M, how many times classes are drawn.
        bins: L, how many classes.
        steps: (n,) in which the ranges are divided.
        generator: of the random numbers.

    Returns:
        (n, M, L) the classes' values, from small to large.

    Raises:
        ValueError: if a range has fewer steps than `bins`, or shapes do not fit.
    """
    require_integer("sets", sets, 1)
    require_integer("bins", bins, 1)
    if low.ndim != 1 or low.shape != high.shape or len(low) != len(steps):
        shapes = f"shapes {tuple(low.shape)}, {tuple(high.shape)} and ({len(steps)},)"
        fail("low, high and steps", "one shape (n,)", shapes)
    for name, value in (("low", low), ("high", high)):
        require_finite(name, value)
    found = []
    for i, step in enumerate(steps):
        step = require_number(f"steps[{i}]", step, above=0)
        # A last step that ends at `high` up to rounding counts.
        count = math.floor((float(high[i]) - float(low[i])) / step + 1e-3) + 1
        if count < bins:
            fail(f"high[{i}] - low[{i}]", f"at least {bins - 1} steps of {step:g}", count - 1)
        shares = torch.rand(sets, count, generator=generator, dtype=torch.float64)
        chosen = shares.topk(bins).indices.sort().values
        found.append(float(low[i]) + step * chosen.double())
    return torch.stack(found).to(low)


class _Picture(nn.Module):
    """A trunk, and the mean of its last maps."""

    def __init__(
        self, low: Tensor, high: Tensor, trunk: str, width: int, blocks: Sequence[int],
        in_channels: int, options: dict[str, Any],
    ) -> None:  # fmt: skip
        super().__init__()
        require_choice("trunk", trunk, ("bottleneck", "basic"))
        for name, value in (("low", low), ("high", high)):
            if value.shape != (6,) or not value.isfinite().all():
                fail(name, "six finite numbers", value)
        if not (high > low).all():
            fail("high", f"above low, {low.tolist()}", high.tolist())
        self.register_buffer("low", low.float())
        self.register_buffer("high", high.float())
        self.register_buffer("mean", torch.tensor(0.0))
        self.register_buffer("std", torch.tensor(1.0))
        if trunk == "basic":
            self.trunk = ResNet(width, 32, blocks, in_channels, **options)
            self.features = self.trunk.channels[-1]
        else:
            self.trunk = BottleneckResNet(width, blocks, in_channels, **options)
            self.features = self.trunk.channels

    def _code(self, images: Tensor) -> Tensor:
        """(B, features)."""
        require_finite("images", images)
        maps = self.trunk((images - self.mean) / self.std)
        return (maps if isinstance(maps, Tensor) else maps[-1]).mean((-2, -1)).float()


class RandomBins(_Picture):
    """RandomizedBins: M sets of L classes for each of the six numbers.

    Each set says the mean of its classes' values by their soft-max, and the answer is the mean over
    the sets.

    Args:
        low, high: (6,) the range of the labels.
        sets, bins: M and L, 30 and 40 in the papers.
        seed: of the classes.
        trunk: "bottleneck" of ResNet-50, as in the paper, or "basic" blocks of two convolutions.
        width, blocks: of the trunk; the defaults are ResNet-50.
        in_channels: of the pictures: 1 if they are infrared.
        options: of the trunk.

    Attributes:
        classes: (6, M, L) their values.
        mean, std: of the pictures, which are normalised by them; 0 and 1 until they are set.

    Raises:
        ValueError: if an argument cannot be, or a range is too small for so many classes.
    """

    def __init__(
        self,
        low: Tensor,
        high: Tensor,
        *,
        sets: int = 30,
        bins: int = 40,
        seed: int = 0,
        trunk: str = "bottleneck",
        width: int = 64,
        blocks: Sequence[int] = (3, 4, 6, 3),
        in_channels: int = 1,
        **options: Any,
    ) -> None:
        super().__init__(low, high, trunk, width, blocks, in_channels, options)
        generator = torch.Generator().manual_seed(seed)
        classes = draw_bins(low.double(), high.double(), sets=sets, bins=bins, generator=generator)
        self.register_buffer("classes", classes.float())
        self.head = nn.Linear(self.features, 6 * sets * bins)

    def forward(self, images: Tensor) -> PoseNumbers:
        """What pictures (B, in_channels, H, W), 0 to 1, tell."""
        logits = self.head(self._code(images)).unflatten(1, self.classes.shape)
        values = (logits.softmax(-1) * self.classes).sum(-1).mean(-1)
        return PoseNumbers(values, logits)


class PictureRegression(_Picture):
    """The same trunk, and a layer that says the six numbers, in units of half their ranges.

    Args:
        low, high, trunk, width, blocks, in_channels, options: as of `RandomBins`.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        low: Tensor,
        high: Tensor,
        *,
        trunk: str = "bottleneck",
        width: int = 64,
        blocks: Sequence[int] = (3, 4, 6, 3),
        in_channels: int = 1,
        **options: Any,
    ) -> None:
        super().__init__(low, high, trunk, width, blocks, in_channels, options)
        self.head = nn.Linear(self.features, 6)

    def forward(self, images: Tensor) -> PoseNumbers:
        """What pictures (B, in_channels, H, W), 0 to 1, tell."""
        middle, half = (self.high + self.low) / 2, (self.high - self.low) / 2
        return PoseNumbers(middle + half * self.head(self._code(images)))
