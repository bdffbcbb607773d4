"""The PointNet++ of the infrared paper: four set abstractions, two feature propagations, seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor, nn

from posecore.arrays import fail, require_finite
from posecore.nets.pointnet2.geometry import LAYERS, Abstraction, Geometry, require_layers
from posecore.nets.pointnet2.layers import FeaturePropagation, SetAbstraction

__all__ = ["PROPAGATIONS", "PointNet2", "Seeds"]

PROPAGATIONS = ((256, 256), (256, 256))
"""Widths of the feature propagations of Table 1."""


class Seeds(NamedTuple):
    """Points with what is known about each."""

    points: Tensor  # (B, S, 3) metres
    features: Tensor  # (B, S, C)


class PointNet2(nn.Module):
    """Clouds to seeds, in the sizes of Tables 1 and 2 if nothing else is said.

    Only coordinates relative to centres come in, so a cloud that is moved as a whole gives the same
    features; a cloud that is turned does not.

    Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.3, after the
    backbone of VoteNet (Qi et al., ICCV 2019).

    | layer | points | radius, m | neighbours | widths (+ 3 coordinates in front) |
    |-------|--------|-----------|------------|-----------------------------------|
    | SA1   | 1024   | 0.02      | 64         | 64, 64, 128                       |
    | SA2   | 512    | 0.04      | 32         | 128, 128, 256                     |
    | SA3   | 256    | 0.08      | 16         | 128, 128, 256                     |
    | SA4   | 128    | 1.0       | 16         | 128, 128, 256                     |
    | FP1   | 256    |           |            | 512 -> 256, 256                   |
    | FP2   | 512    |           |            | 512 -> 256, 256                   |

    Args:
        layers: of the set abstractions.
        propagations: widths of each feature propagation; fewer than there are set abstractions.
        features: of the points that come in, besides their coordinates.
        normalise, project_first, early_max, fused: of all `SetAbstraction`s.

    Attributes:
        seeds: how many there are of each cloud.
        channels: of their features.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(
        self,
        layers: Sequence[Abstraction] = LAYERS,
        propagations: Sequence[Sequence[int]] = PROPAGATIONS,
        features: int = 0,
        *,
        normalise: bool = True,
        project_first: bool = False,
        early_max: bool = False,
        fused: bool = True,
    ) -> None:
        super().__init__()
        self.layers = require_layers(layers)
        if len(propagations) >= len(self.layers):
            fail("propagations", f"fewer than {len(self.layers)} layers", len(propagations))
        channels, self.abstractions = [features], nn.ModuleList()
        for sizes in self.layers:
            self.abstractions.append(
                SetAbstraction(
                    channels[-1], sizes,
                    normalise=normalise, project_first=project_first, early_max=early_max,
                    fused=fused,
                )
            )  # fmt: skip
            channels.append(sizes.widths[-1])
        self.propagations, coarse = nn.ModuleList(), channels.pop()
        for widths in propagations:
            self.propagations.append(FeaturePropagation(coarse, channels.pop(), widths))
            coarse = widths[-1]
        self.seeds, self.channels = self.layers[-1 - len(propagations)].points, coarse

    def forward(self, geometry: Geometry, features: Tensor | None = None) -> Seeds:
        """The seeds of clouds.

        Args:
            geometry: by `build_geometry`, with this network's `layers` and as many propagations.
            features: (B, N, C) of the points, or None where C is 0.

        Raises:
            ValueError: if the geometry is of other layers, or features have another shape or are
                not finite.
        """
        *_, seeds = self.stages(geometry, features).values()
        return seeds

    def stages(self, geometry: Geometry, features: Tensor | None = None) -> dict[str, Seeds]:
        """What every layer gives, by name: SA1, SA2, ..., then FP1, ...: the rows of Table 2.

        Raises:
            ValueError: if the geometry is of other layers, or a feature is not finite.
        """
        self._check(geometry)
        if isinstance(features, Tensor):  # else they would stay in the norms' statistics
            require_finite("features", features)
        points, known, stages = geometry.coordinates(), [features], {}
        for i, layer in enumerate(self.abstractions):
            known.append(layer(points[i], known[i], geometry.levels[i]))
            stages[f"SA{i + 1}"] = Seeds(points[i + 1], known[-1])
        coarse = known.pop()
        for i, layer in enumerate(self.propagations):
            coarse = layer(coarse, known.pop(), geometry.links[i])
            stages[f"FP{i + 1}"] = Seeds(points[-2 - i], coarse)
        return stages

    def _check(self, geometry: Geometry) -> None:
        expected = [(layer.points, layer.neighbours) for layer in self.layers]
        got = [tuple(level.balls.shape[1:]) for level in geometry.levels]
        if got != expected:
            fail("geometry", f"levels of (points, neighbours) {expected}", got)
        if len(geometry.links) != len(self.propagations):
            expected = f"{len(self.propagations)} links, one of each propagation"
            fail("geometry", expected, len(geometry.links))
