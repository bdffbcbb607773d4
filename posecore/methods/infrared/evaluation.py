"""How good clouds are: silhouettes in other views, distances to the surface that a camera sees."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from posecore.arrays import fail, require_finite, require_number
from posecore.clouds import nearest_neighbours

__all__ = ["first_met", "overlap", "surface_distances"]


def overlap(silhouettes: Tensor, masks: Tensor, threshold: float = 0.5) -> Tensor:
    """Intersection over union of silhouettes and masks.

    Args:
        silhouettes: (..., h, w) 0 to 1; interpolated to the size of the masks.
        masks: (..., H, W) bool.
        threshold: above which a silhouette counts as covered.

    Returns:
        (...) 0 to 1; 1 where both are empty.

    Raises:
        ValueError: if leading dimensions differ, masks are not boolean, or silhouettes not finite.
    """
    if silhouettes.shape[:-2] != masks.shape[:-2]:
        fail("masks", f"shape {tuple(silhouettes.shape[:-2])} and H, W", tuple(masks.shape))
    if masks.dtype != torch.bool:
        fail("masks", "booleans", masks.dtype)
    if not bool(silhouettes.isfinite().all()):
        fail("silhouettes", "finite numbers", "others")
    flat = silhouettes.reshape(-1, 1, *silhouettes.shape[-2:])
    if silhouettes.shape[-2:] != masks.shape[-2:]:
        flat = F.interpolate(flat, size=masks.shape[-2:], mode="bilinear", align_corners=False)
    covered = flat.reshape(masks.shape) > require_number("threshold", threshold, 0, 1)
    union = (covered | masks).sum((-1, -2))
    return torch.where(union > 0, (covered & masks).sum((-1, -2)) / union.clamp(min=1), 1.0)


def first_met(voxels: Tensor, radius: float = 1.5, behind: float = 3.0) -> Tensor:
    """The points of a cloud that a camera's rays meet first.

    A point is hidden if another one is near it in the image, and in front.

    Args:
        voxels: (..., N, 3) as of `posecore.splat.to_voxels`.
        radius: in the image, in voxels.
        behind: in depth, in voxels: points of one surface do not hide each other.

    Returns:
        (..., N) bool.

    Raises:
        ValueError: if a voxel is not finite.
    """
    require_finite("voxels", voxels)
    across = torch.cdist(voxels[..., :2], voxels[..., :2])
    deeper = voxels[..., :, None, 2] - voxels[..., None, :, 2]
    return ~((across < radius) & (deeper > behind)).any(-1)


def surface_distances(cloud: Tensor, visible: Tensor, surface: Tensor) -> tuple[float, float]:
    """Mean distances between a cloud and the surface that its camera sees.

    Args:
        cloud: (N, 3) points in metres.
        visible: (N,) bool, those that the rays meet first.
        surface: (M, 3) points of the surface, in the same frame.

    Returns:
        From the surface to the cloud, and from the cloud's visible points to the surface; metres.

    Raises:
        ValueError: if there is no surface, or no visible point.
    """
    if not len(surface):
        fail("surface", "one point or more", "none")
    if not bool(visible.any()):
        fail("visible", "one point or more", "none")
    there, _ = nearest_neighbours(cloud, surface)
    back, _ = nearest_neighbours(surface, cloud[visible])
    return float(there.mean()), float(back.mean())
