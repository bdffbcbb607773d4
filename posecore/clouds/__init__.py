"""Point clouds: sampling, neighbours, pairs, interpolation, normals, diameter, their distance."""

from posecore.clouds.extent import diameter
from posecore.clouds.interpolation import (
    interpolate,
    interpolation_weights,
    three_nearest_interpolation,
)
from posecore.clouds.neighbours import ball_query, nearest_neighbours
from posecore.clouds.pairs import (
    cross_product_normals,
    neighbour_directions,
    pair_determinants,
    pair_features,
)
from posecore.clouds.sampling import farthest_point_sampling, gather_points
from posecore.clouds.surfaces import chamfer_distance, estimate_normals

__all__ = [
    "ball_query",
    "chamfer_distance",
    "cross_product_normals",
    "diameter",
    "estimate_normals",
    "farthest_point_sampling",
    "gather_points",
    "interpolate",
    "interpolation_weights",
    "nearest_neighbours",
    "neighbour_directions",
    "pair_determinants",
    "pair_features",
    "three_nearest_interpolation",
]
