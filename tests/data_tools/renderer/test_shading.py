import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer import Ambient, Light, prepare
from data_tools.renderer.samples import Samples
from data_tools.renderer.shading import shade
from data_tools.renderer.visibility import Scene
from data_tools.shapes import Material

K = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])
DARK = Ambient(0, 0)
CORNERS = (-9, -9, 0), (9, -9, 0), (0, 9, 0)


def plain(materials, index, points, normals):
    return np.array([m.colour for m in materials], np.float32)[index]


def looked_at(item, *, x=50.0, y=50.0, distance=1.0, lights=(), ambient=DARK, tilt=0.0):
    """The colour of the point of a plate that pixel (x, y) sees."""
    c, s = np.cos(tilt), np.sin(tilt)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    scene = Scene([item], [(R, np.array([0, 0, distance]))], K, (100, 100))
    normal, ray = R[:, 2], np.array([(x - 50) / 100, (y - 50) / 100, 1])
    z = normal[2] * distance / (normal @ ray)
    zero = np.zeros(1, int)
    samples = Samples(np.array([x]), np.array([y]), zero, zero, np.array([1 / z]))
    return shade(scene, samples, plain, 3, [(light, None) for light in lights], ambient)[0], z * ray


@pytest.fixture(scope="module")
def paint(make_triangles):
    """`paint(...)`: a plate of a material that faces the camera."""

    def painted(**material):
        mesh = make_triangles(CORNERS[::-1]).mesh
        return prepare(dataclasses.replace(mesh, materials=(Material(**material),)))

    return painted


@given(st.floats(0.2, 5), st.floats(0.1, 5), st.floats(-1.2, 1.2))
def test_light_falls_with_the_square_and_the_cosine(paint, distance, power, tilt):
    colour, _ = looked_at(
        paint(colour=(1, 0.5, 0)),
        distance=distance,
        tilt=tilt,
        lights=[Light((0, 0, 0), (power, power, 1))],
    )
    bright = power * np.cos(tilt) / distance**2
    np.testing.assert_allclose(colour, [bright, bright / 2, 0], rtol=1e-4, atol=1e-6)


@given(st.floats(0, 99), st.floats(0, 99))
def test_beams_fall_off_to_the_sides(paint, x, y):
    item = paint(colour=(1, 1, 1))
    wide, point = looked_at(item, x=x, y=y, lights=[Light((0, 0, 0))])
    narrow, _ = looked_at(item, x=x, y=y, lights=[Light((0, 0, 0), beam=3)])
    np.testing.assert_allclose(narrow, wide * (point[2] / np.linalg.norm(point)) ** 3, rtol=1e-4)


def test_nothing_comes_from_behind(paint):
    item = paint(colour=(1, 1, 1), specular=1)
    colour, _ = looked_at(item, lights=[Light((0, 0, 2))])
    assert not colour.any()


def test_lights_add_up(paint):
    item = paint(colour=(0.3, 0.5, 0.7), specular=0.4, shininess=30)
    lights = [Light((0.2, 0.1, 0), (1, 0.5, 0.2)), Light((-0.5, 0, 0.2), 2)]
    one, two, both = (
        looked_at(item, lights=some)[0] for some in ([lights[0]], [lights[1]], lights)
    )
    np.testing.assert_allclose(both, one + two, rtol=1e-5)


@given(st.floats(-3.1, 3.1))
def test_ambient_light_depends_on_the_height(paint, angle):
    above, below = np.array([0.8, 0.6, 0.4]), np.array([0.1, 0.2, 0.3])
    # The plate looks along -z.
    up = (np.sin(angle), 0, -np.cos(angle))
    colour, _ = looked_at(paint(colour=(0.5, 1, 1)), ambient=Ambient(above, below, up))
    share = 0.5 + 0.5 * np.cos(angle)
    np.testing.assert_allclose(colour, (below + (above - below) * share) * [0.5, 1, 1], rtol=1e-5)


