"""What a network may know of a cloud and not notice that it is turned.

f1 of the paper, as printed and in three other forms, and what an invariant network is given of
each pair of neighbours and of each point.

| form       | normals                          | of a pair                                 |
|------------|----------------------------------|-------------------------------------------|
| printed    | cross product of the two nearest | distance, two angles                      |
| order_free | principal components             | distance, two angles with lines           |
| oriented   | the same, to the camera's side   | distance, two angles                      |
| handed     | the same, to the camera's side   | distance, two angles, two determinants    |

All but the last are the same for a cloud and its mirror image.

Source: Chen et al., the rotation-invariant paper, Section 3.1, Eq. 1 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from posecore.arrays import require_choice, require_integer, require_number
from posecore.clouds import (
    cross_product_normals,
    gather_points,
    neighbour_directions,
    pair_determinants,
    pair_features,
)
from posecore.nets.graph3d import feature_neighbours

__all__ = ["FORMS", "LocalFeatures", "mean_radius", "pair_channels", "point_channels"]

FORMS = {"printed": 3, "order_free": 3, "oriented": 3, "handed": 5}
"""Forms, and how many numbers they have of a pair."""


@dataclass(frozen=True)
class LocalFeatures:
    """f1: the mean over pairs of a point with some of its neighbours (Eq. 2).

    The paper takes the 20 nearest "in the distance of the features", clusters them, and keeps the
    5 nearest; how is not said. Here those are the 5 that are nearest in space, of the 20 that are
    nearest in space or in features. In space 5 of 20 are just the 5 nearest.

    Attributes:
        form: one of `FORMS`.
        nearest: k1, where features say who is near.
        pairs: k2.
        divisor: the k of Eq. 2, which is printed beside a sum over k2 pairs; None for `pairs`.
        by_features: whether the nearest are those by the features that come into a layer.
        relative: whether distances are divided by the mean distance to the pairs of the point, so
            that a scaled cloud has the same features.
        unit: metres that count as one.

    Raises:
        ValueError: for a form or a number that cannot be.
    """

    form: str = "printed"
    nearest: int = 20
    pairs: int = 5
    divisor: int | None = None
    by_features: bool = False
    relative: bool = False
    unit: float = 0.02

    def __post_init__(self) -> None:
        require_choice("form", self.form, list(FORMS))
        require_integer("pairs", self.pairs, 2)
        require_integer("nearest", self.nearest, self.pairs)
        require_number("unit", self.unit, above=0)
        if self.divisor is not None:
            require_integer("divisor", self.divisor, 1)

    @property
    def channels(self) -> int:
        """How many numbers a point has."""
        return FORMS[self.form]

    def __call__(
        self, points: Tensor, normals: Tensor, neighbours: Tensor, view: Tensor,
        features: Tensor | None = None,
    ) -> Tensor:  # fmt: skip
        """f1 of every point.

        Args:
            points: (B, N, 3) metres.
            normals: (B, N, 3) of length one, to the side of the camera; "printed" has its own.
            neighbours: (B, N, K) indices of the nearest in space, nearest first.
            view: (B, 3) direction to the camera.
            features: (B, N, C) of the layer before, for `by_features`; None for the first.

        Returns:
            (B, N, `channels`).

        Raises:
            ValueError: if there are fewer than `pairs` neighbours.
        """
        if self.by_features and features is not None:
            neighbours = self._near_in_features(points, features)
        require_integer("pairs", self.pairs, 2, neighbours.shape[-1])
        found = pair_channels(
            points, normals, neighbours[..., : self.pairs], view, self.form, self.unit
        )
        if self.relative:
            found = mean_radius(found)
        return found.sum(-2) / (self.divisor or self.pairs)

    def _near_in_features(self, points: Tensor, features: Tensor) -> Tensor:
        alike = feature_neighbours(features.detach(), min(self.nearest, points.shape[-2] - 1))
        off = gather_points(points.detach(), alike) - points.detach()[..., None, :]
        order = off.square().sum(-1).argsort(dim=-1, stable=True)
        return alike.gather(-1, order)


def pair_channels(
    points: Tensor, normals: Tensor, neighbours: Tensor, view: Tensor, form: str = "handed",
    unit: float = 0.02, *, toward_camera: bool = False,
) -> Tensor:  # fmt: skip
    """What is known of each pair of neighbours.

    Args:
        points: (B, N, 3) metres.
        normals: (B, N, 3) of length one, to the side of the camera; "printed" has its own.
        neighbours: (B, N, K) indices, nearest first.
        view: (B, 3) direction to the camera.
        form: one of `FORMS`.
        unit: metres that count as one.
        toward_camera: whether the cosine of the way and the view is there, too.

    Returns:
        (B, N, K, C): distances over `unit`, angles in radians, determinants, a cosine.

    Raises:
        ValueError: for another form, an index out of range, or shapes that do not fit.
    """
    require_choice("form", form, list(FORMS))
    if form == "printed":
        normals = cross_product_normals(points, neighbours[..., :2])
    pairs = pair_features(points, normals, neighbours, sign_free=form == "order_free")
    found = [pairs[..., :1] / unit, pairs[..., 1:]]
    if form == "handed":
        found.append(pair_determinants(points, normals, neighbours, view))
    if toward_camera:
        way = neighbour_directions(points, neighbours)
        found.append((way * view[:, None, None]).sum(-1, keepdim=True))
    return torch.cat(found, -1)


def point_channels(
    points: Tensor, normals: Tensor, view: Tensor, form: str = "handed", unit: float = 0.1
) -> Tensor:
    """What is known of each point beside the middle of its cloud.

    Args:
        points: (B, N, 3) metres, about their mean.
        normals, view, form: as of `pair_channels`; "printed" has no normal of a single point, and
            none here.
        unit: metres that count as one.

    Returns:
        (B, N, 3), or 5 numbers of "handed", or 2 of "printed": the distance from the middle, and
        how far before it the point is, both over `unit`; the cosine of normal and view, for
        "order_free" without its sign; of "handed" det(normal, point, view) over `unit`, and the
        same of the middle's side: how far the normal looks away from it.

    Raises:
        ValueError: for another form.
    """
    require_choice("form", form, list(FORMS))
    ahead = view[:, None]
    found = [torch.linalg.vector_norm(points, dim=-1) / unit, (points * ahead).sum(-1) / unit]
    if form != "printed":
        cosine = (normals * ahead).sum(-1)
        found.append(cosine.abs() if form == "order_free" else cosine)
    if form == "handed":
        across = torch.linalg.cross(normals, points)
        found += [(across * ahead).sum(-1) / unit, (normals * points).sum(-1) / unit]
    return torch.stack(found, -1)


def mean_radius(pairs: Tensor) -> Tensor:
    """(..., K, C) with the first channel, a distance, over its mean; all zero stay zero."""
    distance = pairs[..., :1]
    mean = distance.mean(-2, keepdim=True)
    none = mean == 0
    return torch.cat([distance / mean.masked_fill(none, 1), pairs[..., 1:]], -1)
