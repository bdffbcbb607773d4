"""From a cloud to features of its points: by 3D graph convolution, or from invariants alone.

| layer | at      | paper's width | gets              |
|-------|---------|---------------|-------------------|
| 0     | cloud   | 128           | directions, or what is invariant |
| 1     | cloud   | 128           | layer 0 (and f1)  |
| 2     | 1 / 4   | 256           | layer 1, pooled   |
| 3     | 1 / 4   | 256           | layer 2           |
| 4     | 1 / 16  | 512           | layer 3, pooled   |

All of them side by side, those of coarse clouds from the nearest of their points, are what is known
of a point.

Source: Di et al., "GPV-Pose", CVPR 2022, for the layers (Lin et al., CVPR 2020); Chen et al., the
rotation-invariant paper, Section 3.2, for F = [f1, f2].
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_choice, require_integer, trusted
from posecore.clouds import gather_points, neighbour_directions
from posecore.methods.invariant_gcn.invariants import (
    FORMS,
    LocalFeatures,
    pair_channels,
    point_channels,
)
from posecore.nets.graph3d import Graph, GraphConv, PointLinear, SurfaceConv, pool_maximum
from posecore.nets.pointnet2 import PointNorm

__all__ = ["LEVELS", "NORMS", "WIDTHS", "EdgeConv", "GraphBackbone", "InvariantBackbone"]

WIDTHS = (128, 128, 256, 256, 512)
"""Channels of the layers in the paper's size."""
LEVELS = (0, 0, 1, 1, 2)
"""On which of the clouds of a `Graph` each layer is."""
NORMS = {"layer": nn.LayerNorm, "batch": PointNorm}
"""Of channels. "batch", as published, is of all points of all clouds of a batch, so that what is
said of a cloud in training depends on the others; "layer" is of each point alone."""


class _Backbone(nn.Module):
    """Layers, each with a norm and ReLU, on ever coarser clouds."""

    def __init__(
        self, widths: Sequence[int], levels: Sequence[int], neighbours: int, norm: str
    ) -> None:
        super().__init__()
        if len(widths) != len(levels) or not widths:
            fail("levels", f"one for each of {len(widths)} widths", tuple(levels))
        steps = [b - a for a, b in zip([0, *levels], levels, strict=False)]
        if levels[0] != 0 or any(step not in (0, 1) for step in steps):
            fail("levels", "0, and then the same or the next", tuple(levels))
        require_choice("norm", norm, list(NORMS))
        self.levels = tuple(levels)
        self.neighbours = require_integer("neighbours", neighbours, 1)
        self.norms = nn.ModuleList(NORMS[norm](width) for width in widths)
        self.channels = sum(widths)

    def forward(self, graph: Graph, normals: Tensor, view: Tensor) -> Tensor:
        """What is known of every point.

        Args:
            graph: of B clouds about their means, with a cloud for each level.
            normals: (B, N, 3) of length one, to the side of the camera.
            view: (B, 3) directions to the camera.

        Returns:
            (B, N, `channels`).

        Raises:
            ValueError: if the graph has too few clouds or neighbours.
        """
        if len(graph.coarser) < self.levels[-1]:
            fail("graph", f"{self.levels[-1]} coarser clouds", len(graph.coarser))
        with trusted():
            seen = self._seen(graph, normals, view)
            known, found, at = None, [], 0
            for i, level in enumerate(self.levels):
                if level > at:
                    known, at = pool_maximum(known, graph.coarser[level - 1].pool), level
                known = torch.relu(self.norms[i](self._layer(i, known, seen)))
                nearest = None if level == 0 else graph.coarser[level - 1].nearest
                found.append(known if nearest is None else gather_points(known, nearest))
            return torch.cat([*found, *self._besides(seen)], -1)

    def _indices(self, graph: Graph) -> list[Tensor]:
        """Of every cloud (B, M, K)."""
        found = [graph.neighbours, *(level.neighbours for level in graph.coarser)]
        if found[0].shape[-1] < self.neighbours:
            fail("graph", f"{self.neighbours} neighbours or more", found[0].shape[-1])
        return [indices[..., : self.neighbours].long() for indices in found]

    def _seen(self, graph: Graph, normals: Tensor, view: Tensor) -> dict:
        raise NotImplementedError

    def _layer(self, i: int, known: Tensor | None, seen: dict) -> Tensor:
        raise NotImplementedError

    def _besides(self, seen: dict) -> list[Tensor]:
        return []


