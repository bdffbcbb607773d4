"""Poses from pixels: exact, noisy and wrong ones, flat targets, small and distant objects."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.registration import pnp
from posecore.registration.planar import mirror_pose, planar_poses
from posecore.rotations import geodesic_distance, special_procrustes

SEEDS = st.integers(0, 2**32 - 1)
K = np.array([[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]])


def picture(R, t, points, K=K):
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, None)
    return pixels[:, 0]


def case(seed, count, flat=False, distance=1.0):
    """An object of 0.2 m in front of the camera: R, t, points and exact pixels."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=rng).as_matrix()
    points = rng.uniform(-0.1, 0.1, (count, 3))
    if flat:
        # A square, so that no target is nearly a line; tilted, so that none is seen edge-on.
        points[:4] = [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]
        points[:, 2] = 0
        tilt = Rotation.from_rotvec(rng.uniform(0.3, 1.0) * np.array([0.6, 0.8, 0]))
        spin = Rotation.from_euler("z", rng.uniform(-3, 3))
        frame = Rotation.random(random_state=rng)
        R = (tilt * spin * frame.inv()).as_matrix()
        points = frame.apply(points)
    t = np.array([*rng.uniform(-0.2, 0.2, 2), distance])
    return R, t, points, picture(R, t, points)


def assert_pose(found, R, t, atol=1e-6):
    assert geodesic_distance(found.R, R) < atol
    np.testing.assert_allclose(found.t, t, atol=atol)


@given(
    seed=SEEDS,
    count=st.integers(6, 30),
    method=st.sampled_from(["iterative", "sqpnp", "epnp", "ransac"]),
)
def test_exact_pixels_give_the_exact_pose(seed, count, method):
    R, t, points, pixels = case(seed, count)
    found = pnp(points, pixels, K, method)
    assert_pose(found, R, t)
    assert found.inliers.all() and found.reprojection_error < 1e-4


@given(
    seed=SEEDS,
    count=st.integers(4, 30),
    method=st.sampled_from(["iterative", "sqpnp", "ippe", "ransac"]),
)
def test_flat_targets_give_the_exact_pose(seed, count, method):
    R, t, points, pixels = case(seed, count, flat=True)
    assert_pose(pnp(points, pixels, K, method), R, t)


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 5])
def test_few_exact_pixels_are_met_exactly(count):
    for seed in range(200):  # SQPnP alone misses one of them
        _, _, points, pixels = case(seed, count, distance=0.5)
        found = pnp(points, pixels, K)
        assert found.reprojection_error < 1e-6  # though another pose than ours may meet four points


@pytest.mark.slow
@given(seed=SEEDS, flat=st.booleans(), exponent=st.integers(-5, 5), far=st.booleans())
def test_size_unit_and_origin_of_the_object_do_not_matter(seed, flat, exponent, far):
    R, t, points, pixels = case(seed, 12, flat)
    scale, shift = 10.0**exponent, 1e4 * far
    points, t = scale * (points + shift), scale * (t - R @ np.full(3, shift))
    found = [pnp(points, pixels, K, R=R, t=t)]
    found += [
        pnp(points, pixels, K, method)
        for method in ("iterative", "sqpnp", "ippe" if flat else "epnp", "ransac")
    ]
    for one in found:
        assert geodesic_distance(one.R, R) < 1e-6
        np.testing.assert_allclose(one.t / scale, t / scale, atol=1e-6 * (1 + 2 * shift))


@given(seed=SEEDS, flat=st.booleans(), distance=st.sampled_from([0.5, 1.0, 3.0]))
def test_noisy_pixels_are_met_better_than_by_the_truth(seed, flat, distance):
    R, t, points, exact = case(seed, 8, flat, distance)
    pixels = exact + np.random.default_rng(seed).normal(size=exact.shape)
    found = pnp(points, pixels, K)
    errors = np.linalg.norm(picture(found.R, found.t, points) - pixels, axis=1)
    assert found.reprojection_error == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)
    # Also better than where Levenberg-Marquardt ends that starts from the truth.
    near = pnp(points, pixels, K, R=R, t=t)
    truth = np.sqrt(np.square(exact - pixels).sum(1).mean())
    assert found.reprojection_error <= near.reprojection_error + 1e-6
    assert near.reprojection_error <= truth
    for method in ("sqpnp", "ippe" if flat else "epnp"):
        try:
            other = pnp(points, pixels, K, method).reprojection_error
        except ValueError:  # noise may put a solver's pose behind the camera
            continue
        assert found.reprojection_error <= other + 1e-6


