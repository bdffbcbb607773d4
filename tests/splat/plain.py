"""The projector as one would write it down: loops over points and slices, and plain autograd."""

import torch
import torch.nn.functional as F

from posecore.splat.volumes import MOST, kernel


def plain_render(points, size, intensities=None, scale=1.0, sigma=0.0):
    """Silhouette and picture (H, W) of one cloud (N, 3); arguments as of `posecore.splat.render`.

    Without intensities the picture is that of points that are all 0.
    """
    width, height, depth = size
    raw = points.new_zeros(depth, height, width)
    light = torch.zeros_like(raw)
    for number, point in enumerate(points):
        x, y, z = point.detach().floor().long().tolist()
        for k in (z, z + 1):
            for j in (y, y + 1):
                for i in (x, x + 1):
                    if not (0 <= i < width and 0 <= j < height and 0 <= k < depth):
                        continue
                    # The weight is a product of distances to the other corner, along each axis.
                    weight = 1 - (point - point.new_tensor([i, j, k])).abs()
                    at = torch.zeros_like(raw)
                    at[k, j, i] = 1
                    raw = raw + weight.prod() * at
                    if intensities is not None:
                        light = light + weight.prod() * intensities[number] * at
    mean = light / raw.clamp(min=1)
    occupied = scale * MOST * blurred(raw.clamp(max=1), sigma)
    emitted = scale * MOST * blurred(mean, sigma)
    full = occupied > MOST
    emitted = torch.where(full, emitted * MOST / torch.where(full, occupied, 1), emitted)
    occupied = torch.where(full, MOST, occupied)
    free, picture = points.new_ones(height, width), points.new_zeros(height, width)
    for occupancy, shine in zip(occupied, emitted, strict=True):
        picture = picture + free * shine
        free = free * (1 - occupancy)
    return 1 - free, picture


def blurred(volume, sigma):
    """A (D, H, W) volume blurred along its three axes by convolutions; zeros are outside."""
    half = kernel(sigma)
    both = volume.new_tensor([*half[:0:-1], *half])
    volume = volume[None, None]
    for axis in range(3):
        shape, padding = [1, 1, 1], [0, 0, 0]
        shape[axis], padding[axis] = len(both), len(half) - 1
        volume = F.conv3d(volume, both.view(1, 1, *shape), padding=padding)
    return volume[0, 0]
