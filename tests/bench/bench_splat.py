"""The projector of clouds beside what one would write instead: autograd, and `conv3d` for the blur.

Run with `pytest -n 0 tests/bench/bench_splat.py`; the numbers in brackets are ratios. On a busy
machine add `--benchmark-timer=time.process_time`.
"""

from collections.abc import Callable
from itertools import product

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from posecore.splat import Pictures, render
from posecore.splat.volumes import MOST, kernel

SIZES = {
    "book": (48, 512, (80, 47, 80)),  # clouds: a batch of 16 in three views
    "paper": (6, 2000, (160, 94, 160)),
}
SIGMA = 1.0


def heads(size: str, spread: float) -> tuple[Tensor, Tensor, Tensor]:
    """Points on ellipsoids around the middle, `spread` of the width of the grid across."""
    count, points, grid = SIZES[size]
    generator = torch.Generator().manual_seed(0)
    around = torch.randn(count, points, 3, generator=generator)
    around = around / around.norm(dim=-1, keepdim=True) * torch.tensor([0.8, 1.0, 0.9])
    middle = (torch.tensor(grid) - 1) / 2
    places = middle + around * grid[0] * spread / 2
    return places, torch.rand(count, points, generator=generator), torch.full((count,), 0.8)


def by_autograd(
    points: Tensor, size: tuple[int, int, int], intensities: Tensor, scale: Tensor, sigma: float
) -> Pictures:
    """As `render`, of (B, N, 3)."""
    width, height, depth = size
    count = len(points)
    base = points.detach().floor()
    rest = points - base
    raw = points.new_zeros(count, width * height * depth)
    light = torch.zeros_like(raw)
    for corner in product((0, 1), repeat=3):
        at = base + torch.tensor(corner)
        weight = torch.where(torch.tensor(corner) == 1, rest, 1 - rest).prod(-1)
        inside = ((at >= 0) & (at < torch.tensor(size))).all(-1)
        x, y, z = at.long().unbind(-1)
        index = torch.where(inside, (z * height + y) * width + x, 0)
        weight = weight * inside
        raw = raw.scatter_add(1, index, weight)
        light = light.scatter_add(1, index, weight * intensities)
    volumes = torch.stack([raw.clamp(max=1), light / raw.clamp(min=1)])
    half = kernel(sigma)
    both = torch.tensor([*half[:0:-1], *half])
    volumes = volumes.view(2 * count, 1, depth, height, width)
    for axis in range(3):
        shape, padding = [1, 1, 1], [0, 0, 0]
        shape[axis], padding[axis] = len(both), len(half) - 1
        volumes = F.conv3d(volumes, both.view(1, 1, *shape), padding=padding)
    occupied, emitted = volumes.view(2, count, depth, height, width) * (
        scale[:, None, None, None] * MOST
    )
    logs = (1 - occupied).log().cumsum(1)
    arriving = torch.cat([torch.ones_like(logs[:, :1]), logs[:, :-1].exp()], 1)
    return Pictures(1 - logs[:, -1].exp(), (arriving * emitted).sum(1))


def ours(
    points: Tensor, size: tuple[int, int, int], intensities: Tensor, scale: Tensor, sigma: float
) -> Pictures:
    return render(points, size, intensities=intensities, scale=scale, sigma=sigma)


LIBRARIES = {"posecore": ours, "autograd": by_autograd}


def forward(library: str, size: str, spread: float) -> Pictures:
    points, shades, scales = heads(size, spread)
    with torch.no_grad():
        return LIBRARIES[library](points, SIZES[size][2], shades, scales, SIGMA)


def both_ways(library: str, size: str, spread: float) -> tuple[Tensor, ...]:
    given = [value.requires_grad_() for value in heads(size, spread)]
    seen = LIBRARIES[library](given[0], SIZES[size][2], given[1], given[2], SIGMA)
    loss = seen.silhouette.square().sum() + seen.intensity.square().sum()
    return torch.autograd.grad(loss, given)


@pytest.mark.parametrize("spread", [0.3, 0.6], ids=["head", "cube"])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("way", [forward, both_ways])
def test_clouds(
    benchmark: Callable, one_core: None, way: Callable, library: str, size: str, spread: float
) -> None:
    benchmark.group = f"{way.__name__}, {size}, {spread} of the width across"
    found = benchmark.pedantic(way, (library, size, spread), rounds=3, warmup_rounds=1)
    for one, other in zip(found, way("posecore", size, spread), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=2e-4)