@pytest.mark.slow
@given(seed=SEEDS, flat=st.booleans(), noise=st.sampled_from([0.0, 0.5]))
def test_ransac_finds_the_40_percent_that_are_wrong(seed, flat, noise):
    R, t, points, pixels = case(seed, 30, flat)
    rng = np.random.default_rng(seed)
    pixels = pixels + noise * rng.normal(size=pixels.shape)
    wrong = rng.permutation(30)[:12]
    pixels[wrong] += 20 * (rng.choice([-1, 1], (12, 2)) + rng.normal(size=(12, 2)).clip(-0.5, 0.5))
    found = pnp(points, pixels, K, "ransac", threshold=4)
    right = np.setdiff1d(np.arange(30), wrong)
    assert found.inliers[right].all()
    if noise:
        assert geodesic_distance(found.R, R) < 0.1
    elif not found.inliers[wrong].any():
        assert_pose(found, R, t)
    clean = pnp(points[found.inliers], pixels[found.inliers], K)
    # Errors squared are known to 1e-16 of their sum, so a minimum's place to the root of that.
    np.testing.assert_allclose(found.R, clean.R, atol=1e-6)
    np.testing.assert_allclose(found.t, clean.t, atol=1e-6)
    assert found.reprojection_error == pytest.approx(clean.reprojection_error, abs=1e-9)
    errors = np.linalg.norm(picture(found.R, found.t, points) - pixels, axis=1)
    np.testing.assert_array_equal(found.inliers, errors <= 4)
    again = pnp(points, pixels, K, "ransac", threshold=4)
    assert (again.R == found.R).all() and (again.inliers == found.inliers).all()


@pytest.mark.slow
def test_few_noisy_points_of_a_plane_are_met_in_the_better_of_two_ways():
    for seed in range(100):  # SQPnP alone ends in the worse one three times
        rng = np.random.default_rng(seed)
        R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.1, -0.05, 3.0])
        points = rng.uniform(-0.1, 0.1, (5, 3)) * [1, 1, 0]
        pixels = picture(R, t, points) + rng.normal(size=(5, 2))
        near = pnp(points, pixels, K, R=R, t=t)
        assert pnp(points, pixels, K).reprojection_error <= near.reprojection_error + 1e-6


@pytest.mark.parametrize("confidence", [1e-9, 0.5, 1 - 1e-12])
def test_any_confidence_will_do_without_outliers(confidence):
    R, t, points, pixels = case(0, 12)
    assert_pose(pnp(points, pixels, K, "ransac", confidence=confidence), R, t)


@pytest.mark.parametrize("flat", [False, True])
def test_inliers_are_those_of_the_final_pose(flat):
    for seed in range(30):
        _, _, points, pixels = case(seed, 30, flat)
        pixels = pixels + np.random.default_rng(seed).normal(size=pixels.shape)
        found = pnp(points, pixels, K, "ransac", threshold=2)  # two sigma: many are near it
        errors = np.linalg.norm(picture(found.R, found.t, points) - pixels, axis=1)
        np.testing.assert_array_equal(found.inliers, errors <= 2)


def test_an_initial_pose_chooses_between_the_two_minima_of_a_flat_target():
    R, t, points, pixels = case(0, 20, flat=True, distance=5.0)
    pixels = pixels + 0.3 * np.random.default_rng(0).normal(size=pixels.shape)
    best = pnp(points, pixels, K)
    # Seen from afar, a plane tilted the other way about the line of sight looks almost the same.
    u = np.linalg.svd(points - points.mean(0))[2][2]
    sight = best.t / np.linalg.norm(best.t)
    mirror = np.eye(3) - 2 * np.outer(sight, sight)
    flipped = mirror @ best.R @ (np.eye(3) - 2 * np.outer(u, u))
    other = pnp(points, pixels, K, R=flipped, t=best.t)
    assert geodesic_distance(other.R, best.R) > 0.3
    assert best.reprojection_error < other.reprojection_error < 3 * best.reprojection_error
    back = pnp(points, pixels, K, R=R, t=t)
    np.testing.assert_allclose(back.R, best.R, atol=1e-5)


def test_kind_and_precision_of_the_input_come_back():
    R, t, points, pixels = case(0, 10)
    one = pnp(points, pixels, K, "ransac")
    assert one.inliers.dtype == bool and one.inliers.shape == (10,)
    tensors = [torch.from_numpy(x).float() for x in (points, pixels, K)]
    other = pnp(*tensors, "ransac")
    assert other.R.dtype == other.t.dtype == torch.float32 and other.inliers.dtype == torch.bool
    assert isinstance(other.reprojection_error, float)
    assert_pose(other, R, t, atol=1e-4)  # pixels in float32
    assert_pose(pnp(points.tolist(), pixels.tolist(), K.tolist()), R, t)


