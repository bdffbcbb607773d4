"""3D graph convolution as it is usually written in PyTorch, and a network of five such layers.

An oracle for the outputs of `posecore.nets.graph3d`, and what its speed and memory are compared
with. All distances are sorted, a neighbour's features are copied for each support, and every cosine
is written out before the maximum.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def rows(values: Tensor, index: Tensor) -> Tensor:
    """(B, *K, C) of (B, N, C) at (B, *K)."""
    cloud = torch.arange(len(values)).view(-1, *[1] * (index.ndim - 1))
    return values[cloud, index]


def nearest(points: Tensor, count: int) -> Tensor:
    """(B, N, count) the nearest, less the first, which is taken for the point itself."""
    squared = points.square().sum(-1)
    distances = squared[:, :, None] + squared[:, None] - 2 * points @ points.transpose(1, 2)
    return distances.topk(count + 1, largest=False)[1][:, :, 1:]


def unit_directions(points: Tensor, index: Tensor) -> Tensor:
    return F.normalize(rows(points, index) - points[:, :, None], dim=-1)


class PlainSurface(nn.Module):
    def __init__(self, outputs: int, supports: int):
        super().__init__()
        self.outputs, self.supports = outputs, supports
        self.directions = nn.Parameter(torch.randn(3, supports * outputs))

    def forward(self, points: Tensor, index: Tensor) -> Tensor:
        cosines = F.relu(unit_directions(points, index) @ F.normalize(self.directions, dim=0))
        cosines = cosines.view(*index.shape, self.supports, self.outputs)
        return cosines.max(2)[0].sum(2)


class PlainConv(nn.Module):
    def __init__(self, inputs: int, outputs: int, supports: int):
        super().__init__()
        self.outputs, self.supports = outputs, supports
        self.weight = nn.Parameter(torch.randn(inputs, (supports + 1) * outputs))
        self.bias = nn.Parameter(torch.randn((supports + 1) * outputs))
        self.directions = nn.Parameter(torch.randn(3, supports * outputs))

    def forward(self, points: Tensor, features: Tensor, index: Tensor) -> Tensor:
        cosines = F.relu(unit_directions(points, index) @ F.normalize(self.directions, dim=0))
        known = features @ self.weight + self.bias
        centre, lent = known[..., : self.outputs], known[..., self.outputs :]
        lent = cosines * rows(lent, index)
        lent = lent.view(*index.shape, self.supports, self.outputs)
        return centre + lent.max(2)[0].sum(2)

    def copy_from(self, layer: nn.Module) -> "PlainConv":
        """Take the weights of a `GraphConv`."""
        with torch.no_grad():
            self.weight.copy_(layer.weights.kernel[..., 0].T)
            self.bias.copy_(layer.weights.bias)
            self.directions.copy_(layer.directions)
        return self
