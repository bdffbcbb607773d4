"""Small sizes of P2R and P2P, and clouds for them."""

import torch

from posecore.nets.pointnet2 import Abstraction, build_geometry
from posecore.randomness import seeded

LAYERS = (
    Abstraction(16, 0.05, 6, (6, 8)), Abstraction(8, 0.1, 6, (8, 8)),
    Abstraction(6, 0.2, 4, (8, 8)), Abstraction(4, 1.0, 4, (8, 8)),
)  # fmt: skip
WIDTHS = ((8, 8), (8, 10))


def geometry(count=3):
    generator = torch.Generator().manual_seed(0)
    return build_geometry(0.1 * torch.randn(count, 40, 3, generator=generator), LAYERS, 2)


def small(kind, *args, **options):
    with seeded(0):
        return kind(*args, layers=LAYERS, propagations=WIDTHS, **options)