class GraphBackbone(_Backbone):
    """3D-GCN, with f1 beside the features that come into some layers.

    Args:
        widths, levels: of the layers.
        supports: S.
        neighbours: K; of a coarser cloud as many as its graph has, if these are fewer.
        f1: what the invariant features are; None for none, as in the rebuilt GPV-Pose and A1.
        f1_layers: which layers get them, from 1 on; the paper's figure has the first that follows.
            Coarser clouds get those of their points.
        norm: one of `NORMS`.
        fused: as of `posecore.nets.graph3d.GraphConv`.

    Attributes:
        channels: of what is known of a point.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        widths: Sequence[int] = WIDTHS,
        levels: Sequence[int] = LEVELS,
        *,
        supports: int = 7,
        neighbours: int = 10,
        f1: LocalFeatures | None = None,
        f1_layers: Sequence[int] = (1,),
        norm: str = "layer",
        fused: bool = True,
    ) -> None:
        super().__init__(widths, levels, neighbours, norm)
        self.f1, self.f1_layers = f1, frozenset(() if f1 is None else f1_layers)
        for layer in self.f1_layers:
            require_integer("f1_layers", layer, 1, len(widths) - 1)
        more = 0 if f1 is None else f1.channels
        self.layers = nn.ModuleList([SurfaceConv(widths[0], supports, fused=fused)])
        for i, width in enumerate(widths[1:], 1):
            inputs = widths[i - 1] + (more if i in self.f1_layers else 0)
            self.layers.append(GraphConv(inputs, width, supports, fused=fused))
        self.channels += more

    def _seen(self, graph: Graph, normals: Tensor, view: Tensor) -> dict:
        indices = self._indices(graph)
        ways = [
            neighbour_directions(points, near)
            for points, near in zip(graph.clouds(), indices, strict=True)
        ]
        seen = {"indices": indices, "ways": ways, "graph": graph, "normals": normals, "view": view}
        if self.f1 is not None:
            seen["f1"] = self.f1(graph.points, normals, graph.neighbours.long(), view)
        return seen

    def _layer(self, i: int, known: Tensor | None, seen: dict) -> Tensor:
        level = self.levels[i]
        ways, indices = seen["ways"][level], seen["indices"][level]
        if known is None:
            return self.layers[i](ways)
        if i in self.f1_layers:
            known = torch.cat([known, self._f1(level, known, seen)], -1)
        return self.layers[i](known, ways, indices)

    def _f1(self, level: int, known: Tensor, seen: dict) -> Tensor:
        graph = seen["graph"]
        if self.f1.by_features and level == 0:
            near = graph.neighbours.long()
            seen["f1"] = self.f1(graph.points, seen["normals"], near, seen["view"], known)
        return graph.clouds(seen["f1"])[level]

    def _besides(self, seen: dict) -> list[Tensor]:
        return [] if self.f1 is None else [seen["f1"]]


class EdgeConv(nn.Module):
    """max over neighbours of ReLU(A f_j + E e_ij), and what C f_i adds.

    Args:
        inputs, outputs: channels of features.
        edges: channels of e_ij, of a pair.

    Raises:
        ValueError: if a size cannot be.
    """

    def __init__(self, inputs: int, outputs: int, edges: int) -> None:
        super().__init__()
        self.other = PointLinear(inputs, outputs, bias=False)
        self.own = PointLinear(inputs, outputs)
        self.edge = PointLinear(edges, outputs)

    def forward(self, features: Tensor, edges: Tensor, neighbours: Tensor) -> Tensor:
        """(B, N, inputs), (B, N, K, edges) and indices (B, N, K) to (B, N, outputs)."""
        lent = gather_points(self.other(features), neighbours)
        return (lent + self.edge(edges)).relu().amax(2) + self.own(features)


class InvariantBackbone(_Backbone):
    """Features that do not change when a cloud is turned, with its normals and the camera.

    Every layer sees pairs of neighbours by their invariants only, the direction to the camera among
    them: it turns with the cloud where a camera moves about a thing that stays. Nothing of it is in
    the paper, whose network has 3D-GCN's features beside f1, and those change.

    Args:
        widths, levels: of the layers.
        neighbours: K; of a coarser cloud as many as its graph has, if these are fewer.
        form: one of `FORMS`; with all but "handed" left and right look alike.
        norm: one of `NORMS`.

    Attributes:
        channels: of what is known of a point.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        widths: Sequence[int] = WIDTHS,
        levels: Sequence[int] = LEVELS,
        *,
        neighbours: int = 10,
        form: str = "handed",
        norm: str = "layer",
    ) -> None:
        super().__init__(widths, levels, neighbours, norm)
        require_choice("form", form, list(FORMS))
        self.form = form
        first = {"printed": 2, "order_free": 3, "oriented": 3, "handed": 5}[form]
        self.layers = nn.ModuleList([PointLinear(first, widths[0])])
        for i, width in enumerate(widths[1:], 1):
            self.layers.append(EdgeConv(widths[i - 1], width, FORMS[form] + 1))

    def _seen(self, graph: Graph, normals: Tensor, view: Tensor) -> dict:
        indices = self._indices(graph)
        edges = [
            pair_channels(*cloud, near, view, self.form, toward_camera=True)
            for cloud, near in zip(
                zip(graph.clouds(), graph.clouds(normals), strict=True), indices, strict=True
            )
        ]
        first = point_channels(graph.points, normals, view, self.form)
        return {"indices": indices, "edges": edges, "first": first}

    def _layer(self, i: int, known: Tensor | None, seen: dict) -> Tensor:
        level = self.levels[i]
        if known is None:
            return self.layers[i](seen["first"])
        return self.layers[i](known, seen["edges"][level], seen["indices"][level])
