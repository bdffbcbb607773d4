"""Distances from a surface against what is known of boxes, balls and points."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

from data_tools.bop.surfaces import MOST_VERTICES, Surface


def from_box(points, half):
    """How far points are from the surface of a box around the origin."""
    beyond = np.abs(points) - half
    outside = np.linalg.norm(beyond.clip(min=0), axis=1)
    return np.where((beyond < 0).all(1), -beyond.max(1), outside)


def test_of_a_box(rng):
    half = np.array([0.05, 0.03, 0.02])
    points = rng.uniform(-0.1, 0.1, (3000, 3))
    found = Surface(trimesh.creation.box(2 * half)).distances(points)
    expected = from_box(points, half)
    # Never too small, and too large by no more than the points that find the triangles are apart.
    assert (found - expected > -1e-15).all()
    assert (found - expected).max() < 1e-3
    assert np.median(found - expected) < 1e-12


def test_of_a_ball(rng):
    surface = Surface(trimesh.creation.icosphere(4, 0.1))
    points = rng.normal(size=(500, 3)) / 10
    expected = np.abs(np.linalg.norm(points, axis=1) - 0.1)
    np.testing.assert_allclose(surface.distances(points), expected, rtol=0, atol=5e-4)


def test_its_own_points_lie_on_it():
    surface = Surface(trimesh.creation.torus(0.05, 0.02))
    assert len(surface.points) == 1024 + 5000
    largest, mean = surface.gap(surface.points)
    assert largest < 1e-6 and mean < 1e-6


def test_where_many_thin_triangles_meet():
    """In the middle of a disk's fan the nearest drawn points lie on other triangles."""
    disk = trimesh.creation.cylinder(0.04, 0.001, sections=64)
    surface = Surface(disk)
    turned = surface.points @ trimesh.transformations.rotation_matrix(1.0, [0, 0, 1])[:3, :3]
    assert surface.gap(turned)[0] < 2e-4 < surface.distances(turned).max()


def test_the_smallest_triangle_is_not_overlooked():
    large = trimesh.creation.box((1, 1, 1))
    tiny = trimesh.creation.box((1e-4, 1e-4, 1e-4))
    tiny.apply_translation([0, 0, 0.8])
    surface = Surface(trimesh.util.concatenate([large, tiny]))
    assert surface.distances(np.array([[0, 0, 0.8]])) == pytest.approx(0.5e-4, abs=1e-9)


def test_points_without_faces(rng):
    cloud = trimesh.Trimesh(rng.normal(size=(40, 3)), np.zeros((0, 3), int), process=False)
    surface, points = Surface(cloud), rng.normal(size=(30, 3))
    assert np.array_equal(surface.points, cloud.vertices)
    expected = cdist(points, cloud.vertices).min(1)
    np.testing.assert_allclose(surface.distances(points), expected, rtol=1e-12)


def test_many_vertices_are_thinned_out_always_alike(rng):
    cloud = trimesh.Trimesh(rng.normal(size=(50_000, 3)), np.zeros((0, 3), int), process=False)
    one, other = Surface(cloud), Surface(cloud)
    assert len(one.points) == MOST_VERTICES
    assert np.array_equal(one.points, other.points)
