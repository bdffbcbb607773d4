"""The plane that points lie on, by weighted principal components."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from posecore.arrays import Array, array_function, fail, require_finite, somewhere

__all__ = ["Plane", "fit_plane"]


class Plane(NamedTuple):
    """The points x with `normal . x = offset`."""

    normal: Array
    """(..., 3) of length one."""
    offset: Array
    """(...) its distance from the origin, along the normal."""


@array_function(points="... N 3", weights="... N", toward="... 3")
def fit_plane(points: Array, weights: Array | None = None, toward: Array | None = None) -> Plane:
    """The plane of which weighted points are nearest, in the sum of squared distances.

    It goes through their weighted mean; its normal is the direction in which they spread least. So
    any plane can be told, where a fit of z = a x + b y + c, as GPV-Pose has it, breaks down for
    planes that hold the z axis. Points on a line, or in one place, leave the normal open: then it
    is one of those that fit.

    Gradients flow to points and weights, and are finite everywhere: what the normal would do where
    two directions spread alike, to rounding, is left out of them.

    Args:
        points: (..., N, 3) in any unit.
        weights: (..., N) none negative, not all zero; None: all alike.
        toward: (..., 3) a direction to whose side the normal is turned; by default the one whose
            offset is not negative.

    Returns:
        A `Plane`: `(normal, offset)`.

    Raises:
        ValueError: if a weight is negative, or all of a cloud's are zero; if points are so large
            that their squares overflow.
    """
    if weights is None:
        w = points.new_full((1, points.shape[-2]), 1 / points.shape[-2])
    else:
        if somewhere(weights < 0):
            fail("weights", "none negative", float(weights.min()))
        if somewhere(weights.sum(-1) == 0):
            fail("weights", "some above 0 in each cloud", "all 0")
        w = (weights / weights.sum(-1, keepdim=True))[..., None, :]
    mean = w @ points  # (..., 1, 3)
    off = points - mean
    spread = (off.mT * w) @ off  # (..., 3, 3)
    require_finite("points", spread, "points whose squares are finite")
    normal = _LeastAxis.apply(spread.double())[0].to(points)
    offset = (normal * mean[..., 0, :]).sum(-1)
    side = offset if toward is None else (normal * toward).sum(-1)
    sign = torch.where(side < 0, -1, 1).to(points)
    return Plane(sign[..., None] * normal, sign * offset)


class _LeastAxis(torch.autograd.Function):
    """The unit eigenvector of the least eigenvalue of symmetric matrices (..., 3, 3)."""

    @staticmethod
    def forward(matrix: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        values, vectors = torch.linalg.eigh(matrix)
        return vectors[..., 0].clone(), values, vectors

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*output[1:])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> Tensor:
        # dv_0 = sum over j of v_j (v_j^T dM v_0) / (l_0 - l_j): PyTorch's own also divides by
        # l_1 - l_2, which says nothing of v_0.
        values, vectors = ctx.saved_tensors
        gap = values[..., :1] - values[..., 1:]
        unique = -gap > 64 * torch.finfo(values.dtype).eps * values[..., 2:].abs()
        share = (vectors[..., 1:].mT @ gradient[..., None])[..., 0]
        share = torch.where(unique, share / torch.where(unique, gap, 1), 0)
        pull = (vectors[..., 1:] @ share[..., None]) * vectors[..., None, :, 0]
        return (pull + pull.mT) / 2

    @staticmethod
    def vmap(info: Any, dims: Any, matrix: Tensor) -> Any:
        return _LeastAxis.apply(matrix.movedim(dims[0], 0)), (0, 0, 0)
