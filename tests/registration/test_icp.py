"""ICP against brute force, on shapes that leave motions open, and on real and computed depth."""

import json
import math

import cv2
import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.registration import icp, refine_on_depth, umeyama
from posecore.rotations import axis_angle_to_matrix, geodesic_distance, special_procrustes

SEEDS = st.integers(0, 2**32 - 1)
METHODS = ["point_to_point", "point_to_plane"]
EYE, ORIGIN = np.eye(3), np.zeros(3)


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def perturbed(R, t, degrees, metres, seed):
    """A pose off by exactly an angle about, and a distance along, random directions."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(math.radians(degrees) * direction(rng)).as_matrix()
    return turn @ R, t + metres * direction(rng)


def pose_errors(found, R, t):
    return math.degrees(geodesic_distance(found.R, R)), np.linalg.norm(found.t - t)


def ellipsoid(count, axes, seed=0):
    """Points of an ellipsoid and its outward unit normals."""
    rng = np.random.default_rng(seed)
    sphere = rng.normal(size=(count, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    normals = sphere / axes
    return sphere * axes, normals / np.linalg.norm(normals, axis=1, keepdims=True)


# Points far apart compared with the motion, so that the nearest is the true partner from the start.
LATTICE = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)


@given(seed=SEEDS, method=st.sampled_from(METHODS), scale=st.sampled_from([1e-3, 1.0, 1e3]))
def test_a_moved_part_of_a_cloud_is_put_back(seed, method, scale):
    rng = np.random.default_rng(seed)
    target = scale * (LATTICE + rng.uniform(-0.2, 0.2, LATTICE.shape))
    normals = rng.normal(size=target.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    R, t = perturbed(EYE, scale * rng.normal(size=3), 1.5, 0.05 * scale, seed)
    chosen = rng.permutation(len(target))[:30]
    source = (target[chosen] - t) @ R  # so that (R, t) leads to the target

    start = axis_angle_to_matrix(0.01 * direction(rng)) @ R, t + 0.05 * scale * direction(rng)
    found = icp(source, target, *start, method=method, target_normals=normals)

    assert found.converged and found.inlier_count == 30 and found.inlier_fraction == 1
    np.testing.assert_allclose(found.R, R, atol=1e-9)
    np.testing.assert_allclose(found.t, t, atol=1e-8 * scale)
    assert found.rmse < 1e-8 * scale


@given(seed=SEEDS, keep=st.sampled_from([1.0, 0.6]))
def test_one_step_is_a_brute_force_fit_of_brute_force_pairs(seed, keep):
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 40, 3))
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)

    def pairs(R, t):
        moved = source @ R.T + t
        gaps = np.linalg.norm(moved[:, None] - target, axis=-1)
        best = np.flatnonzero(gaps.min(1) < 1.5)
        best = best[np.argsort(gaps.min(1)[best])][: math.ceil(keep * len(best))]
        return moved[best], gaps.argmin(1)[best]

    moved, partner = pairs(R, t)
    options = dict(max_distance=1.5, keep=keep, max_iterations=1)
    to_points = icp(source, target, R, t, **options)
    _, step_R, step_t = umeyama(moved, target[partner])
    np.testing.assert_allclose(to_points.R, step_R @ R, atol=1e-10)
    np.testing.assert_allclose(to_points.t, step_R @ t + step_t, atol=1e-10)

    to_planes = icp(
        source, target, R, t, method="point_to_plane", target_normals=normals, **options
    )
    n = normals[partner]
    # Low 2004, about the origin: the normal equations have one solution, wherever one turns about.
    A = np.concatenate([np.cross(moved, n), n], 1)
    middle = moved.mean(0)
    A[:, :3] -= np.cross(middle, n)
    x = np.linalg.solve(A.T @ A, A.T @ ((target[partner] - moved) * n).sum(1))
    step_R = Rotation.from_rotvec(x[:3]).as_matrix()
    np.testing.assert_allclose(to_planes.R, step_R @ R, atol=1e-7)
    np.testing.assert_allclose(to_planes.t, step_R @ (t - middle) + middle + x[3:], atol=1e-7)

    for found in (to_points, to_planes):
        moved, partner = pairs(found.R, found.t)
        distances = np.linalg.norm(moved - target[partner], axis=1)
        assert found.rmse == pytest.approx(np.sqrt(np.mean(distances**2)))
        assert (found.inlier_count, found.inlier_fraction) == (len(moved), len(moved) / 40)
        assert (found.iterations, found.converged) == (1, False)


def test_planes_need_fewer_steps_than_points():
    target, normals = ellipsoid(4000, np.array([0.05, 0.08, 0.12]))
    source = ellipsoid(500, np.array([0.05, 0.08, 0.12]), seed=1)[0]
    R, t = perturbed(EYE, ORIGIN, 8, 0.01, seed=0)
    options = dict(target_normals=normals, tolerance=1e-4, max_iterations=200)
    points, planes = (icp(source, target, R, t, method=m, **options) for m in METHODS)
    assert points.converged and planes.converged
    assert planes.iterations * 4 < points.iterations
    degrees, metres = pose_errors(planes, EYE, ORIGIN)
    assert degrees < 0.3 and metres < 2e-4  # its points lie 4 mm apart


@given(seed=SEEDS)
def test_a_plane_is_met_without_sliding_or_turning_on_it(seed):
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    target = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], 1)
    normals = np.tile([0.0, 0.0, 1.0], (len(target), 1))
    source = np.concatenate([rng.uniform(-0.5, 0.5, (50, 2)), np.zeros((50, 1))], 1)
    spin = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    tilt = Rotation.from_rotvec([*rng.uniform(-0.2, 0.2, 2), 0]).as_matrix()
    t = rng.uniform(-0.2, 0.2, 3)
    F = Rotation.random(random_state=rng).as_matrix()  # the plane lies aslant

    def land(R):
        options = dict(method="point_to_plane", target_normals=normals @ F.T)
        found = icp(source, target @ F.T, F @ R, F @ t, **options)
        assert found.converged
        return F.T @ found.R, F.T @ found.t

    R, there = land(spin)
    np.testing.assert_allclose(R, spin, atol=1e-12)
    np.testing.assert_allclose(there, [t[0], t[1], 0], atol=1e-12)

    R, there = land(tilt @ spin)
    np.testing.assert_allclose((source @ R.T + there)[:, 2], 0, atol=1e-9)
    assert np.linalg.norm(there[:2] - t[:2]) < 0.1 and geodesic_distance(R, spin) < 0.1


def test_a_sphere_finds_its_centre_and_keeps_its_turn(rng):
    target, normals = ellipsoid(3000, np.ones(3))
    source = ellipsoid(300, np.ones(3), seed=1)[0]
    R = Rotation.random(random_state=rng).as_matrix()
    options = dict(method="point_to_plane", target_normals=normals, tolerance=1e-3)
    found = icp(source, target, R, [0.2, -0.1, 0.1], **options)
    assert found.converged
    np.testing.assert_allclose(found.t, 0, atol=2e-3)  # 0.06 between points, squared by the planes
    assert geodesic_distance(found.R, R) < 0.245  # no point turns farther than the centre moves


def test_clutter_falls_to_the_schedule_and_to_trimming(rng):
    axes = np.array([0.05, 0.08, 0.12])
    target, normals = ellipsoid(4000, axes)
    source = ellipsoid(400, axes, seed=1)[0]
    source[:30] += [0.0, 0.0, 0.3]  # has no partner
    source[30:90] *= 0.7  # has a wrong one, at 2 to 3 cm
    start = perturbed(EYE, ORIGIN, 5, 0.01, seed=0)
    options = dict(method="point_to_plane", target_normals=normals, max_iterations=100)
    schedule = icp(source, target, *start, max_distance=(0.05, 0.02, 0.01), **options)
    trimmed = icp(source, target, *start, keep=0.7, **options)
    assert max(pose_errors(schedule, EYE, ORIGIN)) < 0.4
    assert max(pose_errors(trimmed, EYE, ORIGIN)) < 0.4
    assert schedule.inlier_count == 310 and trimmed.inlier_count == 280
    assert schedule.rmse < 3e-3  # the target's points lie 4 mm apart
    for distance in (0.05, None):
        found = icp(source, target, *start, max_distance=distance, **options)
        assert max(pose_errors(found, EYE, ORIGIN)) > 1


def test_the_frames_may_be_moved_and_the_result_moves_along(rng):
    target, normals = ellipsoid(500, np.array([0.05, 0.08, 0.12]))
    source = target[:100] + 1e-3 * rng.normal(size=(100, 3))
    R, t = perturbed(EYE, ORIGIN, 3, 0.005, seed=1)
    A, a = perturbed(EYE, ORIGIN, 77, 2.0, seed=2)
    for method in METHODS:
        options = dict(method=method, max_iterations=10)
        here = icp(source, target, R, t, target_normals=normals, **options)
        there = icp(
            source, target @ A.T + a, A @ R, A @ t + a, target_normals=normals @ A.T, **options
        )
        np.testing.assert_allclose(there.R, A @ here.R, atol=1e-9)
        np.testing.assert_allclose(there.t, A @ here.t + a, atol=1e-9)


def test_a_slightly_wrong_rotation_becomes_a_rotation():
    target, _ = ellipsoid(200, np.array([0.05, 0.08, 0.12]))
    found = icp(target[:50], target, EYE + 3e-4, ORIGIN)
    np.testing.assert_allclose(found.R @ found.R.T, EYE, atol=1e-14)
    assert found.converged and found.rmse < 1e-12


def test_tensors_come_back_as_tensors_of_their_precision():
    target = torch.from_numpy(ellipsoid(200, np.array([0.05, 0.08, 0.12]))[0]).float()
    source = target[:50].requires_grad_()
    found = icp(source, target, torch.eye(3), torch.full((3,), 1e-3))
    assert found.R.dtype == found.t.dtype == torch.float32
    assert isinstance(found.rmse, float) and isinstance(found.converged, bool)
    assert not found.R.requires_grad
    torch.testing.assert_close(found.t, torch.zeros(3), atol=1e-7, rtol=0)


# A half-axes ellipsoid before a wall, seen by a small camera: depth to the bit, no sensor.
AXES = np.array([0.05, 0.08, 0.12])
CAMERA = np.array([[300.0, 0, 79.5], [0, 300, 59.5], [0, 0, 1]])
TRUE_R = Rotation.from_euler("xyz", [2.0, 0.4, -1.0]).as_matrix()
TRUE_T = np.array([0.03, -0.02, 0.7])


def depth_of_ellipsoid(R, t, wall=0.9):
    columns, rows = np.meshgrid(np.arange(160), np.arange(120))
    pixels = np.stack([columns, rows, np.ones_like(rows)], -1)
    rays = pixels @ np.linalg.inv(CAMERA).T @ R / AXES  # in the frame where it is the unit sphere
    eye = -t @ R / AXES
    a, b, c = (rays**2).sum(-1), rays @ eye, eye @ eye - 1
    root = b * b - a * c
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, wall)


@pytest.mark.slow
@given(seed=SEEDS)
def test_a_computed_depth_image_is_met(seed):
    depth = depth_of_ellipsoid(TRUE_R, TRUE_T)
    model = ellipsoid(1000, AXES)
    start = perturbed(TRUE_R, TRUE_T, 8, 0.015, seed)
    found = refine_on_depth(depth, CAMERA, *model, *start)
    degrees, metres = pose_errors(found, TRUE_R, TRUE_T)
    assert degrees < 0.5 and metres < 5e-4  # pixels are 2.3 mm apart
    assert found.inlier_fraction > 0.8 and found.rmse < 2e-3


def test_a_hidden_half_and_missing_depth_do_not_pull():
    depth = depth_of_ellipsoid(TRUE_R, TRUE_T)
    depth[:, 95:] = 0.55  # an occluder
    depth[::3] = 0
    model = ellipsoid(1000, AXES)
    for seed in range(5):
        start = perturbed(TRUE_R, TRUE_T, 5, 0.01, seed)
        found = refine_on_depth(depth, CAMERA, *model, *start)
        degrees, metres = pose_errors(found, TRUE_R, TRUE_T)
        assert degrees < 1.5 and metres < 2e-3
    assert 0.3 < found.inlier_fraction < 0.8


def test_refinement_does_not_depend_on_the_unit():
    depth = depth_of_ellipsoid(TRUE_R, TRUE_T)
    points, normals = ellipsoid(500, AXES)
    R, t = perturbed(TRUE_R, TRUE_T, 8, 0.015, seed=3)
    metres = refine_on_depth(depth, CAMERA, points, normals, R, t)
    mm = refine_on_depth(1000 * depth, CAMERA, 1000 * points, normals, R, 1000 * t)
    np.testing.assert_allclose(mm.R, metres.R, atol=1e-9)
    np.testing.assert_allclose(mm.t, 1000 * metres.t, atol=1e-6)


@pytest.mark.slow
def test_a_real_frame_is_met_from_every_perturbation(real_data):
    scene = real_data / "lmo" / "test" / "000002"
    camera = json.loads((scene / "scene_camera.json").read_text())["3"]
    K = np.reshape(camera["cam_K"], (3, 3))
    image = cv2.imread(str(scene / "depth" / "000003.png"), cv2.IMREAD_UNCHANGED)
    depth = image * camera["depth_scale"] / 1000
    truth = json.loads((scene / "scene_gt.json").read_text())["3"]
    can = next(view for view in truth if view["obj_id"] == 5)
    R = special_procrustes(np.reshape(can["cam_R_m2c"], (3, 3)))
    t = np.array(can["cam_t_m2c"]) / 1000
    mesh = trimesh.load(real_data / "lmo" / "models" / "obj_000005.ply", process=False)
    points, face = trimesh.sample.sample_surface(mesh, 2000, seed=0)
    model = points / 1000, mesh.face_normals[face]

    for seed in range(20):
        found = refine_on_depth(depth, K, *model, *perturbed(R, t, 10, 0.02, seed))
        degrees, metres = pose_errors(found, R, t)
        # The depth lies 6 mm behind the model at the ground truth, so that is how far it is.
        assert degrees < 5 and metres < 0.01
        assert found.converged and found.rmse < 0.004 and found.inlier_fraction > 0.5


CLOUD, NORMALS = ellipsoid(50, np.ones(3))
DEPTH = depth_of_ellipsoid(TRUE_R, TRUE_T)
MODEL = ellipsoid(100, AXES)


def run(**changes):
    given = dict(source=CLOUD, target=CLOUD, R=EYE, t=ORIGIN, target_normals=NORMALS)
    return icp(**(given | changes))


def refine(**changes):
    given = dict(depth=DEPTH, K=CAMERA, model_points=MODEL[0], model_normals=MODEL[1])
    return refine_on_depth(**(given | dict(R=TRUE_R, t=TRUE_T) | changes))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: run(R=np.diag([1, 1, -1])), "R: expected rotation"),
        (lambda: run(R=1.1 * EYE), "R: expected rotation"),
        (lambda: run(method="plane"), "method:"),
        (lambda: run(method="point_to_plane", target_normals=None), "target_normals:"),
        (lambda: run(method="point_to_plane", target_normals=2 * NORMALS), "target_normals:"),
        (lambda: run(t=[9, 9, 9], max_distance=0.5), "max_distance: expected at least 3 pairs"),
        (lambda: run(source=CLOUD[:2]), "source: expected at least 3 pairs"),
        (lambda: run(max_distance=0), "max_distance:"),
        (lambda: run(max_distance=[]), "max_distance:"),
        (lambda: run(max_distance=[0.1, 0.2]), "max_distance: expected distances from coarse"),
        (lambda: run(max_distance="far"), "max_distance:"),
        (lambda: run(keep=0), "keep:"),
        (lambda: run(keep=1.1), "keep:"),
        (lambda: run(max_iterations=0), "max_iterations:"),
        (lambda: run(tolerance=-1), "tolerance:"),
        (lambda: run(source=np.arange(5.0)[:, None] * [0.1, 0.2, 0]), "source and target: "),
        (lambda: refine(depth=np.zeros((120, 160))), "depth:"),
        (lambda: refine(depth=-DEPTH), "depth:"),
        (lambda: refine(depth=np.full((120, 160), 3.0)), "depth: expected points within"),
        (lambda: refine(t=TRUE_T - [0, 0, 2]), "depth: expected points within"),
        (lambda: refine(K=np.zeros((3, 3))), "K:"),
        (lambda: refine(model_normals=0 * MODEL[1]), "model_normals: expected vectors of length"),
        (lambda: refine(R=-EYE), "R:"),
        (lambda: refine(max_distance=1e-6), "max_distance:"),
        (lambda: refine(keep=2), "keep:"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}"):
        call()


def test_the_same_call_gives_the_same_bits(rng):
    start = perturbed(TRUE_R, TRUE_T, 8, 0.015, seed=0)
    one, other = (refine_on_depth(DEPTH, CAMERA, *MODEL, *start) for _ in range(2))
    assert (one.R == other.R).all() and (one.t == other.t).all() and one[2:] == other[2:]
