"""What a pose costs: time of a forward pass at the paper's sizes, and of a step at the book's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median

import torch

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
        generator = torch.Generator().manual_seed(seed)
        directions = torch.randn(1, recipe.points, 3, generator=generator)
        points = 0.1 * torch.nn.functional.normalize(directions, dim=-1)
        with torch.no_grad():
            whole = milliseconds(partial(pose_of_clouds, net, points), repeats)
            after = milliseconds(partial(net.pose, net.geometry(points)), repeats)
        values[Key(f"{name}, paper", "test", "time")] = whole
        values[Key(f"{name}, paper", "test", "time, geometry known")] = after
        count = sum(p.numel() for p in net.parameters())
        values[Key(f"{name}, paper", "test", "weights")] = count / 1e6
    return values
