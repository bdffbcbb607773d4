"""What PointNet++ needs to know of where points are, apart from what it learns.

Which points are centres, which points are in whose ball, and who lends features to whom follow from
the coordinates alone. That is most of the work of a small network, and none of it changes when a
cloud is turned or moved. So it is computed once for each cloud, kept, and turned with it:

    geometry = build_geometry(points, LAYERS)     # once
    batch = geometry.select(rows).turned(R)       # at every step

Source: Qi et al., "PointNet++: Deep Hierarchical Feature Learning on Point Sets in a Metric Space",
NeurIPS 2017, Section 3.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from posecore.arrays import fail, require_finite, require_integer, require_number, trusted
from posecore.clouds import (
    ball_query,
    farthest_point_sampling,
    gather_points,
    interpolation_weights,
)

__all__ = ["LAYERS", "Abstraction", "Geometry", "Level", "Link", "build_geometry"]


class Abstraction(NamedTuple):
    """The sizes of a set abstraction.

    Attributes:
        points: S, how many centres are chosen.
        radius: of the balls about them, in metres.
        neighbours: K, of a ball; the first ones by index if there are more.
        widths: of the layers that every neighbour goes through.
    """

    points: int
    radius: float
    neighbours: int
    widths: tuple[int, ...]


LAYERS = (
    Abstraction(1024, 0.02, 64, (64, 64, 128)),
    Abstraction(512, 0.04, 32, (128, 128, 256)),
    Abstraction(256, 0.08, 16, (128, 128, 256)),
    Abstraction(128, 1.0, 16, (128, 128, 256)),
)
"""Those of Table 1 of Firintepe et al., "From IR images to point clouds to pose", 2021. Numbers of
neighbours are not in it; these are of VoteNet's backbone, which the paper builds on."""


class Level(NamedTuple):
    """One set abstraction's part: int32 indices into the N points of the level before."""

    centres: Tensor  # (B, S)
    balls: Tensor  # (B, S, K)


class Link(NamedTuple):
    """One feature propagation's part: where each of M points gets its features from."""

    indices: Tensor  # (B, M, 3) int32, into the points of the coarser level
    weights: Tensor  # (B, M, 3) of sum 1


@dataclass(frozen=True, eq=False)
class Geometry:
    """All that a `PointNet2` needs to know of B clouds but features.

    Attributes:
        points: (B, N, 3) metres.
        levels: of the set abstractions, from fine to coarse.
        links: of the feature propagations, in the order in which they come: the first leads from
            the last level to the one before it.
    """

    points: Tensor
    levels: tuple[Level, ...]
    links: tuple[Link, ...] = ()

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.points)

    def coordinates(self) -> list[Tensor]:
        """(B, S, 3) of the points of every level, the cloud itself first."""
        found = [self.points]
        with trusted():
            for level in self.levels:
                found.append(gather_points(found[-1], level.centres))
        return found

    def select(self, rows: Tensor) -> Geometry:
        """Of some of the clouds, as an index (M,) of integers tells them."""
        return self._mapped(lambda values: values[rows])

    def to(self, device: torch.device | str) -> Geometry:
        """The same on another device."""
        return self._mapped(lambda values: values.to(device))

    def at(self, points: Tensor) -> Geometry:
        """The same centres, balls and links, of points that lie elsewhere.

        Exact for points that were turned or moved as one; for points with a little noise it is what
        was known of them before.

        Args:
            points: (B, N, 3) as many as there were.

        Raises:
            ValueError: for another shape, or what is not finite.
        """
        if points.shape != self.points.shape:
            expected = f"shape {tuple(self.points.shape)}"
            fail("points", expected, f"shape {tuple(points.shape)}")
        require_finite("points", points)
        return replace(self, points=points)

    def turned(self, R: Tensor) -> Geometry:
        """Of the clouds turned about the origin.

        Args:
            R: (B, 3, 3) rotations, or one (3, 3) for all.

        Raises:
            ValueError: for another shape, or what is not finite.
        """
        if R.shape not in ((3, 3), (len(self), 3, 3)):
            fail("R", f"shape (3, 3) or ({len(self)}, 3, 3)", f"shape {tuple(R.shape)}")
        require_finite("R", R)
        return replace(self, points=self.points @ R.to(self.points).mT)

    def tensors(self) -> dict[str, Tensor]:
        """All of it by name, for a batch or a file; `of` makes it whole again."""
        named = {"points": self.points}
        for i, level in enumerate(self.levels):
            named |= {f"level{i}.{name}": value for name, value in level._asdict().items()}
        for i, link in enumerate(self.links):
            named |= {f"link{i}.{name}": value for name, value in link._asdict().items()}
        return named

    @classmethod
    def of(cls, tensors: dict[str, Tensor]) -> Geometry:
        """What `tensors` named, made whole again; other names are left alone.

        Raises:
            ValueError: if one is missing.
        """

        def parts(kind: type, word: str) -> tuple:
            numbers = [re.fullmatch(rf"{word}([0-9]+)\.\w+", name) for name in tensors]
            found = []
            for i in range(max((int(match[1]) + 1 for match in numbers if match), default=0)):
                names = [f"{word}{i}.{field}" for field in kind._fields]
                for name in names:
                    if name not in tensors:
                        fail("tensors", f"{name!r} among them", sorted(tensors))
                found.append(kind(*(tensors[name] for name in names)))
            return tuple(found)

        if "points" not in tensors:
            fail("tensors", "'points' among them", sorted(tensors))
        return cls(tensors["points"], parts(Level, "level"), parts(Link, "link"))

    def _mapped(self, change: Callable[[Tensor], Tensor]) -> Geometry:
        return Geometry.of({name: change(value) for name, value in self.tensors().items()})


