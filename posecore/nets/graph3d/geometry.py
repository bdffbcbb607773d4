"""What a graph convolution needs to know of where points are, apart from what it learns.

Who is whose neighbour, which points make the coarser clouds, and where each point finds itself
there follow from the coordinates alone, and do not change when a cloud is turned, moved or scaled.
So they are computed once for each cloud, kept, and turned with it:

    graph = build_graph(points, sizes=(128, 32))   # once
    batch = graph.select(rows).turned(R)           # at every step

Two things of the published code are mended here. It takes the nearest point for the point itself
and drops it, which of two points in one place keeps the wrong one; here a point is left out of its
neighbours by its number. And it draws the points of a coarser cloud at random whenever it is asked,
also in a test; here they are the farthest points, or drawn once from a seed.

Source: Lin et al., "Convolution in the Cloud: Learning Deformable Kernels in 3D Graph Convolution
Networks for Point Cloud Analysis", CVPR 2020, Sections 3.2 and 3.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from posecore.arrays import (
    fail,
    require_choice,
    require_finite,
    require_integer,
    trusted,
)
from posecore.clouds import farthest_point_sampling, gather_points, nearest_neighbours

__all__ = [
    "CHOICES",
    "Coarser",
    "Graph",
    "build_graph",
    "feature_neighbours",
    "other_neighbours",
]

CHOICES = ("farthest", "random")
"""Of the points of a coarser cloud."""


class Coarser(NamedTuple):
    """A coarser cloud: int32 indices, nearest first where several are near."""

    centres: Tensor  # (B, M) its points, among those of the cloud before
    pool: Tensor  # (B, M, P) the nearest others of each, among those of the cloud before
    neighbours: Tensor  # (B, M, K) the nearest others of each, among its own
    nearest: Tensor  # (B, N) of each point of the finest cloud the nearest, among its own


@dataclass(frozen=True, eq=False)
class Graph:
    """All that graph convolutions need to know of B clouds but features.

    Attributes:
        points: (B, N, 3) metres.
        neighbours: (B, N, K) int32, the nearest others of each point, nearest first.
        coarser: the clouds that were chosen from them, from fine to coarse.
    """

    points: Tensor
    neighbours: Tensor
    coarser: tuple[Coarser, ...] = ()

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.points)

    def clouds(self, values: Tensor | None = None) -> list[Tensor]:
        """What belongs to the points of every cloud, the finest first: coordinates by default.

        Args:
            values: (B, N, C) of the finest, such as normals.
        """
        found = [self.points if values is None else values]
        with trusted():
            for level in self.coarser:
                found.append(gather_points(found[-1], level.centres))
        return found

    def select(self, rows: Tensor) -> Graph:
        """Of some of the clouds, as an index (M,) of integers tells them."""
        return self._mapped(lambda values: values[rows])

    def to(self, device: torch.device | str) -> Graph:
        """The same on another device."""
        return self._mapped(lambda values: values.to(device))

    def at(self, points: Tensor) -> Graph:
        """The same neighbours of points that lie elsewhere.

        Exact for points that were turned, moved and scaled as one; for points with a little noise
        it is what was known of them before.

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

    def turned(self, R: Tensor) -> Graph:
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
        named = {"points": self.points, "neighbours": self.neighbours}
        for i, level in enumerate(self.coarser):
            named |= {f"coarser{i}.{name}": value for name, value in level._asdict().items()}
        return named

    @classmethod
    def of(cls, tensors: dict[str, Tensor]) -> Graph:
        """What `tensors` named, made whole again; other names are left alone.

        Raises:
            ValueError: if one is missing.
        """
        prefixes = {name.partition(".")[0] for name in tensors if name.startswith("coarser")}
        wanted = ["points", "neighbours"]
        wanted += [f"coarser{i}.{name}" for i in range(len(prefixes)) for name in Coarser._fields]
        for name in wanted:
            if name not in tensors:
                fail("tensors", f"{name!r} among them", sorted(tensors))
        levels = (
            Coarser(*(tensors[f"coarser{i}.{name}"] for name in Coarser._fields))
            for i in range(len(prefixes))
        )
        return cls(tensors["points"], tensors["neighbours"], tuple(levels))

    def _mapped(self, change: Callable[[Tensor], Tensor]) -> Graph:
        return Graph.of({name: change(value) for name, value in self.tensors().items()})


