"""The shared layers of a set abstraction and its maximum, a few balls at a time.

Written step by step, every layer writes numbers for each neighbour of each ball: at the paper's
size tens of megabytes a cloud, most of which wait in memory for the backward pass. On a processor
that takes longer than the products. Here a few balls go through as many steps as they can while
they stay in the cache, and what is cheap to compute again is not kept. Two things save more:

- Balls with few points are filled with copies of the first. A copy adds to the mean and variance of
  the norms, and to nothing else; so it is counted, not computed. Balls go in order of their size,
  and each few are as wide as the largest among them.
- ReLU after a norm keeps or turns the order of a channel's numbers. So the maximum is chosen before
  both, and only it goes through them.

The result, its gradients and the norms' statistics are those of the steps one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from posecore.arrays import fail

__all__ = ["fused_maximum"]

ROWS = 2048  # neighbours at once: what they become stays in the cache


class _Few(NamedTuple):
    """Some balls of like size."""

    balls: Tensor  # (n,) which of the B S
    rows: Tensor  # (n, k) their points, among the B N
    copies: int  # how many more of the first each has: K - k
    at: slice  # where their n k rows are kept


class _Layer(NamedTuple):
    """What a norm and the linear layer before it are made of."""

    weight: Tensor | None  # (C, D); the first layer has come before
    slope: Tensor  # (C) of the norm's line
    shift: Tensor  # (C)


def fused_maximum(
    table: Tensor, centres: Tensor, balls: Tensor, norms: Sequence[nn.BatchNorm1d],
    linears: Sequence[nn.Linear],
) -> Tensor:  # fmt: skip
    """max over K of the layers, whose first has been applied to points and to centres apart.

    Args:
        table: (B, N, C) the first layer's values of points.
        centres: (B, S, C) those of centres, to be subtracted.
        balls: (B, S, K) indices into the N points, filled up with copies of the first.
        norms: of all layers, each with ReLU after it; all in training mode, or none.
        linears: all but the first.

    Returns:
        (B, S, D) of the last layer.

    Raises:
        ValueError: in training for a single neighbour, which has no variance.
    """
    if norms[0].training and balls.numel() < 2:
        fail("balls", "more than one neighbour in all while training", balls.numel())
    first = torch.arange(0, table[..., 0].numel(), table.shape[1], device=balls.device)
    few = _few(balls.long() + first[:, None, None])
    parameters = [p for norm in norms for p in (norm.weight, norm.bias)]
    parameters += [linear.weight for linear in linears]
    flat = table.flatten(0, 1), centres.flatten(0, 1)
    if norms[0].training:
        found, *moments = _Fused.apply(*flat, few, balls.shape[-1], norms[0].eps, *parameters)
        count = balls.numel()
        for norm, mean, variance in zip(norms, moments[::2], moments[1::2], strict=True):
            norm.num_batches_tracked += 1
            norm.running_mean.lerp_(mean.to(norm.running_mean), norm.momentum)
            unbiased = variance.to(norm.running_var) * (count / (count - 1))
            norm.running_var.lerp_(unbiased, norm.momentum)
    else:
        found = _of_known(*flat, few, norms, linears)
    return found.unflatten(0, balls.shape[:2])


def _few(balls: Tensor) -> list[_Few]:
    """Balls (B, S, K) of rows, in order of size, a few at a time."""
    flat = balls.flatten(0, 1)
    sizes = (flat != flat[:, :1]).sum(1) + 1
    order = sizes.argsort(stable=True)
    widths, most = sizes[order].tolist(), balls.shape[-1]
    found, begin, at = [], 0, 0
    while begin < len(widths):
        end, width = begin + 1, widths[begin]
        # As many as there is room for, if all are as wide as the last.
        while end < len(widths) and (end + 1 - begin) * widths[end] <= ROWS:
            width, end = widths[end], end + 1
        chosen = order[begin:end]
        rows = flat[chosen, :width].contiguous()
        found.append(_Few(chosen, rows, most - width, slice(at, at + rows.numel())))
        begin, at = end, at + rows.numel()
    return found


def _of_known(
    table: Tensor, centres: Tensor, few: list[_Few], norms: Sequence, linears: Sequence
) -> Tensor:
    """With the norms' own statistics, and without gradients."""
    layers = []
    for norm, linear in zip(norms, [None, *linears], strict=True):
        slope = norm.weight * (norm.running_var + norm.eps).rsqrt()
        shift = norm.bias - norm.running_mean * slope
        layers.append(_Layer(None if linear is None else linear.weight, slope, shift))
    found = centres.new_empty(len(centres), len(layers[-1].slope))
    for part in few:
        x = _activate(_grouped(table, centres, part), layers[0])
        for layer in layers[1:]:
            x = _activate(x @ layer.weight.T, layer)
        found[part.balls] = x.unflatten(0, part.rows.shape).amax(1)
    return found


