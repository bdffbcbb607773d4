"""Points without partners: iterative closest point between clouds, or a model and a depth image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from torch import Tensor

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_integer,
    require_number,
    to_numbers,
)
from posecore.cameras import depth_to_points
from posecore.registration.alignment import umeyama
from posecore.rotations import axis_angle_to_matrix, require_rotation, special_procrustes

__all__ = ["IcpResult", "icp", "refine_on_depth"]


class IcpResult(NamedTuple):
    """Where the iteration ended."""

    R: Array
    """(3, 3) rotation from source to target."""
    t: Array
    """(3,) translation."""
    rmse: float
    """Root mean square distance of the pairs in use at this pose."""
    inlier_count: int
    """How many source points have a partner in use at this pose."""
    inlier_fraction: float
    """The same, as a fraction of those that looked for one."""
    iterations: int
    """Steps taken, over all stages."""
    converged: bool
    """Whether the last stage ended because the pose stood still."""


class _Pairs(NamedTuple):
    source: np.ndarray  # (P, 3) at the current pose
    target: np.ndarray  # (P, 3) the point of the target nearest to each
    normals: np.ndarray | None  # (P, 3) of the tangent planes, where distances to planes count
    sought: int  # points that looked for a partner


@array_function(source="N 3", target="M 3", R="3 3", t="3", target_normals="M 3")
def icp(
    source: Array,
    target: Array,
    R: Array,
    t: Array,
    *,
    method: str = "point_to_point",
    target_normals: Array | None = None,
    max_distance: float | Sequence[float] | None = None,
    keep: float = 1.0,
    max_iterations: int = 50,
    tolerance: float = 1e-6,
) -> IcpResult:
    """Iterative closest point: pair each source point with its nearest target point, fit, repeat.

    "point_to_point" minimises the distances of the pairs (Besl & McKay 1992), by `umeyama`.
    "point_to_plane" minimises the distances to the target's tangent planes (Chen & Medioni 1992):
    points may slide along a surface, so it needs far fewer steps. The rotation is linearised (Low
    2004), the step then applied as an exact rotation. What the planes leave open, such as sliding
    along a flat target, stays as it is: of all steps that fit, the smallest is taken.

    Finds the minimum nearest to the initial pose. Computed in float64; no gradients.

    Args:
        source: (N, 3) points to be moved.
        target: (M, 3) points that stay.
        R, t: (3, 3) and (3,), the initial pose, from source to target.
        method: "point_to_point" or "point_to_plane".
        target_normals: (M, 3) unit normals, for "point_to_plane"; their sign does not matter.
        max_distance: pairs farther apart do not count; a sequence is a schedule of stages, from
            coarse to fine. None: all pairs count.
        keep: the closest fraction of the pairs that counts, in (0, 1]; less than one where source
            points have no true partner (trimmed ICP, Chetverikov et al. 2002).
        max_iterations: the most steps in each stage.
        tolerance: a stage ends when a step moves no point by more than this times the source's
            radius.

    Returns:
        An `IcpResult`.

    Raises:
        ValueError: if `R` is not a rotation; if normals are missing or not of length one; if fewer
            than three pairs are within `max_distance`; if pairs fitted point to point lie on one
            line.
    """
    require_choice("method", method, ["point_to_point", "point_to_plane"])
    to_planes = method == "point_to_plane"
    if to_planes:
        if target_normals is None:
            fail("target_normals", "unit normals for point_to_plane", None)
        _require_unit("target_normals", target_normals)
    stages = [np.inf] if max_distance is None else _schedule(max_distance)
    points, scene = to_numbers("source", source), to_numbers("target", target)
    normals = to_numbers("target_normals", target_normals) if to_planes else None
    keep = require_number("keep", keep, high=1, above=0)
    tree = cKDTree(scene)

    def find_pairs(R: np.ndarray, t: np.ndarray, limit: float) -> _Pairs:
        moved = points @ R.T + t
        mine, theirs = _nearest(tree, moved, limit, keep)
        planes = None if normals is None else normals[theirs]
        return _Pairs(moved[mine], scene[theirs], planes, len(points))

    return _iterate(find_pairs, R, t, stages, _radius(points), max_iterations, tolerance)


@array_function(depth="H W", K="3 3", model_points="N 3", model_normals="N 3", R="3 3", t="3")
def refine_on_depth(
    depth: Array,
    K: Array,
    model_points: Array,
    model_normals: Array,
    R: Array,
    t: Array,
    *,
    max_distance: float | Sequence[float] | None = None,
    keep: float = 0.9,
    max_iterations: int = 30,
    tolerance: float = 1e-3,
) -> IcpResult:
    """Refine an object's pose on a depth image by point-to-plane ICP; no mask is needed.

    At every step the model points that face the camera look for their nearest scene points, and
    the scene's distances to the model's tangent planes are minimised: the normals of a mesh are
    exact, those of a depth image are noisy. Model points without a true partner, hidden or lost by
    the sensor, drop out by `max_distance` and `keep`. (Searched from the scene to the model, the
    clutter around the object would pull.)

    Args:
        depth: (H, W) metres along the optical axis, 0 where there is none.
        K: (3, 3) camera matrix.
        model_points: (N, 3) points of the model's surface, spread evenly; some thousands will do.
        model_normals: (N, 3) their outward unit normals.
        R, t: (3, 3) and (3,), the initial pose, from object to camera.
        max_distance: as in `icp`; the first about as large as the error to be mended. None: 0.15,
            0.1 and 0.05 times the model's size.
        keep, max_iterations, tolerance: as in `icp`.

    Returns:
        An `IcpResult`; `inlier_fraction` is that of the model points which face the camera.

    Raises:
        ValueError: if `R` is not a rotation, normals are not of length one, depth is negative, the
            depth image has no point near the initial pose, or fewer than three pairs are within
            `max_distance`.
    """
    require_rotation("R", R)
    _require_unit("model_normals", model_normals)
    keep = require_number("keep", keep, high=1, above=0)
    points, normals = (
        to_numbers("model_points", model_points),
        to_numbers("model_normals", model_normals),
    )
    radius = _radius(points)
    if max_distance is None:
        max_distance = [0.3 * radius, 0.2 * radius, 0.1 * radius]
    stages = _schedule(max_distance)
    centre = to_numbers("R", R) @ _middle(points) + to_numbers("t", t)
    # Twice: the surface may be off by the first distance, and find its partners as far again.
    scene = _points_near(depth, K, centre, radius + 2 * stages[0])
    tree = cKDTree(scene)

    def find_pairs(R: np.ndarray, t: np.ndarray, limit: float) -> _Pairs:
        moved, turned = points @ R.T + t, normals @ R.T
        facing = np.flatnonzero((moved * turned).sum(1) < 0)
        mine, theirs = _nearest(tree, moved[facing], limit, keep)
        mine = facing[mine]
        return _Pairs(moved[mine], scene[theirs], turned[mine], len(facing))

    return _iterate(find_pairs, R, t, stages, radius, max_iterations, tolerance)


def _points_near(depth: Tensor, K: Tensor, centre: np.ndarray, reach: float) -> np.ndarray:
    slab = (depth > 0) & ((depth - centre[2]).abs() <= reach)
    if bool(slab.any()):
        points = to_numbers("depth", depth_to_points(depth, K, slab))
        points = points[np.linalg.norm(points - centre, axis=1) <= reach]
        if len(points):
            return points
    fail("depth", f"points within {reach:.4g} of the initial pose's {centre.round(4)}", "none")


def _iterate(
    find_pairs: Callable[[np.ndarray, np.ndarray, float], _Pairs],
    R_first: Tensor,
    t_first: Tensor,
    stages: Sequence[float],
    radius: float,
    max_iterations: int,
    tolerance: float,
) -> IcpResult:
    """Fit and pair again until nothing moves, stage by stage."""
    require_rotation("R", R_first)
    max_iterations = require_integer("max_iterations", max_iterations, 1)
    still = require_number("tolerance", tolerance, 0) * radius
    # A product of rotations stays as orthonormal as its first factor.
    R, t = special_procrustes(to_numbers("R", R_first)), to_numbers("t", t_first)
    iterations, converged = 0, False
    for limit in stages:
        for _ in range(max_iterations):
            pairs = _enough(find_pairs(R, t, limit), limit)
            step_R, step_t = _step(pairs)
            R, t = step_R @ R, step_R @ t + step_t
            iterations += 1
            moves = pairs.source @ step_R.T + step_t - pairs.source
            converged = bool(np.linalg.norm(moves, axis=1).max() <= still)
            if converged:
                break
    pairs = _enough(find_pairs(R, t, stages[-1]), stages[-1])
    count = len(pairs.source)
    return IcpResult(
        R=R_first.new_tensor(R),
        t=t_first.new_tensor(t),
        rmse=float(np.sqrt(np.square(pairs.source - pairs.target).sum(1).mean())),
        inlier_count=count,
        inlier_fraction=count / pairs.sought,
        iterations=iterations,
        converged=converged,
    )


def _step(pairs: _Pairs) -> tuple[np.ndarray, np.ndarray]:
    """The motion (R, t) of the source points that fits their partners best."""
    if pairs.normals is None:
        _, R, t = umeyama(pairs.source, pairs.target)
        return R, t
    # Turning about the pairs' middle, measured in arc length, makes the six unknowns comparable, so
    # that the smallest step is small in the points' motion.
    middle = pairs.source.mean(0)
    arms = pairs.source - middle
    arm = np.linalg.norm(arms, axis=1).max() or 1.0
    A = np.concatenate([np.cross(arms / arm, pairs.normals), pairs.normals], axis=1)
    b = ((pairs.target - pairs.source) * pairs.normals).sum(1)
    x = np.linalg.lstsq(A, b, rcond=1e-6)[0]
    R = axis_angle_to_matrix(x[:3] / arm)
    return R, middle + x[3:] - R @ middle


def _nearest(
    tree: cKDTree, points: np.ndarray, limit: float, keep: float
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the closest fraction `keep` of the points with a partner, and of the partners."""
    if not np.isfinite(points).all():
        fail("R and t", "a pose that keeps points finite", "one that takes some beyond all numbers")
    distance, index = tree.query(points, distance_upper_bound=limit)
    found = np.flatnonzero(np.isfinite(distance))
    if keep < 1:
        order = np.argsort(distance[found], kind="stable")
        found = found[order[: int(np.ceil(keep * len(found)))]]
    return found, index[found]


def _enough(pairs: _Pairs, limit: float) -> _Pairs:
    if len(pairs.source) < 3:
        fail(
            "max_distance" if np.isfinite(limit) else "source",
            f"at least 3 pairs within {limit:.4g}",
            f"{len(pairs.source)} of {pairs.sought} points with a partner",
        )
    return pairs


def _schedule(max_distance: float | Sequence[float]) -> list[float]:
    given = [max_distance] if np.ndim(max_distance) == 0 else list(max_distance)  # type: ignore
    stages = [require_number("max_distance", distance, above=0) for distance in given]
    if not stages or stages != sorted(stages, reverse=True):
        fail("max_distance", "distances from coarse to fine", max_distance)
    return stages


def _require_unit(name: str, normals: Tensor) -> None:
    off = (normals.norm(dim=-1) - 1).abs()
    if bool((off > 1e-3).any()):
        fail(
            name, "vectors of length 1", f"{int((off > 1e-3).sum())} of {len(normals)} that are not"
        )


def _middle(points: np.ndarray) -> np.ndarray:
    return (points.min(0) + points.max(0)) / 2


def _radius(points: np.ndarray) -> float:
    return float(np.linalg.norm(points - _middle(points), axis=1).max())
