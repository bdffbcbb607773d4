from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from data_tools.shapes import NAMES, make_object
from data_tools.shapes.building import turns
from data_tools.textures import albedo, infrared

IDS = range(1, 9)
make = cache(make_object)


@cache
def samples(object_id, count=500):
    """Points on the surface that can be seen from outside, and their faces."""
    mesh = make(object_id)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    rng = np.random.default_rng(object_id)
    face = rng.choice(len(mesh.faces), count, p=body.area_faces / body.area_faces.sum())
    corner = rng.dirichlet((1, 1, 1), count)
    return (mesh.vertices[mesh.faces[face]] * corner[..., None]).sum(1), face


def nearest(mesh, points):
    """The point of the surface nearest to each point, its face, and the distance."""
    triangles = mesh.vertices[mesh.faces]
    near = cKDTree(triangles.mean(1)).query(points, k=40)[1]
    on = trimesh.triangles.closest_point(
        triangles[near].reshape(-1, 3, 3), np.repeat(points, near.shape[1], 0)
    ).reshape(*near.shape, 3)
    distance = np.linalg.norm(on - points[:, None], axis=-1)
    best = distance.argmin(1)
    rows = np.arange(len(points))
    return on[rows, best], near[rows, best], distance[rows, best]


def changes(object_id, motion):
    """How far the surface, and how much its colour and infrared, change under a motion."""
    mesh = make(object_id)
    points, face = samples(object_id)
    on, other, distance = nearest(mesh, points @ motion[:3, :3].T + motion[:3, 3])
    zeros = np.zeros_like(points)
    colours, brights = (
        (
            look(mesh.materials, mesh.material[face], points, zeros),
            look(mesh.materials, mesh.material[other], on, zeros),
        )
        for look in (albedo, infrared)
    )
    return distance, np.abs(colours[0] - colours[1]).max(1), np.abs(brights[0] - brights[1])


@pytest.mark.parametrize("object_id", IDS)
def test_sizes_and_origin(object_id):
    mesh = make(object_id)
    assert mesh.name == NAMES[object_id - 1]
    assert 0.12 <= mesh.diameter <= 0.26
    assert mesh.size.min() > 0.05
    np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-12)


def test_two_are_symmetric():
    counts = [len(make(k).symmetries) for k in IDS]
    assert counts == [1, 1, 36, 2, 1, 1, 1, 1]
    np.testing.assert_array_equal(make(3).axis, [0, 0, 1])
    assert all(make(k).axis is None for k in IDS if k != 3)


@pytest.mark.parametrize("object_id", [3, 4])
def test_symmetries_are_true(object_id):
    motions = make(object_id).symmetries
    np.testing.assert_array_equal(motions[0], np.eye(4))
    np.testing.assert_array_equal(motions, turns((0, 0, 1), len(motions)))
    for motion in motions[1 :: max(1, len(motions) // 5)]:
        distance, colour, bright = changes(object_id, motion)
        assert distance.max() < 1e-5
        # A point at a border between materials may find the other one a micrometre away.
        assert np.quantile(colour, 0.98) < 0.02
        assert np.quantile(bright, 0.98) < 0.02


def test_an_axis_of_revolution_allows_every_turn():
    """Between the steps the polygon of the vase shows, by less than a tenth of a millimetre."""
    motion = turns((0, 0, 1), 360)[7]
    distance, colour, _ = changes(3, motion)
    assert distance.max() < 1.5e-4
    assert np.quantile(colour, 0.98) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("object_id", [1, 2, 4, 5, 6, 7, 8])
def test_nothing_else_is_symmetric(object_id):
    stated = make(object_id).symmetries
    for axis in np.eye(3):
        for step, motion in enumerate(turns(axis, 12)[1:], 1):
            if np.abs(stated - motion).max((1, 2)).min() < 1e-9:
                continue
            distance, colour, _ = changes(object_id, motion)
            differs = np.quantile(distance, 0.9) > 0.002 or np.quantile(colour, 0.9) > 0.1
            assert differs, (object_id, axis, step)


def test_the_can_is_told_apart_by_its_label_alone():
    for motion in turns((0, 0, 1), 6)[1:]:
        distance, colour, bright = changes(2, motion)
        assert np.quantile(distance, 0.9) < 1e-3
        assert np.quantile(colour, 0.9) > 0.3
        assert np.quantile(bright, 0.9) > 0.2


def test_objects_are_textured():
    """Colours vary over each object, so that a method has something to see."""
    for object_id in IDS:
        mesh = make(object_id)
        points, face = samples(object_id)
        colour = albedo(mesh.materials, mesh.material[face], points, np.zeros_like(points))
        assert colour.std(0).max() > 0.05, mesh.name
        assert len(mesh.materials) >= 2


@given(st.one_of(st.integers(max_value=0), st.integers(9), st.floats(), st.text(), st.booleans()))
def test_bad_ids(object_id):
    with pytest.raises(ValueError, match="^object_id:"):
        make_object(object_id)
