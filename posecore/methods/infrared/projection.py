"""Clouds that one camera sees, projected into others: Eq 1 and 2 of the paper, as they are meant.

As printed, Eq 1 multiplies metric points by the inverse intrinsics. Points are metres in the axes
of the camera whose image the network was given, so `X = p + t` is in that camera's frame, its pose
takes X to the world, and the pose of another camera from there into that one's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from posecore.splat import Pictures, render, to_voxels

__all__ = ["Projector", "into_views"]


def into_views(points: Tensor, own: Tensor, T_world_cam: Tensor) -> Tensor:
    """Points of one camera's frame in the frames of several.

    Args:
        points: (B, N, 3) metres.
        own: (B, 4, 4) pose in the world of the camera whose frame it is.
        T_world_cam: (B, J, 4, 4) poses of the others.

    Returns:
        (B, J, N, 3) metres.
    """
    # In a training in half precision, too, whose products would be off by millimetres.
    with torch.autocast(points.device.type, enabled=False):
        world = points @ own[:, :3, :3].mT + own[:, None, :3, 3]
        return (world[:, None] - T_world_cam[:, :, None, :3, 3]) @ T_world_cam[:, :, :3, :3]


@dataclass(frozen=True)
class Projector:
    """Clouds to silhouettes and pictures in several views.

    Attributes:
        image: (width, height) in pixels of the images that camera matrices belong to.
        size: (W, H, D) of the grid of voxels, which has an image's field of view.
        extent: metres from the front of the grid to its back, the cloud's translation midway.
    """

    image: tuple[int, int]
    size: tuple[int, int, int]
    extent: float

    def __call__(
        self,
        points: Tensor,
        t: Tensor,
        own: Tensor,
        K: Tensor,
        T_world_cam: Tensor,
        *,
        intensities: Tensor | None = None,
        scale: Tensor | float = 1.0,
        sigma: float = 0.0,
    ) -> Pictures:
        """What J cameras see of B clouds.

        Args:
            points: (B, N, 3) metres, relative to t, along the axes of the clouds' own cameras.
            t: (B, 3) metres, in the frames of these.
            own: (B, 4, 4) poses of these cameras in the world.
            K, T_world_cam: (B, J, 3, 3) and (B, J, 4, 4) of the cameras that look.
            intensities: (B, N); None for no pictures.
            scale: (B,) or one number.
            sigma: of the blur in voxels.

        Returns:
            silhouette and intensity (B, J, H, W).
        """
        voxels = self.to_voxels(points, t, own, K, T_world_cam)
        count = T_world_cam.shape[1]
        if intensities is not None:
            intensities = intensities[:, None].expand(-1, count, -1)
        if isinstance(scale, Tensor):
            scale = scale[:, None].expand(-1, count)
        return render(voxels, self.size, intensities=intensities, scale=scale, sigma=sigma)

    def to_voxels(
        self, points: Tensor, t: Tensor, own: Tensor, K: Tensor, T_world_cam: Tensor
    ) -> Tensor:
        """(B, J, N, 3) where the points are in each camera's grid; arguments as of a call."""
        seen = into_views(points + t[:, None], own, T_world_cam)
        middle = into_views(t[:, None], own, T_world_cam)[:, :, 0, 2]
        return to_voxels(seen, K, self.image, self.size, middle, self.extent)
