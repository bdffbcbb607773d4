"""OpenGL's cameras: a point lands on the same pixel by either way."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import cameras, poses
from posecore.opengl import (
    intrinsics_to_projection,
    opencv_to_opengl,
    opengl_to_opencv,
    projection_to_intrinsics,
)

SIZE = (640, 480)
K = np.array([[572.4, 1.5, 325.3], [0, 573.6, 242.0], [0, 0, 1]])
seeds = st.integers(0, 10**6)


def pixel_of_opengl(P, point, size):
    """What OpenGL does with a point of its camera frame, step by step."""
    clip = P @ [*point, 1]
    x, y, depth = clip[:3] / clip[3]
    column, row_from_below = (x + 1) / 2 * size[0], (y + 1) / 2 * size[1]
    # Its pixels are areas: the first one goes from 0 to 1, and its centre is at a half.
    return np.array([column - 0.5, size[1] - row_from_below - 0.5]), depth


@given(seeds)
def test_both_ways_lead_to_the_same_pixel(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=rng).as_matrix()
    t, points = np.array([*rng.normal(size=2), 4]), rng.normal(size=(5, 3))
    camera = poses.apply(R, t, points)
    expected = cameras.project(K, camera, behind="inf")
    P = intrinsics_to_projection(K, SIZE, 0.5, 20.0)
    seen = poses.apply(*opencv_to_opengl(R, t), points)
    for point, pixel, z in zip(seen, expected, camera[:, 2], strict=True):
        if z > 0.1:
            found, depth = pixel_of_opengl(P, point, SIZE)
            np.testing.assert_allclose(found, pixel, rtol=0, atol=1e-9)
            assert (depth < -1) == (z < 0.5) and (depth > 1) == (z > 20)


def test_the_corners_and_planes_of_what_is_seen():
    P = intrinsics_to_projection(K, SIZE, 0.5, 20.0)
    for z, depth in ((0.5, -1), (20.0, 1)):
        for corner in ([-0.5, -0.5], [639.5, 479.5]):
            point = z * np.linalg.solve(K, [*corner, 1])
            clip = P @ [point[0], -point[1], -point[2], 1]
            sign = -1 if corner[0] < 0 else 1
            np.testing.assert_allclose(clip[:3] / clip[3], [sign, -sign, depth], atol=1e-12)
    endless = intrinsics_to_projection(K, SIZE, 0.5, math.inf)
    assert np.array_equal(endless[2], [0, 0, -1, -1])
    np.testing.assert_allclose(endless, intrinsics_to_projection(K, SIZE, 0.5, 1e12), atol=1e-11)


def test_a_perspective_by_field_of_view():
    """As gluPerspective writes it: the optical axis in the middle of the picture."""
    angle, (width, height), near, far = math.radians(60), SIZE, 0.1, 10.0
    f = 1 / math.tan(angle / 2)
    P = np.zeros((4, 4))
    P[0, 0], P[1, 1] = f * height / width, f
    P[2, 2:], P[3, 2] = [(far + near) / (near - far), 2 * far * near / (near - far)], -1
    found = projection_to_intrinsics(P, SIZE)
    focal = height / 2 / math.tan(angle / 2)
    expected = [[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(intrinsics_to_projection(found, SIZE, near, far), P, atol=1e-14)


@given(seeds)
def test_projections_come_back(seed):
    rng = np.random.default_rng(seed)
    many = K * rng.uniform(0.5, 2, (2, 3, 1, 1)) * [[1, 1, 1], [1, -1, 1], [0, 0, 0]] + [
        [0, 0, 0], [0, 0, 0], [0, 0, 1]
    ]  # fmt: skip
    P = intrinsics_to_projection(many, SIZE, 0.1, 9)
    np.testing.assert_allclose(projection_to_intrinsics(P, SIZE), many, atol=1e-11)


@given(seeds)
def test_poses_of_objects_and_of_cameras(seed):
    R, t = Rotation.random(random_state=seed).as_matrix(), np.array([0.1, -0.2, 3])
    F = np.diag([1.0, -1, -1, 1])
    there = opencv_to_opengl(R, t)
    assert np.array_equal(poses.to_matrix(*there), F @ poses.to_matrix(R, t))
    for one, other in zip(opengl_to_opencv(*there), (R, t), strict=True):
        assert np.array_equal(one, other)
    # A camera's own pose, camera to world, as NeRF's transforms.json has it: its columns change.
    to_world = poses.to_matrix(R, t)
    found = poses.to_matrix(*opengl_to_opencv(*poses.invert(R, t)))
    np.testing.assert_allclose(np.linalg.inv(found), to_world @ F, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("size", lambda: intrinsics_to_projection(K, 640, 0.1, 9)),
        ("size", lambda: intrinsics_to_projection(K, (640, 0), 0.1, 9)),
        ("size", lambda: projection_to_intrinsics(np.eye(4), (1, 2, 3))),
        ("near", lambda: intrinsics_to_projection(K, SIZE, 0, 9)),
        ("far", lambda: intrinsics_to_projection(K, SIZE, 1, 1)),
        ("far", lambda: intrinsics_to_projection(K, SIZE, 1, math.nan)),
        ("K", lambda: intrinsics_to_projection(np.zeros((3, 3)), SIZE, 1, 2)),
        ("P", lambda: projection_to_intrinsics(np.eye(4), SIZE)),
        (
            "P",
            lambda: projection_to_intrinsics(intrinsics_to_projection(K, SIZE, 1, 2).T, SIZE),
        ),
        (
            "P",
            lambda: projection_to_intrinsics(
                intrinsics_to_projection(K, SIZE, 1, 2) + np.eye(4, k=3), SIZE
            ),
        ),
    ],
)
def test_what_cannot_be(name, call):
    with pytest.raises(ValueError, match=f"^{name}: expected "):
        call()
