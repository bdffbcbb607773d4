"""Points of an object and where they are in a picture: the object's pose, solved by OpenCV."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_integer,
    require_number,
    to_numbers,
)
from posecore.cameras import project, require_intrinsics
from posecore.registration.planar import Pose as _Pose
from posecore.registration.planar import better, planar_poses
from posecore.rotations import require_rotation

__all__ = ["PnpResult", "pnp"]

_SOLVERS = {
    "sqpnp": cv2.SOLVEPNP_SQPNP,
    "epnp": cv2.SOLVEPNP_EPNP,
    "ippe": cv2.SOLVEPNP_IPPE,
}
_THIN = 1e-6  # points that spread less across a line than this, relative to along it, are on it
_FLAT = 1e-2  # flatter than this, EPnP fails once in eight times and more; IPPE works up to here
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-12)


class PnpResult(NamedTuple):
    """The pose found and how well it fits."""

    R: Array
    """(3, 3) rotation from object to camera."""
    t: Array
    """(3,) translation in the unit of the object's points."""
    inliers: Array
    """(N,) bool: the points that count; all of them unless the method is "ransac"."""
    reprojection_error: float
    """Root mean square distance in pixels between the inliers and their projections."""


class _Points(NamedTuple):
    """Matched points; the object's are centred and scaled to unit size.

    OpenCV 5.0's SQPnP fails on objects smaller than a millimetre if the unit is the metre, and its
    RANSAC works in float32, which holds few digits of an object far from its origin.
    """

    object: np.ndarray  # (N, 3)
    image: np.ndarray  # (N, 2)
    K: np.ndarray


@array_function(points_3d="N 3", points_2d="N 2", K="3 3", R="3 3", t="3")
def pnp(
    points_3d: Array,
    points_2d: Array,
    K: Array,
    method: str = "iterative",
    *,
    R: Array | None = None,
    t: Array | None = None,
    threshold: float = 4.0,
    confidence: float = 0.999,
    max_iterations: int = 1000,
    min_inliers: int = 4,
    seed: int = 0,
) -> PnpResult:
    """The pose of an object from points whose pixels are known (Perspective-n-Point).

    - "iterative": least reprojection error, by Levenberg-Marquardt from the initial pose if given;
      else from every solution of SQPnP, of IPPE for the points moved into one plane, and of AP3P
      if they are four, and the best end counts: few or nearly flat points often fit in two ways.
    - "sqpnp" (Terzakis & Lourakis 2020), "epnp" (Lepetit et al. 2009), "ippe" for flat targets
      (Collins & Bartoli 2014): the solver's own result, not refined.
    - "ransac": the largest set of points that agrees with one pose to `threshold`, and "iterative"
      on it, repeated until the set stands still.

    Computed in float64; no gradients; the same input gives the same result.

    Args:
        points_3d: (N, 3) points of the object, at least four different ones not on one line.
        points_2d: (N, 2) their pixels; of a picture with lens distortion, see `pnp_distorted`.
        K: (3, 3) camera matrix without skew, which OpenCV does not know.
        method: one of the above.
        R, t: (3, 3) and (3,), an initial pose for "iterative".
        threshold: pixels; how far an inlier may be from its projection ("ransac").
        confidence: probability, in (0, 1), of having drawn a sample without outliers ("ransac").
        max_iterations: most samples drawn ("ransac").
        min_inliers: fewer are no consensus; four may agree by chance ("ransac").
        seed: of the samples ("ransac").

    Returns:
        A `PnpResult`.

    Raises:
        ValueError: for the argument at fault: fewer than four different points, points on one line
            in space or in the picture, too few or too flat points for EPnP, points not flat for
            IPPE, a camera matrix that is singular or skewed, an initial pose that is incomplete or
            no rotation, no consensus, or no pose found with all points in front of the camera.
    """
    require_choice("method", method, ["iterative", *_SOLVERS, "ransac"])
    require_intrinsics("K", K)
    if bool(K[0, 1] != 0):
        fail("K", "no skew", float(K[0, 1]))
    X, x = to_numbers("points_3d", points_3d), to_numbers("points_2d", points_2d)
    _require_points(X, x)

    threshold = require_number("threshold", threshold, above=0)
    # OpenCV finds nothing if asked for certainty.
    confidence = require_number("confidence", confidence, high=1 - 1e-12, above=0)
    max_iterations = require_integer("max_iterations", max_iterations, 1)
    min_inliers = require_integer("min_inliers", min_inliers, 4)
    seed = require_integer("seed", seed, 0)
    start = _start(R, t, method)

    middle = X.mean(0)
    size = float(np.sqrt(np.square(X - middle).sum(1).mean()))
    points = _Points((X - middle) / size, x, to_numbers("K", K))
    if method == "ransac":
        pose, inliers = _consensus(points, threshold, confidence, max_iterations, min_inliers, seed)
    else:
        if start is not None:
            start = (start[0], (start[1] + cv2.Rodrigues(start[0])[0] @ middle[:, None]) / size)
        pose, inliers = _fit(points, method, start), np.ones(len(X), dtype=bool)

    rotation = cv2.Rodrigues(pose[0])[0]
    errors = _errors(points, pose)[inliers]
    return PnpResult(
        R=points_3d.new_tensor(rotation),
        t=points_3d.new_tensor(pose[1][:, 0] * size - rotation @ middle),
        inliers=torch.from_numpy(inliers).to(points_3d.device),
        reprojection_error=float(np.sqrt(np.square(errors).mean())),
    )


