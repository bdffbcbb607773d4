"""Small clouds, networks and batches for the tests of the rotation-invariant method."""

import torch

from posecore.clouds import estimate_normals
from posecore.methods.invariant_gcn.network import Cloud, InvariantGCN
from posecore.nets.graph3d import build_graph
from posecore.randomness import seeded
from posecore.rotations import random_rotations

MEAN_SIZE = [[0.1, 0.2, 0.1], [0.3, 0.1, 0.2]]
SMALL = {
    "mean_size": MEAN_SIZE, "widths": (8, 8, 12, 12, 16), "neighbours": 4, "supports": 2,
    "norm": "layer", "pooled": ((12, 10), (9,)), "dense": (12, 10), "faces": (11, 10),
}  # fmt: skip


def batch(count=3, points=40, dtype=torch.float32, seed=0):
    """Points on boxes, as `CategoryClouds.batch` has them."""
    g = torch.Generator().manual_seed(seed)
    double = {"generator": g, "dtype": torch.float64}
    size = 0.1 + 0.2 * torch.rand(count, 3, **double)
    canonical = (torch.rand(count, points, 3, **double) - 0.5) * size[:, None]
    R = random_rotations(count, generator=g, dtype=torch.float64)
    t = 0.02 * torch.randn(count, 3, **double)
    seen = canonical @ R.mT + t[:, None]
    mean = seen.mean(1)
    seen, t = seen - mean[:, None], t - mean
    view = torch.nn.functional.normalize(torch.randn(count, 3, **double), dim=-1)
    graph = build_graph(seen, (12, 5), (8, 4, 4))
    normals = estimate_normals(seen, 8, 3 * view)
    found = {**graph.tensors(), "normals": normals, "view": view, "R": R, "t": t, "size": size}
    found |= {"canonical": canonical, "category": torch.arange(count) % 2}
    found["symmetric"] = torch.arange(count) % 3 == 1
    return {
        name: value.to(dtype) if value.is_floating_point() else value
        for name, value in found.items()
    }


def network(dtype=torch.float32, **options):
    with seeded(0):
        return InvariantGCN(**SMALL | options).to(dtype)


def say(net, given):
    with torch.no_grad():
        return net.eval()(Cloud.of(given))
