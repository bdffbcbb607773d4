"""3D graph convolutions: points learn from their neighbours by directions that are learned."""

from posecore.nets.graph3d.geometry import (
    CHOICES,
    Coarser,
    Graph,
    build_graph,
    feature_neighbours,
    other_neighbours,
)
from posecore.nets.graph3d.layers import GraphConv, PointLinear, SurfaceConv, pool_maximum

__all__ = [
    "CHOICES",
    "Coarser",
    "Graph",
    "GraphConv",
    "PointLinear",
    "SurfaceConv",
    "build_graph",
    "feature_neighbours",
    "other_neighbours",
    "pool_maximum",
]
