"""PointNet++ as it is usually written in PyTorch: channels first, copies in groups, `Conv2d`.

An oracle for the outputs of `posecore.nets.pointnet2`, and what its speed is compared with.
Sampling is a loop over points, balls sort the indices of all points, and every neighbour's features
are copied before the first convolution.
"""

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(B, M, N) of (B, M, 3) and (B, N, 3)."""
    return (
        a.square().sum(-1, keepdim=True) + b.square().sum(-1)[:, None] - 2 * a @ b.transpose(1, 2)
    )


def rows(values: Tensor, index: Tensor) -> Tensor:
    """(B, *K, C) of (B, N, C) at (B, *K)."""
    cloud = torch.arange(len(values)).view(-1, *[1] * (index.ndim - 1))
    return values[cloud, index]


def farthest(points: Tensor, count: int) -> Tensor:
    clouds, n, _ = points.shape
    chosen = torch.zeros(clouds, count, dtype=torch.long)
    squared = torch.full((clouds, n), 1e10)
    last = torch.zeros(clouds, dtype=torch.long)
    each = torch.arange(clouds)
    for i in range(count):
        chosen[:, i] = last
        squared = torch.minimum(squared, (points - points[each, last][:, None]).square().sum(-1))
        last = squared.argmax(-1)
    return chosen


def ball(points: Tensor, centres: Tensor, radius: float, count: int) -> Tensor:
    n = points.shape[1]
    index = torch.arange(n).expand(*centres.shape[:2], n).clone()
    index[squared_distances(centres, points) >= radius**2] = n
    index = index.sort(-1)[0][..., :count]
    return torch.where(index == n, index[..., :1], index)


class PlainAbstraction(nn.Module):
    def __init__(self, features: int, points: int, radius: float, count: int, widths: tuple):
        super().__init__()
        self.points, self.radius, self.count = points, radius, count
        sizes = (3 + features, *widths)
        pairs = list(pairwise(sizes))
        self.convs = nn.ModuleList(nn.Conv2d(i, o, 1, bias=False) for i, o in pairs)
        self.norms = nn.ModuleList(nn.BatchNorm2d(o) for _, o in pairs)

    def forward(self, points: Tensor, features: Tensor | None) -> tuple[Tensor, Tensor]:
        centres = rows(points, farthest(points, self.points))
        index = ball(points, centres, self.radius, self.count)
        x = (rows(points, index) - centres[:, :, None]) / self.radius
        if features is not None:
            x = torch.cat([x, rows(features.transpose(1, 2), index)], -1)
        x = x.permute(0, 3, 2, 1)  # (B, C, K, S)
        for conv, norm in zip(self.convs, self.norms, strict=True):
            x = F.relu(norm(conv(x)))
        return centres, x.max(2)[0]  # (B, C, S)


class PlainPropagation(nn.Module):
    def __init__(self, inputs: int, widths: tuple):
        super().__init__()
        sizes = (inputs, *widths)
        pairs = list(pairwise(sizes))
        self.convs = nn.ModuleList(nn.Conv1d(i, o, 1, bias=False) for i, o in pairs)
        self.norms = nn.ModuleList(nn.BatchNorm1d(o) for _, o in pairs)

    def forward(self, fine: Tensor, coarse: Tensor, own: Tensor, features: Tensor) -> Tensor:
        distances, index = squared_distances(fine, coarse).sort(-1)
        closeness = 1 / (distances[..., :3].clamp(min=0).sqrt() + 1e-8)
        weights = closeness / closeness.sum(-1, keepdim=True)
        lent = (rows(features.transpose(1, 2), index[..., :3]) * weights[..., None]).sum(2)
        x = torch.cat([lent.transpose(1, 2), own], 1)
        for conv, norm in zip(self.convs, self.norms, strict=True):
            x = F.relu(norm(conv(x)))
        return x


class PlainPointNet2(nn.Module):
    """The same network as `posecore.nets.pointnet2.PointNet2`: `copy_from` takes its weights."""

    def __init__(self, layers: tuple, propagations: tuple):
        super().__init__()
        channels, self.abstractions = [0], nn.ModuleList()
        for layer in layers:
            self.abstractions.append(PlainAbstraction(channels[-1], *layer))
            channels.append(layer.widths[-1])
        coarse, self.propagations = channels.pop(), nn.ModuleList()
        for widths in propagations:
            self.propagations.append(PlainPropagation(coarse + channels.pop(), widths))
            coarse = widths[-1]

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, 3) to (B, S, 3) and (B, C, S)."""
        places, known = [points], [None]
        for layer in self.abstractions:
            centres, features = layer(places[-1], known[-1])
            places.append(centres), known.append(features)
        for layer in self.propagations:
            coarse, features = places.pop(), known.pop()
            known[-1] = layer(places[-1], coarse, known[-1], features)
        return places[-1], known[-1]

    def copy_from(self, net: nn.Module) -> "PlainPointNet2":
        """Take the weights of a `PointNet2`, in the order in which both have them."""
        theirs = [v for k, v in net.state_dict().items() if not k.endswith("tracked")]
        of_layers = [*self.abstractions, *self.propagations]
        mine = []
        for layer in of_layers:
            for conv, norm in zip(layer.convs, layer.norms, strict=True):
                mine += [conv.weight, norm.weight, norm.bias, norm.running_mean, norm.running_var]
        with torch.no_grad():
            for own, other in zip(mine, theirs, strict=True):
                own.copy_(other.reshape(own.shape))
        return self
