import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.shapes import Material, Mesh


def tetrahedron(**changes):
    fields = dict(
        name="tetrahedron",
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float64),
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
        corner_normals=np.ones((4, 3, 3), np.float32),
        material=np.zeros(4, np.int16),
        materials=(Material((0.5, 0.5, 0.5)),),
        closed=np.ones(4, bool),
    )
    return Mesh(**{**fields, **changes})


def test_measures():
    mesh = tetrahedron()
    assert mesh.diameter == pytest.approx(np.sqrt(13))
    np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(mesh.size, [1, 2, 3])
    np.testing.assert_array_equal(mesh.symmetries, np.eye(4)[None])
    assert mesh.axis is None


@given(st.integers(0, 2**32 - 1))
def test_diameter_is_the_largest_distance(seed):
    vertices = np.random.default_rng(seed).normal(size=(9, 3))
    mesh = tetrahedron(vertices=vertices)
    distances = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    assert mesh.diameter == pytest.approx(distances.max(), rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        (dict(vertices=np.zeros((4, 2))), "vertices"),
        (dict(vertices=np.zeros((4, 3), np.float32)), "vertices"),
        (dict(vertices=np.full((4, 3), np.nan)), "vertices"),
        (dict(faces=np.full((4, 3), 4, np.int32)), "faces"),
        (dict(faces=np.full((4, 3), -1, np.int32)), "faces"),
        (dict(faces=np.zeros((4, 3), np.int64)), "faces"),
        (dict(corner_normals=np.ones((4, 3), np.float32)), "corner_normals"),
        (dict(material=np.ones(4, np.int16)), "material"),
        (dict(material=np.zeros(3, np.int16)), "material"),
        (dict(closed=np.ones(4)), "closed"),
        (dict(symmetries=np.eye(4)), "symmetries"),
    ],
)
def test_bad_meshes(changes, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        tetrahedron(**changes)


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        (dict(colour=(0.5, 0.5)), "colour"),
        (dict(colour=(0.5, 0.5, 1.1)), "colour"),
        (dict(second=(-0.1, 0, 0)), "second"),
        (dict(specular=1.5), "specular"),
        (dict(infrared=-0.1), "infrared"),
        (dict(second_infrared=2.0), "second_infrared"),
        (dict(scale=0.0), "scale"),
        (dict(shininess=-1.0), "shininess"),
        (dict(seed=-1), "seed"),
        (dict(seed=0.5), "seed"),
        (dict(place=(1.0, 0.0)), "place"),
        (dict(place=(np.nan,) * 12), "place"),
    ],
)
def test_bad_materials(fields, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        Material(**{"colour": (0.5, 0.5, 0.5), **fields})
