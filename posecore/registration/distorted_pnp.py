"""Poses from the pixels of a picture that was taken through a lens."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, to_numbers
from posecore.distortion import project_distorted, undistort_points
from posecore.registration.planar import Pose as _Pose
from posecore.registration.pnp import _STOP, PnpResult, pnp

__all__ = ["pnp_distorted"]

ROUNDS = 10  # of inliers and poses, until they stand still


@array_function(points_3d="N 3", points_2d="N 2", K="3 3", distortion="D", R="3 3", t="3")
def pnp_distorted(
    points_3d: Array,
    points_2d: Array,
    K: Array,
    distortion: Array,
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
    """The pose of an object from pixels of a picture with lens distortion: `pnp` for it.

    The pixels are undistorted, `pnp` finds the pose. That of "iterative" and "ransac" is then
    refined on the pixels as they were measured, with the lens in the projection (by
    Levenberg-Marquardt again): undistorted, errors at the rim would have other weights.

    Args:
        points_3d: (N, 3) points of the object, at least four different ones not on one line.
        points_2d: (N, 2) their pixels in the picture as it was taken.
        K: (3, 3) camera matrix without skew.
        distortion: (D,) with D of 4, 5 or 8: k1, k2, p1, p2, then k3, then k4, k5, k6.
        method: as in `pnp`.
        R, t: (3, 3) and (3,), an initial pose for "iterative".
        threshold: pixels of the picture; how far an inlier may be from its projection ("ransac").
        confidence, max_iterations, min_inliers, seed: as in `pnp`.

    Returns:
        A `PnpResult`; its reprojection error is in pixels of the picture.

    Raises:
        ValueError: as `pnp` does; if there are not 4, 5 or 8 coefficients; if no ray leads through
            the lens to a pixel, unless "ransac" may leave it out.
    """
    pinhole = undistort_points(points_2d, K, distortion, "inf" if method == "ransac" else "refuse")
    usable = torch.isfinite(pinhole).all(-1)
    if int(usable.sum()) < 4:
        got = f"{int(usable.sum())} of {len(usable)}"
        fail("points_2d", "at least 4 pixels to which a ray leads through the lens", got)
    found = pnp(
        points_3d[usable],
        pinhole[usable],
        K,
        method,
        R=R,
        t=t,
        threshold=threshold,
        confidence=confidence,
        max_iterations=max_iterations,
        min_inliers=min_inliers,
        seed=seed,
    )
    problem = _Problem(points_3d, points_2d, K, distortion)
    pose = problem.begin(found)
    inliers = np.zeros(len(usable), bool)
    inliers[usable.cpu().numpy()] = found.inliers.cpu().numpy()
    if method == "iterative":
        pose = problem.refined(pose, inliers)
    elif method == "ransac":
        for _ in range(ROUNDS):
            pose = problem.refined(pose, inliers)
            before, inliers = inliers, problem.errors(pose) <= threshold
            if (inliers == before).all():
                break
            if inliers.sum() < min_inliers:
                expected = f"{min_inliers} that agree with one pose to {threshold} px"
                fail("points_2d", expected, f"no such consensus among {len(inliers)}")
    rotation = cv2.Rodrigues(pose[0])[0]
    shift = pose[1][:, 0] * problem.size - rotation @ problem.middle
    return PnpResult(
        R=points_3d.new_tensor(rotation),
        t=points_3d.new_tensor(shift),
        inliers=torch.from_numpy(inliers).to(points_3d.device),
        reprojection_error=float(np.sqrt(np.square(problem.errors(pose)[inliers]).mean())),
    )


class _Problem:
    """The points and pixels for OpenCV, those of the object centred and scaled as in `pnp`."""

    def __init__(self, points_3d: Array, points_2d: Array, K: Array, distortion: Array) -> None:
        points = to_numbers("points_3d", points_3d)
        self.middle = points.mean(0)
        self.size = float(np.sqrt(np.square(points - self.middle).sum(1).mean()))
        self.object = (points - self.middle) / self.size
        self.image = to_numbers("points_2d", points_2d)
        self.K, self.distortion = to_numbers("K", K), to_numbers("distortion", distortion)

    def begin(self, found: PnpResult) -> _Pose:
        """A pose that was found, of the points as they are here."""
        R, t = to_numbers("R", found.R), to_numbers("t", found.t)
        return cv2.Rodrigues(R)[0], ((t + R @ self.middle) / self.size)[:, None]

    def refined(self, pose: _Pose, chosen: np.ndarray) -> _Pose:
        """The pose of least error in the picture near one, or that one where none is better."""
        new = cv2.solvePnPRefineLM(
            self.object[chosen],
            self.image[chosen],
            self.K,
            self.distortion,
            pose[0].copy(),
            pose[1].copy(),
            _STOP,
        )
        # OpenCV does not know where a lens ends.
        errors = [np.square(self.errors(p)[chosen]).sum() for p in (pose, new)]
        return new if errors[1] <= errors[0] else pose

    def errors(self, pose: _Pose) -> np.ndarray:
        """Distance of each point from its projection in pixels, (N,); infinite without one."""
        if not (np.isfinite(pose[0]).all() and np.isfinite(pose[1]).all()):
            return np.full(len(self.object), np.inf)
        camera = self.object @ cv2.Rodrigues(pose[0])[0].T + pose[1][:, 0]
        pixels = project_distorted(self.K, camera, self.distortion, behind="inf")
        return np.linalg.norm(pixels - self.image, axis=1)
