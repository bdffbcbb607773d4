"""Nearly flat points fit a picture in two ways, mirrored in depth: both poses, to start from."""

from __future__ import annotations

import cv2
import numpy as np

__all__ = ["better", "mirror_pose", "planar_poses"]

_QUARTER, _FLIP = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.diag([1.0, -1, -1])
# OpenCV's IPPE makes vectors of its rotations by a formula that breaks at half turns, sometimes so
# that the vector is short. A half turn in one of these frames of a plane is none in some other.
_FRAMES = (np.eye(3), _QUARTER, _FLIP, _FLIP @ _QUARTER)
_SAME = 1e-3  # radians, between one pose seen from two frames
_CLEARLY = 1e-6  # part of the cost; less is rounding, which should not choose between starts
_EXACT = 1e-6  # pixels; what fits so well has nothing to be mended

Pose = tuple[np.ndarray, np.ndarray]
"""Axis-angle vector and translation, (3, 1) each."""


def planar_poses(points_3d: np.ndarray, points_2d: np.ndarray, K: np.ndarray) -> list[Pose]:
    """Both poses of IPPE (Collins & Bartoli 2014) for the points moved into their own plane.

    Args:
        points_3d: (N, 3) points of the object.
        points_2d: (N, 2) their pixels.
        K: (3, 3) camera matrix.

    Returns:
        Axis-angle vectors and translations, (3, 1) each, the one that fits the flattened points
        better first; none where OpenCV finds none.
    """
    middle = points_3d.mean(0)
    axes = np.linalg.svd(points_3d - middle, full_matrices=False)[2]
    axes[2] *= np.sign(np.linalg.det(axes))
    flat = (points_3d - middle) @ axes.T
    flat[:, 2] = 0
    turns, shifts = [], []
    for frame in _FRAMES:
        try:
            found = cv2.solvePnPGeneric(flat @ frame.T, points_2d, K, None, flags=cv2.SOLVEPNP_IPPE)
        except cv2.error:
            continue
        for turn, shift in zip(*found[1:3], strict=True):
            if np.isfinite(turn).all() and np.isfinite(shift).all():
                turns.append(cv2.Rodrigues(turn)[0] @ frame)
                shifts.append(shift)
    if not turns:
        return []
    R, t = np.array(turns), np.array(shifts)[..., 0]  # (P, 3, 3) and (P, 3)
    camera = (flat @ R.mT + t[:, None]) @ K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        costs = np.square(camera[..., :2] / camera[..., 2:] - points_2d).sum((1, 2))
    costs[~(camera[..., 2] > 0).all(1)] = np.inf
    chosen = [int(costs.argmin())]
    costs[np.abs(R - R[chosen[0]]).max((1, 2)) <= _SAME] = np.inf
    if np.isfinite(costs.min()):
        chosen.append(int(costs.argmin()))
    turned = R[chosen] @ axes
    shifted = t[chosen] - turned @ middle
    return [(cv2.Rodrigues(R)[0], t[:, None]) for R, t in zip(turned, shifted, strict=True)]


def mirror_pose(points_3d: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The rotation with which nearly flat points, seen from afar, give the same picture.

    Depth is mirrored about the points' middle and the object about its own plane: two reflections
    make a rotation.

    Args:
        points_3d: (N, 3) points of the object, their middle at the origin.
        R: (3, 3) rotation from object to camera.
        t: (3,) where the middle is in the camera's frame, not at its centre.

    Returns:
        (3, 3) rotation; `t` stays.
    """
    normal = np.linalg.svd(points_3d, full_matrices=False)[2][2]
    sight = t / np.linalg.norm(t)
    about = [np.eye(3) - 2 * np.outer(v, v) for v in (sight, normal)]
    return about[0] @ R @ about[1]


def better(cost: float, before: float, count: int) -> bool:
    """Whether a sum of squared pixels of `count` points is less by more than rounding."""
    return before > count * _EXACT**2 and cost < (1 - _CLEARLY) * before
