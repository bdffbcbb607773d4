"""Poses from pixels of a picture that was taken through a lens."""

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from posecore.distortion import project_distorted
from posecore.registration import pnp, pnp_distorted
from posecore.rotations import geodesic_distance

K = np.array([[420.0, 0, 325.3], [0, 421, 242.0], [0, 0, 1]])
WIDE = np.array([-0.31, 0.12, 0.0004, 0.0011, -0.021])
RATIONAL = np.array([0.9, -0.4, 0.0002, -0.0003, 0.05, 1.2, -0.1, 0.02])


def case(seed, count=20, lens=WIDE, size=1.0, flat=False):
    """An object that fills much of the picture: R, t, points and exact pixels."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)).as_matrix()
    points = rng.uniform(-0.5, 0.5, (count, 3)) * [1, 1, 0 if flat else 1] * size
    t = np.array([*rng.uniform(-0.1, 0.1, 2), 1.6]) * size
    return R, t, points, project_distorted(K, points @ R.T + t, lens)


@pytest.mark.parametrize("lens", [WIDE, WIDE[:4], RATIONAL])
@pytest.mark.parametrize("method", ["iterative", "sqpnp", "epnp", "ransac"])
def test_exact_pixels_give_the_exact_pose(method, lens):
    for seed, size in ((0, 1.0), (1, 1e-4), (2, 1e4)):
        R, t, points, seen = case(seed, lens=lens, size=size)
        found = pnp_distorted(points, seen, K, lens, method)
        assert geodesic_distance(found.R, R) < 1e-6
        np.testing.assert_allclose(found.t, t, rtol=0, atol=1e-6 * size)
        assert found.inliers.all() and found.reprojection_error < 1e-4
    # Without the lens in mind it is another pose.
    assert pnp(points, seen, K).reprojection_error > 1


def test_flat_targets():
    R, t, points, seen = case(3, flat=True)
    for method in ("iterative", "ippe", "ransac"):
        found = pnp_distorted(points, seen, K, WIDE, method)
        assert geodesic_distance(found.R, R) < 1e-6
        np.testing.assert_allclose(found.t, t, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_of_noisy_pixels_the_error_in_the_picture_is_least(seed):
    """The answer of OpenCV's own solver that knows the lens, and no pose beside it is better."""
    R, t, points, seen = case(seed)
    seen = seen + np.random.default_rng(seed).normal(size=seen.shape)
    found = pnp_distorted(points, seen, K, WIDE)
    start = cv2.Rodrigues(R)[0], t[:, None].copy()
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-14)
    turn, shift = cv2.solvePnPRefineLM(points, seen, K, WIDE, *start, stop)
    assert geodesic_distance(found.R, cv2.Rodrigues(turn)[0]) < 1e-6
    np.testing.assert_allclose(found.t, shift[:, 0], atol=1e-6)

    def error(R, t):
        gaps = project_distorted(K, points @ R.T + t, WIDE) - seen
        return np.sqrt((gaps**2).sum(-1).mean())

    least = error(found.R, found.t)
    assert found.reprojection_error == pytest.approx(least)
    for i in range(3):
        for step in (-1e-3, 1e-3):
            turned = Rotation.from_rotvec(step * np.eye(3)[i]).as_matrix() @ found.R
            assert error(turned, found.t) > least
            assert error(found.R, found.t + step * np.eye(3)[i]) > least
    begun = pnp_distorted(points, seen, K, WIDE, R=R, t=t)
    assert error(begun.R, begun.t) == pytest.approx(least)


def test_wrong_pixels_are_left_out_and_those_outside_the_lens_too():
    R, _, points, seen = case(7, count=40, lens=np.array([-0.28, 0, 0, 0]))
    seen[:8] += 40
    seen[8:10] = [[5000, 242], [325, -9000]]  # no ray leads there
    found = pnp_distorted(points, seen, K, [-0.28, 0, 0, 0], "ransac")
    assert not found.inliers[:10].any() and found.inliers[10:].all()
    assert geodesic_distance(found.R, R) < 1e-6
    with pytest.raises(ValueError, match="^points: expected pixels to which a ray leads"):
        pnp_distorted(points, seen, K, [-0.28, 0, 0, 0])


def test_tensors_and_precision():
    R, _, points, seen = case(0)
    as_tensors = [torch.from_numpy(x).float() for x in (points, seen, K, WIDE)]
    found = pnp_distorted(*as_tensors)
    assert found.R.dtype == torch.float32 and isinstance(found.inliers, torch.Tensor)
    assert geodesic_distance(found.R.numpy(), R.astype(np.float32)) < 1e-4


def test_what_is_refused():
    _, _, points, seen = case(0)
    for lens in (np.zeros(3), np.zeros(12)):
        with pytest.raises(ValueError, match="^distortion: expected 4, 5 or 8 coefficients"):
            pnp_distorted(points, seen, K, lens)
    with pytest.raises(ValueError, match="^K: expected no skew"):
        pnp_distorted(points, seen, K + np.eye(3, k=1) * [0, 1, 0], WIDE)
    with pytest.raises(ValueError, match="^method: expected one of 'iterative'"):
        pnp_distorted(points, seen, K, WIDE, "dlt")
    barrel = [-0.28, 0, 0, 0]
    with pytest.raises(ValueError, match="^points_2d: expected at least 4 pixels to which a ray"):
        pnp_distorted(points[:5], seen[:5] * [[1], [1], [1], [99], [99]], K, barrel, "ransac")
    scattered = np.random.default_rng(0).uniform(0, 480, seen.shape)
    with pytest.raises(ValueError, match="^points_2d: expected 8 that agree with one pose"):
        pnp_distorted(points, scattered, K, WIDE, "ransac", min_inliers=8, threshold=1.0)
