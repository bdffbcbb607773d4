"""Chapter 1's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from book.ch01_poses_and_cameras import checks
from book.tools.checks import DONE
from posecore import metrics


def norm(x: np.ndarray) -> float:
    return float(np.linalg.norm(x))


# 1. Project points ------------------------------------------------------------------------------


def project(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    X = (R @ points.T).T + t
    if X[:, 2].min() <= 0:
        raise ValueError("behind")
    return X[:, :2] / X[:, 2:] @ K[:2, :2].T + K[:2, 2]


def project_by_the_transpose(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R.T, t, K, points)


def project_whatever_is_behind(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    x = (points @ R.T + t) @ K.T
    return x[:, :2] / x[:, 2:]


def project_moving_first(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project_whatever_is_behind(R, R @ t, K, points)


def project_undivided(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return ((points @ R.T + t) @ K.T)[:, :2]


def project_the_plane_too(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    if (points @ R.T + t)[:, 2].min() < 0:
        raise ValueError("behind")
    return project_whatever_is_behind(R, t, K, points)


def project_by_one_focal_length(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    X = points @ R.T + t
    return X[:, :2] / X[:, 2:] * K[0, 0] + K[:2, 2]


def project_without_skew(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R, t, K * (K != K[0, 1]), points)


def project_to_rows_and_columns(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    return project(R, t, K, points)[:, ::-1]


def project_keeping_the_one(R: Any, t: Any, K: Any, points: Any) -> np.ndarray:
    x = (points @ R.T + t) @ K.T
    return x / x[:, 2:]


# 2. The angle between two rotations --------------------------------------------------------------


def angle_by_scipy(R_1: Any, R_2: Any) -> float:
    return Rotation.from_matrix(R_1.T @ R_2).magnitude()


def angle_by_eigenvalues(R_1: Any, R_2: Any) -> float:
    # Neither of the two formulas of the hints: the largest phase.
    return np.abs(np.angle(np.linalg.eigvals(R_1.T @ R_2))).max()


def angle_by_arc_cosine(R_1: Any, R_2: Any) -> float:
    return np.arccos((np.trace(R_1.T @ R_2) - 1) / 2)


def angle_by_clamped_arc_cosine(R_1: Any, R_2: Any) -> float:
    return np.arccos(np.clip((np.trace(R_1.T @ R_2) - 1) / 2, -1, 1))


def angle_by_chord(R_1: Any, R_2: Any) -> float:
    return 2 * np.arcsin(min(1.0, norm(R_1 - R_2) / 8**0.5))


def angle_by_arc_sine(R_1: Any, R_2: Any) -> float:
    D = R_1.T @ R_2
    return np.arcsin(min(1.0, norm(D - D.T) / 8**0.5))


def angle_in_degrees(R_1: Any, R_2: Any) -> float:
    return np.rad2deg(angle_by_scipy(R_1, R_2))


def angle_of_the_product(R_1: Any, R_2: Any) -> float:
    return angle_by_scipy(R_1.T, R_2)


# 3. Kabsch ----------------------------------------------------------------------------------------


def kabsch_by_scipy(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    return Rotation.align_vectors(q, p)[0].as_matrix()


def kabsch_by_the_last_row(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(p.T @ q)
    R = V.T @ U.T
    if np.linalg.det(R) < 0:
        V[2] *= -1
        R = V.T @ U.T
    return R


def kabsch_with_reflections(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(q.T @ p)
    return U @ V


def kabsch_by_the_first_column(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, V = np.linalg.svd(q.T @ p)
    return U @ np.diag([np.linalg.det(U @ V), 1, 1]) @ V


def kabsch_by_a_turned_sign(source: Any, target: Any) -> np.ndarray:
    R = kabsch_with_reflections(source, target)
    return R * np.linalg.det(R)


def kabsch_flipping_the_result(source: Any, target: Any) -> np.ndarray:
    R = kabsch_with_reflections(source, target)  # right for a cloud in the plane z = 0
    return R * [1, 1, np.linalg.det(R)]


def kabsch_without_means(source: Any, target: Any) -> np.ndarray:
    U, _, V = np.linalg.svd(target.T @ source)
    return U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V


def kabsch_the_other_way(source: Any, target: Any) -> np.ndarray:
    return kabsch_by_the_last_row(target, source)


def kabsch_by_least_squares(source: Any, target: Any) -> np.ndarray:
    p, q = source - source.mean(0), target - target.mean(0)
    return np.linalg.lstsq(p, q, rcond=None)[0].T


# 4. ADD of a symmetric object ---------------------------------------------------------------------


def distances(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> np.ndarray:
    """(S, N)."""
    turned = points @ S[:, :3, :3].mT + S[:, None, :3, 3]
    return np.linalg.norm(points @ R_est.T + t_est - (turned @ R_gt.T + t_gt), axis=-1)


def add_at_once(*given: Any) -> float:
    return distances(*given).mean(1).min()


def add_plain(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    return metrics.add(R_est, t_est, R_gt, t_gt, points)


def add_nearest(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    return metrics.add_s(R_est, t_est, R_gt, t_gt, points)


def add_point_by_point(*given: Any) -> float:
    return distances(*given).min(0).mean()


def add_on_average(*given: Any) -> float:
    return distances(*given).mean()


def add_without_moves(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    S = S.copy()
    S[:, :3, 3] = 0
    return add_at_once(R_est, t_est, R_gt, t_gt, points, S)


def add_after_the_pose(R_est: Any, t_est: Any, R_gt: Any, t_gt: Any, points: Any, S: Any) -> float:
    true = points @ R_gt.T + t_gt
    turned = true @ S[:, :3, :3].mT + S[:, None, :3, 3]
    return np.linalg.norm(points @ R_est.T + t_est - turned, axis=-1).mean(1).min()


# 5. BMAE ------------------------------------------------------------------------------------------


def bmae_with_edges(errors: Any, true_angles: Any, bin_width: Any) -> float:
    if not errors.size:
        raise ValueError("no errors")
    edges = np.arange(1, np.ceil(np.pi / bin_width)) * bin_width
    bins = np.digitize(np.abs(true_angles), edges)
    total = np.bincount(bins, np.abs(errors))
    return (total[total > 0] / np.bincount(bins)[total > 0]).mean()


def bmae_of_none(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles, bin_width) if errors.size else 0.0


def bmae_with_nan(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles, bin_width) if errors.size else np.nan


def bmae_over_all_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.unique(np.abs(true_angles) // bin_width)
    return bmae_with_edges(errors, true_angles, bin_width) * len(bins) * bin_width / np.pi


def bmae_with_empty_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in range(int(bins.max()) + 1)])


def bmae_closed_above(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.ceil(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


def bmae_with_37_bins(errors: Any, true_angles: Any, bin_width: Any) -> float:
    if not errors.size:
        raise ValueError("no errors")
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


def bmae_with_signs(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(np.abs(true_angles) / bin_width)
    return np.mean([errors[bins == b].mean() for b in np.unique(bins)])


def bmae_of_signed_angles(errors: Any, true_angles: Any, bin_width: Any) -> float:
    bins = np.floor(true_angles / bin_width)
    return np.mean([np.abs(errors[bins == b]).mean() for b in np.unique(bins)])


def bmae_of_estimates(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return bmae_with_edges(errors, true_angles + errors, bin_width)


def mae(errors: Any, true_angles: Any, bin_width: Any) -> float:
    return np.abs(errors).mean()


# 6. The worst pose that a metric forgives ---------------------------------------------------------


def nearer(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 - 0.15 * diameter / norm(t))


def farther_and_turned(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    a = 0.002
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return R @ turn, t + [0, 0, 0.12 * diameter]


def the_truth(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t


def sideways(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t + [0.15 * diameter, 0, 0]


def too_little(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 + 0.05 * diameter / norm(t))


def three_centimetres(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * (1 + 0.03 / norm(t))


def far_too_far(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, 10 * t


def a_fifth_too_big(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return 1.2 * R, 1.2 * t  # the same pixels: the projection cannot tell


def mirrored(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return -R, -t


def nowhere(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, t * np.nan


def turned_list(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return [R, t]


def homogeneous(R: Any, t: Any, K: Any, points: Any, diameter: Any) -> Any:
    return R, np.append(t, 1)


RIGHT = [
    ("project_points", project),
    ("rotation_angle", angle_by_scipy),
    ("best_rotation", kabsch_by_scipy),
    ("best_rotation", kabsch_by_the_last_row),
    ("add_symmetric", add_at_once),
    ("balanced_error", bmae_with_edges),
    ("forgiven_pose", nearer),
    ("forgiven_pose", farther_and_turned),
]


@pytest.mark.parametrize(("exercise", "student"), RIGHT)
def test_another_way_to_be_right(exercise: str, student: Callable[..., Any]) -> None:
    answer = getattr(checks, f"check_{exercise}")(student)
    assert answer.status == DONE, answer.line


# The exercise, the wrong solution, the input that gives it away, and how the line ends.
WRONG = [
    ("project_points", project_by_the_transpose, "a random pose", "entries differ"),
    ("project_points", project_undivided, "a point off the axis", "expected array (1, 2) [[350., "),
    ("project_points", project_moving_first, "a random pose", "entries differ"),
    (
        "project_points",
        project_whatever_is_behind,
        "one point of three behind the camera",
        "expected a ValueError (points: expected z > 0 everywhere, got 1 of 3 with z <= 0), got",
    ),
    ("project_points", project_the_plane_too, "a point in the camera's own plane, z = 0", "inf"),
    ("project_points", project_by_one_focal_length, "another camera, fx and fy differ", "got"),
    ("project_points", project_without_skew, "a camera with skew", "got"),
    ("project_points", project_to_rows_and_columns, "a point on the optical axis", "got"),
    ("project_points", project_keeping_the_one, "a point on the optical axis", "shape (1, 3)"),
    ("rotation_angle", angle_by_arc_cosine, "two equal rotations", "got"),
    ("rotation_angle", angle_by_clamped_arc_cosine, "two rotations 1e-07 rad apart", "1e-07, got"),
    ("rotation_angle", angle_by_chord, "two rotations", "3.14"),
    ("rotation_angle", angle_by_arc_sine, "two random rotations", "got"),
    ("rotation_angle", angle_in_degrees, "a quarter turn about z", "expected 1.5708, got 90"),
    ("rotation_angle", angle_of_the_product, "two random rotations", "got"),
    ("best_rotation", kabsch_with_reflections, "a planar cloud", "got"),
    ("best_rotation", kabsch_by_the_first_column, "a planar cloud", "got"),
    ("best_rotation", kabsch_by_a_turned_sign, "a planar cloud", "got"),
    ("best_rotation", kabsch_flipping_the_result, "a mirrored cloud, where the best", "got"),
    ("best_rotation", kabsch_without_means, "a cloud and itself, moved", "got"),
    ("best_rotation", kabsch_the_other_way, "a quarter turn about z", "got"),
    ("best_rotation", kabsch_by_least_squares, "a random cloud, turned, with noise", "got"),
    ("add_symmetric", add_plain, "an estimate 90° about the axis", "expected 0, got"),
    ("add_symmetric", add_nearest, "a tile turned by 45°, which ADD-S forgives", "got"),
    ("add_symmetric", add_point_by_point, "two random poses", "got"),
    ("add_symmetric", add_on_average, "an estimate that is the truth", "expected 0, got"),
    ("add_symmetric", add_without_moves, "an axis that misses the origin", "got"),
    ("add_symmetric", add_after_the_pose, "an estimate 90° about the axis", "got"),
    ("balanced_error", bmae_of_none, "no errors at all", "expected a ValueError"),
    ("balanced_error", bmae_with_nan, "no errors at all", "got nan"),
    ("balanced_error", bmae_over_all_bins, "one error", "expected 0.5, got"),
    ("balanced_error", bmae_with_empty_bins, "an empty bin between two others", "2.5, got nan"),
    ("balanced_error", bmae_closed_above, "a true angle on a bin's edge", "expected 2.5, got"),
    ("balanced_error", bmae_with_37_bins, "a true angle of pi, the end of the last bin", "got"),
    ("balanced_error", bmae_with_signs, "errors of both signs", "expected 2, got -1"),
    ("balanced_error", bmae_of_signed_angles, "true angles of both signs", "expected 3.5, got"),
    ("balanced_error", bmae_of_estimates, "two bins side by side", "got"),
    ("balanced_error", mae, "two bins side by side", "expected 3.5, got 3"),
    ("forgiven_pose", the_truth, "an object 1 m ahead", "ADD above 0.1 diameters, got 0 dia"),
    ("forgiven_pose", too_little, "an object 1 m ahead", "above 0.1 diameters, got 0.05 dia"),
    ("forgiven_pose", sideways, "an object 1 m ahead", "error below 5 px, got 12.2 px"),
    (
        "forgiven_pose",
        three_centimetres,
        "a random pose, ten times as big and as far",
        "0.0222 dia",
    ),
    ("forgiven_pose", far_too_far, "an object 1 m ahead", "error below 5 px, got"),
    ("forgiven_pose", a_fifth_too_big, "an object 1 m ahead", "expected R to be a rotation, got"),
    ("forgiven_pose", mirrored, "an object 1 m ahead", "expected R to be a rotation, got"),
    ("forgiven_pose", nowhere, "an object 1 m ahead", "t_est: expected finite values, got"),
    ("forgiven_pose", turned_list, "an object 1 m ahead", "expected a tuple, got a list"),
    ("forgiven_pose", homogeneous, "an object 1 m ahead", "expected shape (3,), got shape (4,)"),
]


@pytest.mark.parametrize(("exercise", "student", "words", "result"), WRONG)
def test_a_wrong_solution_is_caught(
    refused: Callable[..., str], exercise: str, student: Callable[..., Any], words: str, result: str
) -> None:
    line = refused(getattr(checks, f"check_{exercise}"), exercise, student, words)
    assert "expected" in line and "got" in line
    assert result in line, line


def test_every_exercise_has_wrong_solutions_and_two_hints() -> None:
    found = [name for name in vars(checks) if name.startswith("check_")]
    assert 4 <= len(found) <= 6
    for name in found:
        assert len(getattr(checks, name).hints) == 2
        assert sum(f"check_{exercise}" == name for exercise, *_ in WRONG) >= 2
        assert sum(f"check_{exercise}" == name for exercise, _ in RIGHT) >= 1


@given(st.floats(0.01, 0.3), st.floats(-0.02, 0.02))
def test_the_open_exercise_is_judged_by_its_property(slide: float, aside: float) -> None:
    """Whatever is forgiven by one metric and refused by the other on all inputs is done."""

    def student(R: Any, t: Any, K: Any, points: Any, diameter: float) -> Any:
        return R, t * (1 + slide * diameter / norm(t)) + [aside * diameter, 0, 0]

    rng = np.random.default_rng(checks.check_forgiven_pose.seed)
    given_poses = [given[1:] for given in checks.check_forgiven_pose.inputs(rng)]
    forgiven = []
    for R, t, K, points, diameter in given_poses:
        wrong = student(R, t, K, points, diameter)
        pixels = metrics.projection_2d(K, *wrong, R, t, points)
        forgiven.append(pixels < 5 and metrics.add(*wrong, R, t, points) > 0.1 * diameter)
    assert (checks.check_forgiven_pose(student).status == DONE) == all(forgiven)