def test_other_cameras():
    R, t, points, _ = case(3, 10)
    for camera in (np.eye(3), K * [[-1], [1], [1]], np.diag([1e4, 9e3, 1])):
        camera_points = points @ R.T + t
        pixels = (camera_points / camera_points[:, 2:]) @ camera.T[:, :2]
        for method in ("iterative", "sqpnp", "epnp"):
            assert_pose(pnp(points, pixels, camera, method), R, t)


def test_no_random_state_is_touched():
    _, _, points, pixels = case(0, 20)
    cv2.setRNGSeed(1)
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one = pnp(points, pixels, K, "ransac", seed=5)
    cv2.setRNGSeed(77)
    other = pnp(points, pixels, K, "ransac", seed=5)
    assert (one.R == other.R).all()
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_the_cat_of_a_real_photograph(real_data):
    folder = real_data / "linemod_cat"
    keypoints = np.loadtxt(folder / "cat_points_3d.txt")
    pose = np.load(folder / "cat_pose.npy")
    camera = np.array([[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]])
    R, t = special_procrustes(pose[:, :3]), pose[:, 3]
    exact = picture(R, t, keypoints, camera)
    for method in ("iterative", "sqpnp", "epnp", "ransac"):
        assert_pose(pnp(keypoints, exact, camera, method), R, t)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pixels = exact + rng.normal(size=exact.shape)
        found = pnp(keypoints, pixels, camera)
        assert geodesic_distance(found.R, R) < np.radians(5)
        assert np.linalg.norm(found.t - t) < 0.03
        pixels[rng.permutation(len(pixels))[:3]] += 40
        found = pnp(keypoints, pixels, camera, "ransac", threshold=5)
        assert found.inliers.sum() == len(pixels) - 3
        assert geodesic_distance(found.R, R) < np.radians(8)


R0, T0, POINTS, PIXELS = case(0, 12)
FLAT = POINTS * [1, 1, 0]
LINE = np.linspace(0, 1, 12)[:, None] * [0.1, 0.2, -0.1] + 0.3
SKEW = K + [[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]]
ALL_OVER = np.random.default_rng(0).uniform(0, 480, (12, 2))


def run(points_3d=POINTS, points_2d=PIXELS, K=K, method="iterative", **options):
    return pnp(points_3d, points_2d, K, method, **options)


@pytest.mark.parametrize("method", ["iterative", "sqpnp", "ransac"])
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(points_3d=POINTS[:3], points_2d=PIXELS[:3]), "points_3d: expected at least 4 diff"),
        (dict(points_3d=POINTS[[0, 1, 2] * 4]), "points_3d: expected at least 4 different"),
        (dict(points_3d=LINE), "points_3d: expected points that are not all on one line"),
        (dict(points_3d=np.full((12, 3), 0.3)), "points_3d:"),
        (dict(points_3d=0.3 + 1e-17 * POINTS), "points_3d:"),
        (dict(points_2d=LINE[:, :2] * 100), "points_2d: expected points that are not all on one"),
        (dict(points_2d=np.full((12, 2), 33.3)), "points_2d:"),
        (dict(K=np.zeros((3, 3))), "K:"),
        (dict(K=SKEW), "K: expected no skew"),
        (dict(K=2 * K), "K:"),
        (dict(threshold=0), "threshold:"),
        (dict(threshold=np.nan), "threshold:"),
        (dict(confidence=1.0), "confidence:"),
        (dict(confidence=0), "confidence:"),
        (dict(max_iterations=0), "max_iterations:"),
        (dict(min_inliers=3), "min_inliers:"),
        (dict(seed=-1), "seed:"),
        (dict(seed=0.5), "seed:"),
    ],
)
def test_bad_input_is_named(changes, named, method):
    with pytest.raises(ValueError, match=f"^{named}"):
        run(method=method, **changes)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(method="p3p"), "method:"),
        (dict(method="epnp", points_3d=FLAT), "points_3d: expected at least 5 points, not in one"),
        (dict(method="epnp", points_3d=POINTS[:4], points_2d=PIXELS[:4]), "points_3d: expected at"),
        (dict(method="ippe"), "points_3d: expected points in one plane"),
        (dict(R=R0), "t:"),
        (dict(t=T0), "R:"),
        (dict(R=2 * R0, t=T0), "R:"),
        (dict(R=-R0, t=T0), "R:"),
        (dict(R=R0, t=T0, method="sqpnp"), "R: expected an initial pose only"),
        (dict(R=R0, t=T0, method="ransac"), "R: expected an initial pose only"),
        (dict(R=R0, t=[0, 0, -1]), "points_2d: expected the picture of an object in front"),
        (dict(method="ransac", points_2d=ALL_OVER, threshold=1e-3), "points_2d: expected 4 that"),
        (dict(method="ransac", points_2d=ALL_OVER, min_inliers=10), "points_2d: expected 10 that"),
        (dict(method="ransac", min_inliers=13), "points_2d: expected 13 that agree"),
    ],
)
def test_what_one_method_cannot_do_is_named(changes, named):
    with pytest.raises(ValueError, match=f"^{named}"):
        run(**changes)


