"""Which of an object's symmetries brings a true pose nearest to an estimate, in a maximum's sense.

A few points bound a maximum over all of them from below. So all motions are tried with a few, and
only those with all points that could still be the best: the answer is that of the whole search.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from posecore import poses
from posecore.arrays import fail
from posecore.symmetry import require_symmetries

__all__ = ["at_best_motion", "best_for_pixels", "best_for_points"]

PROBES = (48, 400)  # points of the first and the second round, at most
BLOCK = 400_000  # points posed at once: some megabytes, and few calls

Gap = Callable[[Tensor, Tensor, Tensor], Tensor]
"""The largest gap of points (n, 3) for pairs of a row (P,) and a motion (P,): (P,)."""


def at_best_motion(
    search: Callable[..., Tensor],
    symmetries: Tensor | None,
    points: Tensor,
    arguments: tuple[Tensor, ...],
) -> tuple[Tensor, Tensor]:
    """The true poses, the last two of the arguments, each after the motion that `search` finds.

    Raises:
        ValueError: if `symmetries` are no rigid motions.
    """
    R_gt, t_gt = arguments[-2:]
    if symmetries is None:
        return R_gt, t_gt
    require_symmetries(symmetries)
    cores = (2, 2, 1, 2, 1)[-len(arguments) :]
    batch = np.broadcast_shapes(
        *(x.shape[: x.ndim - core] for x, core in zip(arguments, cores, strict=True))
    )
    rows = [
        x.detach().expand(*batch, *(3,) * core).reshape(-1, *(3,) * core)
        for x, core in zip(arguments, cores, strict=True)
    ]
    if not len(rows[0]) or len(symmetries) == 1:
        best = symmetries[:1].expand(*batch, 4, 4)
    else:
        best = symmetries[search(*rows, points.detach(), symmetries.detach()).reshape(batch)]
    return poses.compose(R_gt, t_gt, best[..., :3, :3], best[..., :3, 3])


@torch.no_grad()
def best_for_points(
    R_est: Tensor, t_est: Tensor, R_gt: Tensor, t_gt: Tensor, points: Tensor, symmetries: Tensor
) -> Tensor:
    """For each row the motion with the smallest MSSD.

    Args:
        R_est, t_est, R_gt, t_gt: (B, 3, 3) and (B, 3).
        points: (N, 3).
        symmetries: (S, 4, 4).

    Returns:
        (B,) indices.
    """
    S_R, S_t = symmetries[:, :3, :3], symmetries[:, :3, 3]

    def gap(row: Tensor, motion: Tensor, some: Tensor) -> Tensor:
        R = R_est[row] - R_gt[row] @ S_R[motion]
        t = (t_est - t_gt)[row] - (R_gt[row] @ S_t[motion][..., None])[..., 0]
        return _largest_length(torch.baddbmm(t[:, :, None], R, some.T.expand(len(row), -1, -1)))

    return _search(gap, len(R_est), len(symmetries), points)


@torch.no_grad()
def best_for_pixels(
    K: Tensor,
    R_est: Tensor,
    t_est: Tensor,
    R_gt: Tensor,
    t_gt: Tensor,
    points: Tensor,
    symmetries: Tensor,
) -> Tensor:
    """For each row the motion with the smallest MSPD.

    Args:
        K, R_est, t_est, R_gt, t_gt: (B, 3, 3) and (B, 3).
        points: (N, 3).
        symmetries: (S, 4, 4).

    Returns:
        (B,) indices; of the first motion where the estimate has a point behind the camera.

    Raises:
        ValueError: if a true pose, as it is, has a point behind the camera.
    """
    behind = sum(int((R[2] @ points.T + t[2] <= 0).sum()) for R, t in zip(R_gt, t_gt, strict=True))
    if behind:
        fail("t_gt", "a ground truth in front of the camera", f"{behind} points behind it")
    S_R, S_t = symmetries[:, :3, :3], symmetries[:, :3, 3]
    A_est, b_est, A_gt, b_gt = (
        *(K @ R_est, (K @ t_est[..., None])[..., 0]),
        *(K @ R_gt, (K @ t_gt[..., None])[..., 0]),
    )

    def pixels(A: Tensor, b: Tensor, some: Tensor) -> tuple[Tensor, Tensor]:
        seen = torch.baddbmm(b[:, :, None], A, some.T.expand(len(A), -1, -1))  # (P, 3, n)
        return seen[:, :2] / seen[:, 2:], (seen[:, 2] <= 0).any(-1)

    def gap(row: Tensor, motion: Tensor, some: Tensor) -> Tensor:
        here, hidden = pixels(A_est[row], b_est[row], some)
        b = b_gt[row] + (A_gt[row] @ S_t[motion][..., None])[..., 0]
        there, lost = pixels(A_gt[row] @ S_R[motion], b, some)
        return _largest_length(here - there).masked_fill(hidden | lost, torch.inf)

    return _search(gap, len(R_est), len(symmetries), points)


def _largest_length(vectors: Tensor) -> Tensor:
    """Of each row of `vectors` (P, d, n) the largest length: (P,)."""
    # Component by component: a norm over a dimension that is not the last is far slower.
    first, *others = vectors.unbind(1)
    squared = first * first
    for other in others:
        squared.addcmul_(other, other)
    return squared.amax(-1).sqrt()


def _search(gap: Gap, rows: int, motions: int, points: Tensor) -> Tensor:
    """For each of the rows the motion whose largest gap is smallest: (rows,) indices."""
    device = points.device
    best = torch.zeros(rows, dtype=torch.long, device=device)
    every = torch.arange(rows, device=device)
    value = _in_blocks(gap, every, best, points)
    row, motion = (x.ravel() for x in torch.meshgrid(
        every, torch.arange(motions, device=device), indexing="ij"
    ))  # fmt: skip
    left = torch.isfinite(value)[row]  # else no motion helps: the estimate is behind the camera
    row, motion = row[left], motion[left]
    for count in (*PROBES, len(points)):
        if not len(row):
            break
        some = points if count >= len(points) else points[_extremes(points, count)]
        # What overflows to no number is no promise; argmin would take it for the best.
        bound = _in_blocks(gap, row, motion, some).nan_to_num(torch.inf, posinf=torch.inf)
        table = torch.full((rows, motions), torch.inf, dtype=bound.dtype, device=device)
        table[row, motion] = bound
        first = table.argmin(1)
        found = table[every, first]
        if len(some) < len(points):  # a bound yet: how good is the motion that promises most?
            tried = torch.isfinite(found).nonzero()[:, 0]
            found[tried] = _in_blocks(gap, tried, first[tried], points)
        better = found < value
        best, value = torch.where(better, first, best), torch.where(better, found, value)
        if len(some) == len(points):
            break
        left = bound < value[row]
        row, motion = row[left], motion[left]
    return best


def _in_blocks(gap: Gap, row: Tensor, motion: Tensor, points: Tensor) -> Tensor:
    step = max(1, BLOCK // len(points))
    blocks = [gap(r, m, points) for r, m in zip(row.split(step), motion.split(step), strict=True)]
    return torch.cat(blocks)


def _extremes(points: Tensor, count: int) -> Tensor:
    """Indices of at most `count` points: those that lie farthest out in as many directions."""
    number = np.arange(count) + 0.5
    height, turn = 1 - 2 * number / count, np.pi * (1 + 5**0.5) * number  # a Fibonacci sphere
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height])
    return (points @ torch.from_numpy(directions).to(points)).argmax(0).unique()
