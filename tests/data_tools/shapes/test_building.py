import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.shapes import Material
from data_tools.shapes.building import (
    Part,
    around,
    assemble,
    on_plane,
    paint,
    random_paint,
    turn,
    turns,
)
from data_tools.shapes.pieces import box, ellipsoid, revolve
from data_tools.textures import albedo

GREY = Material((0.5, 0.5, 0.5))
seeds = st.integers(0, 2**32 - 1)


def pattern_of(mesh, points):
    normals = np.zeros_like(points)
    return albedo(mesh.materials, np.zeros(len(points), int), points, normals)


@given(seeds)
def test_patterns_move_along_with_parts(seed):
    rng = np.random.default_rng(seed)
    material = Material((0.1, 0.2, 0.3), (0.9, 0.8, 0.7), "noise", 8)
    R, t = turns(rng.normal(size=3), 7)[3, :3, :3], rng.normal(size=3)
    part = ellipsoid(0.1, material)
    moved = part.moved(R).moved(shift=t).moved(turn("x", 30), (0, 0, 1))
    points = rng.uniform(-0.1, 0.1, (50, 3))
    there = (points @ R.T + t) @ turn("x", 30).T + [0, 0, 1]
    np.testing.assert_allclose(
        moved.vertices, (part.vertices @ R.T + t) @ turn("x", 30).T + [0, 0, 1], atol=1e-12
    )
    np.testing.assert_allclose(pattern_of(part, points), pattern_of(moved, there), atol=1e-4)


def test_assembly_keeps_patterns_where_they_were_in_a_part():
    material = Material((0, 0, 0), (1, 1, 1), "stripes", 20)
    parts = [box((0.1, 0.2, 0.3), 0.01, material).moved(shift=(0.4, 0, 0)), ellipsoid(0.1, GREY)]
    mesh = assemble("both", parts, turn("z", 90))
    np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-12)
    middle = np.array([0.175, 0.0, 0.0])  # of the parts' bounding box
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3))
    there = (points - middle) @ turn("z", 90).T
    expected = pattern_of(parts[0], points)
    np.testing.assert_allclose(pattern_of(mesh, there), expected, atol=1e-4)
    assert expected.std() > 0.3


def test_assembly_shares_materials_and_keeps_order():
    mesh = assemble("three", [box((1, 1, 1), 0.1, GREY), ellipsoid(0.1, GREY)], centre=False)
    assert mesh.materials == (GREY,)
    assert mesh.faces[-1].max() == len(mesh.vertices) - 1 or mesh.faces.max() < len(mesh.vertices)
    assert (mesh.faces[300:].min(), mesh.faces[:300].max()) == (152, 151)
    assert mesh.closed.all()


def test_plain_materials_are_shared_wherever_their_parts_go():
    noisy = Material((0.5, 0.5, 0.5), pattern="noise")
    parts = [
        ellipsoid(0.1, m).moved(turn("x", 20), (k, 0, 0)) for k in (0, 1) for m in (GREY, noisy)
    ]
    assert assemble("four", parts).materials.count(GREY) == 1
    assert len(assemble("four", parts).materials) == 3


def test_normals_of_a_sphere_point_outward():
    mesh = assemble("sphere", [ellipsoid(0.1, GREY, level=3)])
    expected = mesh.vertices[mesh.faces] / 0.1
    assert np.abs(mesh.corner_normals - expected).max() < 0.02


def test_creases_stay_sharp_and_smooth_edges_stay_smooth():
    cylinder = revolve([([(0, 0), (1, 0), (1, 1), (0, 1)], GREY)], 48)
    normals = assemble("cylinder", [cylinder], centre=False).corner_normals
    flat = np.abs(normals[..., 2])
    assert ((flat < 1e-6) | (flat > 1 - 1e-6)).all()
    side = flat.max(1) < 0.5
    corners = cylinder.vertices[cylinder.faces[side]]
    np.testing.assert_allclose(normals[side][..., :2], corners[..., :2], atol=1e-5)


def test_an_open_part_is_not_closed():
    part = ellipsoid(0.1, GREY)
    assert part.closed
    torn = Part(part.vertices, part.faces[1:], part.material[1:], part.materials)
    assert not torn.closed
    assert not assemble("torn", [torn]).closed.any()
    flipped = part.faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert not Part(part.vertices, flipped, part.material, part.materials).closed


@given(seeds)
def test_pieces_turn_outside_out(seed):
    vertices = np.random.default_rng(seed).normal(size=(4, 3))
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    part = Part.of(vertices, faces, GREY)
    a, b, c = np.moveaxis(vertices[part.faces], 1, 0)
    assert (np.cross(a, b) * c).sum() > 0


@pytest.mark.parametrize(
    ("code", "linear"),
    [("#000000", (0, 0, 0)), ("#ffffff", (1, 1, 1)), ("#ff8000", (1, 0.2158605, 0))],
)
def test_paint(code, linear):
    np.testing.assert_allclose(paint(code), linear, atol=1e-6)


@given(seeds)
def test_random_paint_is_a_colour_of_its_ranges(seed):
    rgb = np.array(random_paint(np.random.default_rng(seed), (0.2, 0.5), (0.4, 0.8)))
    encoded = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    assert 0.4 - 0.01 <= encoded.max() <= 0.8 + 0.01
    assert 0.2 - 0.02 <= 1 - encoded.min() / encoded.max() <= 0.5 + 0.02


def test_random_paint_has_every_hue():
    rng = np.random.default_rng(0)
    leading = [np.argmax(random_paint(rng)) for _ in range(100)]
    assert min(np.bincount(leading, minlength=3)) > 15


@given(st.integers(1, 40), seeds)
def test_turns_form_a_group(count, seed):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    motions = turns(axis, count)
    np.testing.assert_array_equal(motions[0], np.eye(4))
    power = np.linalg.matrix_power(motions[1 % count], count)
    np.testing.assert_allclose(power, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(motions[:, :3, :3] @ axis, np.tile(axis, (count, 1)), atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_turn_is_right_handed(axis):
    k = "xyz".index(axis)
    np.testing.assert_allclose(
        turn(axis, 90) @ np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3], atol=1e-15
    )


def test_pattern_planes_and_bands():
    picture = on_plane(Material((0, 0, 0)), (1, 2, 3), (0, 2, 0), (0, 0, 4))
    place = np.reshape(picture.place, (3, 4))
    np.testing.assert_allclose(place @ [1, 2, 3, 1], [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(place @ [1, 4, 7, 1], [1, 1, 0], atol=1e-12)
    place = np.reshape(around(GREY, 0.2, 0.7, 90).place, (3, 4))
    np.testing.assert_allclose(place @ [0, 1, 0.2, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(place @ [0, 1, 0.7, 1], [1, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: paint("red"), "code"),
        (lambda: paint("#12345"), "code"),
        (lambda: paint("#12345g"), "code"),
        (lambda: paint("1234567"), "code"),
        (lambda: turns((0, 0, 1), 0), "count"),
        (lambda: turns((0, 0, 0), 3), "axis"),
        (lambda: assemble("nothing", []), "parts"),
        (lambda: around(GREY, 0.3, 0.3), "high"),
        (lambda: on_plane(GREY, (0, 0, 0), (1, 0, 0), (2, 0, 0)), "right, up"),
        (lambda: turn("w", 3), "axis"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        call()
