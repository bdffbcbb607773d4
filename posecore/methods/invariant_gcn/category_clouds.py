"""Clouds about their mean with all that a network has to know: prepared once, varied in batches.

Neighbours, coarser clouds and normals follow from the points; a turn and a scale take them along.
A move of the whole cloud changes nothing, as clouds are about their means.

Source: Chen et al., the rotation-invariant paper, Section 3.4: turns, moves, scale and noise.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from data_tools.batches.memory import require_bytes
from posecore.arrays import fail, require_choice, require_integer, require_number
from posecore.clouds import estimate_normals
from posecore.methods.invariant_gcn.network import Cloud
from posecore.methods.invariant_gcn.seen_clouds import SeenClouds
from posecore.nets.graph3d import Graph
from posecore.rotations import axis_angle_to_matrix, random_rotations

__all__ = ["TURNS", "CategoryClouds", "Variation", "normals_and_view", "turned_clouds"]

AT_ONCE = 256  # clouds whose graphs are built together
NEAREST = 16  # points that a normal is of
TURNS = ("any", "roll", "all")
"""About an axis of any direction by at most an angle; about the ray to the camera, as a camera is
rolled; any rotation, all alike."""


@dataclass(frozen=True)
class Variation:
    """What is varied in a batch.

    Attributes:
        turn: degrees by which a cloud is turned at most, about its mean; of "all" without meaning.
        about: one of `TURNS`.
        scale: a cloud and its thing are larger or smaller by up to this share.
        noise: metres, of a normal distribution, on each coordinate of each point. Neighbours and
            normals stay those of before.

    Raises:
        ValueError: for a number that is out of range.
    """

    turn: float = 0.0
    about: str = "any"
    scale: float = 0.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        require_number("turn", self.turn, 0, 180)
        require_choice("about", self.about, TURNS)
        if require_number("scale", self.scale, 0, 1) == 1:
            fail("scale", "below 1", self.scale)
        require_number("noise", self.noise, 0)


class CategoryClouds:
    """Clouds about their means.

    Args:
        seen: in the frames of their cameras.
        build: makes the graph of clouds (B, N, 3).

    Attributes:
        seen: as they came.
        graph: of the V centred clouds.
        normals: (V, N, 3) of length one, to the side of the camera.
        centre: (V, 3) metres, their means in the frames of the cameras.
        view: (V, 3) unit vectors to the cameras.
        R: (V, 3, 3), t: (V, 3) metres relative to `centre`, size: (V, 3), canonical: (V, N, 3).

    Raises:
        ValueError: if clouds have too few points for the graph, or it does not fit into memory.
    """

    def __init__(self, seen: SeenClouds, build: Callable[[Tensor], Graph]) -> None:
        self.seen = seen
        self.centre = seen.points.mean(1)
        points = seen.points - self.centre[:, None]
        one = sum(values[0].nbytes for values in build(points[:1]).tensors().values())
        one += seen.points[0].nbytes
        # While the parts are joined, each number is there twice.
        require_bytes(
            "clouds", "graphs that fit into", f"{len(seen)} clouds", 2.0 * one * len(seen)
        )
        self.normals, self.view = normals_and_view(seen.points)
        parts = [build(part).tensors() for part in points.split(AT_ONCE)]
        self.graph = Graph.of(
            {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        )
        self.R, self.size, self.canonical = seen.R, seen.size, seen.canonical
        self.t = seen.t - self.centre

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.centre)

    def only(self, chosen: Tensor) -> CategoryClouds:
        """Some of the clouds: those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        part = copy.copy(self)
        part.seen = self.seen.only(chosen)
        for name in ("normals", "centre", "view", "R", "t", "size", "canonical"):
            setattr(part, name, getattr(self, name)[chosen])
        rows = chosen.nonzero()[:, 0] if chosen.dtype == torch.bool else chosen
        part.graph = self.graph.select(rows)
        return part

    def batch(self, rows: Tensor) -> dict[str, Tensor]:
        """Clouds by their numbers (B,), as they are.

        Returns:
            - what `Cloud.of` takes: the tensors of the graph, "points" (B, N, 3) among them,
              "normals" (B, N, 3), "view" (B, 3), "category" (B,);
            - "R" (B, 3, 3), "t" and "size" (B, 3), "canonical" (B, N, 3), metres;
            - "symmetric" (B,) bool.
        """
        own = ("normals", "view", "R", "t", "size", "canonical")
        found = {name: getattr(self, name)[rows] for name in own}
        of_seen = {name: getattr(self.seen, name)[rows] for name in ("category", "symmetric")}
        return {**self.graph.select(rows).tensors(), **found, **of_seen}

    def draw(
        self, count: int, *, generator: torch.Generator, vary: Variation | None = None
    ) -> dict[str, Tensor]:
        """A batch of `count` clouds, each varied by itself; as `batch` has it.

        Args:
            count: B.
            generator: of random numbers.
            vary: what is varied; None for nothing.

        Raises:
            ValueError: for a number that cannot be.
        """
        require_integer("count", count, 1)
        batch = self.batch(torch.randint(len(self), (count,), generator=generator))
        return batch if vary is None else _varied(batch, vary, generator)

    def clouds(self, rows: Tensor) -> Cloud:
        """What a network is given of clouds by their numbers (B,)."""
        return Cloud.of(self.batch(rows))