@torch.no_grad()
def build_graph(
    points: Tensor,
    sizes: Sequence[int] = (128, 32),
    neighbours: int | Sequence[int] = 10,
    *,
    pool: int = 4,
    choice: str = "farthest",
    seed: int = 0,
) -> Graph:
    """Neighbours in space, coarser clouds, and the way back from them.

    Args:
        points: (B, N, 3) metres.
        sizes: how many points each coarser cloud has, ever fewer. The first point of a cloud is
            kept by "farthest", so the order of points decides which are: the same order gives the
            same.
        neighbours: K of all clouds, or of each, the finest first. Points in one place are
            neighbours like others, and have no direction (`posecore.clouds.
            neighbour_directions`).
        pool: P, of how many others in the finer cloud a point of the coarser takes the maximum.
        choice: one of `CHOICES`: by farthest point sampling, where copies of points come last; or
            at random, as published.
        seed: of the random choice.

    Raises:
        ValueError: if a cloud has too few points for its neighbours or for the next one, or a
            number cannot be.
    """
    if not isinstance(points, Tensor) or not points.is_floating_point():
        fail("points", "a tensor of floating point numbers", getattr(points, "dtype", points))
    if points.ndim != 3 or points.shape[-1] != 3 or not points.shape[1]:
        fail("points", "shape (B, N, 3), N at least 1", f"shape {tuple(points.shape)}")
    require_choice("choice", choice, CHOICES)
    generator = torch.Generator().manual_seed(require_integer("seed", seed, 0))
    counts = [points.shape[1], *sizes]
    given = [neighbours] * len(counts) if isinstance(neighbours, int) else list(neighbours)
    if len(given) != len(counts):
        fail("neighbours", f"one number, or one for each of {len(counts)} clouds", given)
    for i, (count, k) in enumerate(zip(counts, given, strict=True)):
        if i:
            require_integer(f"sizes[{i - 1}]", count, 1, counts[i - 1])
        require_integer(f"neighbours of {count} points", k, 1, count - 1)
    clouds, levels = [points], []
    for count, k in zip(sizes, given[1:], strict=True):
        fine = clouds[-1]
        require_integer(f"pool of {fine.shape[1]} points", pool, 1, fine.shape[1] - 1)
        if choice == "farthest":
            centres = farthest_point_sampling(fine, count)
        else:
            drawn = torch.rand(fine.shape[:2], generator=generator).argsort(1)[:, :count]
            centres = drawn.to(fine.device)
        clouds.append(gather_points(fine, centres))
        near = gather_points(other_neighbours(fine, pool), centres)
        nearest = nearest_neighbours(clouds[-1], points)[1][..., 0]
        levels.append(
            Coarser(centres.int(), near.int(), other_neighbours(clouds[-1], k).int(), nearest.int())
        )
    return Graph(points, other_neighbours(points, given[0]).int(), tuple(levels))


@torch.no_grad()
def other_neighbours(points: Tensor, k: int) -> Tensor:
    """The nearest other points of each point, nearest first; equally near ones by index.

    A point is never its own neighbour, but a copy of it may be.

    Args:
        points: (B, N, 3) metres.
        k: at most N - 1.

    Returns:
        (B, N, k) int64.

    Raises:
        ValueError: if there are not so many.
    """
    require_integer("k", k, 1, points.shape[-2] - 1)
    found = nearest_neighbours(points, points, k + 1)[1]
    own = found == torch.arange(points.shape[-2], device=points.device)[:, None]
    # Of many copies in one place a point may not be among the first: then the last goes.
    own[..., -1] |= ~own.any(-1)
    return found[~own].reshape(*found.shape[:-1], k)


@torch.no_grad()
def feature_neighbours(features: Tensor, k: int) -> Tensor:
    """The same by the Euclidean distance of features.

    Which of several equally near ones come first is not said, as in PyTorch's `topk`.

    Args:
        features: (B, N, C).
        k: at most N - 1.

    Returns:
        (B, N, k) int64.

    Raises:
        ValueError: if there are not so many.
    """
    require_integer("k", k, 1, features.shape[-2] - 1)
    distances = torch.cdist(features.float(), features.float())
    distances.diagonal(dim1=-2, dim2=-1).fill_(torch.inf)
    return distances.topk(k, largest=False).indices
