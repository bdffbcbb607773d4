"""Choosing points of a cloud, and looking up what belongs to chosen points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_finite,
    require_integer,
    values_known,
)
from posecore.clouds.search import at_least_float32

__all__ = ["farthest_point_sampling", "gather_points"]

_BLOCK = 2**20  # numbers of a gradient written out at once


@array_function(points="... N 3")
def farthest_point_sampling(points: Array, count: int, start: int | str = 0) -> Array:
    """Choose points one by one, each the one farthest from all that were chosen before.

    Deterministic: of several equally far points the one of smallest index is taken, and no index
    is taken twice. When only copies of chosen points are left, they follow in order of their index.

    Args:
        points: (..., N, 3) clouds.
        count: how many points to choose from each, at most N.
        start: index of the first point, or "farthest_from_centre": the centre of the bounding box
            counts as chosen already, as for the keypoints of PVNet (Peng et al., CVPR 2019;
            reference implementation zju3dv/pvnet).

    Returns:
        (..., count) int64 indices into the N points, in the order of choice.

    Raises:
        ValueError: if `count` is not between 1 and N, `start` is no index and not that word, or
            points are so far apart that squared distances overflow.
    """
    *batch, n, _ = points.shape
    require_integer("count", count, 1, n)
    # In NumPy whatever the device: a step is a few short passes over memory, and starting threads
    # or kernels for each costs more than it saves. Coordinates lie apart, one row per cloud.
    cloud = at_least_float32(points).reshape(-1, n, 3)
    reach = (cloud.amax(1) - cloud.amin(1)).square().sum(-1)
    require_finite("points", reach, "points whose squared distances are finite")
    cloud = cloud.cpu().numpy()
    xyz = np.ascontiguousarray(np.moveaxis(cloud, -1, 0))  # (3, B, N)
    squared = np.full_like(xyz[0], np.inf)  # (B, N) distance to the nearest chosen point
    indices = np.empty((count, len(squared)), dtype=np.int64)
    if isinstance(start, str):
        require_choice("start", start, ("farthest_from_centre",))
        centre = (xyz.min(-1, keepdims=True) + xyz.max(-1, keepdims=True)) / 2
        x, y, z = np.square(xyz - centre)
        squared = x + y + z
        indices[0] = squared.argmax(-1)  # the first of equal ones
    else:
        indices[0] = require_integer("start", start, 0, n - 1)

    difference = np.empty_like(xyz)
    x, y, z = difference
    flat_xyz, flat_squared = xyz.reshape(3, -1), squared.reshape(-1)  # views
    first = n * np.arange(len(squared))  # where each cloud begins
    for step in range(1, count):
        chosen = first + indices[step - 1]
        np.subtract(xyz, flat_xyz[:, chosen][..., None], out=difference)
        np.square(difference, out=difference)
        x += y
        x += z
        np.minimum(squared, x, out=squared)
        flat_squared[chosen] = -1  # never again, not even among equal points
        squared.argmax(-1, out=indices[step])
    return torch.from_numpy(indices.T.reshape(*batch, count)).to(points.device)


@array_function(keeps_half=True, values="... N C")
def gather_points(values: Array, indices: Array) -> Array:
    """The rows of `values` at `indices`; gradients flow back to `values`.

    Args:
        values: (..., N, C) coordinates or features of N points.
        indices: (..., *K) integers from 0 to N - 1, with the batch dimensions of `values` and any
            further dimensions: (..., M) from sampling, (..., M, k) from a neighbour search.

    Returns:
        (..., *K, C).

    Raises:
        ValueError: if an index is out of range or not an integer, or the batch dimensions differ.
    """
    indices = to_indices(indices, values.device)
    rows, positions = table(values, indices)
    clouds = math.prod(values.shape[:-2])
    gathered = _Gathering.apply(rows, positions.reshape(clouds, indices.numel() // max(1, clouds)))
    return gathered.reshape(*indices.shape, values.shape[-1])


class _Gathering(torch.autograd.Function):
    """Rows of a table (B * N, C) at positions (B, M), cloud i among the rows from i N: (B, M, C).

    The backward pass is that of PyTorch's `embedding`, several times as fast as indexing's on more
    than one thread, and in one order of sums. But it wants the whole gradient in memory, where that
    of a mean or a sum over neighbours is a few numbers repeated: so such a gradient is written out
    for a few clouds at a time.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(rows: Tensor, positions: Tensor) -> Tensor:
        columns = positions.reshape(-1, 1).expand(-1, rows.shape[1])  # `gather` is the fastest
        return rows.gather(0, columns).reshape(*positions.shape, rows.shape[1])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
        rows, positions = inputs
        ctx.save_for_backward(positions)
        ctx.save_for_forward(positions)
        ctx.rows = len(rows)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (positions,) = ctx.saved_tensors
        clouds = max(1, len(positions))
        n = ctx.rows // clouds
        whole = gradient.is_contiguous()
        step = clouds if whole else max(1, _BLOCK * clouds // max(1, gradient.numel()))
        parts = zip(gradient.split(step), positions.split(step), strict=True)
        sums = [
            torch.ops.aten.embedding_dense_backward(
                part, where - i * step * n, n * len(part), -1, False
            )
            for i, (part, where) in enumerate(parts)
        ]
        return torch.cat(sums), None

    @staticmethod
    def jvp(ctx: Any, rows: Tensor, positions: None) -> Tensor:
        return _Gathering.apply(rows, *ctx.saved_tensors)


def to_indices(indices: Array, device: torch.device) -> Tensor:
    """The argument `indices` of a public function as an int64 tensor.

    Raises:
        ValueError: if they are no integers, or ragged.
    """
    if not isinstance(indices, Tensor):
        try:
            array = np.array(indices)
        except ValueError:
            fail("indices", "integers", "rows of different lengths")
        if array.dtype.kind not in "iu":
            fail("indices", "integers", f"dtype {array.dtype}")
        indices = torch.from_numpy(array.astype(np.int64))
    if indices.is_floating_point() or indices.is_complex() or indices.dtype == torch.bool:
        fail("indices", "integers", indices.dtype)
    return indices.to(device, torch.long)


def table(values: Tensor, indices: Tensor) -> tuple[Tensor, Tensor]:
    """All rows of `values` (..., N, C) in one table (B * N, C), and where in it `indices` point.

    Raises:
        ValueError: if the indices have other batch dimensions, or point outside the cloud.
    """
    *batch, n, channels = values.shape
    if list(indices.shape[: len(batch)]) != batch:
        expected = f"the batch dimensions {tuple(batch)} of the values first"
        fail("indices", expected, f"shape {tuple(indices.shape)}")
    low, high = indices.aminmax() if values_known() and indices.numel() else (0, 0)
    if low < 0 or high >= n:
        fail("indices", f"integers from 0 to {n - 1}", f"values from {int(low)} to {int(high)}")
    rows = values.reshape(-1, channels)
    first = torch.arange(0, len(rows), n, device=values.device)  # where each cloud begins
    return rows, indices + first.reshape(batch + [1] * (indices.ndim - len(batch)))