def _grouped(table: Tensor, centres: Tensor, part: _Few) -> Tensor:
    """(n k, C) of points less that of their centres."""
    x = table.index_select(0, part.rows.flatten()).unflatten(0, part.rows.shape)
    return x.sub_(centres[part.balls][:, None]).flatten(0, 1)


def _activate(x: Tensor, layer: _Layer) -> Tensor:
    return torch.addcmul(layer.shift, x, layer.slope).relu_()


class _Moments:
    """Mean and variance of rows that come a few at a time."""

    def __init__(self) -> None:
        self.about = self.sums = self.squares = None

    def add(self, x: Tensor, part: _Few) -> None:
        """Rows (n k, C), the first of each ball once more for every copy."""
        if self.about is None:
            # Squares about the mean of some: about zero, a large mean would hide the variance.
            self.about = x.mean(0)
            self.sums, self.squares = (torch.zeros_like(self.about, dtype=torch.float64),) * 2
        off = x - self.about
        sums, squares = off.sum(0), None
        firsts = off[:: part.rows.shape[1]]
        if part.copies:
            sums = sums + part.copies * firsts.sum(0)
            squares = part.copies * firsts.square().sum(0)
        total = off.square_().sum(0)
        self.sums = self.sums + sums
        self.squares = self.squares + (total if squares is None else total + squares)

    def ends(self, count: int) -> tuple[Tensor, Tensor]:
        """(C) mean and variance of `count` rows."""
        off = self.sums / count
        variance = (self.squares / count - off.square()).clamp(min=0)
        return self.about + off.to(self.about), variance.to(self.about)


