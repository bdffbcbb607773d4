"""How far an estimated pose is from the true one, measured on the points of the object's model.

Every function takes the estimate `(R_est, t_est)`, the ground truth `(R_gt, t_gt)` and model points
in the object's frame. Leading batch dimensions broadcast. Any matrix is accepted as R, because
published ground truth is not always exactly a rotation.

A symmetric object looks the same after a transform S of its own frame. Its symmetries come as
homogeneous matrices (S, 4, 4) that include the identity; the error is then that of the best one.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from contextvars import ContextVar

import numpy as np
import torch
from scipy.spatial import ConvexHull, QhullError, cKDTree
from torch import Tensor

from posecore import cameras, poses
from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_finite,
    somewhere,
    values_known,
)
from posecore.metrics import motions
from posecore.rotations import rotation_defect

__all__ = ["add", "add_s", "mspd", "mssd", "projection_2d", "threads_for_searches"]

POSES = {"R_est": "... 3 3", "t_est": "... 3", "R_gt": "... 3 3", "t_gt": "... 3"}
MOVED = "R_est, t_est, R_gt, t_gt and points"
MAX_POINTS = 1_000_000  # points posed at once: some 25 MB each time, which is used again and again
SORT_FROM = 20_000  # points from which a search in the order of their places is faster
INTERLEAVED = np.array([sum((i >> b & 1) << 3 * b for b in range(5)) for i in range(32)], np.uint16)
SEARCHERS: ContextVar[int | None] = ContextVar("SEARCHERS", default=None)


@contextlib.contextmanager
def threads_for_searches() -> Iterator[None]:
    """Within it only the searches of ADD-S use several threads, as many as PyTorch else may.

    PyTorch's own share the work of every single operation and wait for each other by spinning. Of
    operations that are over in a millisecond this gains little on free cores, and on cores that
    others use too it takes a multiple of the time of one thread. A search takes long and shares
    nothing. With one thread sums are also taken in the same order whatever the number.
    """
    threads = torch.get_num_threads()
    token = SEARCHERS.set(threads)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        SEARCHERS.reset(token)


@array_function(**POSES, points="... N 3")
def add(R_est: Array, t_est: Array, R_gt: Array, t_gt: Array, points: Array) -> Array:
    """ADD: the mean distance between model points in the estimated and in the true pose.

    Hinterstoisser et al., Model Based Training, Detection and Pose Estimation of Texture-Less 3D
    Objects in Heavily Cluttered Scenes, ACCV 2012 (average distance of model points).

    Args:
        R_est, t_est, R_gt, t_gt: (..., 3, 3) and (..., 3) poses, metres.
        points: (..., N, 3) model points, metres.

    Returns:
        (...) metres.
    """
    # Both poses move the same point, so their difference is itself one affine map of the point.
    return _over_rows(
        lambda R, t, x: _mean(poses.apply(R, t, x).norm(dim=-1)),
        (R_est - R_gt, 2),
        (t_est - t_gt, 1),
        (points, 2),
        per_row=points.shape[-2],
    )


@array_function(**POSES, points="... N 3")
def add_s(
    R_est: Array,
    t_est: Array,
    R_gt: Array,
    t_gt: Array,
    points: Array,
    direction: str = "gt_to_est",
) -> Array:
    """ADD-S: like ADD, but every point is compared with the nearest one, whichever that is.

    Same source as `add`. Print differs from code: the evaluation that the benchmarks use
    measures from every ground-truth point to the nearest estimated one; CIPE (Eq 12) writes the
    other way. The two differ where the model's points are unevenly spread.

    Args:
        R_est, t_est, R_gt, t_gt: (..., 3, 3) and (..., 3) poses, metres.
        points: (..., N, 3) model points, metres.
        direction: "gt_to_est" (default) or "est_to_gt".

    Returns:
        (...) metres.

    Raises:
        ValueError: if `direction` is neither of the two, or a pose takes points so far that they
            are no numbers.
    """
    require_choice("direction", direction, ("gt_to_est", "est_to_gt"))
    given = {"R_est": R_est, "t_est": t_est, "R_gt": R_gt, "t_gt": t_gt, "points": points}
    for name, values in given.items():
        require_finite(name, values)  # a search would find something near to what is no number
    from_R, from_t, to_R, to_t = R_gt, t_gt, R_est, t_est
    if direction == "est_to_gt":
        from_R, from_t, to_R, to_t = to_R, to_t, from_R, from_t
    rigid = rotation_defect(to_R) <= 1e-5  # false for NaN, where the squares overflow
    if points.ndim > 2 or not bool(rigid.all()):
        return _over_rows(
            _mean_nearest_distance,
            (from_R, 2),
            (from_t, 1),
            (to_R, 2),
            (to_t, 1),
            (points, 2),
            per_row=MAX_POINTS,  # one row at a time: every row has a cloud of its own
        )
    # A rigid motion keeps distances: seen from the frame of the second pose, all rows search in
    # one and the same cloud, the model. Its points are taken in the order of the tree's leaves,
    # so that one search begins where the last one ended.
    R, t = to_R.mT @ from_R, (to_R.mT @ (from_t - to_t)[..., None])[..., 0]
    tree = _tree(points)
    ordered = points[torch.from_numpy(tree.indices).to(points.device)]
    return _over_rows(
        lambda R, t: _nearest_distance(poses.apply(R, t, ordered), points, tree).mean(-1),
        (R, 2),
        (t, 1),
        per_row=points.shape[-2],
    )


def _mean_nearest_distance(
    from_R: Tensor, from_t: Tensor, to_R: Tensor, to_t: Tensor, points: Tensor
) -> Tensor:
    """One row of `add_s`, as it is defined."""
    there = poses.apply(to_R, to_t, points)[0]
    require_finite(MOVED, there, "a pose that keeps points finite")
    return _nearest_distance(poses.apply(from_R, from_t, points), there, _tree(there)).mean(-1)


def _tree(cloud: Tensor) -> cKDTree:
    return cKDTree(cloud.detach().cpu().numpy(), leafsize=16)


def _nearest_distance(queries: Tensor, cloud: Tensor, tree: cKDTree) -> Tensor:
    """From each of `queries` (B, M, 3) to the nearest point of `cloud` (N, 3): (B, M)."""
    require_finite(MOVED, queries, "a pose that keeps points finite")
    flat = queries.detach().reshape(-1, 3).cpu().numpy()
    # As many threads as PyTorch may have: who gives it one core means that core.
    workers = SEARCHERS.get() or torch.get_num_threads()
    if len(flat) < SORT_FROM:
        _, index = tree.query(flat, workers=workers)
    else:
        order = _order_in_space(flat)
        index = np.empty(len(flat), dtype=np.int64)
        _, index[order] = tree.query(flat.take(order, axis=0), workers=workers)
    index = np.minimum(index, len(cloud) - 1)  # SciPy names no point whose distance overflows
    nearest = cloud[torch.from_numpy(index).to(cloud.device)].reshape(queries.shape)
    # Measured again, so that gradients flow and the precision is that of the input.
    return (queries - nearest).norm(dim=-1)


def _order_in_space(points: np.ndarray) -> np.ndarray:
    """An order of points (n, 3) in which what is near follows: Morton's, of 32^3 cells.

    The searches of many poses then take one way through the tree again and again, and the
    processor foresees it.
    """
    x = points.T.copy()
    low, high = x.min(1, keepdims=True), x.max(1, keepdims=True)
    with np.errstate(all="ignore"):  # of points that overflow the order does not matter
        x -= low
        x *= len(INTERLEAVED) / np.maximum(high - low, np.finfo(x.dtype).tiny)
        i, j, k = x.astype(np.uint8)
    code = INTERLEAVED.take(i, mode="clip")
    code |= (INTERLEAVED << 1).take(j, mode="clip")
    code |= (INTERLEAVED << 2).take(k, mode="clip")
    return code.argsort(kind="stable")  # of 16 bits: a radix sort


@array_function(**POSES, points="N 3", symmetries="S 4 4")
def mssd(
    R_est: Array,
    t_est: Array,
    R_gt: Array,
    t_gt: Array,
    points: Array,
    symmetries: Array | None = None,
) -> Array:
    """MSSD: the largest distance between corresponding model points, at the best symmetry.

    Hodan et al., BOP Challenge 2020 on 6D Object Localization, ECCVW 2020, Eq 2 (maximum
    symmetry-aware surface distance).

    Args:
        R_est, t_est, R_gt, t_gt: (..., 3, 3) and (..., 3) poses, metres.
        points: (N, 3) model points, metres.
        symmetries: (S, 4, 4), metres, or None for an object without symmetries.

    Returns:
        (...) metres.
    """
    # The distance is a convex function of the point, so its maximum lies on the convex hull.
    corners = points[_hull_vertices(points)]
    R_gt, t_gt = motions.at_best_motion(
        motions.best_for_points, symmetries, corners, (R_est, t_est, R_gt, t_gt)
    )
    return _over_rows(
        lambda R, t: _largest(poses.apply(R, t, corners).norm(dim=-1)),
        (R_est - R_gt, 2),
        (t_est - t_gt, 1),
        per_row=len(corners),
    )


@array_function(K="... 3 3", **POSES, points="N 3", symmetries="S 4 4")
def mspd(
    K: Array,
    R_est: Array,
    t_est: Array,
    R_gt: Array,
    t_gt: Array,
    points: Array,
    symmetries: Array | None = None,
) -> Array:
    """MSPD: the largest pixel distance between projected model points, at the best symmetry.

    Same source as `mssd`, Eq 3 (maximum symmetry-aware projection distance).

    Args:
        K: (..., 3, 3) intrinsics.
        R_est, t_est, R_gt, t_gt: (..., 3, 3) and (..., 3) poses, metres.
        points: (N, 3) model points, metres.
        symmetries: (S, 4, 4), metres, or None for an object without symmetries.

    Returns:
        (...) pixels; infinite where the estimate puts a point behind the camera.

    Raises:
        ValueError: if the ground truth puts a point behind the camera.
    """
    R_gt, t_gt = motions.at_best_motion(
        motions.best_for_pixels, symmetries, points, (K, R_est, t_est, R_gt, t_gt)
    )
    return _pixel_distance(K, R_est, t_est, R_gt, t_gt, points, _largest)


@array_function(K="... 3 3", **POSES, points="... N 3")
def projection_2d(
    K: Array, R_est: Array, t_est: Array, R_gt: Array, t_gt: Array, points: Array
) -> Array:
    """The mean pixel distance between model points projected by both poses.

    Brachmann et al., Uncertainty-Driven 6D Pose Estimation of Objects and Scenes from a Single RGB
    Image, CVPR 2016; a pose is commonly called correct under 5 px.

    Args:
        K: (..., 3, 3) intrinsics.
        R_est, t_est, R_gt, t_gt: (..., 3, 3) and (..., 3) poses, metres.
        points: (..., N, 3) model points, metres.

    Returns:
        (...) pixels; infinite where the estimate puts a point behind the camera.

    Raises:
        ValueError: if the ground truth puts a point behind the camera.
    """
    return _pixel_distance(K, R_est, t_est, R_gt, t_gt, points, _mean)


def _largest(values: Tensor) -> Tensor:
    return values.amax(-1)


def _mean(values: Tensor) -> Tensor:
    return values.mean(-1)


def _pixel_distance(
    K: Tensor,
    R_est: Tensor,
    t_est: Tensor,
    R_gt: Tensor,
    t_gt: Tensor,
    points: Tensor,
    reduce: Callable[[Tensor], Tensor],
) -> Tensor:
    def distance(
        K: Tensor, R_est: Tensor, t_est: Tensor, R_gt: Tensor, t_gt: Tensor, points: Tensor
    ) -> Tensor:
        seen = poses.apply(R_est, t_est, points)
        require_finite("R_est, t_est and points", seen, "a pose that keeps points finite")
        hidden = seen[..., 2] <= 0
        # Any point in front of the camera in their place, so that their gradient is 0, not NaN.
        seen = torch.where(hidden[..., None], seen.new_tensor([0.0, 0.0, 1.0]), seen)
        pixels = cameras.project(K, seen)
        there = poses.apply(R_gt, t_gt, points)
        require_finite("R_gt, t_gt and points", there, "a pose that keeps points finite")
        behind = there[..., 2] <= 0
        if somewhere(behind):
            expected = "a ground truth in front of the camera"
            fail("t_gt", expected, f"{int(behind.sum())} points behind it")
        gaps = (pixels - cameras.project(K, there)).norm(dim=-1)
        return reduce(gaps.masked_fill(hidden, torch.inf))

    return _over_rows(
        distance,
        (K, 2),
        (R_est, 2),
        (t_est, 1),
        (R_gt, 2),
        (t_gt, 1),
        (points, 2),
        per_row=points.shape[-2],
    )


def _hull_vertices(points: Tensor) -> np.ndarray | slice:
    if not values_known():
        return slice(None)
    try:
        return ConvexHull(points.detach().cpu().numpy().astype(np.float64)).vertices
    except (QhullError, ValueError):  # too few points, or flat: every point may be extreme
        return slice(None)


def _over_rows(
    function: Callable[..., Tensor], *arguments: tuple[Tensor, int], per_row: int
) -> Tensor:
    """Call `function` on the arguments, their batch flattened, in pieces that fit the memory.

    Args:
        function: takes the arguments with one batch dimension and returns one value a row.
        arguments: pairs of a tensor and the number of its last dimensions that are not batch.
        per_row: how many points one row poses.
    """
    heads = [x.shape[: x.ndim - core] for x, core in arguments]
    batch = np.broadcast_shapes(*heads)
    rows = math.prod(batch)
    if rows == 0:
        return arguments[0][0].new_zeros(batch)
    step = max(1, MAX_POINTS // per_row)
    flat = [  # what all rows share stays one row, so that nothing is copied
        x.reshape(1, *x.shape[len(head) :])
        if math.prod(head) == 1
        else x.expand(*batch, *x.shape[len(head) :]).reshape(rows, *x.shape[len(head) :])
        for (x, _), head in zip(arguments, heads, strict=True)
    ]
    pieces = [
        function(*(x if len(x) == 1 else x[start : start + step] for x in flat))
        for start in range(0, rows, step)
    ]
    return torch.cat(pieces).reshape(batch)