def require_layers(layers: Sequence[Abstraction]) -> tuple[Abstraction, ...]:
    """Sizes as they can be, from fine to coarse; else a ValueError that names `layers`.

    Raises:
        ValueError: naming the entry of `layers` that cannot be.
    """
    layers = tuple(Abstraction(*layer) for layer in layers)
    if not layers:
        fail("layers", "at least one", "none")
    before = None
    for i, (points, radius, neighbours, widths) in enumerate(layers):
        require_integer(f"layers[{i}].points", points, 1, before)
        require_number(f"layers[{i}].radius", radius, above=0)
        require_integer(f"layers[{i}].neighbours", neighbours, 1)
        if not widths:
            fail(f"layers[{i}].widths", "at least one", "none")
        for width in widths:
            require_integer(f"layers[{i}].widths", width, 1)
        before = points
    return layers


@torch.no_grad()
def build_geometry(
    points: Tensor,
    layers: Sequence[Abstraction] = LAYERS,
    propagations: int = 2,
    *,
    power: float = 1.0,
) -> Geometry:
    """Centres by farthest point sampling, balls about them, and weights of the way back.

    Args:
        points: (B, N, 3) metres. The first is the first centre, so the order of points decides
            which are chosen: the same order gives the same.
        layers: of the set abstractions. A ball that has fewer points than asked for is filled with
            copies of its first; it is never empty, as its centre is in the cloud, and if it were,
            it would hold the nearest point (`posecore.clouds.ball_query`).
        propagations: how many levels features go back by.
        power: of the inverse distance by which the three nearest are weighed: 1 as in VoteNet, 2 as
            in Eq. 2 of PointNet++.

    Raises:
        ValueError: if clouds have fewer points than the first layer chooses, or a number cannot be.
    """
    layers = require_layers(layers)
    require_integer("propagations", propagations, 0, len(layers) - 1)
    if not isinstance(points, Tensor) or not points.is_floating_point():
        fail("points", "a tensor of floating point numbers", getattr(points, "dtype", points))
    if points.ndim != 3 or points.shape[-1] != 3 or points.shape[1] < layers[0].points:
        expected = f"shape (B, N, 3) with N of at least {layers[0].points}"
        fail("points", expected, f"shape {tuple(points.shape)}")
    places, levels, links = [points], [], []
    for layer in layers:
        centres = farthest_point_sampling(places[-1], layer.points)
        places.append(gather_points(places[-1], centres))
        balls = ball_query(places[-2], places[-1], layer.radius, layer.neighbours)
        levels.append(Level(centres.int(), balls.int()))
    for i in range(propagations):
        indices, weights = interpolation_weights(places[-1 - i], places[-2 - i], power)
        links.append(Link(indices.int(), weights))
    return Geometry(points, tuple(levels), tuple(links))
