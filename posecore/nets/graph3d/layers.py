"""3D graph convolutions: a kernel is a few directions in space, which are learned.

Source: Lin et al., "Convolution in the Cloud: Learning Deformable Kernels in 3D Graph Convolution
Networks for Point Cloud Analysis", CVPR 2020, Sections 3.3 and 3.4; Eq. 3 of the rotation-invariant
paper (Chen et al.), read so that neighbours lend their own features.

A layer knows directions to neighbours, not distances: it gives the same for a cloud that is moved
or scaled. It does not for one that is turned.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from posecore.arrays import fail, require_integer, trusted
from posecore.clouds import gather_points
from posecore.nets.graph3d.fused import support_maximum

__all__ = ["GraphConv", "PointLinear", "SurfaceConv", "pool_maximum"]


class PointLinear(nn.Module):
    """A linear layer on the last dimension, with its weights as the kernel of a convolution.

    (outputs, inputs, 1): so that `posecore.training.muon.Muon` takes it for one.

    Args:
        inputs, outputs: channels.
        bias: whether there is one.
        gain: factor on the standard deviation sqrt(2 / inputs) of the first weights, which suits a
            ReLU after it.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(self, inputs: int, outputs: int, *, bias: bool = True, gain: float = 1.0) -> None:
        super().__init__()
        require_integer("inputs", inputs, 1)
        require_integer("outputs", outputs, 1)
        first = torch.randn(outputs, inputs, 1) * (gain * math.sqrt(2 / inputs))
        self.kernel = nn.Parameter(first)
        self.bias = nn.Parameter(torch.zeros(outputs)) if bias else None

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) to (..., outputs)."""
        return F.linear(x, self.kernel[..., 0], self.bias)

    def extra_repr(self) -> str:
        """What `print` shows."""
        outputs, inputs, _ = self.kernel.shape
        return f"{inputs}, {outputs}, bias={self.bias is not None}"


class _Supports(nn.Module):
    """S directions for each of C channels."""

    def __init__(self, outputs: int, supports: int, fused: bool) -> None:
        super().__init__()
        self.outputs = require_integer("outputs", outputs, 1)
        self.supports = require_integer("supports", supports, 1)
        self.fused = bool(fused)
        self.directions = nn.Parameter(torch.randn(3, supports * outputs))

    def unit_supports(self) -> Tensor:
        """(S, 3, C) the directions, of length one."""
        unit = F.normalize(self.directions, dim=0)
        return unit.unflatten(1, (self.supports, self.outputs)).transpose(0, 1)

    def _fuses(self, directions: Tensor) -> bool:
        return self.fused and directions.device.type == "cpu"

    def _cosines(self, directions: Tensor) -> Tensor:
        """(B, N, K, S, C), none below 0."""
        cosines = (directions @ F.normalize(self.directions, dim=0)).relu()
        return cosines.unflatten(-1, (self.supports, self.outputs))

    def extra_repr(self) -> str:
        """What `print` shows."""
        return f"outputs={self.outputs}, supports={self.supports}"


class SurfaceConv(_Supports):
    """The first layer, which knows nothing but where neighbours are.

    sum over supports of the max over neighbours of ReLU(cos(direction, support)).

    Args:
        outputs: C, channels.
        supports: S, directions of each channel.
        fused: whether a processor does all of it a few points at a time, with the same numbers and
            gradients in a fraction of time and memory (`posecore.nets.graph3d.fused`).

    Attributes:
        directions: (3, S C) of any length.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(self, outputs: int, supports: int = 7, *, fused: bool = True) -> None:
        super().__init__(outputs, supports, fused)
        bound = 1 / math.sqrt(supports * outputs)
        nn.init.uniform_(self.directions, -bound, bound)

    def forward(self, directions: Tensor) -> Tensor:
        """(B, N, K, 3), by `posecore.clouds.neighbour_directions`, to (B, N, C)."""
        _require_directions(directions)
        if not self._fuses(directions):
            return self._cosines(directions).amax(2).sum(2)
        unit = self.unit_supports().contiguous()
        found = support_maximum(directions.flatten(0, 1), unit)
        return found.unflatten(0, directions.shape[:2])


class GraphConv(_Supports):
    """A layer on features.

    A point's own features, by weights of the centre, and the sum over supports of the max over
    neighbours of ReLU(cos(direction, support)) times the neighbour's features, by weights of the
    support.

    Args:
        inputs: channels of the features.
        outputs: C, channels.
        supports: S, directions of each channel.
        fused: as of `SurfaceConv`.

    Attributes:
        directions: (3, S C) of any length.
        weights: of the centre, then of the supports.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(self, inputs: int, outputs: int, supports: int = 7, *, fused: bool = True) -> None:
        super().__init__(outputs, supports, fused)
        self.weights = PointLinear(inputs, (supports + 1) * outputs)
        bound = 1 / math.sqrt((supports + 1) * outputs)
        for values in (self.directions, self.weights.kernel, self.weights.bias):
            nn.init.uniform_(values, -bound, bound)

    def forward(self, features: Tensor, directions: Tensor, neighbours: Tensor) -> Tensor:
        """What points learn of their neighbours.

        Args:
            features: (B, N, inputs).
            directions: (B, N, K, 3), by `posecore.clouds.neighbour_directions`.
            neighbours: (B, N, K) indices into the N points.

        Returns:
            (B, N, C).

        Raises:
            ValueError: for another shape, or an index out of range.
        """
        _require_directions(directions)
        batch, n, k = directions.shape[:3]
        inputs = self.weights.kernel.shape[1]
        if features.shape != (batch, n, inputs):
            expected = f"shape {(batch, n, inputs)}"
            fail("features", expected, f"shape {tuple(features.shape)}")
        if neighbours.shape != (batch, n, k):
            fail("neighbours", f"shape {(batch, n, k)}", f"shape {tuple(neighbours.shape)}")
        if not self._fuses(directions):
            return self._step_by_step(features, directions, neighbours)
        low, high = neighbours.aminmax() if neighbours.numel() else (0, 0)
        if low < 0 or high >= n:
            fail("neighbours", f"indices from 0 to {n - 1}", f"from {int(low)} to {int(high)}")
        rows = features.flatten(0, 1)
        weight = self.weights.kernel[..., 0].unflatten(0, (-1, self.outputs))
        bias = self.weights.bias.unflatten(0, (-1, 1, self.outputs))
        centre = torch.addmm(bias[0], rows, weight[0].T)
        table = torch.baddbmm(bias[1:], rows.expand(self.supports, -1, -1), weight[1:].mT)
        first = torch.arange(0, batch * n, n, device=features.device)[:, None, None]
        lent = support_maximum(
            directions.flatten(0, 1), self.unit_supports().contiguous(), table,
            (neighbours + first).flatten(0, 1),
        )  # fmt: skip
        return (centre + lent).unflatten(0, (batch, n))

    def _step_by_step(self, features: Tensor, directions: Tensor, neighbours: Tensor) -> Tensor:
        centre, table = self.weights(features).split(
            (self.outputs, self.supports * self.outputs), dim=-1
        )
        with trusted():
            lent = gather_points(table, neighbours).unflatten(-1, (self.supports, self.outputs))
        return centre + (self._cosines(directions) * lent).amax(2).sum(2)


def pool_maximum(features: Tensor, pool: Tensor) -> Tensor:
    """(B, N, C) features of a cloud to (B, M, C) of a coarser one: the maximum of `Coarser.pool`.

    Args:
        features: (B, N, C).
        pool: (B, M, P) indices into the N points.

    Raises:
        ValueError: for another shape, or an index out of range.
    """
    with trusted():
        return gather_points(features, pool).amax(2)


def _require_directions(directions: Tensor) -> None:
    if directions.ndim != 4 or directions.shape[-1] != 3 or not directions.shape[2]:
        expected = "shape (B, N, K, 3), K at least 1"
        fail("directions", expected, f"shape {tuple(directions.shape)}")
