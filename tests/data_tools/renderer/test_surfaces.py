import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.renderer.surfaces import (
    camera_points,
    dot,
    face_normals,
    normalised,
    rotated,
    surface_at,
)
from posecore.cameras import project


def triple(array):
    return tuple(np.float32(array).T)


@given(st.integers(0, 2**32 - 1))
def test_vectors(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 7, 3))
    R = Rotation.random(random_state=rng).as_matrix()
    np.testing.assert_allclose(dot(triple(a), triple(b)), (a * b).sum(1), atol=1e-5)
    np.testing.assert_allclose(np.stack(rotated(R, triple(a)), 1), a @ R.T, atol=1e-5)
    unit = a / np.linalg.norm(a, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack(normalised(triple(a)), 1), unit, atol=1e-5)
    assert not np.stack(normalised(triple(0 * a))).any()


@given(st.integers(0, 2**32 - 1))
def test_camera_points_project_to_their_pixels(seed):
    rng = np.random.default_rng(seed)
    K = np.array([[rng.uniform(100, 900), rng.uniform(-5, 5), 160], [0, 300, 90], [0, 0, 1]])
    x, y, z = rng.uniform(0, 320, 9), rng.uniform(0, 188, 9), rng.uniform(0.01, 5, 9)
    points = np.stack(camera_points(K, x, y, 1 / z), 1)
    assert points.dtype == np.float32
    np.testing.assert_allclose(points[:, 2], z, rtol=1e-6)
    pixels = project(K, points.astype(np.float64))
    np.testing.assert_allclose(pixels, np.stack([x, y], 1), atol=1e-3)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_the_surface_at_points_of_faces(shapes, seed):
    rng = np.random.default_rng(seed)
    item = shapes[rng.integers(len(shapes))]
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.02, -0.03, 0.5])
    K = np.array([[300.0, 0, 160], [0, 300, 90], [0, 0, 1]])
    face = rng.integers(len(item.source), size=20)
    corners = item.mesh.vertices[item.mesh.faces[item.source[face]]]
    weights = rng.dirichlet([1, 1, 1], 20)
    points = np.einsum("pk,pkj->pj", weights, corners)
    seen = points @ R.T + t
    x, y = project(K, seen).T
    surface = surface_at(item, (R, t), K, x, y, 1 / seen[:, 2], face)
    np.testing.assert_allclose(np.stack(surface.point, 1), seen, atol=1e-6)
    np.testing.assert_allclose(np.stack(surface.coordinates, 1), points, atol=1e-6)
    normal = np.einsum("pk,pkj->pj", weights, item.mesh.corner_normals[item.source[face]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack(surface.object_normal, 1), normal, atol=2e-3)
    flat = item.planes[:3, face].T @ R.T
    side = np.where((flat * seen).sum(1) > 0, -1, 1)[:, None]
    np.testing.assert_array_equal(surface.side, side[:, 0])
    np.testing.assert_allclose(np.stack(surface.normal, 1), side * (normal @ R.T), atol=2e-3)
    towards = np.stack(face_normals(item, (R, t), face, surface.side), 1)
    np.testing.assert_allclose(towards, side * flat, atol=1e-6)
    assert ((towards * seen).sum(1) <= 1e-6).all()
