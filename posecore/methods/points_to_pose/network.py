"""P2R and P2P: PointNet++'s seeds, and two ways to make one pose of them.

All that they say is along the axes of the cloud that comes in, and relative to its origin. Whoever
centres a cloud first, as one should, adds the centre to the translation again: the paper's "sum of
the predicted relative translation and the translation of the input cloud".

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Sections 3.3 and 3.4,
Figures 7 and 8. The voting module is that of VoteNet (Qi et al., ICCV 2019).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_integer, require_number
from posecore.methods.points_to_pose.voting import robust_mean
from posecore.nets.pointnet2 import (
    LAYERS,
    PROPAGATIONS,
    Abstraction,
    Geometry,
    PointNet2,
    PointNorm,
    Seeds,
    build_geometry,
    shared_mlp,
)
from posecore.nets.rotation_heads import RotationHead

__all__ = ["PointsToPose", "PointsToRotation", "Prediction"]


class Prediction(NamedTuple):
    """What a network says of B clouds.

    Attributes:
        rotation: (B, n) numbers that stand for it, a quaternion (w, x, y, z) of any length if
            nothing else was asked for; the network's `decode` makes matrices of them.
        t: (B, 3) metres, relative to the cloud's origin, or None.
        votes: (B, S, K, 3) metres, where each seed thinks each keypoint is, or None.
        keypoints: (B, K, 3) metres, what the votes come to, or None.
    """

    rotation: Tensor
    t: Tensor | None = None
    votes: Tensor | None = None
    keypoints: Tensor | None = None


class _PoseNet(nn.Module):
    """A backbone, and numbers that stand for a rotation."""

    def __init__(
        self, layers: Sequence[Abstraction], propagations: Sequence[Sequence[int]],
        representation: str, unit: float, places: bool, options: dict[str, Any],
    ) -> None:  # fmt: skip
        super().__init__()
        self.backbone = PointNet2(layers, propagations, **options)
        self.head = RotationHead(representation)
        self.unit, self.places = require_number("unit", unit, above=0), bool(places)
        self.known = self.backbone.channels + 3 * self.places

    def decode(self, prediction: Prediction) -> Tensor:
        """(B, 3, 3) the rotations."""
        return self.head.decode(prediction.rotation)

    def geometry(self, points: Tensor) -> Geometry:
        """What it has to know of clouds (B, N, 3), metres, as `build_geometry` makes it."""
        return build_geometry(points, self.backbone.layers, len(self.backbone.propagations))

    def pose(self, geometry: Geometry) -> tuple[Tensor, Tensor]:
        """R (B, 3, 3) and t (B, 3); where none is said, t is the cloud's origin."""
        said = self(geometry)
        R = self.decode(said)
        return R, R.new_zeros(len(R), 3) if said.t is None else said.t

    def _of_seeds(self, seeds: Seeds) -> Tensor:
        """(B, S, known)."""
        if not self.places:
            return seeds.features
        return torch.cat([seeds.points / self.unit, seeds.features], -1)


