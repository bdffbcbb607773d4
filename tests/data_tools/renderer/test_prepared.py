import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer import prepare


def map_normals(prepared, face, points):
    """The normal that the face's map gives at points, unit length."""
    ones = np.ones((len(points), 1))
    normals = np.hstack([points, ones]) @ prepared.normals[face].astype(np.float64).T
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_planes_are_those_of_the_faces(shapes):
    for item in shapes:
        mesh = item.mesh
        for k in range(3):
            corner = mesh.vertices[mesh.faces[item.source, k]].T
            height = (item.planes[:3] * corner).sum(0) + item.planes[3]
            np.testing.assert_allclose(height, 0, atol=1e-15)
        np.testing.assert_allclose(np.linalg.norm(item.planes[:3], axis=0), 1, rtol=1e-12)


def test_planes_look_outside(shapes):
    sphere = shapes[0]
    assert (sphere.planes[3] < 0).all()  # the centre is behind every face
    assert sphere.two_sided is None
    assert shapes[4].two_sided.all()


@given(st.integers(0, 2**32 - 1))
def test_normals_are_the_interpolated_ones(shapes, seed):
    rng = np.random.default_rng(seed)
    item = shapes[rng.integers(len(shapes))]
    face = rng.integers(len(item.source))
    weights = rng.dirichlet([1, 1, 1], 5)
    mesh = item.mesh
    points = weights @ mesh.vertices[mesh.faces[item.source[face]]]
    expected = weights @ mesh.corner_normals[item.source[face]].astype(np.float64)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    # The map has seven digits; its slope is up to 1 / height of the face, here at most 1e3 / m.
    np.testing.assert_allclose(map_normals(item, face, points), expected, atol=1e-4)


def test_faces_without_area_are_left_out(make_triangles):
    point, line = ((0, 0, 1),) * 3, ((0, 0, 1), (1, 0, 1), (2, 0, 1))
    good = ((0, 0, 1), (1, 0, 1), (0, 1, 1))
    item = make_triangles(point, good, line, good)
    assert item.source.tolist() == [1, 3]
    assert np.isfinite(item.planes).all() and np.isfinite(item.normals).all()


def test_needles_get_one_finite_normal(make_triangles):
    item = make_triangles(((0, 0, 1), (1, 0, 1), (0.5, 1e-9, 1)))
    mesh = item.mesh
    bent = mesh.corner_normals.copy()
    bent[0, 0] = (1, 0, 0)
    item = prepare(dataclasses.replace(mesh, corner_normals=bent))
    assert np.isfinite(item.normals).all()
    np.testing.assert_allclose(item.normals[0, :, 3], bent[0].mean(0), atol=1e-6)
    assert not item.normals[0, :, :3].any()


def test_a_mesh_without_faces(make_triangles):
    item = make_triangles()
    assert len(item.source) == 0
    assert item.planes.shape == (4, 0) and item.normals.shape == (0, 3, 4)


def test_says_what_it_is(shapes):
    assert repr(shapes[2]) == "PreparedMesh(shape, 12 faces)"


@pytest.mark.parametrize("mesh", [None, "cube", np.zeros((3, 3))])
def test_bad_input(mesh):
    with pytest.raises(ValueError, match="mesh: expected a Mesh"):
        prepare(mesh)
