"""Small clouds and networks for the tests of PointNet++."""

import torch

from posecore.nets.pointnet2 import Abstraction, PointNet2, build_geometry
from posecore.randomness import seeded

SMALL = (
    Abstraction(20, 0.1, 12, (6, 7, 8)),
    Abstraction(10, 0.2, 8, (6, 5)),
    Abstraction(5, 0.4, 8, (9,)),
)


def cloud(count=2, points=60, dtype=torch.float64):
    generator = torch.Generator().manual_seed(0)
    return 0.1 * torch.randn(count, points, 3, generator=generator, dtype=torch.float64).to(dtype)


def geometry(points=None, layers=SMALL, propagations=1, **options):
    return build_geometry(cloud() if points is None else points, layers, propagations, **options)


def network(layers=SMALL, propagations=((8,),), features=0, *, dtype=torch.float64, **options):
    """With norms whose lines rise and fall."""
    with seeded(0):
        net = PointNet2(layers, propagations, features, **options).to(dtype)
        for p in net.parameters():
            if p.ndim == 1:
                torch.nn.init.normal_(p)
    return net
