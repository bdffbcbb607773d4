"""VSD: how far the visible surface is from where it should be, measured on depth images.

Of a symmetric or half-hidden object several poses look the same to a depth camera. VSD compares
only what that camera can see, so it takes these poses for equal without a list of symmetries.

Depth is z along the optical axis in metres, 0 where there is none: of the model where it is not
drawn, of the scene where the sensor measured nothing. All is as the toolkit of the BOP benchmark
computes it since 2019, which says more than the papers: distances are lengths of rays from the
camera's centre, not depths; where the sensor measured nothing a model counts as visible; and
constants are below.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from posecore import cameras
from posecore.arrays import Array, array_function, fail, require_number, somewhere

__all__ = ["VSD_DELTA", "VSD_TAUS", "distance_image", "visible_surface", "vsd"]

VSD_DELTA = 0.015
"""Metres that a surface may lie behind what the sensor measured and yet be seen; of ITODD 0.005."""
VSD_TAUS = np.arange(0.05, 0.51, 0.05)
"""Of the diameter: from which distance on a pixel is wrong; spelt as the toolkit spells them."""


@array_function(depth="... H W", K="... 3 3")
def distance_image(depth: Array, K: Array) -> Array:
    """How far what a pixel sees is from the camera's centre, of every pixel of a depth image.

    Args:
        depth: (..., H, W) z along the optical axis in metres, 0 where there is none.
        K: (..., 3, 3) intrinsics.

    Returns:
        (..., H, W) lengths of rays in metres, 0 where there is none.

    Raises:
        ValueError: if a depth is negative, or `K` is no camera matrix.
    """
    _require_depth("depth", depth)
    return depth * _ray_lengths(depth, K)


@array_function(depth_model="... H W", depth_test="... H W", K="... 3 3")
def visible_surface(
    depth_model: Array, depth_test: Array, K: Array, delta: float = VSD_DELTA
) -> Array:
    """Where a model can be seen: not more than `delta` behind what the sensor measured.

    Hodan, Michel et al., BOP: Benchmark for 6D Object Pose Estimation, ECCV 2018, section 4.1.
    Where the sensor measured nothing the model is taken to be visible (BOP19 on; in 2018 it was
    not), so that shiny objects are measured as well.

    Args:
        depth_model: (..., H, W) depth of the model in its pose, drawn; 0 where it is not.
        depth_test: (..., H, W) depth that the sensor measured of the scene; 0 where it did not.
        K: (..., 3, 3) intrinsics.
        delta: metres.

    Returns:
        (..., H, W) booleans.

    Raises:
        ValueError: if a depth or `delta` is negative, or `K` is no camera matrix.
    """
    delta = require_number("delta", delta, 0)
    _require_depth("depth_model", depth_model)
    _require_depth("depth_test", depth_test)
    rays = _ray_lengths(depth_test, K)
    return _visible(depth_model * rays, depth_test * rays, delta)


@array_function(
    depth_est="... H W", depth_gt="... H W", depth_test="... H W", K="... 3 3",
    diameter="...", taus="N",
)  # fmt: skip
def vsd(
    depth_est: Array,
    depth_gt: Array,
    depth_test: Array,
    K: Array,
    diameter: Array,
    delta: float = VSD_DELTA,
    taus: Array = VSD_TAUS,
) -> Array:
    """VSD: the share of the visible surface that is missing, surplus, or too far off.

    Hodan, Michel et al., BOP: Benchmark for 6D Object Pose Estimation, ECCV 2018, Eq 1, with
    distances divided by the diameter as in Hodan et al., BOP Challenge 2020, section 2.2. With
    masks V of what can be seen (`visible_surface`) and distances D (`distance_image`)

        V_est = visible(depth_est), or V_gt where the estimate covers the pixel too,
        e = mean over V_est or V_gt of: 0 if in both and |D_est - D_gt| / diameter < tau, else 1.

    The estimate's mask takes over what is visible of the truth (Hodan et al., On Evaluation of 6D
    Object Pose Estimation, ECCVW 2016, Eq 14), for an estimate a little too deep would else hide
    behind the very surface that the sensor saw. It counts pixels, so it has no gradient.

    Args:
        depth_est, depth_gt: (..., H, W) depth in metres of the model in the estimated and in the
            true pose, drawn without anything else; 0 where it is not. BOP's renderer draws backs
            of faces too.
        depth_test: (..., H, W) depth that the sensor measured of the scene, 0 where it did not.
        K: (..., 3, 3) intrinsics. All may be cropped alike, as long as both models are inside.
        diameter: (...) of the object in metres; 1 for distances that are not to be divided.
        delta: metres that a surface may lie behind what was measured and yet be seen.
        taus: (N,) as parts of the diameter; the toolkit has 0.05 to 0.5 in ten steps.

    Returns:
        (..., N) errors in [0, 1], one for each of `taus`; 1 where nothing of either can be seen.

    Raises:
        ValueError: if a depth or `delta` is negative, a diameter or one of `taus` is not above 0,
            or `K` is no camera matrix.
    """
    delta = require_number("delta", delta, 0)
    for name, depth in (
        ("depth_est", depth_est),
        ("depth_gt", depth_gt),
        ("depth_test", depth_test),
    ):
        _require_depth(name, depth)
    for name, values in (("diameter", diameter), ("taus", taus)):
        if somewhere(values <= 0):
            fail(name, "numbers above 0", values[values <= 0][0].item())
    rays = _ray_lengths(depth_test, K)
    dist_est, dist_gt, dist_test = depth_est * rays, depth_gt * rays, depth_test * rays
    visible_gt = _visible(dist_gt, dist_test, delta)
    visible_est = _visible(dist_est, dist_test, delta) | (visible_gt & (dist_est > 0))
    both, either = visible_gt & visible_est, visible_gt | visible_est
    gaps = (dist_gt - dist_est).abs() / diameter[..., None, None]
    union, common = _count(either), _count(both)
    wrong = torch.stack([_count(both & (gaps >= tau)) for tau in taus], -1)
    wrong = wrong + (union - common)[..., None]
    share = wrong.to(gaps.dtype) / union.clamp(min=1)[..., None]
    return share.masked_fill((union == 0)[..., None], 1)


def _visible(dist_model: Tensor, dist_test: Tensor, delta: float) -> Tensor:
    return (dist_model > 0) & ((dist_test == 0) | (dist_model - dist_test <= delta))


def _ray_lengths(depth: Tensor, K: Tensor) -> Tensor:
    """How long the ray of each pixel is at depth 1: (..., H, W)."""
    return cameras.back_project(torch.ones_like(depth), K).norm(dim=-1)


def _count(mask: Tensor) -> Tensor:
    return mask.sum((-2, -1))


def _require_depth(name: str, depth: Tensor) -> None:
    if somewhere(depth < 0):
        fail(name, "depths of at least 0", depth[depth < 0][0].item())
