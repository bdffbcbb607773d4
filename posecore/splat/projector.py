"""The differentiable projector: a cloud of points as a silhouette and a picture of one camera.

Points go through the camera into a grid of voxels, `size` = (W, H, D): columns and rows are those
of the image, in larger pixels, and depth is cut into D slices of a given range. There they are
spread over the eight nearest voxels, blurred, and seen along the rays.

Source: Insafutdinov and Dosovitskiy, "Unsupervised learning of shape and pose with differentiable
point clouds", 2018; as Firintepe et al. use it, "From IR images to point clouds to pose", 2021,
Section 3.1.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.splat.volumes import Pictures, rendered

__all__ = ["Pictures", "render", "to_voxels"]

NEAR = 0.01  # metres; nearer points, and those behind the camera, are not in the grid
NOWHERE = -1e4  # voxels, of points that are not in the grid
AT_ONCE = {"cpu": 2**19}  # voxels of the volumes that are computed together: what a cache holds
ELSEWHERE = 2**25  # on a GPU, which is idle with less


def to_voxels(
    points: Tensor,
    K: Tensor,
    image: tuple[int, int],
    size: tuple[int, int, int],
    depth: Tensor | float,
    extent: float,
) -> Tensor:
    """Where points are in a camera's grid of voxels.

    Args:
        points: (..., N, 3) metres, in the camera's frame.
        K: (..., 3, 3) camera matrix of the image.
        image: (width, height) in pixels of the image that K belongs to.
        size: (W, H, D) of the grid, which has the image's field of view.
        depth: (...) metres, the depth at the middle of the grid.
        extent: metres from the grid's front to its back.

    Returns:
        (..., N, 3) x, y, z in voxels, the centre of the first voxel at 0. Points less than 1 cm in
        front of the camera, or behind it, are far outside the grid, and have no gradient.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    _require_points("points", points)
    width, height = _require_size("image", image, 2)
    size = _require_size("size", size, 3)
    extent = require_number("extent", extent, above=0)
    if not isinstance(K, Tensor) or K.shape[-2:] != (3, 3):
        fail("K", "a tensor of shape (..., 3, 3)", _shown(K))
    _require_numbers("depth", depth)
    K, z = K.to(points), points[..., 2]
    middle = torch.as_tensor(depth, dtype=z.dtype, device=z.device)
    for name, value, lead in (("K", K, K.shape[:-2]), ("depth", middle, middle.shape)):
        if not _fits(lead, points.shape[:-2]):
            fail(name, f"{tuple(points.shape[:-2])} of them or one", f"shape {tuple(value.shape)}")
        if not bool(value.isfinite().all()):
            fail(name, "finite numbers", "others")
    seen = z >= NEAR
    safe = torch.where(seen, z, 1)
    x, y = points[..., 0] / safe, points[..., 1] / safe
    k = K[..., None, :, :]
    u = k[..., 0, 0] * x + k[..., 0, 1] * y + k[..., 0, 2]
    v = k[..., 1, 1] * y + k[..., 1, 2]
    voxels = torch.stack(
        [
            (u + 0.5) * (size[0] / width) - 0.5,
            (v + 0.5) * (size[1] / height) - 0.5,
            (z - middle[..., None]) * (size[2] / extent) + (size[2] - 1) / 2,
        ],
        -1,
    )
    return torch.where(seen[..., None], voxels, NOWHERE)


