"""Points as a blurred volume, rays through it, and the way back: the inner loop of the projector.

A volume is `(D, H, W)` voxels; a point is at (x, y, z) in voxels, the centre of the first at 0.
Nothing of it is seen by autograd: `rendered` gives, with what it made, a function from gradients of
the pictures to gradients of the points.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["MOST", "Gradients", "Pictures", "kernel", "rendered"]

MOST = 1 - 1e-5
"""Of occupancy, so that its complement has a logarithm (Insafutdinov and Dosovitskiy)."""


class Pictures(NamedTuple):
    """What is seen along the rays, each (B, H, W); "intensity" is None without intensities."""

    silhouette: Tensor
    intensity: Tensor | None


class Gradients(NamedTuple):
    """Of the points (B, N, 3), intensities (B, N) or None, and occupancy scales (B,)."""

    points: Tensor
    intensities: Tensor | None
    scales: Tensor


def kernel(sigma: float) -> tuple[float, ...]:
    """A Gaussian at 0, 1, ... voxels from its middle, cut at three sigma; both sides sum to 1."""
    if sigma == 0:
        return (1.0,)
    half = [math.exp(-0.5 * (k / sigma) * (k / sigma)) for k in range(math.ceil(3 * sigma) + 1)]
    total = 2 * sum(half) - half[0]
    return tuple(value / total for value in half)


def rendered(
    points: Tensor,
    intensities: Tensor | None,
    scales: Tensor,
    size: tuple[int, int, int],
    sigma: float,
) -> tuple[Pictures, Callable[[Tensor, Tensor | None], Gradients]]:
    """Pictures of some clouds, and what turns gradients of the pictures into those of the clouds.

    Only the box in which a cloud has points, and what the blur makes of it, is computed.

    Args:
        points: (B, N, 3) x, y, z in voxels.
        intensities: (B, N), or None.
        scales: (B,) of the occupancy.
        size: (W, H, D) of the volume.
        sigma: of the blur in voxels; 0 for none.
    """
    count = len(points)
    base, fraction, low, shape = _boxes(points, size)
    if min(shape) < 1:  # nothing is in the volumes
        return _nothing(points, intensities, scales, size)
    index, weights = _spread(base, fraction, low, shape, size)
    cells = shape[0] * shape[1] * shape[2]
    raw = points.new_zeros(count, cells).scatter_add_(1, index, weights)
    stack = raw.new_empty(1 if intensities is None else 2, count, cells)
    torch.clamp(raw, max=1, out=stack[0])
    if intensities is not None:
        share = 1 / raw.clamp(min=1)
        light = torch.zeros_like(raw).scatter_add_(1, index, weights * intensities.repeat(1, 8))
        torch.mul(light, share, out=stack[1])
    # Scaled before it is blurred, as the box is smaller then.
    factor = (scales * MOST)[:, None]
    margins = _margins(low, shape, size, sigma)
    blurs = [
        _band(n, margin, sigma, points.dtype, points.device)
        for n, margin in zip(shape, margins, strict=True)
    ]
    scaled = (stack * factor).view(-1, shape[2], shape[1], shape[0])
    volumes = _blur(scaled, blurs).unflatten(0, stack.shape[:2])
    begin = low - low.new_tensor([before for before, _ in margins])
    beyond = _beyond(begin[:, 2], volumes.shape[2], size[2])
    if beyond is not None:  # what the blur moved out of the grid stops no light
        volumes.masked_fill_(beyond, 0)
    cut = None
    if bool((scales > 1).any()):  # else the blur of what is at most 1 is as well
        cut = (MOST / volumes[0]).clamp_(max=1)
        volumes *= cut
    places = _places(begin, volumes.shape[-2:], size)
    free = 1 - volumes[0]
    logs = free.log().cumsum_(1)
    passed = logs[:, -1].exp()  # the light that no voxel stops
    silhouette = _put(1 - passed, places, size)
    picture = emitted = arriving = None
    if intensities is not None:
        emitted, arriving = volumes[1], torch.ones_like(logs)
        torch.exp(logs[:, :-1], out=arriving[:, 1:])
        picture = _put(torch.einsum("bdhw,bdhw->bhw", arriving, emitted), places, size)

    def backward(of_silhouette: Tensor, of_picture: Tensor | None) -> Gradients:
        grads = torch.empty_like(volumes)
        # d(1 - prod(1 - o)) / do_i = prod / (1 - o_i), and sum(T e) by o_i loses what lies behind.
        ahead = (_take(of_silhouette, places, passed) * passed)[:, None]
        if picture is not None:
            reached = torch.mul(arriving, _take(of_picture, places, passed)[:, None], out=grads[1])
            upto = (reached * emitted).cumsum_(1)
            ahead = upto.add_(ahead - upto[:, -1:])
        torch.div(ahead, free, out=grads[0])
        if cut is not None:
            # A full voxel holds no more when more comes; the new light displaces what was there.
            full = cut < 1
            grads[0].masked_fill_(full, 0)
            if picture is not None:
                grads[1] *= cut
                grads[0] -= torch.where(full, grads[1] * emitted / MOST, 0)
        if beyond is not None:
            grads.masked_fill_(beyond, 0)
        back = _blur(grads.flatten(0, 1), [blur.T for blur in blurs]).view(stack.shape)
        of_scales = torch.einsum("kbc,kbc->b", back, stack) * MOST
        back = back * factor
        of_raw = back[0].masked_fill_(raw > 1, 0)
        of_shades = None
        if picture is None:
            of_weights = of_raw.gather(1, index)
        else:
            of_light = back[1].mul_(share)
            of_raw.sub_((of_light * stack[1]).masked_fill_(raw <= 1, 0))
            at = of_light.gather(1, index)
            of_shades = (at * weights).view(count, 8, -1).sum(1)
            of_weights = of_raw.gather(1, index).addcmul_(at, intensities.repeat(1, 8))
        of_points = _pulled(of_weights.view(count, 2, 2, 2, -1), base, fraction, size)
        return Gradients(of_points, of_shades, of_scales)

    return Pictures(silhouette, picture), backward


def _nothing(
    points: Tensor, intensities: Tensor | None, scales: Tensor, size: tuple[int, int, int]
) -> tuple[Pictures, Callable[[Tensor, Tensor | None], Gradients]]:
    """Black pictures, on which nothing has an influence."""
    empty = points.new_zeros(len(points), size[1], size[0])
    shades = None if intensities is None else torch.zeros_like(intensities)
    grads = Gradients(torch.zeros_like(points), shades, torch.zeros_like(scales))
    return Pictures(empty, None if shades is None else empty.clone()), lambda _, __: grads


def _boxes(
    points: Tensor, size: tuple[int, int, int]
) -> tuple[Tensor, Tensor, Tensor, tuple[int, int, int]]:
    """Lowest corners of the points' voxels and what is left, (B, N, 3); a box for each cloud.

    The boxes are as large as the largest needs to be: their lowest corners (B, 3), and the shape.
    """
    limits = points.new_tensor(size)
    if not points.shape[1]:
        return points, points, points.new_zeros(len(points), 3).long(), (0, 0, 0)
    # Further out than a voxel no weight is in the volume, so it may be anywhere there.
    near = torch.minimum(points.clamp(min=-2), limits + 1)
    base = near.floor()
    touches = ((base > -2) & (base < limits)).all(-1, keepdim=True)
    low = base.masked_fill(~touches, math.inf).amin(1).clamp(min=0)
    high = torch.minimum(base.masked_fill(~touches, -math.inf).amax(1) + 1, limits - 1)
    sides = (high - low).amax(0) + 1  # minus infinity where no cloud has a point inside
    low = torch.minimum(low, limits - 1)  # of clouds without any
    return base, near - base, low.long(), tuple(int(side) for side in sides.clamp(min=0).tolist())


def _margins(
    low: Tensor, shape: tuple[int, int, int], size: tuple[int, int, int], sigma: float
) -> list[tuple[int, int]]:
    """Along each axis how far the blur is followed before and behind the boxes: into the grid."""
    reach = len(kernel(sigma)) - 1
    behind = low.new_tensor(size) - low.new_tensor(shape) - low
    rooms = torch.stack([low, behind]).amax(1).clamp(0, reach).T.tolist()
    return [(before, after) for before, after in rooms]


def _beyond(first: Tensor, depth: int, limit: int) -> Tensor | None:
    """(B, depth, 1, 1) which slices lie outside of the grid; None if none does."""
    slices = first[:, None] + torch.arange(depth, device=first.device)
    outside = (slices < 0) | (slices >= limit)
    return outside[:, :, None, None] if bool(outside.any()) else None


def _places(
    begin: Tensor, shape: tuple[int, int], size: tuple[int, int, int]
) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """For each cloud where its (rows, columns) are in the image, and which of the box these are."""
    result = []
    for x, y, _ in begin.tolist():
        image, box = [], []
        for first, length, limit in zip((y, x), shape, size[1::-1], strict=True):
            start, stop = max(0, first), min(limit, first + length)
            image.append(slice(start, stop))
            box.append(slice(start - first, stop - first))
        result.append((tuple(image), tuple(box)))
    return result


def _put(boxes: Tensor, places: list, size: tuple[int, int, int]) -> Tensor:
    """(B, H, W) images of what is in their boxes, 0 elsewhere."""
    images = boxes.new_zeros(len(boxes), size[1], size[0])
    for number, (image, box) in enumerate(places):
        images[(number, *image)] = boxes[(number, *box)]
    return images


def _take(images: Tensor, places: list, like: Tensor) -> Tensor:
    """What images have in the boxes: the way back of `_put`."""
    boxes = torch.zeros_like(like)
    for number, (image, box) in enumerate(places):
        boxes[(number, *box)] = images[(number, *image)]
    return boxes


def _spread(
    base: Tensor,
    fraction: Tensor,
    low: Tensor,
    shape: tuple[int, int, int],
    size: tuple[int, int, int],
) -> tuple[Tensor, Tensor]:
    """(B, 8 N) index in the box and weight of the eight corners, in the order z, y, x."""
    indices, weights = [], []
    for axis in range(3):
        first = base[..., axis]
        corners = torch.stack([first, first + 1], 1)  # (B, 2, N)
        share = torch.stack([1 - fraction[..., axis], fraction[..., axis]], 1)
        there = (corners >= 0) & (corners < size[axis])
        # A point that is outside along another axis may be outside this box, too.
        place = (corners.long() - low[:, None, None, axis]).clamp_(0, shape[axis] - 1)
        indices.append(place)
        weights.append(share * there)
    x, y, z = indices
    index = (z[:, :, None, None] * shape[1] + y[:, None, :, None]) * shape[0] + x[:, None, None]
    wx, wy, wz = weights
    weight = wz[:, :, None, None] * wy[:, None, :, None] * wx[:, None, None]
    return index.flatten(1), weight.flatten(1)


def _pulled(grads: Tensor, base: Tensor, fraction: Tensor, size: tuple[int, int, int]) -> Tensor:
    """(B, N, 3) gradients of points from those (B, 2, 2, 2, N) of their corners' weights."""
    shares, signs = [], []
    for axis in range(3):
        first = base[..., axis]
        corners = torch.stack([first, first + 1], 1)
        there = ((corners >= 0) & (corners < size[axis])).to(grads.dtype)
        shares.append(torch.stack([1 - fraction[..., axis], fraction[..., axis]], 1) * there)
        signs.append(torch.stack([-there[:, 0], there[:, 1]], 1))
    along_x = (grads * signs[0][:, None, None]).sum(3)  # (B, z, y, N)
    over_x = (grads * shares[0][:, None, None]).sum(3)
    x = ((along_x * shares[1][:, None]).sum(2) * shares[2]).sum(1)
    y = ((over_x * signs[1][:, None]).sum(2) * shares[2]).sum(1)
    z = ((over_x * shares[1][:, None]).sum(2) * signs[2]).sum(1)
    return torch.stack([x, y, z], -1)


@functools.lru_cache(maxsize=256)
def _band(
    size: int, margin: tuple[int, int], sigma: float, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """(before + size + after, size) the blur of one axis as a matrix, from a box to its margins."""
    before, after = margin
    half = kernel(sigma)[: before + size + after]
    band = torch.zeros(before + size + after, size, dtype=dtype, device=device)
    for k, value in enumerate(half):
        for offset in {-before + k, -before - k}:  # of diagonals, those outside of it are empty
            if -len(band) < offset < size:
                band.diagonal(offset).fill_(value)
    return band


def _blur(volumes: Tensor, blurs: list[Tensor]) -> Tensor:
    """(B, D, H, W) volumes blurred along x, y and z by matrices: faster than any convolution."""
    along_x, along_y, along_z = blurs
    volumes = volumes @ along_x.T
    volumes = along_y @ volumes
    count, depth, height, width = volumes.shape
    volumes = along_z @ volumes.reshape(count, depth, height * width)
    return volumes.view(count, -1, height, width)