@pytest.mark.parametrize("method", ["iterative", "sqpnp", "epnp", "ransac"])
def test_an_error_of_opencv_becomes_a_value_error(monkeypatch, method):
    def give_up(*args, **kwargs):
        raise cv2.error("an assertion failed")

    monkeypatch.setattr(cv2, "solvePnPRansac", give_up)
    monkeypatch.setattr(cv2, "solvePnPGeneric", give_up)
    with pytest.raises(ValueError, match="^points_2d:"):
        run(method=method)


@given(seed=SEEDS, method=st.sampled_from(["iterative", "sqpnp", "epnp", "ransac"]))
def test_nonsense_gives_a_pose_or_a_value_error(seed, method):
    rng = np.random.default_rng(seed)
    count = rng.integers(4, 9)
    points = rng.integers(-1, 2, (count, 3)).astype(float)  # many alike, flat or on lines
    pixels = rng.integers(0, 4, (count, 2)) * 200.0
    try:
        found = pnp(points, pixels, K, method)
    except ValueError:
        return
    np.testing.assert_allclose(found.R @ found.R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found.R) > 0 and np.isfinite(found.t).all()
    assert (points[found.inliers] @ found.R.T + found.t)[:, 2].min() > 0
    assert np.isfinite(found.reprojection_error)


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [0.005, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("count", [5, 8, 20])
def test_nearly_flat_points_do_not_end_in_the_mirror_image(thickness, count):
    """SQPnP alone begins on the wrong side in up to 4 % of such pictures."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-0.1, 0.1, (count, 3)) * [1, 1, thickness]
        R = Rotation.random(random_state=rng).as_matrix()
        t = np.array([0, 0, rng.uniform(0.5, 1.2)])
        pixels = picture(R, t, points) + 1.5 * rng.normal(size=(count, 2))
        best = pnp(points, pixels, K, R=R, t=t).reprojection_error
        assert pnp(points, pixels, K).reprojection_error <= best * (1 + 1e-6), seed


@pytest.mark.parametrize("method", ["ippe", "sqpnp", "iterative", "ransac"])
@pytest.mark.parametrize("short_of_it", [0, 1e-9, 1e-6, 1e-3, 0.1])
def test_half_turns_of_flat_targets(method, short_of_it):
    """OpenCV's IPPE makes a vector of its rotation by a formula that breaks there."""
    rng = np.random.default_rng(0)
    for axis in [*np.eye(3), *rng.normal(size=(10, 3)), *rng.normal(size=(10, 3)) * [1, 1, 0]]:
        points = rng.uniform(-0.1, 0.1, (8, 3)) * [1, 1, 0]
        R = Rotation.from_rotvec((np.pi - short_of_it) * axis / np.linalg.norm(axis)).as_matrix()
        t = np.array([0.1, 0.05, 1])
        found = pnp(points, picture(R, t, points), K, method)
        assert found.reprojection_error < 1e-4  # cv2.Rodrigues rounds the last 1e-5 to pi
        assert_pose(found, R, t, atol=1e-5)


def test_planar_poses_are_the_two_that_fit_flat_points():
    R, t, points, pixels = case(3, 8, flat=True)
    best, other = planar_poses(points, pixels, K)
    np.testing.assert_allclose(cv2.Rodrigues(best[0])[0], R, atol=1e-6)
    np.testing.assert_allclose(best[1][:, 0], t, atol=1e-6)
    mirrored = mirror_pose(points - points.mean(0), R, t + R @ points.mean(0))
    assert geodesic_distance(cv2.Rodrigues(other[0])[0], mirrored) < 0.2
    assert geodesic_distance(mirrored, R) > 0.4
    back = mirror_pose(points - points.mean(0), mirrored, t + R @ points.mean(0))
    np.testing.assert_allclose(back, R, atol=1e-12)
