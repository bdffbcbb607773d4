"""Matched points: the rigid or similarity transform between two clouds, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_finite, values_known
from posecore.rotations import special_procrustes

__all__ = ["Alignment", "umeyama"]


class Alignment(NamedTuple):
    """The transform `x -> scale R x + t`."""

    scale: Array
    """(...) one where no scale was asked for."""
    R: Array
    """(..., 3, 3) rotation, never a reflection."""
    t: Array
    """(..., 3) translation."""


@array_function(source="... N 3", target="... N 3", weights="... N")
def umeyama(
    source: Array, target: Array, weights: Array | None = None, with_scale: bool = False
) -> Alignment:
    """Least-squares transform between matched points: `target ~ scale R source + t`.

    Minimises `sum_i w_i |target_i - (scale R source_i + t)|^2` over all rotations R. With means and
    variance weighted, and the covariance of target and source H = U D V^T,

        R = U S V^T,  scale = tr(D S) / var(source),  t = mean(target) - scale R mean(source)

    where S = diag(1, 1, det(U) det(V)). Points in one plane are enough. Gradients flow to the
    points and to the weights.

    Source: Umeyama 1991, "Least-Squares Estimation of Transformation Parameters Between Two Point
    Patterns", equations 39-43; here with weights.

    Args:
        source: (..., N, 3) points.
        target: (..., N, 3) where they should go; point i belongs to point i of `source`.
        weights: (..., N) none negative; a pair of weight zero counts for nothing. None: all alike.
        with_scale: estimate the scale too; otherwise it is one.

    Returns:
        An `Alignment`: `(scale, R, t)`.

    Raises:
        ValueError: if the rotation is not unique: fewer than three pairs of positive weight, the
            points of either cloud on one line or in one spot (to the rounding of their precision),
            or clouds so mirrored that several rotations fit alike; if a weight is negative; if
            points are so large that their squares overflow.
    """
    count = source.shape[-2]
    if count < 3:
        fail("source", "at least 3 points", count)
    if weights is None:
        w = source.new_full((1, count), 1 / count)
    else:
        _require_weights(weights)
        w = (weights / weights.sum(-1, keepdim=True))[..., None, :]

    mean_source, mean_target = w @ source, w @ target  # (..., 1, 3)
    p, q = source - mean_source, target - mean_target
    # Dividing by the number is much faster than multiplying each point by its weight.
    weighted_p = p / count if weights is None else w.mT * p
    H = (q.mT @ weighted_p).double()  # (..., 3, 3)
    require_finite("source and target", H, "points whose squares are finite")
    R = special_procrustes(H)
    if values_known():
        _require_unique(R, H, w, p, q, mean_source, mean_target)

    scale = torch.ones_like(H[..., 0, 0])
    if with_scale:
        scale = (R * H).sum((-2, -1)) / (w @ p.square()).sum((-2, -1))
    R, scale = R.to(p), scale.to(p)
    t = mean_target - scale[..., None, None] * (mean_source @ R.mT)
    return Alignment(scale, R, t[..., 0, :])


def _require_weights(weights: Tensor) -> None:
    if not values_known():
        return
    if bool((weights < 0).any()):
        fail("weights", "none negative", float(weights.min()))
    positive = (weights > 0).sum(-1)
    if bool((positive < 3).any()):
        fail("weights", "at least 3 positive ones", int(positive.min()))


@torch.no_grad()
def _require_unique(
    R: Tensor, H: Tensor, w: Tensor, p: Tensor, q: Tensor, mean_p: Tensor, mean_q: Tensor
) -> None:
    """Refuse clouds whose best rotation R would be chosen by rounding.

    It is unique if s_2 + s_3 > 0, where s are the singular values of H and the last is negative if
    H reflects. That is the least eigenvalue a_1 of A = tr(R^T H) I - R^T H, and at most three times
    det(A) over the sum of products of two eigenvalues, 1 / (1 / a_1 + 1 / a_2 + 1 / a_3).
    """
    S = R.mT @ H
    A = _trace(S)[..., None, None] * torch.eye(3).to(S) - S
    products = (_trace(A).square() - A.square().sum((-2, -1))) / 2
    margin = torch.linalg.det(A) / products  # NaN for H = 0
    spread_p, spread_q = ((w @ x.square()).sum((-2, -1)).sqrt() for x in (p, q))
    reach_p = mean_p.norm(dim=-1)[..., 0] + spread_p
    reach_q = mean_q.norm(dim=-1)[..., 0] + spread_q
    rounding = torch.finfo(p.dtype).eps * (reach_p * spread_q + reach_q * spread_p)
    if not bool((margin > 4 * rounding).all()):
        fail(
            "source and target",
            "points that determine one rotation",
            "points on one line, in one spot, or mirrored, which several rotations fit alike",
        )


def _trace(M: Tensor) -> Tensor:
    return M.diagonal(dim1=-2, dim2=-1).sum(-1)
