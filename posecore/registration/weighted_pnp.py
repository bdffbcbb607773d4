"""A pose from pixels of which each is known with its own uncertainty."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, to_numbers
from posecore.registration.planar import better, mirror_pose
from posecore.registration.pnp import PnpResult, pnp

__all__ = ["uncertainty_pnp"]

_SYMMETRIC = 1e-5  # of the largest entry: what float32 may leave of symmetry
_ENOUGH = 4  # points for a pose
_WILD = 10.0  # times as unsure as the fourth surest: such points choose no start
_ITERATIONS = 100
_ROUNDING = 1e-12  # of the cost; near the minimum steps are right that no longer lower it
_STILL = 1e-11  # a step (radians, sizes of the object) shorter than this is the last


@array_function(points_3d="N 3", points_2d="N 2", covariances="N 2 2", K="3 3")
def uncertainty_pnp(points_3d: Array, points_2d: Array, covariances: Array, K: Array) -> PnpResult:
    """The pose of least reprojection error in units of each pixel's own uncertainty.

    Minimises the sum of `e^T Sigma^-1 e`, `e` the way from a pixel to its point's projection, by
    Levenberg-Marquardt over rotation and translation. The start is `pnp` of all points or `pnp` of
    those that are not ten times as unsure as the fourth surest, whichever fits better; then once
    more from its mirror image, since (nearly) flat points fit in two ways. If all covariances are
    one multiple of the identity, the result is that of `pnp`'s "iterative". Computed in float64; no
    gradients.

    Args:
        points_3d: (N, 3) points of the object, at least four different ones not on one line.
        points_2d: (N, 2) their pixels.
        covariances: (N, 2, 2) of the pixels, in pixels squared, symmetric and positive definite.
        K: (3, 3) camera matrix without skew.

    Returns:
        A `PnpResult`: all points are inliers, and `reprojection_error` is plain pixels.

    Raises:
        ValueError: if a covariance is not symmetric and positive definite, if `pnp` refuses the
            points or the camera, or if no pose is found with all points in front of the camera.

    Source:
        Peng et al. 2019, "PVNet", section 3.2, which starts from EPnP of the four surest points.
    """
    X, x = to_numbers("points_3d", points_3d), to_numbers("points_2d", points_2d)
    sigma = to_numbers("covariances", covariances)
    camera = to_numbers("K", K)
    whiten, deviations = _whitening(sigma)

    middle = X.mean(0)
    size = float(np.sqrt(np.square(X - middle).sum(1).mean()))
    chosen = deviations <= _WILD * np.sort(deviations)[:_ENOUGH][-1]
    starts, errors = [], []
    for some in [chosen] if chosen.all() else [chosen, np.ones_like(chosen)]:
        try:
            found = pnp(X[some], x[some], camera)
        except ValueError as error:  # few points may be too few, on one line, or fit no pose
            errors.append(error)
            continue
        starts.append((found.R, (found.t + found.R @ middle) / size))
    if not starts:
        raise errors[-1]

    problem = _Problem((X - middle) / size, x, whiten, camera)
    R, t = min(starts, key=lambda pose: problem.cost(*pose))
    if not np.isfinite(problem.cost(R, t)):
        fail("points_2d", "the picture of an object in front of the camera", "points behind it")
    R, t = _minimise(problem, R, t)
    mirrored = mirror_pose(problem.object, R, t), t
    if np.isfinite(problem.cost(*mirrored)):
        mirrored = _minimise(problem, *mirrored)
        if better(problem.cost(*mirrored), problem.cost(R, t), len(X)):
            R, t = mirrored
    plain = problem.residuals(R, t)
    return PnpResult(
        R=points_3d.new_tensor(R),
        t=points_3d.new_tensor(t * size - R @ middle),
        inliers=torch.ones(len(X), dtype=torch.bool, device=points_3d.device),
        reprojection_error=float(np.sqrt(np.square(plain).sum(1).mean())),
    )


class _Problem(NamedTuple):
    """Matched points, the object's centred and scaled, and what to minimise over poses."""

    object: np.ndarray  # (N, 3)
    image: np.ndarray  # (N, 2)
    whiten: np.ndarray  # (N, 2, 2), turns errors into ones of covariance 1
    K: np.ndarray

    def residuals(self, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Ways from the pixels to the projections, (N, 2) in pixels."""
        camera = self.object @ R.T + t
        return camera[:, :2] @ self.K[:2, :2].T / camera[:, 2:] + self.K[:2, 2] - self.image

    def cost(self, R: np.ndarray, t: np.ndarray) -> float:
        """Sum of squared whitened residuals; infinite if a point is not in front of the camera."""
        if (self.object @ R[2] + t[2]).min() <= 0:
            return np.inf
        return float(np.square(self._whitened(self.residuals(R, t)[..., None])).sum())

    def normal_equations(self, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`J^T J` (6, 6) and `J^T r` (6,) for the pose `(exp(w) R, t + s)` at w = 0, s = 0."""
        turned = self.object @ R.T
        camera = turned + t
        # How a pixel moves with its point in the camera frame, (N, 2, 3).
        flat = camera[:, :2] @ self.K[:2, :2].T / camera[:, 2:]
        moves = np.empty((len(camera), 2, 3))
        moves[..., :2], moves[..., 2] = self.K[:2, :2], -flat
        moves = self._whitened(moves / camera[:, 2, None, None])
        # The point moves by w x q, q = R X, so the pixel by (q x its gradient) . w.
        (a, b, c), (x, y, z) = moves.transpose(2, 0, 1), turned.T[..., None]
        J = np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c], -1).reshape(-1, 6)
        r = self._whitened(self.residuals(R, t)[..., None]).reshape(-1)
        return J.T @ J, J.T @ r

    def _whitened(self, columns: np.ndarray) -> np.ndarray:
        return self.whiten @ columns


def _minimise(problem: _Problem, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt with Marquardt's scaling by the diagonal."""
    cost, damping = problem.cost(R, t), 1e-4
    A, g = problem.normal_equations(R, t)
    for _ in range(_ITERATIONS):
        damped = A + damping * np.diag(np.diag(A) + 1e-12 * np.trace(A))
        step = -np.linalg.solve(damped, g)
        there = cv2.Rodrigues(step[:3])[0] @ R, t + step[3:]
        reached = problem.cost(*there)
        if reached <= (1 + _ROUNDING) * cost:
            (R, t), cost, damping = there, reached, damping / 10
            A, g = problem.normal_equations(R, t)
        else:
            damping *= 10
        if np.abs(step).max() < _STILL:
            break
    return R, t


def _whitening(sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`Sigma^-1/2` (N, 2, 2) and the largest standard deviation of each pixel (N,).

    Both are relative to the median deviation: only ratios matter, and squares stay in range.
    """
    largest = np.abs(sigma).max((1, 2))
    if (np.abs(sigma[:, 0, 1] - sigma[:, 1, 0]) > _SYMMETRIC * largest).any():
        worst = np.abs(sigma[:, 0, 1] - sigma[:, 1, 0]).argmax()
        fail("covariances", "symmetric matrices", sigma[worst].tolist())
    sigma = (sigma + sigma.swapaxes(1, 2)) / 2
    small, large = np.linalg.eigvalsh(sigma).T
    flat = small <= 1e-12 * large
    if flat.any():
        fail("covariances", "positive definite matrices", sigma[flat][0].tolist())
    scale = np.median(large)
    lower = np.linalg.cholesky(sigma / scale)
    return np.linalg.inv(lower), np.sqrt(large / scale)
