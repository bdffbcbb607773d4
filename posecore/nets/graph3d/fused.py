"""The sum over supports of a maximum over neighbours, without a number for each pair of both.

Written step by step, a graph convolution makes (B, N, K, S C) cosines and as many copies of its
neighbours' features, and keeps both for the backward pass: at the paper's size hundreds of
megabytes in one layer. But of the K neighbours the maximum takes one, and only that one gets a
gradient. So here a few points at a time go through one support after the other while they stay in
the processor's cache, and all that is kept is which neighbour it was: one byte.

The result and its gradients are those of the steps one by one.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from posecore.arrays import fail

__all__ = ["support_maximum"]

CELLS = 2**17  # numbers at once: few enough to stay in the cache, enough to be worth a call each


def support_maximum(
    directions: Tensor, supports: Tensor, table: Tensor | None = None,
    neighbours: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """sum_s max_k relu(<direction_k, support_s>) table_s[neighbour_k].

    Args:
        directions: (R, K, 3) unit vectors from R points to their neighbours, or zero.
        supports: (S, 3, C) unit vectors, one for each channel.
        table: (S, T, C) what each of T points lends by each support; None for ones.
        neighbours: (R, K) int64, rows of the table; None without one.

    Returns:
        (R, C).

    Raises:
        ValueError: if there are more than 255 neighbours, whose number is no byte.
    """
    if directions.shape[1] > 255:
        fail("neighbours", "at most 255 of a point", directions.shape[1])
    return _SupportMaximum.apply(directions, supports, table, neighbours)


class _SupportMaximum(torch.autograd.Function):
    """Keeps the number of the neighbour that was the maximum."""

    @staticmethod
    @torch.amp.custom_fwd(device_type="cpu", cast_inputs=torch.float32)
    def forward(
        ctx: Any, directions: Tensor, supports: Tensor, table: Tensor | None,
        neighbours: Tensor | None,
    ) -> Tensor:  # fmt: skip
        rows, count, _ = directions.shape
        kernels, _, channels = supports.shape
        by_neighbour = directions.transpose(0, 1).contiguous()  # (K, R, 3)
        where = None if neighbours is None else neighbours.T.contiguous()
        found = directions.new_zeros(rows, channels)
        kept = any(ctx.needs_input_grad)
        index = torch.zeros(kernels, rows, channels, dtype=torch.uint8) if kept else None
        size = max(1, CELLS // channels)
        room = directions.new_empty(3, min(size, rows), channels)
        larger = torch.empty(min(size, rows), channels, dtype=torch.bool)
        for begin in range(0, rows, size):
            part = slice(begin, min(rows, begin + size))
            few = part.stop - begin
            value, lent, best = (each[:few] for each in room)
            mask = larger[:few]
            for s in range(kernels):
                for k in range(count):
                    now = value if k else best
                    torch.mm(by_neighbour[k, part], supports[s], out=now).relu_()
                    if table is not None:
                        torch.index_select(table[s], 0, where[k, part], out=lent)
                        now.mul_(lent)
                    if not k:
                        continue
                    if kept:
                        # The first of equal ones, as `max` has it; numbers rise, so the largest is
                        # that of the last that was larger than all before.
                        torch.gt(value, best, out=mask)
                        which = index[s, part]
                        torch.maximum(which, mask.view(torch.uint8).mul_(k), out=which)
                    torch.maximum(best, value, out=best)
                found[part] += best
        ctx.save_for_backward(directions, supports, table, neighbours, index)
        return found

    @staticmethod
    @once_differentiable
    @torch.amp.custom_bwd(device_type="cpu")
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        directions, supports, table, neighbours, index = ctx.saved_tensors
        of_directions = torch.zeros_like(directions) if ctx.needs_input_grad[0] else None
        of_supports = torch.zeros_like(supports)
        of_table = None if table is None else torch.zeros_like(table)
        rows, channels = gradient.shape
        size = max(1, CELLS // channels)
        for begin in range(0, rows, size):
            part = slice(begin, min(rows, begin + size))
            g = gradient[part]
            axes = directions[part].unbind(-1)  # (n, K) each
            for s in range(len(supports)):
                which = index[s, part].long()  # (n, C)
                chosen = [axis.gather(1, which) for axis in axes]
                cosine = chosen[0] * supports[s, 0]
                cosine.addcmul_(chosen[1], supports[s, 1]).addcmul_(chosen[2], supports[s, 2])
                of_cosine = g * (cosine > 0)
                if table is not None:
                    row = neighbours[part].gather(1, which)
                    of_table[s].scatter_add_(0, row, cosine.relu_().mul_(g))
                    of_cosine.mul_(table[s].gather(0, row))
                for a in range(3):
                    of_supports[s, a] += torch.linalg.vecdot(of_cosine, chosen[a], dim=0)
                    if of_directions is not None:
                        pull = of_cosine * supports[s, a]
                        of_directions[part, :, a].scatter_add_(1, which, pull)
        return of_directions, of_supports, of_table, None
