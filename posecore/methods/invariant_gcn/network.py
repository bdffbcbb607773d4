"""The network: what is known of points, and three branches that say what follows for the pose.

1. Two axes of the box with confidences, translation and size, of the whole cloud. In the frame in
   which the cloud comes, so this is no invariant; it also sees where points are.
2. Canonical coordinates of each point, over the diagonal of the box, from features alone: if these
   are invariant, so are the coordinates.
3. The six faces of the box as each point sees them: direction, distance, confidence.

Source: Chen et al., the rotation-invariant paper, Section 3.3 and Figure 1; Di et al., "GPV-Pose",
CVPR 2022. What is said besides, a confidence of each canonical coordinate and the proportions of
the box, is not in them: Umeyama's road needs it to weigh points and to tell a size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from posecore.arrays import fail, require_choice, require_integer, require_number
from posecore.methods.invariant_gcn.backbone import (
    LEVELS,
    NORMS,
    WIDTHS,
    GraphBackbone,
    InvariantBackbone,
)
from posecore.methods.invariant_gcn.faces import FACES
from posecore.methods.invariant_gcn.invariants import LocalFeatures
from posecore.nets.graph3d import Graph, PointLinear

__all__ = ["BACKBONES", "BRANCHES", "Cloud", "InvariantGCN", "Prediction"]

BACKBONES = ("graph", "invariant")
BRANCHES = ("axes", "canonical", "faces")


class Cloud(NamedTuple):
    """What a network is given of B clouds."""

    graph: Graph  # of points about their mean, metres
    normals: Tensor  # (B, N, 3) of length one, to the side of the camera
    view: Tensor  # (B, 3) unit vectors to the camera
    category: Tensor  # (B,) int64

    @classmethod
    def of(cls, batch: Mapping[str, Tensor]) -> Cloud:
        """Of a batch by `CategoryClouds.draw`."""
        return cls(Graph.of(batch), *(batch[name] for name in cls._fields[1:]))

    def to(self, device: torch.device | str) -> Cloud:
        """The same on another device."""
        return Cloud(*(part.to(device) for part in self))


class Prediction(NamedTuple):
    """What a network says of B clouds; None of a branch that it has not."""

    x: Tensor | None = None  # (B, 3) of any length, the first column of R
    y: Tensor | None = None  # (B, 3) the second one
    x_confidence: Tensor | None = None  # (B,) 0 to 1
    y_confidence: Tensor | None = None  # (B,)
    t: Tensor | None = None  # (B, 3) metres, relative to the mean of the cloud
    size: Tensor | None = None  # (B, 3) metres
    canonical: Tensor | None = None  # (B, N, 3) over the diagonal of the box
    canonical_confidence: Tensor | None = None  # (B, N) before a sigmoid
    proportions: Tensor | None = None  # (B, 3) size over the diagonal
    face_normals: Tensor | None = None  # (B, N, 6, 3) of length one, outward
    face_distances: Tensor | None = None  # (B, N, 6) metres
    face_confidences: Tensor | None = None  # (B, N, 6) 0 to 1


class InvariantGCN(nn.Module):
    """Clouds of known categories to poses, sizes, canonical coordinates and faces of boxes.

    Args:
        mean_size: (C, 3) metres, of the things of each category, in whose residual sizes are said.
        backbone: "graph" for 3D-GCN, or "invariant".
        branches: which of `BRANCHES` there are.
        widths, levels, neighbours, norm: of the backbone.
        supports, f1, f1_layers: of "graph"; f1 as the arguments of `LocalFeatures`, None for none.
        form: of "invariant".
        context: channels of what is known of the whole cloud, which each point is told for its
            canonical coordinate; 0 for none, as published.
        pooled: widths of the first branch before its maximum over points, and after it.
        dense: widths of the second branch's layers.
        faces: widths of the third branch's layers.
        places: whether the axes' heads see where points are. As published they do not, and the one
            of translation and size does. An invariant backbone's have to: without it, what they
            say of an axis could not turn with the cloud.
        dropout: share of the first branch's features that is left out in training.
        unit: metres that count as one where places go in or lengths come out.

    Attributes:
        mean_size: (C, 3) metres.

    Raises:
        ValueError: if an argument cannot be.
    """

    def __init__(
        self,
        mean_size: Sequence[Sequence[float]],
        *,
        backbone: str = "graph",
        branches: Sequence[str] = BRANCHES,
        widths: Sequence[int] = WIDTHS,
        levels: Sequence[int] = LEVELS,
        neighbours: int = 10,
        norm: str = "batch",
        supports: int = 7,
        f1: Mapping[str, Any] | None = None,
        f1_layers: Sequence[int] = (1,),
        form: str = "handed",
        context: int = 0,
        pooled: Sequence[Sequence[int]] = ((1024, 256), (256,)),
        dense: Sequence[int] = (512, 512, 256, 128),
        faces: Sequence[int] = (512, 256, 128),
        places: bool = False,
        dropout: float = 0.2,
        unit: float = 0.1,
    ) -> None:
        super().__init__()
        require_choice("backbone", backbone, BACKBONES)
        for branch in branches:
            require_choice("branches", branch, BRANCHES)
        if not branches:
            fail("branches", "one or more", "none")
        self.register_buffer("mean_size", _sizes(mean_size))
        shared = {"neighbours": neighbours, "norm": norm}
        if backbone == "graph":
            local = None if f1 is None else LocalFeatures(**f1)
            self.backbone = GraphBackbone(
                widths, levels, supports=supports, f1=local, f1_layers=f1_layers, **shared
            )
        else:
            self.backbone = InvariantBackbone(widths, levels, form=form, **shared)
        self.branches = tuple(branches)
        self.places, self.unit = bool(places), require_number("unit", unit, above=0)
        kinds = len(self.mean_size)
        known = self.backbone.channels + kinds
        self.axes = self.canonical = self.faces = None
        if "axes" in branches:
            self.axes = nn.ModuleDict(
                {
                    name: _PooledHead(known + 3 * sees, pooled, outputs, norm, dropout)
                    for name, outputs, sees in (
                        ("x", 4, self.places), ("y", 4, self.places), ("lengths", 6, True),
                    )
                }
            )  # fmt: skip
        if "canonical" in branches:
            self.canonical = _CanonicalHead(known, context, dense, norm)
        if "faces" in branches:
            outputs = len(FACES) * 5
            self.faces = nn.Sequential(
                *_layers((known + 3, *faces), norm), _last(faces[-1], outputs)
            )

    def forward(self, cloud: Cloud) -> Prediction:
        """What clouds tell.

        Raises:
            ValueError: unless there is one category for each cloud; for graphs with fewer levels or
                neighbours than the backbone needs.
        """
        graph, normals, view, category = cloud
        if category.shape != (len(graph),):
            fail("category", f"shape ({len(graph)},)", f"shape {tuple(category.shape)}")
        known = self.backbone(graph, normals, view)
        kinds = F.one_hot(category, len(self.mean_size)).to(known)
        known = torch.cat([known, kinds[:, None].expand(-1, known.shape[1], -1)], -1)
        placed = torch.cat([known, graph.points / self.unit], -1)
        said = {}
        if self.axes is not None:
            for name in ("x", "y"):
                head = self.axes[name](placed if self.places else known)
                said |= {name: head[:, 1:], f"{name}_confidence": head[:, 0].sigmoid()}
            lengths = self.unit * self.axes["lengths"](placed)
            said |= {"t": lengths[:, :3], "size": self.mean_size[category] + lengths[:, 3:]}
        if self.canonical is not None:
            said |= self.canonical(known, F.normalize(self.mean_size, dim=-1)[category])
        if self.faces is not None:
            heads = self.faces(placed).unflatten(-1, (len(FACES), 5))  # (B, N, 6, 5)
            said |= {
                "face_normals": F.normalize(heads[..., :3], dim=-1),
                "face_distances": self.unit * heads[..., 3],
                "face_confidences": heads[..., 4].sigmoid(),
            }
        return Prediction(**said)


class _PooledHead(nn.Module):
    """Layers of points, their maximum, layers of clouds."""

    def __init__(
        self, inputs: int, widths: Sequence[Sequence[int]], outputs: int, norm: str, dropout: float
    ) -> None:
        super().__init__()
        before, after = widths
        self.before = nn.Sequential(*_layers((inputs, *before), norm))
        self.after = nn.Sequential(
            *_layers((before[-1], *after), norm), nn.Dropout(dropout), _last(after[-1], outputs)
        )

    def forward(self, known: Tensor) -> Tensor:
        """(B, N, inputs) to (B, outputs)."""
        return self.after(self.before(known).amax(1))


class _CanonicalHead(nn.Module):
    """Canonical coordinates of points with confidences, and proportions of the box."""

    def __init__(self, inputs: int, context: int, widths: Sequence[int], norm: str) -> None:
        super().__init__()
        require_integer("context", context, 0)
        summary = context or widths[0]
        self.summary = nn.Sequential(*_layers((inputs, summary), norm))
        self.tells = bool(context)
        self.points = nn.Sequential(
            *_layers((inputs + context, *widths), norm), _last(widths[-1], 4)
        )
        self.proportions = _last(summary, 3)

    def forward(self, known: Tensor, usual: Tensor) -> dict[str, Tensor]:
        """Of (B, N, inputs) and the usual proportions (B, 3) of their categories."""
        whole = self.summary(known).amax(1)
        proportions = usual + self.proportions(whole)
        if self.tells:
            known = torch.cat([known, whole[:, None].expand(-1, known.shape[1], -1)], -1)
        said = self.points(known)
        return {
            "canonical": said[..., :3],
            "canonical_confidence": said[..., 3],
            "proportions": proportions,
        }


def _layers(sizes: Sequence[int], norm: str) -> list[nn.Module]:
    found: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        found += [PointLinear(inputs, outputs, bias=False), NORMS[norm](outputs), nn.ReLU()]
    return found


def _last(inputs: int, outputs: int) -> nn.Linear:
    """What is said at first is small: a plain matrix, which Muon leaves to Adam."""
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        layer.weight.mul_(0.1)
        layer.bias.zero_()
    return layer


def _sizes(mean_size: Sequence[Sequence[float]]) -> Tensor:
    try:
        sizes = torch.as_tensor(mean_size, dtype=torch.float32)
    except (TypeError, ValueError):
        fail("mean_size", "three lengths for each category", repr(mean_size)[:80])
    if sizes.ndim != 2 or sizes.shape[-1] != 3 or not len(sizes):
        fail("mean_size", "shape (C, 3), C at least 1", f"shape {tuple(sizes.shape)}")
    if not bool((sizes > 0).all() & sizes.isfinite().all()):
        fail("mean_size", "lengths above 0", sizes.tolist())
    return sizes.clone()
