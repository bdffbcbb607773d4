"""3D graph convolution beside what one would write instead: every cosine and every copy kept.

Run with `pytest -n 0 -s tests/bench/bench_graph3d.py`; the numbers in brackets are ratios, and
lines tell the memory. On a busy machine add `--benchmark-timer=time.process_time`. Neighbours
are given, and their directions count in both.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from posecore.clouds import neighbour_directions
from posecore.nets.graph3d import GraphConv, SurfaceConv, other_neighbours
from posecore.randomness import seeded
from tests.bench.plain_graph3d import PlainConv, PlainSurface

SIZES = {
    # clouds, points, neighbours, supports, channels in (0: the surface layer) and out
    "paper, surface": (16, 512, 10, 7, 0, 128),
    "paper, 128": (16, 512, 10, 7, 128, 128),
    "paper, 256": (16, 128, 10, 7, 256, 256),
    "paper, 512": (16, 32, 10, 7, 256, 512),
    "book": (16, 128, 8, 3, 24, 24),
}


def cloud(size: str) -> Tensor:
    """(B, N, 3) the side of an ellipsoid as large as a mug that a camera sees."""
    count, points = SIZES[size][:2]
    around = torch.randn(count, points, 3, generator=torch.Generator().manual_seed(0))
    around = around / around.norm(dim=-1, keepdim=True) * torch.tensor([0.04, 0.06, 0.05])
    return torch.cat([around[..., :2], -around[..., 2:].abs()], -1)


class Step:
    """Forward and backward, of a plain layer or of ours."""

    def __init__(self, size: str, library: str) -> None:
        count, points, k, supports, inputs, outputs = SIZES[size]
        self.points = cloud(size)
        self.index = other_neighbours(self.points, k)
        self.plain = library == "plain"
        with seeded(0):
            self.features = torch.randn(count, points, inputs, requires_grad=True)
            fused = library == "posecore"
            if inputs:
                self.layer = GraphConv(inputs, outputs, supports, fused=fused)
            else:
                self.layer = SurfaceConv(outputs, supports, fused=fused)
        if self.plain and inputs:
            self.layer = PlainConv(inputs, outputs, supports).copy_from(self.layer)
        elif self.plain:
            plain = PlainSurface(outputs, supports)
            plain.load_state_dict(self.layer.state_dict())
            self.layer = plain
        self.inputs = inputs

    def forward(self) -> Tensor:
        if self.plain:
            known = (self.points, self.features) if self.inputs else (self.points,)
            return self.layer(*known, self.index)
        directions = neighbour_directions(self.points, self.index)
        if not self.inputs:
            return self.layer(directions)
        return self.layer(self.features, directions, self.index)

    def __call__(self) -> Tensor:
        found = self.forward()
        self.layer.zero_grad()
        found.square().mean().backward()
        return found.detach()

    def kept(self) -> int:
        """Bytes that wait for the backward pass, each array once."""
        storages = {}

        def keep(tensor: Tensor) -> Tensor:
            storage = tensor.untyped_storage()
            storages[storage.data_ptr()] = storage.nbytes()
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
            found = self.forward()
            found.square().mean()
        return sum(storages.values())

    def peak(self) -> int:
        """Bytes at most at once besides what there was before, by PyTorch's own profiler."""
        self()
        with torch.profiler.profile(
            activities=[torch.profiler.ProfilerActivity.CPU], profile_memory=True
        ) as seen:
            self()
        now = most = 0
        for event in seen.profiler.kineto_results.events():
            if event.name() == "[memory]":
                now += event.nbytes()
                most = max(most, now)
        return most


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", ["posecore", "posecore, step by step", "plain"])
def test_forward_and_backward(benchmark: Callable, one_core: None, library: str, size: str) -> None:
    benchmark.group = f"3D graph convolution forward and backward, {size}"
    step = Step(size, library)
    found = benchmark.pedantic(step, rounds=3, warmup_rounds=1)
    torch.testing.assert_close(found, Step(size, "plain")(), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("size", SIZES)
def test_memory(one_core: None, size: str) -> None:
    ours, plain = Step(size, "posecore"), Step(size, "plain")
    kept, usual = ours.kept(), plain.kept()
    most, at_most = ours.peak(), plain.peak()
    print(
        f"\n{size}: kept {kept / 1e6:.1f} MB of {usual / 1e6:.1f} ({kept / usual:.3f}), "
        f"at most {most / 1e6:.1f} MB of {at_most / 1e6:.1f} ({most / at_most:.3f})"
    )
    assert kept < usual / 3
    assert most < at_most / 3
