"""The search behind `posecore.clouds`: one rule, two roads that find the same indices bit for bit.

On the CPU k-d trees search, clouds side by side in threads; elsewhere, and for balls that hold much
of the cloud, all distances are computed block by block. Squared distances are compared as they come
out in the precision of the points, by the same operations in the same order on both roads. Nothing
passes a gradient here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from posecore.arrays import require_finite

__all__ = ["at_least_float32", "ball_indices", "nearest_indices", "same_batch"]

_BLOCK = 2**19  # distances computed at once: few enough to stay in a processor's cache
_QUERIES = 2**12  # queries of a tree at once: work for several threads, and bounded memory
_SMALL_BALL = 1 / 64  # share of the cloud up to which trees beat the computation of all distances


def at_least_float32(points: Tensor) -> Tensor:
    """The points, without gradient, in a precision that all parts of the search can handle."""
    return points.detach().to(torch.promote_types(points.dtype, torch.float32))


def same_batch(points: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    """Both clouds with the batch dimensions to which theirs broadcast."""
    batch = np.broadcast_shapes(points.shape[:-2], queries.shape[:-2])
    return points.expand(*batch, -1, -1), queries.expand(*batch, -1, -1)


def nearest_indices(
    points: Tensor,
    queries: Tensor,
    k: int,
    settle_ties: bool = True,
    names: str = "points and queries",
) -> Tensor:
    """The `k` nearest points of every query, by distance and then by index.

    Args:
        points: (..., N, 3).
        queries: (..., M, 3), same batch dimensions.
        k: how many, at most N.
        settle_ties: False is faster and leaves open which of equally near points is found, for
            what depends on the distance alone.
        names: of the caller's arguments; an error begins with them.

    Returns:
        (..., M, k) int64.

    Raises:
        ValueError: if squared distances overflow: no point would be the nearest.
    """
    *batch, m, _ = queries.shape
    points = at_least_float32(points).reshape(-1, points.shape[-2], 3)
    queries = at_least_float32(queries).reshape(-1, m, 3)
    _require_distances(points, queries, names)
    road = _nearest_by_trees if points.device.type == "cpu" else _nearest_by_blocks
    return road(points, queries, k, settle_ties).reshape(*batch, m, k)


def ball_indices(points: Tensor, queries: Tensor, radius: float, count: int) -> Tensor:
    """For every query the first `count` points closer than `radius`, filled up with the first.

    Args:
        points: (B, N, 3) as `at_least_float32` gives them.
        queries: (B, M, 3).
        radius: of the balls.
        count: how many indices per ball.

    Returns:
        (B, M, count) int64; -1 where a ball is empty.

    Raises:
        ValueError: if squared distances overflow.
    """
    _require_distances(points, queries, "points and queries")
    by_trees = points.device.type == "cpu" and _balls_are_small(points, queries, radius)
    road = _balls_by_trees if by_trees else _balls_by_blocks
    return road(points, queries, radius, count)


def _require_distances(points: Tensor, queries: Tensor, names: str) -> None:
    """Refuse what has no squared distances, before trees and sorting take it for anything."""
    low = torch.minimum(points.amin(1), queries.amin(1))
    high = torch.maximum(points.amax(1), queries.amax(1))
    reach = (high - low).square().sum(-1)
    require_finite(names, reach, "points whose squared distances are finite")


def _nearest_by_blocks(points: Tensor, queries: Tensor, k: int, settle_ties: bool) -> Tensor:
    found = []
    for squared in _squared_distance_blocks(points, queries):
        near, indices = squared.topk(min(k + 1, points.shape[1]), largest=False)
        if settle_ties and bool((near[..., 1:] == near[..., :-1]).any()):
            indices = squared.sort(stable=True).indices
        found.append(indices[..., :k])
    return torch.cat(found, dim=1)


def _nearest_by_trees(points: Tensor, queries: Tensor, k: int, settle_ties: bool) -> Tensor:
    def search(tree: cKDTree, cloud: np.ndarray, centres: np.ndarray) -> np.ndarray:
        if settle_ties:
            return _nearest_by_index(tree, cloud, centres, k)
        return tree.query(centres, np.arange(1, k + 1))[1]

    return _search_trees(search, points, queries, k)


def _nearest_by_index(tree: cKDTree, points: np.ndarray, queries: np.ndarray, k: int) -> np.ndarray:
    # The tree measures in float64 and leaves the order of ties open. So it is asked for one point
    # more than is wanted, and for twice as many again where the last may be as near as the k-th.
    n = len(points)
    indices = np.empty((len(queries), k), dtype=np.int64)
    rows, size = np.arange(len(queries)), k + 1
    rounding = 16 * np.finfo(points.dtype).eps  # several times that of a sum of three squares
    while len(rows):
        size = min(size, n)
        distance, found = tree.query(queries[rows], np.arange(1, size + 1))
        clear = (distance[:, :-1] < distance[:, 1:] * (1 - rounding)).all(axis=1)
        indices[rows[clear]] = found[clear, :k]
        rows, found = rows[~clear], found[~clear]
        squared = _squared_norm(points[found] - queries[rows, None])
        order = np.lexsort((found, squared))
        found = np.take_along_axis(found, order, axis=1)
        squared = np.take_along_axis(squared, order, axis=1)
        settled = (squared[:, k - 1] < squared[:, -1] * (1 - rounding)) | (size == n)
        indices[rows[settled]] = found[settled, :k]
        rows, size = rows[~settled], 2 * size
    return indices


def _balls_by_blocks(points: Tensor, queries: Tensor, radius: float, count: int) -> Tensor:
    limit = _squared_radius(points, radius)
    n = points.shape[1]
    found = []
    for squared in _squared_distance_blocks(points, queries):
        hits = np.flatnonzero((squared < limit).cpu().numpy())  # faster than PyTorch's nonzero
        balls = _first_hits(hits, squared.shape[:2].numel(), n, count)
        found.append(balls.reshape(*squared.shape[:2], count))
    return torch.from_numpy(np.concatenate(found, axis=1)).to(points.device)


def _balls_by_trees(points: Tensor, queries: Tensor, radius: float, count: int) -> Tensor:
    limit = _squared_radius(points, radius)

    def search(tree: cKDTree, cloud: np.ndarray, centres: np.ndarray) -> np.ndarray:
        # A little more than the radius, because the tree rounds differently.
        pairs = _tree(centres).sparse_distance_matrix(tree, 1.001 * radius, output_type="ndarray")
        row, column = pairs["i"], pairs["j"]
        inside = _squared_norm(cloud[column] - centres[row]) < limit
        hits = np.sort((row * len(cloud) + column)[inside])
        return _first_hits(hits, len(centres), len(cloud), count)

    return _search_trees(search, points, queries, count)


def _first_hits(hits: np.ndarray, m: int, n: int, count: int) -> np.ndarray:
    """From the sorted positions of the hits in a mask (m, n), `count` columns for every row."""
    bounds = hits.searchsorted(n * np.arange(m + 1))
    first, last = bounds[:-1, None], bounds[1:, None]  # of the hits of each row
    slots = first + np.arange(count)
    np.copyto(slots, first, where=slots >= last)
    columns = np.append(hits % n, -1)[slots]  # the last row may begin after the last hit
    columns[first[:, 0] == last[:, 0]] = -1
    return columns


def _search_trees(
    search: Callable[[cKDTree, np.ndarray, np.ndarray], np.ndarray],
    points: Tensor,
    queries: Tensor,
    size: int,
) -> Tensor:
    """Indices (B, M, size): `search` applied to each cloud and some of its queries, in threads."""
    clouds, centres = points.numpy(), queries.numpy()
    trees = _in_threads(_tree, clouds)
    indices = np.empty((*centres.shape[:2], size), dtype=np.int64)

    def fill(part: tuple[int, slice]) -> None:
        indices[part] = search(trees[part[0]], clouds[part[0]], centres[part])

    begins = range(0, centres.shape[1], _QUERIES)
    _in_threads(fill, [(i, slice(b, b + _QUERIES)) for i in range(len(clouds)) for b in begins])
    return torch.from_numpy(indices)


def _balls_are_small(points: Tensor, queries: Tensor, radius: float) -> bool:
    """Whether trees will be faster, judged by a few balls of the first cloud."""
    if len(points) == 0:
        return False
    some = queries[0, :: max(1, queries.shape[1] // 32)].numpy()
    held = _tree(points[0].numpy()).query_ball_point(some, radius, return_length=True)
    return bool(held.mean() < _SMALL_BALL * points.shape[1])


def _squared_distance_blocks(points: Tensor, queries: Tensor) -> Iterator[Tensor]:
    """All squared distances (B, M, N), some queries at a time."""
    x, y, z = points.mT.contiguous()[:, :, None].unbind(1)  # (B, 1, N) each
    size = max(1, _BLOCK // max(1, x.numel()))
    for begin in range(0, queries.shape[1], size):
        a, b, c = queries[:, begin : begin + size, :, None].unbind(2)  # (B, size, 1) each
        yield (x - a).square_().add_((y - b).square_()).add_((z - c).square_())


def _squared_norm(difference: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(difference * difference, -1, 0)
    return x + y + z


def _squared_radius(points: Tensor, radius: float) -> float:
    return points.new_tensor(radius * radius).item()  # rounded as the distances are


def _tree(points: np.ndarray) -> cKDTree:
    return cKDTree(points, balanced_tree=False)  # built faster, searched as fast


def _in_threads(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """The results for all items; trees are built and searched without Python's global lock."""
    if len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        return list(pool.map(function, items))
