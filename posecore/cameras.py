"""Pinhole cameras: from points to pixels and back, and the camera of a cropped or resized image.

A camera is its matrix `K = [[fx, s, cx], [0, fy, cy], [0, 0, 1]]`; the skew `s` is 0 in most data.
Pixels are (x, y) = (column, row) with the centre of the first pixel at (0, 0), as OpenCV and BOP
have it, so the image covers -0.5 to width - 0.5. Camera frame: x right, y down, z forward.

A lens that bends straight lines is in `posecore.distortion`, OpenGL's cameras in `posecore.opengl`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_integer,
    somewhere,
    values_known,
)

__all__ = [
    "back_project",
    "crop_and_resize_intrinsics",
    "crop_intrinsics",
    "depth_to_points",
    "project",
    "require_intrinsics",
    "resize_intrinsics",
]


def require_intrinsics(name: str, K: Array) -> None:
    """Refuse what is not an invertible pinhole matrix.

    Skew and negative focal lengths (a mirrored image) are allowed.

    Args:
        name: what the caller's argument is called; the error begins with it.
        K: (..., 3, 3) matrices.

    Raises:
        ValueError: if the last row is not 0 0 1, the entry left of fy is not 0, fx or fy is 0, or
            an entry is not finite.
    """
    matrices = _to_tensor(name, K)
    if matrices.shape[-2:] != (3, 3):
        fail(name, "camera matrices, shape (..., 3, 3)", f"shape {tuple(matrices.shape)}")
    if not values_known():
        return
    focal = matrices[..., [0, 1], [0, 1]]
    rest = matrices[..., [1, 2, 2, 2], [0, 0, 1, 2]]
    good = (focal != 0).all(-1) & (rest == rest.new_tensor([0, 0, 0, 1])).all(-1)
    good &= torch.isfinite(matrices).all(-1).all(-1)
    if not bool(good.all()):
        expected = "[[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx and fy not 0"
        fail(name, expected, matrices[~good][0].tolist())


@array_function(K="... 3 3", points="... N 3")
def project(K: Array, points: Array, behind: str = "refuse") -> Array:
    """Where points of the camera frame appear in the image.

    Args:
        K: (..., 3, 3) camera matrix.
        points: (..., N, 3) points in the camera frame; only the ratio of the coordinates matters.
        behind: what to do with points that are not in front of the camera (z <= 0): "refuse", or
            "inf": both their coordinates become +inf and they pass no gradient. A metric then
            counts such a pose as infinitely wrong.

    Returns:
        (..., N, 2) pixel coordinates (x, y).

    Raises:
        ValueError: if `K` is no camera matrix, or `behind` is "refuse" and a point has z <= 0.
    """
    require_intrinsics("K", K)
    require_choice("behind", behind, ("refuse", "inf"))
    z = points[..., 2:]
    hidden = z <= 0
    if behind == "refuse" and somewhere(hidden):
        fail("points", "z > 0 everywhere", f"{int(hidden.sum())} of {hidden.numel()} with z <= 0")
    # The centre is added last: far off the axis the quotient may be infinite, but never NaN.
    scaled = points[..., :2] @ K[..., :2, :2].mT
    # A depth that has overflowed would bring all to the centre: there is no such pixel.
    z = torch.where(hidden, torch.ones_like(z), torch.where(torch.isinf(z), torch.nan, z))
    pixels = scaled / z + K[..., None, :2, 2]
    return pixels.masked_fill(hidden, torch.inf)


@array_function(depth="... H W", K="... 3 3")
def back_project(depth: Array, K: Array) -> Array:
    """The point of the camera frame that every pixel of a depth image sees.

    Args:
        depth: (..., H, W) z coordinate in metres, not the length of the ray; 0 where unknown.
        K: (..., 3, 3) camera matrix.

    Returns:
        (..., H, W, 3) points in metres; (0, 0, 0) where the depth is 0.

    Raises:
        ValueError: if a depth is negative or `K` is no camera matrix.
    """
    _require_depth(depth)
    require_intrinsics("K", K)
    rows = torch.arange(depth.shape[-2], dtype=depth.dtype, device=depth.device)
    columns = torch.arange(depth.shape[-1], dtype=depth.dtype, device=depth.device)
    return _lift(columns[None, :], rows[:, None], depth, K[..., None, None, :, :])


@array_function(depth="H W", K="3 3")
def depth_to_points(depth: Array, K: Array, mask: Array | None = None) -> Array:
    """The points of one depth image where it has a depth, row by row.

    Args:
        depth: (H, W) z coordinate in metres; 0 where unknown.
        K: (3, 3) camera matrix.
        mask: (H, W) true (or not 0) where points are wanted; everywhere by default.

    Returns:
        (M, 3) points in metres.

    Raises:
        ValueError: if a depth is negative, `K` is no camera matrix, or no point is left.
    """
    _require_depth(depth)
    require_intrinsics("K", K)
    valid = depth > 0
    if mask is not None:
        wanted = _like("mask", mask, depth) != 0
        if wanted.shape != depth.shape:
            fail("mask", f"shape {tuple(depth.shape)} as depth has", f"shape {tuple(wanted.shape)}")
        if not bool(wanted.any()):
            fail("mask", "at least one true pixel", "none")
        valid = valid & wanted
    if not bool(valid.any()):
        fail("depth", "a depth above 0 at one wanted pixel at least", "none")
    rows, columns = valid.nonzero(as_tuple=True)
    return _lift(columns.to(depth.dtype), rows.to(depth.dtype), depth[rows, columns], K)


@array_function(K="... 3 3")
def crop_intrinsics(K: Array, x: float | Array, y: float | Array) -> Array:
    """The camera of a crop whose first pixel is pixel (`x`, `y`) of the whole image.

    Args:
        K: (..., 3, 3) camera matrix of the whole image.
        x, y: numbers or (...), column and row of the crop's first pixel; may lie outside the image.

    Returns:
        (..., 3, 3) camera matrix of the crop.

    Raises:
        ValueError: if `K` is no camera matrix, or `x` or `y` do not fit it.
    """
    require_intrinsics("K", K)
    x, y = _like("x", x, K), _like("y", y, K)
    return _change_pixels(K, torch.ones_like(x), -x, torch.ones_like(y), -y)


@array_function(K="... 3 3")
def resize_intrinsics(K: Array, old_size: Sequence[int], new_size: Sequence[int]) -> Array:
    """The camera of a resized image.

    The border of the image, half a pixel outside the first centre, stays the border, as in
    `cv2.resize`: `x' = (x + 0.5) * new / old - 0.5`.

    Args:
        K: (..., 3, 3) camera matrix of the image of `old_size`.
        old_size, new_size: (width, height) in pixels.

    Returns:
        (..., 3, 3) camera matrix of the resized image.
    """
    old_width, old_height = _require_size("old_size", old_size)
    box = [0, 0, old_width, old_height]
    return crop_and_resize_intrinsics(K, box, _require_size("new_size", new_size))


@array_function(K="... 3 3")
def crop_and_resize_intrinsics(
    K: Array, box: Sequence[float] | Array, new_size: Sequence[int]
) -> Array:
    """The camera of a crop that was resized: `crop_intrinsics`, then `resize_intrinsics`.

    Args:
        K: (..., 3, 3) camera matrix of the whole image.
        box: (..., 4) x, y, width, height: the first pixel of the crop and its extent in pixels.
            Fractions are allowed; the crop covers x - 0.5 to x + width - 0.5.
        new_size: (width, height) of the result in pixels.

    Returns:
        (..., 3, 3) camera matrix of the result.

    Raises:
        ValueError: if `K` is no camera matrix, or a width or height is not positive.
    """
    require_intrinsics("K", K)
    new_width, new_height = _require_size("new_size", new_size)
    box = _like("box", box, K)
    if box.ndim == 0 or box.shape[-1] != 4:
        fail("box", "shape (..., 4)", f"shape {tuple(box.shape)}")
    x, y, width, height = box.unbind(-1)
    if somewhere(torch.minimum(width, height) <= 0):
        fail("box", "width and height above 0", box[torch.minimum(width, height) <= 0][0].tolist())
    scale_x, scale_y = new_width / width, new_height / height
    shift_x, shift_y = (0.5 - x) * scale_x - 0.5, (0.5 - y) * scale_y - 0.5
    return _change_pixels(K, scale_x, shift_x, scale_y, shift_y)


def _change_pixels(K: Tensor, ax: Tensor, bx: Tensor, ay: Tensor, by: Tensor) -> Tensor:
    """The camera whose pixels are `x' = ax * x + bx`, `y' = ay * y + by`."""
    try:
        np.broadcast_shapes(ax.shape, bx.shape, ay.shape, by.shape, K.shape[:-2])
    except ValueError:
        given = f"{tuple(K.shape[:-2])} and {tuple(bx.shape)}, {tuple(by.shape)}"
        fail("K and the crop", "batch dimensions that broadcast", given)
    zero, one = torch.zeros_like(ax + ay), torch.ones_like(ax + ay)
    entries = torch.broadcast_tensors(ax, zero, bx, zero, ay, by, zero, zero, one)
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3)) @ K


def _lift(x: Tensor, y: Tensor, z: Tensor, K: Tensor) -> Tensor:
    """The points of depth `z` that are seen at the pixels (`x`, `y`)."""
    ray_y = (y - K[..., 1, 2]) / K[..., 1, 1]
    ray_x = (x - K[..., 0, 2] - K[..., 0, 1] * ray_y) / K[..., 0, 0]
    return torch.stack(torch.broadcast_tensors(ray_x * z, ray_y * z, z), dim=-1)


def _require_depth(depth: Tensor) -> None:
    wrong = ~(depth >= 0)  # true for NaN as well
    if somewhere(wrong):
        got = f"{int(wrong.sum())} of {depth.numel()} below 0 or no number"
        fail("depth", "no value below 0", got)


def _require_size(name: str, size: Sequence[int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        fail(name, "(width, height)", repr(size))
    return require_integer(name, width, 1), require_integer(name, height, 1)


def _to_tensor(name: str, value: object) -> Tensor:
    if isinstance(value, Tensor):
        return value
    try:
        return torch.from_numpy(np.array(value))
    except (TypeError, ValueError):  # not numbers, or rows of different lengths
        fail(name, "numbers", repr(value))


def _like(name: str, value: object, like: Tensor) -> Tensor:
    """`value` in the precision and on the device of `like`, which plain numbers cannot change."""
    tensor = _to_tensor(name, value).to(like.device, like.dtype)
    if somewhere(~torch.isfinite(tensor)):
        fail(name, "finite numbers", tensor.tolist())
    return tensor