def test_highlights_are_where_a_mirror_would_show_the_lamp(paint):
    lamp = Light((0.4, 0, 0))
    item = paint(colour=(0, 0, 0), specular=0.5, shininess=4000)
    line = [looked_at(item, x=x, lights=[lamp])[0][0] for x in np.linspace(50, 90, 81)]
    assert 50 + np.argmax(line) / 2 == pytest.approx(70)  # half-way between them
    item = paint(colour=(0, 0, 0), specular=0.5, shininess=40)
    # At the mirror point the highlight is specular * (s + 8) / 8, times what arrives.
    square = 0.2**2 + 1
    expected = 0.5 * 48 / 8 / square * (1 / np.sqrt(square))
    assert looked_at(item, x=70.0, lights=[lamp])[0][0] == pytest.approx(expected, rel=1e-4)


def test_sharper_highlights_are_brighter_and_smaller(paint):
    lamp = Light((0, 0, 0))
    values = {}
    for shininess in (10, 100):
        item = paint(colour=(0, 0, 0), specular=1, shininess=shininess)
        values[shininess] = [looked_at(item, x=x, lights=[lamp])[0][0] for x in (50.0, 80.0)]
    assert values[100][0] > values[10][0] and values[100][1] < values[10][1]


def test_gloss_mirrors_the_surroundings_most_at_grazing_angles(paint):
    item = paint(colour=(0, 0, 0), specular=1)
    ambient = Ambient(1, 1)
    square, _ = looked_at(item, ambient=ambient)
    grazing, _ = looked_at(item, ambient=ambient, tilt=1.5)
    assert square == pytest.approx(0.04, abs=1e-6)
    cosine = np.cos(1.5)
    assert grazing == pytest.approx(0.04 + 0.96 * (1 - cosine) ** 5, rel=1e-3)


@given(st.floats(-1.4, 1.4))
def test_gloss_mirrors_what_lies_in_the_mirrored_direction(paint, tilt):
    item = paint(colour=(0, 0, 0), specular=1)
    colour, _ = looked_at(item, ambient=Ambient(0.9, 0.1), tilt=tilt)
    # Tilted by an angle, a mirror shows what is at twice the angle: its height is -sin(2 tilt).
    fresnel = 0.04 + 0.96 * (1 - np.cos(tilt)) ** 5
    expected = fresnel * (0.1 + 0.8 * (0.5 - 0.5 * np.sin(2 * tilt)))
    np.testing.assert_allclose(colour, expected, rtol=1e-3, atol=1e-5)


def test_every_sample_gets_its_own_material_and_object(make_triangles):
    colours = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    a, b = CORNERS[::-1], ((9, 9, 0.5), (9, -9, 0.5), (-9, 9, 0.5))
    mesh = make_triangles(a, b).mesh
    two = tuple(Material(colour) for colour in colours[:2])
    item = prepare(dataclasses.replace(mesh, materials=two, material=np.array([0, 1], np.int16)))
    other = make_triangles(a).mesh
    other = prepare(dataclasses.replace(other, materials=(Material(colours[2]),)))
    poses = [(np.eye(3), np.array([0, 0, 1.0]))] * 2
    scene = Scene([item, other], poses, K, (100, 100))
    rng = np.random.default_rng(0)
    n = 20_000  # more than one chunk
    instance, face = rng.integers(2, size=n), rng.integers(2, size=n)
    face[instance == 1] = 0
    z = np.where((instance == 0) & (face == 1), 1.5, 1.0)
    samples = Samples(np.full(n, 50.0), np.full(n, 50.0), instance, face, 1 / z)
    result = shade(scene, samples, plain, 3, [], Ambient(1, 1))
    expected = np.array(colours)[np.where(instance == 1, 2, face)]
    np.testing.assert_allclose(result, expected, atol=1e-6)
