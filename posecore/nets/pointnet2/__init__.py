"""PointNet++: sets of points abstracted ball by ball, and features brought back to finer sets."""

from posecore.nets.pointnet2.backbone import PROPAGATIONS, PointNet2, Seeds
from posecore.nets.pointnet2.geometry import (
    LAYERS,
    Abstraction,
    Geometry,
    Level,
    Link,
    build_geometry,
)
from posecore.nets.pointnet2.layers import (
    FeaturePropagation,
    PointNorm,
    SetAbstraction,
    shared_mlp,
)

__all__ = [
    "LAYERS",
    "PROPAGATIONS",
    "Abstraction",
    "FeaturePropagation",
    "Geometry",
    "Level",
    "Link",
    "PointNet2",
    "PointNorm",
    "Seeds",
    "SetAbstraction",
    "build_geometry",
    "shared_mlp",
]
