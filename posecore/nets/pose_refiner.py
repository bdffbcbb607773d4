"""The refiner of DenseFusion without depth: how a pose is to be corrected, from points.

Two streams go through the same layers for every point, one of where it is and one of what is known
about it. Their mean over all points is what the object as a whole tells, and two small heads say
from it the turn and the shift of a correction.

| per point              | points  | features |
|------------------------|---------|----------|
| layer 1                | 3 -> 64 | F -> 64  |
| layer 2                | 128     | 128      |
| both layers of both    | 384     |          |
| layers 3, 4            | 512, 1024 |        |
| mean over the points   | 1024    |          |
| each head              | 512, 128, then 4 or 3 for each object | |
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_integer

__all__ = ["Correction", "PoseRefiner"]


class Correction(NamedTuple):
    """What a refiner says."""

    quaternion: Tensor
    """(B, 4) turn (w, x, y, z) of any length; of new weights the identity."""
    shift: Tensor
    """(B, 3) three numbers for the translation, whose units are the caller's; at first zero."""


class PoseRefiner(nn.Module):
    """From a cloud of points with features to a turn and a shift.

    Several objects share all layers but the last, which has outputs of its own for each, as in the
    reference. A new refiner corrects nothing: the last layers begin with zeros.

    Wang et al., DenseFusion: 6D Object Pose Estimation by Iterative Dense Fusion, CVPR 2019,
    Section 3.4; sizes from the reference implementation j96w/DenseFusion, whose second stream takes
    colour features. The order of the points does not matter.

    Args:
        features: F, how many numbers are known about each point besides its place.
        objects: how many objects it serves.
        width: of the first layer, from which all others follow; 64 in the reference.

    Raises:
        ValueError: if one of them is no integer of at least 1.
    """

    def __init__(self, features: int, objects: int = 1, width: int = 64) -> None:
        super().__init__()
        self.features = require_integer("features", features, 1)
        self.objects = require_integer("objects", objects, 1)
        width = require_integer("width", width, 1)
        self.points_1, self.points_2 = _linear(3, width), _linear(width, 2 * width)
        self.known_1, self.known_2 = _linear(features, width), _linear(width, 2 * width)
        self.both = _layers(6 * width, 8 * width, 16 * width)
        self.turn, self.shift = (
            nn.Sequential(_layers(16 * width, 8 * width, 2 * width), _zero(2 * width, n * objects))
            for n in (4, 3)
        )

    def forward(self, points: Tensor, features: Tensor, index: Tensor | None = None) -> Correction:
        """The correction of each cloud.

        Args:
            points: (B, N, 3).
            features: (B, N, F) of the same points.
            index: (B,) which of the objects each cloud is of, 0 to `objects` - 1; may be left out
                where there is one.

        Raises:
            ValueError: if shapes do not fit, or an index is missing or out of range.
        """
        index = self._checked(points, features, index)
        p_1 = self.points_1(points).relu()  # (B, N, w)
        f_1 = self.known_1(features).relu()
        p_2 = self.points_2(p_1).relu()  # (B, N, 2 w)
        f_2 = self.known_2(f_1).relu()
        each = self.both(torch.cat([p_1, f_1, p_2, f_2], -1))  # (B, N, 16 w)
        whole = each.mean(1)  # (B, 16 w)
        turn, shift = (
            head(whole).unflatten(-1, (self.objects, -1))[torch.arange(len(points)), index]
            for head in (self.turn, self.shift)
        )  # (B, 4) and (B, 3)
        return Correction(turn + turn.new_tensor([1, 0, 0, 0]), shift)

    def _checked(self, points: Tensor, features: Tensor, index: Tensor | None) -> Tensor:
        if points.ndim != 3 or points.shape[-1] != 3 or not points.shape[1]:
            fail("points", "shape (B, N, 3) with N of at least 1", f"shape {tuple(points.shape)}")
        expected = (*points.shape[:2], self.features)
        if features.shape != expected:
            fail("features", f"shape {expected}", f"shape {tuple(features.shape)}")
        if index is None:
            if self.objects > 1:
                fail("index", f"which of {self.objects} objects each cloud is of", None)
            return torch.zeros(len(points), dtype=torch.long, device=points.device)
        if index.shape != points.shape[:1] or index.is_floating_point():
            got = f"shape {tuple(index.shape)}, {index.dtype}"
            fail("index", f"integers, shape {tuple(points.shape[:1])}", got)
        if bool(((index < 0) | (index >= self.objects)).any()):
            fail("index", f"integers from 0 to {self.objects - 1}", index.tolist())
        return index


def _layers(*sizes: int) -> nn.Sequential:
    pairs = pairwise(sizes)
    return nn.Sequential(*[part for i, o in pairs for part in (_linear(i, o), nn.ReLU())])


def _linear(inputs: int, outputs: int) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    nn.init.zeros_(layer.bias)
    return layer


def _zero(inputs: int, outputs: int) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer
