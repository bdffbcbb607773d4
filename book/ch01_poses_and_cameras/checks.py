"""The checks of chapter 1's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from book.tools.checks import Exercise
from posecore import cameras, metrics, poses, registration, rotations

SECONDS = 5.0
K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])

Inputs = Iterator[tuple]


def _pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Any rotation, about a metre before the camera."""
    return rotations.random_rotations(generator=rng), np.array([0, 0, 1]) + rng.normal(size=3) / 10


# 1. Project points ------------------------------------------------------------------------------


def project_points(R: np.ndarray, t: np.ndarray, K: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The pixels (N, 2) of points of the object (N, 3)."""
    return cameras.project(K, poses.apply(R, t, points))


def _points_to_project(rng: np.random.Generator) -> Inputs:
    ahead = np.array([0, 0, 1.0])
    yield "a point on the optical axis", np.eye(3), ahead, K, np.zeros((1, 3))
    yield "a point off the axis", np.eye(3), 2 * ahead, K, np.array([[0.1, 0.05, 0]])
    for _ in range(3):
        yield "a random pose", *_pose(rng), K, rng.normal(size=(5, 3)) / 10
    wide = np.array([[400.0, 0, 100], [0, 500, 80], [0, 0, 1]])
    yield "another camera, fx and fy differ", *_pose(rng), wide, rng.normal(size=(4, 3)) / 10
    skewed = np.array([[400.0, 30, 100], [0, 500, 80], [0, 0, 1]])
    yield "a camera with skew", *_pose(rng), skewed, rng.normal(size=(4, 3)) / 10
    line = np.array([[0, 0, 0], [0, 0, -0.5], [0.2, 0, -3]])
    yield "one point of three behind the camera", np.eye(3), ahead, K, line
    yield "a point in the camera's own plane, z = 0", np.eye(3), 0 * ahead, K, np.eye(3)[:1]


check_project_points = Exercise(
    project_points,
    _points_to_project,
    hints=(
        "First X = R x + t for every point: points are rows, so write points @ R.T + t. "
        "Then X @ K.T, and divide its first two columns by its third.",
        "Before you divide, look at the third column of X: where a z is 0 or less, "
        'raise ValueError("points: ... behind the camera").',
    ),
    seconds=SECONDS,
)


# 2. The angle between two rotations --------------------------------------------------------------


def rotation_angle(R_1: np.ndarray, R_2: np.ndarray) -> float:
    """The angle between two rotations, radians in [0, pi]."""
    return round(float(rotations.geodesic_distance(R_1, R_2)), 15)  # no 1e-17 in messages


def _pairs_of_rotations(rng: np.random.Generator) -> Inputs:
    def pair(angle: float) -> tuple[np.ndarray, np.ndarray]:
        R = rotations.random_rotations(generator=rng)
        axis = rng.normal(size=3)
        turn = rotations.axis_angle_to_matrix(angle * axis / np.linalg.norm(axis))
        return R, R @ turn

    yield "a quarter turn about z", np.eye(3), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for _ in range(3):
        yield "two random rotations", *(rotations.random_rotations(2, generator=rng))
    for _ in range(4):
        R = rotations.random_rotations(generator=rng)
        yield "two equal rotations", R, R.copy()
    for angle in (1e-3, 1e-7, 1e-8):
        for _ in range(2):
            yield f"two rotations {angle:g} rad apart", *pair(angle)
    yield "half a turn about x", np.eye(3), np.diag([1.0, -1, -1])
    for _ in range(4):
        yield "two rotations half a turn apart", *pair(np.pi)
        yield "two rotations 1e-7 rad short of half a turn apart", *pair(np.pi - 1e-7)


check_rotation_angle = Exercise(
    rotation_angle,
    _pairs_of_rotations,
    hints=(
        "The cosine hardly changes near 0 and pi, so it cannot tell small angles apart: "
        "cos(1e-8) is 1 to all 16 digits. Look for the sine as well.",
        "With D = R_1.T @ R_2, the vector (D[2,1] - D[1,2], D[0,2] - D[2,0], D[1,0] - D[0,1]) has "
        "the length 2 sin(a), and the trace is 1 + 2 cos(a). np.arctan2(sine, cosine) is right at "
        "both ends; an arcsine alone fails at the other one.",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 3. Kabsch ----------------------------------------------------------------------------------------


def best_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that best takes one cloud (N, 3) to the other, after their means."""
    return registration.umeyama(source, target).R


def _matched_clouds(rng: np.random.Generator) -> Inputs:
    def turned(cloud: np.ndarray, noise: float = 0.0) -> np.ndarray:
        R, t = _pose(rng)
        return cloud @ R.T + t + noise * rng.normal(size=cloud.shape)

    cloud = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    yield "a quarter turn about z", cloud, cloud @ quarter.T
    yield "a cloud and itself, moved", cloud, cloud + [3, -1, 2]
    for _ in range(3):
        cloud = rng.normal(size=(8, 3))
        yield "a random cloud, turned and moved", cloud, turned(cloud)
        yield "a random cloud, turned, with noise", cloud, turned(cloud, noise=0.1)
    cloud = rng.normal(size=(8, 3))
    yield "half a turn", cloud, cloud @ np.diag([-1.0, -1, 1])
    yield "a cloud with two equal points", *[c[[0, 0, 1, 2, 3]] for c in (cloud, turned(cloud))]
    for _ in range(4):
        flat = rng.normal(size=(6, 3)) * [1, 1, 0]
        yield "a planar cloud", flat, turned(flat)
    yield "only three points", flat[:3], turned(flat[:3])
    for _ in range(3):
        cloud = rng.normal(size=(8, 3)) * [1, 2, 3]
        yield "a mirrored cloud, where the best matrix is a reflection", cloud, turned(-cloud)


check_best_rotation = Exercise(
    best_rotation,
    _matched_clouds,
    hints=(
        "Points are rows: with both means taken away, H is q.T @ p, and NumPy's U, s, Vt = "
        "np.linalg.svd(H) has V^T, not V. Then look at np.linalg.det of your result: is it +1?",
        "Where U @ Vt is a reflection, put np.diag([1, 1, -1]) between U and Vt. That flips the "
        "direction of the smallest singular value, which costs least.",
    ),
    seconds=SECONDS,
)


# 4. ADD of a symmetric object ---------------------------------------------------------------------


def add_symmetric(
    R_est: np.ndarray,
    t_est: np.ndarray,
    R_gt: np.ndarray,
    t_gt: np.ndarray,
    points: np.ndarray,
    symmetries: np.ndarray,
) -> float:
    """ADD against the best of all poses that look like the true one, metres."""
    turned, moved = poses.compose(R_gt, t_gt, symmetries[:, :3, :3], symmetries[:, :3, 3])
    return float(metrics.add(R_est, t_est, turned, moved, points).min())


def _quarter_turns(centre: np.ndarray) -> np.ndarray:
    """The four symmetries (4, 4, 4) of a square tile about the z axis through `centre`."""
    angles = np.arange(4)[:, None] * np.array([0, 0, np.pi / 2])
    R = rotations.axis_angle_to_matrix(angles).round() + 0.0  # no -0 and no 1e-16 in messages
    return poses.to_matrix(R, centre - R @ centre)


def _symmetric_objects(rng: np.random.Generator) -> Inputs:
    points, symmetries = rng.uniform(-0.05, 0.05, size=(6, 3)), _quarter_turns(np.zeros(3))
    (R, t), none = _pose(rng), np.eye(4)[None]
    yield "an estimate that is the truth", R, t, R, t, points, symmetries
    yield "an estimate 1 cm off, no symmetry", R, t + [0, 0, 0.01], R, t, points, none
    grid = np.linspace(-0.05, 0.05, 6)
    tile = np.stack(np.meshgrid(grid, grid, [0.0]), -1).reshape(-1, 3)
    eighth = R @ rotations.axis_angle_to_matrix(np.array([0, 0, np.pi / 4]))
    yield "a tile turned by 45°, which ADD-S forgives", eighth, t, R, t, tile, symmetries
    for number in (1, 2, 3):
        turned, moved = poses.compose(R, t, *poses.from_matrix(symmetries[number]))
        yield f"an estimate {90 * number}° about the axis", turned, moved, R, t, points, symmetries
    aside = _quarter_turns(np.array([0.1, 0.05, 0]))
    turned, moved = poses.compose(R, t, *poses.from_matrix(aside[1]))
    yield "an axis that misses the origin", turned, moved, R, t, points, aside
    for _ in range(3):
        yield "two random poses", *_pose(rng), *_pose(rng), points, symmetries
        yield "random poses, an axis that misses the origin", *_pose(rng), R, t, points, aside


check_add_symmetric = Exercise(
    add_symmetric,
    _symmetric_objects,
    hints=(
        "The symmetry S acts first, in the object's own frame: R_gt @ (S_R @ x + S_t) + t_gt, "
        "with S_R = S[:3, :3] and S_t = S[:3, 3].",
        "One symmetry for all points: for each S take the mean over the points, and only then the "
        "smallest of these means.",
    ),
    seconds=SECONDS,
)


# 5. BMAE ------------------------------------------------------------------------------------------


def balanced_error(errors: np.ndarray, true_angles: np.ndarray, bin_width: float) -> float:
    """The mean absolute error inside bins of the true angle's size, then over the bins."""
    return metrics.balanced_mean_angular_error(errors, true_angles, bin_width)


def _binned_errors(rng: np.random.Generator) -> Inputs:
    yield "one error", np.array([0.5]), np.array([0.1]), 0.25
    yield "two bins side by side", np.array([1.0, 3, 5]), np.array([0.1, 0.2, 0.3]), 0.25
    yield "an empty bin between two others", np.array([1.0, 1, 4]), np.array([0.1, 0.2, 0.8]), 0.25
    yield "errors of both signs", np.array([1.0, -3]), np.array([0.1, 0.2]), 0.25
    yield "true angles of both signs", np.array([1.0, 3, 5]), np.array([-0.1, 0.1, 0.6]), 0.25
    yield "a true angle on a bin's edge", np.array([1.0, 3, 5]), np.array([0.1, 0.25, 0.3]), 0.25
    width = np.pi / 36
    ends = np.array([np.pi, np.pi - 0.01, 0.01])
    yield "a true angle of pi, the end of the last bin", np.array([1.0, 3, 5]), ends, width
    yield "a true angle of -pi", np.array([1.0, 3, 5]), ends * [-1, 1, 1], width
    for _ in range(3):
        angles = rng.normal(scale=0.6, size=12).clip(-3, 3)
        yield "many frontal poses, few extreme ones", rng.normal(size=12) / 10, angles, width
    yield "no errors at all", np.zeros(0), np.zeros(0), 0.25


check_balanced_error = Exercise(
    balanced_error,
    _binned_errors,
    hints=(
        "np.floor(np.abs(true_angles) / bin_width) numbers the bins, half-open as they should be, "
        "and np.unique lists those that hold something. Take the sizes of the errors, too.",
        "pi belongs to the last bin, number ceil(pi / bin_width) - 1: cap the numbers there with "
        "np.minimum. And without any errors, raise a ValueError before you average.",
    ),
    seconds=SECONDS,
)


# 6. The worst pose that a metric forgives ---------------------------------------------------------


def forgiven_pose(
    R: np.ndarray, t: np.ndarray, K: np.ndarray, points: np.ndarray, diameter: float
) -> tuple[np.ndarray, np.ndarray]:
    """A wrong pose (R, t) that the 2D projection error calls correct."""
    return R, t * (1 + 0.2 * diameter / np.linalg.norm(t))


def _poses_to_be_mistaken(rng: np.random.Generator) -> Inputs:
    points = rng.uniform(-1, 1, size=(40, 3)) * [0.04, 0.05, 0.06]
    diameter = float(np.linalg.norm(points[:, None] - points, axis=-1).max())
    yield "an object 1 m ahead", np.eye(3), np.array([0, 0, 1.0]), K, points, diameter
    aside = np.array([0.5, -0.3, 2])
    yield "an object 2 m ahead, off the axis", np.eye(3), aside, K, points, diameter
    for _ in range(4):
        R, t = _pose(rng)
        yield "a random pose", R, t, K, points, diameter
        yield "a random pose, ten times as big and as far", R, 10 * t, K, 10 * points, 10 * diameter


def _is_forgiven(
    answer: tuple[np.ndarray, np.ndarray],
    R: np.ndarray,
    t: np.ndarray,
    K: np.ndarray,
    points: np.ndarray,
    diameter: float,
) -> str:
    if not rotations.is_rotation(answer[0]):
        return "expected R to be a rotation, got a matrix that stretches or mirrors"
    pixels = metrics.projection_2d(K, *answer, R, t, points)
    if not pixels < 5:
        return f"expected a 2D projection error below 5 px, got {pixels:.3g} px"
    share = metrics.add(*answer, R, t, points) / diameter
    if not share > 0.1:
        return f"expected an ADD above 0.1 diameters, got {share:.3g} diameters"
    return ""


check_forgiven_pose = Exercise(
    forgiven_pose,
    _poses_to_be_mistaken,
    hints=(
        "A camera measures directions well and distances badly. Which way can the object move so "
        "that it hardly moves in the image?",
        "Keep R and slide the object along its viewing ray, the line from the camera through t: "
        "t * (1 + s). It moves by s * |t|; choose s so that this is somewhat more than 0.1 "
        "diameters.",
    ),
    judge=_is_forgiven,
    seconds=SECONDS,
)
