"""Chapter 1's exercises, solved as students would: rightly and wrongly."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from posecore import metrics
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


def norm(x: np.ndarray) -> float:
    return float(np.linalg.norm(x))


# 1. Project points ------------------------------------------------------------------------------


@right("project_points")
def project(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    X = (R @ points.T).T + t
    if X[:, 2].min() <= 0:
        raise ValueError("behind")
    return X[:, :2] / X[:, 2:] @ K[:2, :2].T + K[:2, 2]


@wrong("project_points", "a random pose", "entries differ")
def project_by_the_transpose(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R.T, t, K, points)


@wrong(
    "project_points",
    "one point of three behind the camera",
    "expected a ValueError (points: expected z > 0 everywhere, got 1 of 3 with z <= 0), got",
)
def project_whatever_is_behind(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    x = (points @ R.T + t) @ K.T
    return x[:, :2] / x[:, 2:]


@wrong("project_points", "a random pose", "entries differ")
def project_moving_first(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project_whatever_is_behind(R, R @ t, K, points)


@wrong("project_points", "a point off the axis", "expected array (1, 2) [[350., ")
def project_undivided(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return ((points @ R.T + t) @ K.T)[:, :2]


@wrong("project_points", "a point in the camera's own plane, z = 0", "inf")
def project_the_plane_too(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    if (points @ R.T + t)[:, 2].min() < 0:
        raise ValueError("behind")
    return project_whatever_is_behind(R, t, K, points)


@wrong("project_points", "another camera, fx and fy differ", "got")
def project_by_one_focal_length(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    X = points @ R.T + t
    return X[:, :2] / X[:, 2:] * K[0, 0] + K[:2, 2]


@wrong("project_points", "a camera with skew", "got")
def project_without_skew(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R, t, K * (K != K[0, 1]), points)


@wrong("project_points", "a point on the optical axis", "got")
def project_to_rows_and_columns(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R, t, K, points)[:, ::-1]


@wrong("project_points", "a point on the optical axis", "shape (1, 3)")
def project_keeping_the_one(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    x = (points @ R.T + t) @ K.T
    return x / x[:, 2:]


# 2. The angle between two rotations --------------------------------------------------------------


@right("rotation_angle")
def angle_by_scipy(R_1: Any, R_2: Any) -> float:
    return Rotation.from_matrix(R_1.T @ R_2).magnitude()


@right("rotation_angle")
def angle_by_eigenvalues(R_1: Any, R_2: Any) -> float:
    # Neither of the two formulas of the hints: the largest phase.
    return np.abs(np.angle(np.linalg.eigvals(R_1.T @ R_2))).max()


@wrong("rotation_angle", "two equal rotations", "got")
def angle_by_arc_cosine(R_1: Any, R_2: Any) -> float:
    return np.arccos((np.trace(R_1.T @ R_2) - 1) / 2)


@wrong("rotation_angle", "two rotations 1e-07 rad apart", "1e-07, got")
def angle_by_clamped_arc_cosine(R_1: Any, R_2: Any) -> float:
    return np.arccos(np.clip((np.trace(R_1.T @ R_2) - 1) / 2, -1, 1))


@wrong("rotation_angle", "two rotations", "3.14")
def angle_by_chord(R_1: Any, R_2: Any) -> float:
    return 2 * np.arcsin(min(1.0, norm(R_1 - R_2) / 8**0.5))


@wrong("rotation_angle", "two random rotations", "got")
def angle_by_arc_sine(R_1: Any, R_2: Any) -> float:
    D = R_1.T @ R_2
    return np.arcsin(min(1.0, norm(D - D.T) / 8**0.5))


@wrong("rotation_angle", "a quarter turn about z", "expected 1.5708, got 90")
def angle_in_degrees(R_1: Any, R_2: Any) -> float:
    return np.rad2deg(angle_by_scipy(R_1, R_2))


@wrong("rotation_angle", "two random rotations", "got")
def angle_of_the_product(R_1: Any, R_2: Any) -> float:
    return angle_by_scipy(R_1.T, R_2)


# 3. Kabsch ----------------------------------------------------------------------------------------


@right("best_rotation")
def kabsch_by_scipy(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    return Rotation.align_vectors(q, p)[0].as_matrix()


@right("best_rotation")
def kabsch_by_the_last_row(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(p.T @ q)
    R = V.T @ U.T
    if np.linalg.det(R) < 0:
        V[2] *= -1
        R = V.T @ U.T
    return R


@wrong("best_rotation", "a planar cloud", "got")
def kabsch_with_reflections(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(q.T @ p)
    return U @ V


@wrong("best_rotation", "a planar cloud", "got")
def kabsch_by_the_first_column(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(q.T @ p)
    return U @ np.diag([np.linalg.det(U @ V), 1, 1]) @ V


@wrong("best_rotation", "a planar cloud", "got")
def kabsch_by_a_turned_sign(source: Any, target: Any) -> np.ndarray:
    R = kabsch_with_reflections(source, target)
    return R * np.linalg.det(R)


@wrong("best_rotation", "a mirrored cloud, where the best", "got")
def kabsch_flipping_the_result(source: Any, target: Any) -> np.ndarray:
    R = kabsch_with_reflections(source, target)  # right for a cloud in the plane z = 0
    return R * [1, 1, np.linalg.det(R)]


@wrong("best_rotation", "a cloud and itself, moved", "got")
def kabsch_without_means(source: Any, target: Any) -> np.ndarray:
    U, _, V = np.linalg.svd(target.T @ source)
    return U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V


@wrong("best_rotation", "a quarter turn about z", "got")
def kabsch_the_other_way(source: Any, target: Any) -> np.ndarray:
    return kabsch_by_the_last_row(target, source)


@wrong("best_rotation", "a random cloud, turned, with noise", "got")
def kabsch_by_least_squares(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    return np.linalg.lstsq(p, q, rcond=None)[0].T


# 4. ADD of a symmetric object ---------------------------------------------------------------------


def distances(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> np.ndarray:
    """(S, N)."""
    turned = points @ S[:, :3, :3].mT + S[:, None, :3, 3]
    return np.linalg.norm(points @ R_est.T + t_est - (turned @ R_gt.T + t_gt), axis=-1)


@right("add_symmetric")
def add_at_once(*given: Any) -> float:
    return distances(*given).mean(1).min()


@wrong("add_symmetric", "an estimate 90° about the axis", "expected 0, got")
def add_plain(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    return metrics.add(R_est, t_est, R_gt, t_gt, points)


@wrong("add_symmetric", "a tile turned by 45°, which ADD-S forgives", "got")
def add_nearest(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    return metrics.add_s(R_est, t_est, R_gt, t_gt, points)


@wrong("add_symmetric", "two random poses", "got")
def add_point_by_point(*given: Any) -> float:
    return distances(*given).min(0).mean()


@wrong("add_symmetric", "an estimate that is the truth", "expected 0, got")
def add_on_average(*given: Any) -> float:
    return distances(*given).mean()


@wrong("add_symmetric", "an axis that misses the origin", "got")
def add_without_moves(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    S = S.copy()
    S[:, :3, 3] = 0
    return add_at_once(R_est, t_est, R_gt, t_gt, points, S)


@wrong("add_symmetric", "an estimate 90° about the axis", "got")
def add_after_the_pose(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    true = points @ R_gt.T + t_gt
    turned = true @ S[:, :3, :3].mT + S[:, None, :3, 3]
    return np.linalg.norm(points @ R_est.T + t_est - turned, axis=-1).mean(1).min()


# 5. BMAE ------------------------------------------------------------------------------------------


@right("balanced_error")
def bmae_with_edges(errors: Any, true_angles: Any, bin_width: Any) -> float:
    if not errors.size:
        raise ValueError("no errors")
    edges = np.arange(1, np.ceil(np.pi / bin_width)) * bin_width
    bins = np.digitize(np.abs(true_angles), edges)
    total = np.bincount(bins, np.abs(errors))
    return (total[total > 0] / np.bincount(bins)[total > 0]).mean()


@wrong("balanced_error", "no errors at all", "expected a ValueError")
def bmae_of_none(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles, bin_width) if errors.size else 0.0


@wrong("balanced_error", "no errors at all", "got nan")
def bmae_with_nan(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles, bin_width) if errors.size else np.nan


@wrong("balanced_error", "one error", "expected 0.5, got")
def bmae_over_all_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.unique(np.abs(true_angles) // bin_width)
    return bmae_with_edges(errors, true_angles, bin_width) * len(bins) * bin_width / np.pi


@wrong("balanced_error", "an empty bin between two others", "2.5, got nan")
def bmae_with_empty_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in range(int(bins.max()) + 1)])


@wrong("balanced_error", "a true angle on a bin's edge", "expected 2.5, got")
def bmae_closed_above(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.ceil(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


@wrong("balanced_error", "a true angle of pi, the end of the last bin", "got")
def bmae_with_37_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    if not errors.size:
        raise ValueError("no errors")
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


@wrong("balanced_error", "errors of both signs", "expected 2, got -1")
def bmae_with_signs(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([errors[bins == b].mean() for b in np.unique(bins)])


@wrong("balanced_error", "true angles of both signs", "expected 3.5, got")
def bmae_of_signed_angles(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(true_angles / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


@wrong("balanced_error", "two bins side by side", "got")
def bmae_of_estimates(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles + errors, bin_width)


@wrong("balanced_error", "two bins side by side", "expected 3.5, got 3")
def mae(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return np.abs(errors).mean()


# 6. The worst pose that a metric forgives ---------------------------------------------------------


@right("forgiven_pose")
def nearer(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 - 0.15 * diameter / norm(t))


@right("forgiven_pose")
def farther_and_turned(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    a = 0.002
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return R @ turn, t + [0, 0, 0.12 * diameter]


@wrong("forgiven_pose", "an object 1 m ahead", "ADD above 0.1 diameters, got 0 dia")
def the_truth(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t


@wrong("forgiven_pose", "an object 1 m ahead", "error below 5 px, got 12.2 px")
def sideways(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t + [0.15 * diameter, 0, 0]


@wrong("forgiven_pose", "an object 1 m ahead", "above 0.1 diameters, got 0.05 dia")
def too_little(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 + 0.05 * diameter / norm(t))


@wrong("forgiven_pose", "a random pose, ten times as big and as far", "0.0222 dia")
def three_centimetres(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 + 0.03 / norm(t))


@wrong("forgiven_pose", "an object 1 m ahead", "error below 5 px, got")
def far_too_far(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, 10 * t


@wrong("forgiven_pose", "an object 1 m ahead", "expected R to be a rotation, got")
def a_fifth_too_big(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return 1.2 * R, 1.2 * t  # the same pixels: the projection cannot tell


@wrong("forgiven_pose", "an object 1 m ahead", "expected R to be a rotation, got")
def mirrored(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return -R, -t


@wrong("forgiven_pose", "an object 1 m ahead", "t_est: expected finite values, got")
def nowhere(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * np.nan


@wrong("forgiven_pose", "an object 1 m ahead", "expected a tuple, got a list")
def turned_list(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return [R, t]


@wrong("forgiven_pose", "an object 1 m ahead", "expected shape (3,), got shape (4,)")
def homogeneous(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, np.append(t, 1)