class PointsToRotation(_PoseNet):
    """P2R: 1 x 1 convolutions over the seeds, all of them in a row, two dense layers.

    In a row means that the first dense layer knows the seeds by their number: their order counts,
    and is that of farthest point sampling.

    Args:
        layers, propagations: of the backbone.
        widths: of the convolutions; 256, 256 and 4 in the paper.
        dense: of the first dense layer.
        representation: of the rotation, one of `posecore.nets.rotation_heads.REPRESENTATIONS`.
        pooling: "flatten", as in the paper, or "max" over the seeds, for which order is nothing.
        activate_last: whether the last convolution has a norm and ReLU as the others, as the paper
            writes. Of four numbers a seed, ReLU makes about half zero.
        translation: whether to say one. In the paper P2R does not; its clouds come with theirs.
        places: whether the convolutions see where a seed is. In the paper they see features only,
            which know what is about a seed, not where it is in the cloud.
        unit: metres that count as one where places go in or come out.
        options: of `PointNet2`.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        layers: Sequence[Abstraction] = LAYERS,
        propagations: Sequence[Sequence[int]] = PROPAGATIONS,
        *,
        widths: Sequence[int] = (256, 256, 4),
        dense: int = 512,
        representation: str = "quaternion",
        pooling: str = "flatten",
        activate_last: bool = False,
        translation: bool = False,
        places: bool = False,
        unit: float = 0.1,
        **options: Any,
    ) -> None:
        super().__init__(layers, propagations, representation, unit, places, options)
        if pooling not in ("flatten", "max"):
            fail("pooling", "'flatten' or 'max'", repr(pooling))
        if len(widths) < 2:
            fail("widths", "at least two", tuple(widths))
        require_integer("dense", dense, 1)
        *before, last = widths
        self.pooling, self.translation = pooling, bool(translation)
        self.convolutions = shared_mlp(self.known, *before)
        self.convolutions.append(nn.Linear(before[-1], require_integer("widths", last, 1)))
        if activate_last:
            self.convolutions.extend([PointNorm(last), nn.ReLU()])
        count = self.backbone.seeds if pooling == "flatten" else 1
        self.dense = _dense(count * last, dense, self.head.size + 3 * self.translation)

    def forward(self, geometry: Geometry) -> Prediction:
        """What clouds tell, from the geometry that the backbone asks for."""
        x = self.convolutions(self._of_seeds(self.backbone(geometry)))  # (B, S, 4)
        x = x.flatten(1) if self.pooling == "flatten" else x.amax(1)
        said = self.dense(x)
        rotation = said[:, : self.head.size]
        return Prediction(rotation, self.unit * said[:, -3:] if self.translation else None)


class PointsToPose(_PoseNet):
    """P2P: each seed votes for each keypoint, votes are brought together, two heads say the pose.

    Args:
        keypoints: K, how many.
        layers, propagations: of the backbone.
        widths: of the voting module, before its last layer.
        hidden: widths of both heads, before their last layer.
        representation: as of `PointsToRotation`.
        vote_features: C' features that each vote carries besides its place, as VoteNet's do (there
            as many as a seed has); heads get their mean over the seeds. Without, the heads see
            nothing but the keypoints, so that the votes have to be right for the pose to be.
        iterations: of `robust_mean`; 0 is the mean.
        places, unit, options: as of `PointsToRotation`.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        keypoints: int = 9,
        layers: Sequence[Abstraction] = LAYERS,
        propagations: Sequence[Sequence[int]] = PROPAGATIONS,
        *,
        widths: Sequence[int] = (256, 256),
        hidden: Sequence[int] = (256, 256),
        representation: str = "quaternion",
        vote_features: int = 0,
        iterations: int = 1,
        places: bool = False,
        unit: float = 0.1,
        **options: Any,
    ) -> None:
        super().__init__(layers, propagations, representation, unit, places, options)
        self.keypoints = require_integer("keypoints", keypoints, 1)
        self.vote_features = require_integer("vote_features", vote_features, 0)
        self.iterations = require_integer("iterations", iterations, 0)
        size = 3 + self.vote_features
        self.voting = shared_mlp(self.known, *widths)
        self.voting.append(nn.Linear(widths[-1], size * keypoints))
        self.rotation = _dense(size * keypoints, *hidden, self.head.size)
        self.translation = _dense(size * keypoints, *hidden, 3)

    def forward(self, geometry: Geometry) -> Prediction:
        """What clouds tell, from the geometry that the backbone asks for."""
        seeds = self.backbone(geometry)
        said = self.voting(self._of_seeds(seeds)).unflatten(-1, (self.keypoints, -1))
        votes = seeds.points[:, :, None] + self.unit * said[..., :3]  # (B, S, K, 3)
        keypoints = robust_mean(votes, self.iterations)  # (B, K, 3)
        known = torch.cat([keypoints / self.unit, said[..., 3:].mean(1)], -1).flatten(1)
        return Prediction(
            self.rotation(known), self.unit * self.translation(known), votes, keypoints
        )


def _dense(*sizes: int) -> nn.Sequential:
    """Linear layers with ReLU between them."""
    for size in sizes:
        require_integer("hidden", size, 1)
    layers = [part for i, o in pairwise(sizes) for part in (nn.Linear(i, o), nn.ReLU())]
    return nn.Sequential(*layers[:-1])
