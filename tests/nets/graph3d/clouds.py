"""Small clouds and graphs for the tests of graph convolutions."""

import torch

from posecore.nets.graph3d import build_graph


def cloud(count=2, points=40, dtype=torch.float64):
    generator = torch.Generator().manual_seed(0)
    return 0.1 * torch.randn(count, points, 3, generator=generator, dtype=torch.float64).to(dtype)


def graph(points=None, sizes=(12, 5), neighbours=(8, 4, 3), **options):
    return build_graph(cloud() if points is None else points, sizes, neighbours, **options)