def render(
    points: Tensor,
    size: tuple[int, int, int],
    *,
    intensities: Tensor | None = None,
    scale: Tensor | float = 1.0,
    sigma: float = 0.0,
) -> Pictures:
    """Silhouette and picture of clouds in a grid of voxels.

    A point is spread over its eight voxels, which hold 1 at the most; the volume is blurred, and
    times `scale`, 1 at the most, is the share of a ray's light that a voxel stops and sends out:

        silhouette = 1 - prod_i (1 - o_i),    picture = sum_i c_i o_i prod_{j < i} (1 - o_j)

    with c_i the mean intensity of the points around voxel i. The derivative is written by hand, and
    has none of its own.

    Args:
        points: (..., N, 3) x, y, z in voxels, as of `to_voxels`, in float32 or float64. What is
            outside is not seen.
        size: (W, H, D) of the grid.
        intensities: (..., N) of the points; None for no picture.
        scale: (...) or one number, 0 or more, of the occupancy of a cloud. A single point that is
            blurred stops little light; few points make an opaque surface if their scale is above 1.
        sigma: of the blur in voxels; 0 for none. It is cut at three sigma.

    Returns:
        silhouette: (..., H, W), 0 to 1.
        intensity: (..., H, W), None without intensities.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    _require_points("points", points)
    size = _require_size("size", size, 3)
    sigma = require_number("sigma", sigma, 0, 1000)
    if points.dtype in (torch.float16, torch.bfloat16):  # a full voxel's complement would be 0
        fail("points", "torch.float32 or torch.float64", points.dtype)
    lead = points.shape[:-2]
    if intensities is not None and (
        not isinstance(intensities, Tensor) or intensities.shape != points.shape[:-1]
    ):
        fail("intensities", f"shape {tuple(points.shape[:-1])} or None", _shown(intensities))
    if intensities is not None and not bool(intensities.isfinite().all()):
        fail("intensities", "finite numbers", "others")
    if intensities is not None and intensities.is_complex():
        fail("intensities", "real numbers", intensities.dtype)
    _require_numbers("scale", scale)
    scales = torch.as_tensor(scale, dtype=points.dtype, device=points.device)
    if scales.shape not in ((), lead):
        fail("scale", f"one number or shape {tuple(lead)}", _shown(scales))
    if not bool(((scales >= 0) & scales.isfinite()).all()):
        fail("scale", "finite numbers from 0 on", "others")
    shades = None if intensities is None else intensities.to(points.dtype)
    clouds = math.prod(lead)
    silhouette, picture = _Render.apply(
        points.reshape(clouds, *points.shape[-2:]),
        None if shades is None else shades.reshape(clouds, points.shape[-2]),
        scales.expand(lead).reshape(-1),
        size,
        sigma,
    )
    shape = (*lead, size[1], size[0])
    return Pictures(
        silhouette.reshape(shape), None if intensities is None else picture.reshape(shape)
    )


class _Render(torch.autograd.Function):
    """`rendered`, a part of the clouds after the other."""

    @staticmethod
    def forward(
        ctx: Any,
        points: Tensor,
        intensities: Tensor | None,
        scales: Tensor,
        size: tuple[int, int, int],
        sigma: float,
    ) -> tuple[Tensor, Tensor | None]:
        count, voxels = len(points), size[0] * size[1] * size[2]
        ctx.none = () if count else (points, intensities, scales)
        ctx.part = max(1, AT_ONCE.get(points.device.type, ELSEWHERE) // voxels)
        points, scales = points.detach(), scales.detach()
        with torch.autocast(points.device.type, enabled=False):
            parts = [
                rendered(
                    points[k : k + ctx.part],
                    None if intensities is None else intensities[k : k + ctx.part],
                    scales[k : k + ctx.part],
                    size,
                    sigma,
                )
                for k in range(0, count, ctx.part)
            ]
        ctx.back = [back for _, back in parts]
        pictures = [picture for picture, _ in parts]
        shape = (0, size[1], size[0])
        silhouette = torch.cat([points.new_zeros(shape), *(p.silhouette for p in pictures)])
        if intensities is None:
            return silhouette, None
        return silhouette, torch.cat([points.new_zeros(shape), *(p.intensity for p in pictures)])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_silhouette: Tensor, of_picture: Tensor | None) -> tuple:
        with torch.autocast(of_silhouette.device.type, enabled=False):
            grads = [
                back(
                    of_silhouette[k * ctx.part : (k + 1) * ctx.part],
                    None if of_picture is None else of_picture[k * ctx.part : (k + 1) * ctx.part],
                )
                for k, back in enumerate(ctx.back)
            ]
        if not grads:  # without clouds
            zeros = (None if x is None else torch.zeros_like(x) for x in ctx.none)
            return *zeros, None, None
        points = torch.cat([grad.points for grad in grads])
        shades = None
        if of_picture is not None:
            shades = torch.cat([grad.intensities for grad in grads])
        return points, shades, torch.cat([grad.scales for grad in grads]), None, None


def _require_points(name: str, points: Tensor) -> None:
    if not isinstance(points, Tensor) or points.ndim < 2 or points.shape[-1] != 3:
        fail(name, "a tensor of shape (..., N, 3)", _shown(points))
    if not points.is_floating_point():
        fail(name, "floating point numbers", points.dtype)
    if not bool(points.isfinite().all()):
        fail(name, "finite numbers", "others")


def _require_numbers(name: str, value: object) -> None:
    """Refuse what is neither a tensor of real numbers nor some of Python's own."""
    if isinstance(value, Tensor):
        if value.is_complex():
            fail(name, "real numbers", value.dtype)
    else:
        to_numbers(name, value)


def _fits(shape: torch.Size, lead: torch.Size) -> bool:
    """Whether something of this shape can be repeated for each of the leading dimensions."""
    return len(shape) <= len(lead) and all(
        own in (1, whole) for own, whole in zip(shape[::-1], lead[::-1], strict=False)
    )


def _require_size(name: str, size: Sequence[int], count: int) -> tuple[int, ...]:
    if not isinstance(size, tuple | list) or len(size) != count:
        fail(name, f"{count} integers", repr(size))
    return tuple(require_integer(f"{name}[{k}]", value, 1) for k, value in enumerate(size))


def _shown(value: object) -> str:
    return f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else repr(value)[:80]