def normals_and_view(points: Tensor) -> tuple[Tensor, Tensor]:
    """Of clouds (V, N, 3) in the frames of cameras: normals (V, N, 3) and ways to them (V, 3)."""
    k = min(NEAREST, points.shape[1])
    parts = [estimate_normals(p, k, p.new_zeros(len(p), 3)) for p in points.split(AT_ONCE)]
    return torch.cat(parts), -F.normalize(points.mean(1), dim=-1)


def turned_clouds(batch: dict[str, Tensor], Q: Tensor) -> dict[str, Tensor]:
    """A batch whose clouds are turned about their means, and all that belongs to them.

    The camera goes with them: what it saw is what is there. About the ray to it, this is what it
    would see if it were rolled; about others no camera would see these points.

    Args:
        batch: as `CategoryClouds.batch` has it.
        Q: (B, 3, 3) rotations.

    Raises:
        ValueError: for another shape.
    """
    if Q.shape != batch["R"].shape:
        fail("Q", f"shape {tuple(batch['R'].shape)}", f"shape {tuple(Q.shape)}")
    turned = {name: batch[name] @ Q.mT for name in ("points", "normals")}
    turned |= {name: (Q @ batch[name][..., None])[..., 0] for name in ("view", "t")}
    return {**batch, **turned, "R": Q @ batch["R"]}


def _varied(
    batch: dict[str, Tensor], vary: Variation, generator: torch.Generator
) -> dict[str, Tensor]:
    count = len(batch["R"])
    if vary.about == "all":
        batch = turned_clouds(batch, random_rotations(count, generator=generator).to(batch["R"]))
    elif vary.turn:
        axis = F.normalize(torch.randn(count, 3, generator=generator), dim=1)
        share = torch.rand(count, 1, generator=generator)
        if vary.about == "roll":  # to both sides
            axis, share = batch["view"], 2 * share - 1
        turn = axis_angle_to_matrix(axis * share * math.radians(vary.turn))
        batch = turned_clouds(batch, turn)
    if vary.scale:
        factor = 1 + vary.scale * (2 * torch.rand(count, 1, generator=generator) - 1)
        scaled = {name: factor * batch[name] for name in ("t", "size")}
        scaled |= {name: factor[:, None] * batch[name] for name in ("points", "canonical")}
        batch = {**batch, **scaled}
    if vary.noise:
        shape = batch["points"].shape
        noise = vary.noise * torch.randn(shape, generator=generator)
        batch = {**batch, "points": batch["points"] + noise}
    return batch
