"""What a pose costs at the paper's sizes, and a step of a training at the book's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median

import torch
from torch import Tensor
from torch.nn.functional import normalize

from book.ch04_points_to_pose import pose_training as training
from book.tools.keys import Key
from posecore.methods.cloudpose.recipe import RECIPES as CLOUDPOSE
from posecore.methods.points_to_pose.centred_clouds import pose_of_clouds
from posecore.methods.points_to_pose.recipe import RECIPES
from posecore.scale import choose

__all__ = ["measure", "milliseconds"]


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """The median time of one of several calls, after one that is not counted."""
    work()
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return 1000 * median(found)


def measure(seed: int) -> dict[Key, float]:
    """Milliseconds from a cloud to a pose, geometry included, and millions of weights.

    At the paper's sizes, of one cloud of random points in a ball of a head's size.
    """
    size = choose(tiny="tiny", book="paper", paper="paper")
    repeats = choose(tiny=1, book=9, paper=9)
    recipes = {
        "p2r": replace(RECIPES[size], kind="p2r"), "p2p": RECIPES[size],
        "cloudpose": CLOUDPOSE[size],
    }  # fmt: skip
    values = {}
    for name, recipe in recipes.items():
        net = recipe.new_net(seed).eval()
        points = _spheres(1, recipe.points, seed)
        with torch.no_grad():
            whole = milliseconds(partial(pose_of_clouds, net, points), repeats)
            after = milliseconds(partial(net.pose, net.geometry(points)), repeats)
        values[Key(f"{name}, paper", "test", "time")] = whole
        values[Key(f"{name}, paper", "test", "time, geometry known")] = after
        values[Key(f"{name}, book", "test", "time of a step")] = _step(name, seed, repeats)
        count = sum(p.numel() for p in net.parameters())
        values[Key(f"{name}, paper", "test", "weights")] = count / 1e6
    return values


def _spheres(clouds: int, count: int, seed: int) -> Tensor:
    """(B, N, 3) metres, points on spheres about as large as a head."""
    generator = torch.Generator().manual_seed(seed)
    return 0.1 * normalize(torch.randn(clouds, count, 3, generator=generator), dim=-1)


def _step(method: str, seed: int, repeats: int) -> float:
    """Milliseconds of a step of a training at the book's sizes, geometry known."""
    recipe = training.at_book_size(method)
    net, loss = recipe.new_net(seed).train(), recipe.new_loss()
    geometry = net.geometry(_spheres(recipe.batch, recipe.points, seed))
    R, t = torch.eye(3).expand(recipe.batch, 3, 3), torch.zeros(recipe.batch, 3)
    batch = {"R": R, "t": t, **geometry.tensors()}
    optimiser = recipe.optimiser(net.parameters(), lr=recipe.lr)

    def step() -> None:
        optimiser.zero_grad()
        loss(net, batch)["loss"].backward()
        optimiser.step()

    return milliseconds(step, repeats)
