"""Matched points of which many are wrong: a similarity that a few of them agree on (RANSAC)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_integer, require_number, somewhere
from posecore.poses import apply
from posecore.registration.alignment import umeyama
from posecore.rotations import special_procrustes

__all__ = ["RobustAlignment", "ransac_umeyama"]


class RobustAlignment(NamedTuple):
    """The transform `x -> scale R x + t`, and who agrees with it."""

    scale: Array
    """(...) one where no scale was asked for."""
    R: Array
    """(..., 3, 3) rotation, never a reflection."""
    t: Array
    """(..., 3) translation."""
    inliers: Array
    """(..., N) bool, the pairs that are nearer than the threshold."""


@array_function(source="... N 3", target="... N 3", weights="... N")
@torch.no_grad()
def ransac_umeyama(
    source: Array,
    target: Array,
    threshold: float,
    weights: Array | None = None,
    with_scale: bool = False,
    *,
    hypotheses: int = 64,
    sample: int = 4,
    refits: int = 3,
    seed: int = 0,
) -> RobustAlignment:
    """The transform between matched points that most pairs agree on: `target ~ scale R source + t`.

    Each hypothesis is fitted to a few pairs that are drawn at random; the one with the most pairs
    (by weight) nearer than the threshold is fitted again to these, and again to those that are then
    near (Fischler & Bolles, "Random sample consensus", 1981; for object coordinates Wang et al.,
    NOCS, CVPR 2019). The same input gives the same result.

    Args:
        source: (..., N, 3) points.
        target: (..., N, 3) where they should go; point i belongs to point i of `source`.
        threshold: distance in the target's unit, above 0.
        weights: (..., N) none negative: how often a pair is drawn, and what it counts.
        with_scale: estimate the scale too; otherwise it is one.
        hypotheses: how many.
        sample: pairs that each is fitted to, at least 3. The same pair may be drawn again.
        refits: how often the best is fitted to its inliers, at least once.
        seed: of what is drawn.

    Returns:
        A `RobustAlignment`: `(scale, R, t, inliers)`, without gradient.

    Raises:
        ValueError: if fewer than three pairs agree with any hypothesis, or those that agree leave
            the rotation open; for weights that cannot be, or a number out of range.
    """
    n = source.shape[-2]
    threshold = require_number("threshold", threshold, above=0)
    require_integer("hypotheses", hypotheses, 1)
    require_integer("sample", sample, 3)
    require_integer("refits", refits, 1)
    if n < 3:
        fail("source", "at least 3 points", n)
    batch = torch.broadcast_shapes(
        source.shape[:-2], target.shape[:-2], () if weights is None else weights.shape[:-1]
    )
    source, target = source.expand(*batch, n, 3), target.expand(*batch, n, 3)
    w = source.new_ones(*batch, n) if weights is None else weights.expand(*batch, n)
    if somewhere(w < 0) or somewhere(w.sum(-1) <= 0):
        fail("weights", "none negative, and some above 0", float(w.min()))

    rng = np.random.default_rng(require_integer("seed", seed, 0))
    drawn = torch.from_numpy(rng.random(hypotheses * sample)).to(w.device)
    total = w.double().cumsum(-1)
    places = drawn * total[..., -1:]  # the same draws for every cloud
    picks = torch.searchsorted(total, places, right=True).clamp(max=n - 1)
    few = [
        torch.gather(points, -2, picks[..., None].expand(*batch, -1, 3)).unflatten(
            -2, (hypotheses, sample)
        )
        for points in (source, target)
    ]  # (..., H, sample, 3)
    scale, R, t = _fit(*few, with_scale)
    moved = apply(R, t, source[..., None, :, :], scale)  # (..., H, N, 3)
    near = (moved - target[..., None, :, :]).norm(dim=-1) < threshold
    best = (near * w[..., None, :]).sum(-1).argmax(-1)[..., None]
    inliers = near.gather(-2, best[..., None].expand(*batch, 1, n))[..., 0, :]
    for _ in range(refits):
        if somewhere((inliers & (w > 0)).sum(-1) < 3):
            fail("source and target", f"3 pairs or more within {threshold} of some fit", "fewer")
        scale, R, t = umeyama(source, target, w * inliers, with_scale)
        inliers = (apply(R, t, source, scale) - target).norm(dim=-1) < threshold
    return RobustAlignment(scale, R, t, inliers)


def _fit(source: Tensor, target: Tensor, with_scale: bool) -> tuple[Tensor, Tensor, Tensor]:
    """As `umeyama`; of points that decide nothing it gives anything, which few pairs agree with."""
    mean_source, mean_target = source.mean(-2, keepdim=True), target.mean(-2, keepdim=True)
    p, q = source - mean_source, target - mean_target
    H = (q.mT @ p).double()
    R = special_procrustes(H)
    scale = torch.ones_like(H[..., 0, 0])
    if with_scale:
        spread = p.square().sum((-2, -1)).double()
        scale = torch.where(spread > 0, (R * H).sum((-2, -1)) / spread, 0)
    R, scale = R.to(p), scale.to(p)
    t = mean_target - scale[..., None, None] * (mean_source @ R.mT)
    return scale, R, t[..., 0, :]