def _fit(points: _Points, method: str, start: _Pose | None = None) -> _Pose:
    """Of the poses that `method` finds, the one of least reprojection error."""
    flat = _is_flat(points.object)
    if start is not None:
        poses = [start]
    elif method == "iterative":
        poses = _solve(points, cv2.SOLVEPNP_SQPNP)
        if flat:
            poses += _solve(points, cv2.SOLVEPNP_IPPE)
        if len(points.object) == 4:
            poses += _solve(points, cv2.SOLVEPNP_AP3P)
    else:
        if method == "epnp" and (flat or len(points.object) < 5):
            got = "flat ones" if flat else len(points.object)
            fail("points_3d", "at least 5 points, not in one plane, for epnp", got)
        if method == "ippe" and not flat:
            fail("points_3d", "points in one plane for ippe", "points that are not")
        poses = _solve(points, _SOLVERS[method])
    if method == "iterative":
        poses = [_refined(points, pose) for pose in poses]
    errors = [np.square(_errors(points, pose)).sum() for pose in poses]
    if start is None and method in ("iterative", "ippe"):
        # Nearly flat points fit twice, and one solver sees one of the two; IPPE of OpenCV errs at
        # half turns.
        more = planar_poses(*points)
        if method == "iterative":
            more = [_refined(points, pose) for pose in more]
        for pose in more:
            error = np.square(_errors(points, pose)).sum()
            if better(error, min(errors, default=np.inf), len(points.object)):
                poses, errors = [*poses, pose], [*errors, error]
    if not errors or not np.isfinite(min(errors)):
        fail(
            "points_2d",
            "the picture of an object in front of the camera",
            f"pixels for which {method} finds no such pose",
        )
    return poses[int(np.argmin(errors))]


def _refined(points: _Points, pose: _Pose) -> _Pose:
    turn, shift = pose
    return cv2.solvePnPRefineLM(*points, None, turn.copy(), shift.copy(), _STOP)


def _solve(points: _Points, flag: int) -> list[_Pose]:
    """All solutions of one of OpenCV's solvers; none where it gives up."""
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(*points, None, flags=flag)
    except cv2.error:
        return []
    return list(zip(turns, shifts, strict=True))


def _consensus(
    points: _Points,
    threshold: float,
    confidence: float,
    max_iterations: int,
    min_inliers: int,
    seed: int,
) -> tuple[_Pose, np.ndarray]:
    """The pose that most points agree with, and which do, (N,) bool."""
    inliers = _sample_consensus(points, threshold, confidence, max_iterations, seed)
    for _ in range(10):
        pose = _fit_consensus(points, inliers, threshold, min_inliers)
        before, inliers = inliers, _errors(points, pose) <= threshold
        if (inliers == before).all():
            break
    else:
        pose = _fit_consensus(points, inliers, threshold, min_inliers)
    return pose, inliers


def _sample_consensus(
    points: _Points, threshold: float, confidence: float, max_iterations: int, seed: int
) -> np.ndarray:
    """OpenCV's largest set of points that agrees with one pose, (N,) bool.

    The pose that OpenCV returns with it is fitted with EPnP, which is wrong for flat targets.
    """
    # OpenCV draws the same numbers in every call, so the order of the points decides the samples.
    order = np.random.default_rng(seed).permutation(len(points.object))
    try:
        _, _, _, found = cv2.solvePnPRansac(
            points.object[order],
            points.image[order],
            points.K,
            None,
            iterationsCount=max_iterations,
            reprojectionError=threshold,
            confidence=confidence,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        found = None
    inliers = np.zeros(len(order), dtype=bool)
    if found is not None:
        inliers[order[found[:, 0]]] = True
    return inliers


def _fit_consensus(
    points: _Points, inliers: np.ndarray, threshold: float, min_inliers: int
) -> _Pose:
    chosen = _Points(points.object[inliers], points.image[inliers], points.K)
    try:
        if inliers.sum() < min_inliers:
            fail("points_2d", f"at least {min_inliers} inliers", int(inliers.sum()))
        _require_points(chosen.object, chosen.image)
        return _fit(chosen, "iterative")
    except ValueError as error:
        raise ValueError(
            f"points_2d: expected {min_inliers} that agree with one pose to {threshold} px, "
            f"got no such consensus among {len(inliers)} ({error})"
        ) from error


def _errors(points: _Points, pose: _Pose) -> np.ndarray:
    """Distance of each point from its projection in pixels, (N,); infinite behind the camera."""
    turn, shift = pose
    if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return np.full(len(points.object), np.inf)
    camera = points.object @ cv2.Rodrigues(turn)[0].T + shift[:, 0]
    pixels = project(points.K, camera, behind="inf")
    return np.linalg.norm(pixels - points.image, axis=1)


def _start(R: Array | None, t: Array | None, method: str) -> _Pose | None:
    if R is None and t is None:
        return None
    for name, value in (("R", R), ("t", t)):
        if value is None:
            fail(name, "both R and t of an initial pose, or none", None)
        if method != "iterative":
            fail(name, "an initial pose only for iterative", f"one for {method}")
    require_rotation("R", R)
    return cv2.Rodrigues(to_numbers("R", R))[0], to_numbers("t", t)[:, None]


def _require_points(X: np.ndarray, x: np.ndarray) -> None:
    different = len(np.unique(X, axis=0))
    if different < 4:
        fail("points_3d", "at least 4 different points", different)
    for name, points in (("points_3d", X), ("points_2d", x)):
        spread = _spread(points)
        if spread[1] <= _THIN * spread[0]:
            fail(name, "points that are not all on one line", f"{len(points)} that are")


def _is_flat(points: np.ndarray) -> bool:
    spread = _spread(points)
    return bool(spread[2] <= _FLAT * spread[0])


def _spread(points: np.ndarray) -> np.ndarray:
    """Extent along the principal axes, the longest first."""
    return np.linalg.svd(points - points.mean(0), compute_uv=False)