class _Fused(torch.autograd.Function):
    """Keeps what layers between the first and the last gave before their norm."""

    @staticmethod
    def forward(
        ctx: Any, table: Tensor, centres: Tensor, few: list[_Few], most: int, eps: float,
        *parameters: Tensor,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        depth = (len(parameters) + 1) // 3
        weights, kept, layers = (None, *parameters[2 * depth :]), [None] * depth, []
        moments, scales = [], []
        count, rows = len(centres) * most, few[-1].at.stop
        for i in range(depth):
            last = i == depth - 1
            falling = parameters[2 * i] < 0
            channels = len(falling)
            gathered = _Moments()
            if last:
                chosen = centres.new_empty(len(centres), channels)
                index = torch.empty_like(chosen, dtype=torch.long)
            elif i:
                kept[i] = centres.new_empty(rows, channels)
            state = table, centres, weights, kept, layers
            for part in few:
                x = _Fused._value(state, i, part, None if last or not i else kept[i][part.at])
                if last:
                    balls = x.unflatten(0, part.rows.shape)
                    best, where = balls.max(1)
                    if falling.any():
                        best[:, falling], where[:, falling] = balls[:, :, falling].min(1)
                    chosen[part.balls], index[part.balls] = best, where
                gathered.add(x, part)
            mean, variance = gathered.ends(count)
            scale = (variance + eps).rsqrt()
            slope = parameters[2 * i] * scale
            layers.append(_Layer(weights[i], slope, parameters[2 * i + 1] - mean * slope))
            moments += [mean, variance]
            scales.append(scale)
        found = _activate(chosen, layers[-1])
        ctx.few, ctx.count, ctx.means, ctx.scales = few, count, moments[::2], scales
        ctx.save_for_backward(table, centres, *parameters, found)
        ctx.kept, ctx.lines = kept, [(line.slope, line.shift) for line in layers]
        ctx.chosen, ctx.index = chosen, index
        ctx.mark_non_differentiable(*moments)
        return found, *moments

    @staticmethod
    def _value(state: tuple, i: int, part: _Few, out: Tensor | None = None) -> Tensor:
        """Rows of layer i before its norm."""
        table, centres, weights, _, layers = state
        if not i:
            return _grouped(table, centres, part)
        x = _activate(_Fused._known(state, i - 1, part), layers[i - 1])
        return torch.mm(x, weights[i].T, out=out)

    @staticmethod
    def _known(state: tuple, i: int, part: _Few) -> Tensor:
        kept = state[3]
        return _Fused._value(state, i, part) if kept[i] is None else kept[i][part.at]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        table, centres, *parameters, found = ctx.saved_tensors
        depth, means, few = len(ctx.lines), ctx.means, ctx.few
        weights = (None, *parameters[2 * depth :])
        layers = [_Layer(weights[i], *line) for i, line in enumerate(ctx.lines)]
        state = table, centres, weights, ctx.kept, layers
        of_norms, of_weights = [None] * (2 * depth), [None] * depth
        gradient = gradient * (found > 0)  # of what the last norm says
        sums, products = gradient.sum(0), (gradient * ctx.chosen).sum(0)
        below, of_centres = None, torch.empty_like(centres)
        for i in reversed(range(depth)):
            scale, slope = ctx.scales[i], layers[i].slope
            of_norms[2 * i + 1] = sums
            of_norms[2 * i] = of_slope = scale * (products - means[i] * sums)
            # Every row pulls at mean and variance: by a line in its own value.
            pull = -slope * scale * of_slope / ctx.count
            constant = -slope * sums / ctx.count - pull * means[i]
            channels = len(layers[max(0, i - 1)].slope)
            above = below
            # Each few are read before they are written, so one place may do for both.
            if above is None or above.shape[1] != channels:
                below = table.new_empty(few[-1].at.stop, channels)
            if i:
                sums, products = torch.zeros_like(means[i - 1]), torch.zeros_like(means[i - 1])
                of_weights[i] = torch.zeros_like(weights[i])
            for part in few:
                before = _Fused._known(state, i - 1, part) if i else None
                x = None if before is None else _activate(before, layers[i - 1])
                z = ctx.kept[i][part.at] if ctx.kept[i] is not None else None
                if z is None:
                    z = _grouped(table, centres, part) if x is None else x @ weights[i].T
                pulled = torch.addcmul(constant, z, pull)
                balls = pulled.unflatten(0, part.rows.shape)
                balls[:, 0] *= 1 + part.copies
                if above is None:
                    balls.scatter_add_(
                        1, ctx.index[part.balls][:, None], (gradient[part.balls] * slope)[:, None]
                    )
                else:
                    pulled.addcmul_(above[part.at], slope)
                if x is None:
                    of_centres[part.balls] = -balls.sum(1)
                    below[part.at] = pulled
                    continue
                of_weights[i].addmm_(pulled.T, x)
                g = torch.mm(pulled, weights[i], out=below[part.at])
                torch.ops.aten.threshold_backward(g, x, 0, grad_input=g)  # of ReLU
                sums += g.sum(0)
                products += (g * before).sum(0)
        rows = torch.cat([part.rows.flatten() for part in few])
        of_table = torch.ops.aten.embedding_dense_backward(below, rows, len(table), -1, False)
        return of_table, of_centres, None, None, None, *of_norms, *of_weights[1:]
