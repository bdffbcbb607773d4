import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from data_tools.checking.drawing import Placement, Shape, draw, hull_mask, hull_of
from tests.data_tools.checking.made import MESHES, K

SIZE = (160, 120)
BOX = Shape(1, trimesh.creation.box((0.2, 0.1, 0.3)))


def placed(seed, scale=1.0):
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=seed).as_matrix()
    return Placement(K, R, rng.uniform([-0.1, -0.1, 0.7], [0.1, 0.1, 1.5]), scale)


def cast(shape, place):
    """Silhouette and depth by a ray for each pixel."""
    mesh = shape.prepared.mesh
    mesh = trimesh.Trimesh(place.scale * mesh.vertices @ place.R.T + place.t, mesh.faces)
    x, y = np.meshgrid(*map(np.arange, SIZE))
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(place.K).T
    depth = np.full(len(rays), np.inf)
    for a, b, c in mesh.triangles:
        normal = np.cross(b - a, c - a)
        z = (normal @ a) / (rays @ normal)  # rays have z 1
        points = rays * z[:, None]
        sides = [np.cross(q - p, points - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
        depth = np.where(np.all(np.array(sides) >= 0, 0) & (z > 0), np.minimum(depth, z), depth)
    depth = depth.reshape(SIZE[::-1])
    return np.isfinite(depth), np.where(np.isfinite(depth), depth, 0)


@pytest.mark.parametrize("seed", range(4))
def test_silhouette_and_depth_are_those_of_rays(seed):
    mask, depth = draw(BOX, placed(seed), SIZE)
    expected, distance = cast(BOX, placed(seed))
    assert expected.sum() > 300
    assert (mask != expected).sum() <= 3  # rays that pass an edge exactly
    both = mask & expected
    np.testing.assert_allclose(depth[both], distance[both], rtol=1e-6)
    assert not depth[~mask].any()


@pytest.mark.slow
@settings(max_examples=15)
@given(seed=st.integers(0, 1000), factor=st.sampled_from([1e-6, 1e-3, 0.5, 10, 1e6]))
def test_only_ratios_count(seed, factor):
    place = placed(seed)
    larger = Placement(K, place.R, place.t * factor, factor)
    mask, depth = draw(BOX, place, SIZE)
    again, distance = draw(BOX, larger, SIZE)
    assert np.array_equal(mask, again)
    np.testing.assert_allclose(distance, depth * factor, rtol=1e-7)


@settings(max_examples=15)
@given(seed=st.integers(0, 1000))
def test_the_hull_is_that_of_the_projected_corners(seed):
    place = placed(seed)
    corners = BOX.prepared.mesh.vertices @ place.R.T + place.t
    pixels = corners @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    area = ConvexHull(pixels).volume
    assert cv2.contourArea(hull_of(BOX, place)) == pytest.approx(area, rel=1e-4)
    mask = hull_mask(hull_of(BOX, place), SIZE)
    drawn = draw(BOX, place, SIZE)[0]
    assert (drawn & ~mask).sum() <= 3  # OpenCV counts the border in, and rounds corners
    assert (mask & ~drawn).sum() < 0.08 * drawn.sum() + 20


@pytest.mark.slow
def test_a_rough_mesh_has_few_corners():
    ball = Shape(1, trimesh.creation.icosphere(subdivisions=5, radius=0.5))
    assert len(ball.points) <= 600
    assert ball.diameter == pytest.approx(1, rel=1e-3)
    corners = MESHES[3].vertices
    expected = max(np.linalg.norm(a - b) for a in corners for b in corners)
    assert Shape(3, MESHES[3]).diameter == pytest.approx(expected, rel=1e-9)


def test_what_is_not_before_the_camera():
    behind = Placement(K, np.eye(3), np.array([0, 0, -1.0]))
    assert hull_of(BOX, behind) is None and not hull_mask(None, SIZE).any()
    assert not draw(BOX, behind, SIZE)[0].any()
    inside = Placement(K, np.eye(3), np.zeros(3))
    assert hull_of(BOX, inside) is None
    assert draw(BOX, inside, SIZE)[0].all()
    aside = Placement(K, np.eye(3), np.array([5.0, 0, 1]))
    assert not draw(BOX, aside, SIZE)[0].any()


def test_points_alone_are_their_hull():
    points = Shape(1, trimesh.Trimesh(BOX.prepared.mesh.vertices, process=False))
    mask, depth = draw(points, placed(0), SIZE)
    assert depth is None
    assert (mask != draw(BOX, placed(0), SIZE)[0]).sum() < 120


def test_an_open_mesh_is_seen_from_both_sides():
    faces = BOX.prepared.mesh.faces
    turned = Shape(1, trimesh.Trimesh(BOX.prepared.mesh.vertices, faces[:, ::-1], process=False))
    for one, other in zip(draw(BOX, placed(2), SIZE), draw(turned, placed(2), SIZE), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_small_image_has_every_second_pixel():
    hull = np.array([[10, 10], [50, 10], [50, 30], [10, 30]], np.float32)
    small = hull_mask(hull, (101, 60), 2)
    assert small.shape == (30, 51)
    assert np.array_equal(small, hull_mask(hull, (101, 60))[::2, ::2])
