"""Set abstraction and feature propagation, channels last: (B, S, K, C) goes through `nn.Linear`.

Source: Qi et al., "PointNet++: Deep Hierarchical Feature Learning on Point Sets in a Metric Space",
NeurIPS 2017, Sections 3.2 to 3.4. Layers are as in its published code, 1 x 1 convolutions without
bias, each with batch normalisation and ReLU; a 1 x 1 convolution is a matrix product, and that is
fastest where the channels of a point lie side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from posecore.arrays import fail, require_integer, trusted
from posecore.clouds import gather_points, interpolate
from posecore.nets.pointnet2.fused import fused_maximum
from posecore.nets.pointnet2.geometry import Abstraction, Level, Link, require_layers

__all__ = ["FeaturePropagation", "PointNorm", "SetAbstraction", "shared_mlp"]


_MANY = 2**14  # rows


class PointNorm(nn.BatchNorm1d):
    """Batch normalisation of the last dimension of (..., C), over all others."""

    def forward(self, x: Tensor) -> Tensor:
        """(..., C) to (..., C)."""
        if x.ndim != 2:
            return self(x.reshape(-1, x.shape[-1])).view(x.shape)
        rows = x
        plain = self.affine and self.track_running_stats and self.momentum is not None
        exact = x.dtype in (torch.float32, torch.float64)
        many = self.training and len(rows) >= _MANY and x.device.type == "cpu"
        if not (plain and exact and many):
            return super().forward(rows)
        # PyTorch's own norm adds up one row after the other: of a hundred thousand in float32 the
        # fourth digit is lost.
        found, mean, variance = _Norm.apply(rows, self.weight, self.bias, self.eps)
        self.num_batches_tracked += 1
        unbiased = variance * (len(rows) / (len(rows) - 1))
        self.running_mean.lerp_(mean.to(self.running_mean), self.momentum)
        self.running_var.lerp_(unbiased.to(self.running_var), self.momentum)
        return found


class _Norm(torch.autograd.Function):
    """Batch normalisation of rows (N, C), with sums of pairs of sums."""

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, eps: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        mean = x.mean(0)
        off = x - mean
        variance = off.square().mean(0)
        scale = (variance + eps).rsqrt()
        ctx.save_for_backward(off, weight, scale)
        ctx.mark_non_differentiable(mean, variance)
        return torch.addcmul(bias, off, weight * scale), mean, variance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        off, weight, scale = ctx.saved_tensors
        total, slope = gradient.sum(0), (gradient * off).sum(0) * scale
        pull = torch.addcmul(total / len(off), off, slope * scale / len(off))
        return (gradient - pull).mul_(weight * scale), slope, total, None


class SharedMLP(nn.Sequential):
    """Layers that act on the last dimension of (..., C) alone, the same for every point."""

    def forward(self, x: Tensor) -> Tensor:
        """(..., C) to (..., C')."""
        # As rows: what works in place on a view of another shape is copied in the backward pass.
        rows = super().forward(x.reshape(-1, x.shape[-1]))
        return rows.view(*x.shape[:-1], rows.shape[-1])


def shared_mlp(*sizes: int) -> SharedMLP:
    """Linear layers without bias, each with `PointNorm` and ReLU: the same for every point.

    Args:
        sizes: of what comes in, then of what each layer gives.

    Raises:
        ValueError: if fewer than two are given or one is no positive integer.
    """
    if len(sizes) < 2:
        fail("sizes", "at least two", sizes)
    for size in sizes:
        require_integer("sizes", size, 1)
    layers = []
    for inputs, outputs in pairwise(sizes):
        # In place: what is normalised is not looked at again, and fresh memory costs as much time
        # as the numbers in it.
        linear = nn.Linear(inputs, outputs, bias=False)
        layers += [linear, PointNorm(outputs), nn.ReLU(inplace=True)]
    return SharedMLP(*layers)


class SetAbstraction(nn.Module):
    """From N points with features to S centres, each with what it learned of its ball.

    Each neighbour's features and its coordinates relative to the centre go through an MLP; the
    maximum over the ball is what the centre knows.

    Two variants have the same weights, so that one can be read as the other:

    - `project_first`: the first layer acts on points, before they are copied into balls. It is
      linear, so W [(x_j - x_i) / r, f_j] is W [x_j / r, f_j] less W [x_i / r, 0]: the same numbers,
      from fewer products.
    - `early_max`: the maximum is taken of what the first layer gives, and only centres go through
      the rest. Far less work, and another function: a ball knows its extent in every direction that
      the first layer looks, not which neighbour is how far in several at once.

    Args:
        features: C, of a point; 0 if it has coordinates only.
        sizes: of the layer.
        normalise: whether relative coordinates are divided by the radius.
        project_first: as above.
        early_max: as above; always with the first layer before grouping.
        fused: whether a processor does all of it a few balls at a time (`posecore.nets.pointnet2.
            fused`): the same numbers and gradients in a fraction of time and memory. In evaluation
            only where no gradient is asked for. It has the first layer before grouping, too.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(
        self,
        features: int,
        sizes: Abstraction,
        *,
        normalise: bool = True,
        project_first: bool = False,
        early_max: bool = False,
        fused: bool = True,
    ) -> None:
        super().__init__()
        self.features = require_integer("features", features, 0)
        (self.sizes,) = require_layers([sizes])
        self.normalise = bool(normalise)
        self.project_first, self.early_max = bool(project_first), bool(early_max)
        self.fused = bool(fused)
        self.mlp = shared_mlp(3 + features, *self.sizes.widths)

    def forward(self, points: Tensor, features: Tensor | None, level: Level) -> Tensor:
        """What the centres learn.

        Args:
            points: (B, N, 3) metres.
            features: (B, N, C), or None where C is 0.
            level: which are the centres, and who is in their balls.

        Returns:
            (B, S, widths[-1]).

        Raises:
            ValueError: if features have another shape, or are missing.
        """
        self._check(points, features)
        unit = self.sizes.radius if self.normalise else 1.0
        first, norm, relu = self.mlp[:3]
        fused = self._fuses(points)
        with trusted():
            centres = gather_points(points, level.centres) / unit  # (B, S, 3)
            if fused or self.project_first or self.early_max:
                table = first(self._known(points / unit, features))  # (B, N, w)
                places = F.linear(centres, first.weight[:, :3])  # (B, S, w)
                if fused:
                    linears, norms = self.mlp[3::3], self.mlp[1::3]
                    return fused_maximum(table, places, level.balls, norms, linears)
                x = gather_points(table, level.balls)
                if self.early_max:
                    return self.mlp[3:](relu(norm(x.max(2).values - places)))
                x = x - places[:, :, None]  # (B, S, K, w)
            else:
                offsets = gather_points(points, level.balls) / unit - centres[:, :, None]
                known = None if features is None else gather_points(features, level.balls)
                x = first(self._known(offsets, known))
        return self.mlp[3:](relu(norm(x))).max(2).values

    def _fuses(self, points: Tensor) -> bool:
        """Whether the layers go a few balls at a time, as is faster on a processor."""
        if not self.fused or self.early_max or points.device.type != "cpu" or not len(points):
            return False
        return self.training or not torch.is_grad_enabled()

    def _known(self, places: Tensor, features: Tensor | None) -> Tensor:
        return places if features is None else torch.cat([places, features], -1)

    def _check(self, points: Tensor, features: Tensor | None) -> None:
        got = 0 if features is None else features.shape
        expected = (*points.shape[:2], self.features) if self.features else 0
        if got != expected:
            words = f"shape {expected}" if self.features else "None"
            fail("features", words, None if features is None else f"shape {tuple(got)}")

    def extra_repr(self) -> str:
        """What `print` shows."""
        points, radius, neighbours, _ = self.sizes
        return f"points={points}, radius={radius}, neighbours={neighbours}"


class FeaturePropagation(nn.Module):
    """Features of a coarse level brought to the points of a finer one.

    The three nearest coarse points lend theirs, by inverse distance; beside them stand the point's
    own, and an MLP makes one of both.

    Args:
        coarse: channels of the coarse level's features.
        own: channels of the finer level's.
        widths: of the MLP.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(self, coarse: int, own: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.mlp = shared_mlp(coarse + own, *widths)

    def forward(self, coarse: Tensor, own: Tensor, link: Link) -> Tensor:
        """(B, S, coarse) and (B, M, own) to (B, M, widths[-1])."""
        with trusted():
            lent = interpolate(coarse, link.indices, link.weights.to(coarse.dtype))
        return self.mlp(torch.cat([lent, own], -1))
