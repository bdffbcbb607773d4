"""PointNet++ beside what one would write instead: copies in groups, `Conv2d`, `BatchNorm2d`.

Run with `pytest -n 0 tests/bench/bench_pointnet2.py`; the numbers in brackets are ratios. On a busy
machine add `--benchmark-timer=time.process_time`. Geometry counts in both, unless it says "kept".
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from posecore.nets.pointnet2 import LAYERS, PROPAGATIONS, Abstraction, PointNet2, build_geometry
from posecore.randomness import seeded
from tests.bench.plain_pointnet2 import PlainPointNet2

BOOK = (
    Abstraction(64, 0.05, 16, (32, 32, 64)),
    Abstraction(32, 0.1, 16, (64, 64, 128)),
    Abstraction(16, 0.2, 16, (128, 128, 256)),
)
SIZES = {"paper": (4, 2000, LAYERS, PROPAGATIONS), "book": (32, 256, BOOK, ((128, 128),))}


def clouds(size: str) -> Tensor:
    """(B, N, 3) the side of an ellipsoid as large as a head that a camera sees."""
    count, points = SIZES[size][:2]
    around = torch.randn(count, points, 3, generator=torch.Generator().manual_seed(0))
    around = around / around.norm(dim=-1, keepdim=True) * torch.tensor([0.08, 0.12, 0.1])
    return torch.cat([around[..., :2], -around[..., 2:].abs()], -1)


def ours(size: str, *, kept: bool = False, **options: bool) -> Callable[[], Tensor]:
    _, _, layers, propagations = SIZES[size]
    with seeded(0):
        net = PointNet2(layers, propagations, **options)
    points = clouds(size)
    geometry = build_geometry(points, layers, len(propagations))

    def step() -> Tensor:
        it = geometry if kept else build_geometry(points, layers, len(propagations))
        features = net(it).features
        net.zero_grad()
        features.square().mean().backward()
        return features.detach()

    return step


def plain(size: str) -> Callable[[], Tensor]:
    _, _, layers, propagations = SIZES[size]
    with seeded(0):
        net = PlainPointNet2(layers, propagations).copy_from(PointNet2(layers, propagations))
    points = clouds(size)

    def step() -> Tensor:
        features = net(points)[1].transpose(1, 2)
        net.zero_grad()
        features.square().mean().backward()
        return features.detach()

    return step


LIBRARIES = {
    "posecore": ours,
    "posecore, geometry kept": lambda size: ours(size, kept=True),
    "posecore, not fused": lambda size: ours(size, fused=False),
    "posecore, first layer before grouping": lambda size: ours(
        size, fused=False, project_first=True
    ),
    "posecore, early maximum": lambda size: ours(size, early_max=True),
    "plain": plain,
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", LIBRARIES)
def test_forward_and_backward(benchmark: Callable, one_core: None, library: str, size: str) -> None:
    benchmark.group = f"PointNet++ forward and backward, {size}"
    step = LIBRARIES[library](size)
    found = benchmark.pedantic(step, rounds=3, warmup_rounds=1)
    if library.startswith("posecore") and "early" not in library:
        torch.testing.assert_close(found, ours(size)(), rtol=1e-3, atol=1e-3)
