import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from data_tools.shapes import Material
from data_tools.shapes.pieces import box, ellipsoid, loft, revolve, spline, tube

GREY, RED = Material((0.5, 0.5, 0.5)), Material((0.8, 0.1, 0.1))
UP = (0, 0, 1)
lengths = st.floats(0.01, 2.0)


def solid(part):
    """The part as trimesh sees it, which must be sound."""
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    assert part.closed
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-12
    assert mesh.volume > 0
    return mesh


@given(lengths, lengths)
def test_volume_of_a_cylinder(radius, height):
    part = revolve([([(0, 0), (radius, 0), (radius, height), (0, height)], GREY)], 90)
    share = 90 / (2 * np.pi) * np.sin(2 * np.pi / 90)  # a polygon in the circle
    assert solid(part).volume == pytest.approx(np.pi * radius**2 * height * share)


def test_hollow_profile_and_its_materials():
    strips = [
        ([(0, 0), (2, 0), (2, 3)], GREY),
        ([(2, 3), (1, 3), (1, 1), (0, 1)], RED),
    ]
    part = revolve(strips, 60)
    assert solid(part).volume == pytest.approx(np.pi * (4 * 3 - 1 * 2), rel=0.01)
    assert part.materials == (GREY, RED)
    middle = part.vertices[part.faces].mean(1)
    inside = (np.hypot(*middle[:, :2].T) < 1.01) & (middle[:, 2] > 0.9) | (middle[:, 2] > 2.9)
    np.testing.assert_array_equal(part.material == 1, inside)


def test_a_profile_downwards_is_turned_outside_out():
    up = revolve([([(0, 0), (1, 0), (0, 1)], GREY)], 12)
    down = revolve([([(0, 1), (1, 0), (0, 0)], GREY)], 12)
    assert solid(up).volume == pytest.approx(solid(down).volume)


def test_strips_that_do_not_meet_are_joined():
    part = revolve([([(0, 0), (1, 0)], GREY), ([(1, 1), (0, 1)], RED)], 8)
    assert solid(part).volume > 0
    np.testing.assert_array_equal(np.bincount(part.material), [8, 24])


def test_revolution_is_exactly_symmetric():
    part = revolve([([(0, 0), (1, 0.5), (0, 2)], GREY)], 12)
    turned = part.vertices @ trimesh.transformations.rotation_matrix(np.pi / 6, UP)[:3, :3].T
    gaps = np.linalg.norm(turned[:, None] - part.vertices, axis=-1).min(1)
    assert gaps.max() < 1e-12


@given(lengths, lengths, lengths, st.floats(0.05, 0.95), st.integers(1, 4))
def test_box(a, b, c, share, steps):
    radius = share * min(a, b, c) / 2
    part = box((a, b, c), radius, GREY, steps)
    mesh = solid(part)
    np.testing.assert_allclose(mesh.extents, [a, b, c])
    np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-12)
    assert len(part.faces) == 12 * (2 * steps + 1) ** 2
    core = np.array([a, b, c]) / 2 - radius
    out = part.vertices - np.clip(part.vertices, -core, core)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), radius, rtol=1e-9)


@given(lengths, lengths, lengths, st.integers(0, 3))
def test_ellipsoid(a, b, c, level):
    part = ellipsoid((a, b, c), GREY, (1, 2, 3), level)
    solid(part)
    assert len(part.faces) == 20 * 4**level
    distance = np.linalg.norm((part.vertices - [1, 2, 3]) / [a, b, c], axis=1)
    np.testing.assert_allclose(distance, 1, rtol=1e-9)


def circle(count, radius=1.0):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)


def test_torus():
    part = tube(circle(60), 0.25, GREY, UP, 40, around=True)
    assert solid(part).volume == pytest.approx(2 * np.pi**2 * 0.25**2, rel=0.01)
    assert solid(part).euler_number == 0
    x, y, z = part.vertices.T
    np.testing.assert_allclose(np.hypot(np.hypot(x, y) - 1, z), 0.25)


@given(lengths, lengths)
def test_straight_tube_is_an_ellipse_of_the_stated_axes(across, along):
    path = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]])
    part = tube(path, (across, along), GREY, UP, 24)
    np.testing.assert_allclose(solid(part).extents, [3, 2 * across, 2 * along])


def test_tapered_tube():
    part = tube(np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0]]), np.array([1, 0.5, 0.1]), GREY, UP, 32)
    mesh = solid(part)
    ring = part.vertices[np.abs(part.vertices[:, 1] - 1) < 1e-9]
    np.testing.assert_allclose(np.linalg.norm(ring - [0, 1, 0], axis=1), 0.5)
    assert mesh.bounds[0, 1] == 0 and mesh.bounds[1, 1] == 2


@given(st.booleans(), st.integers(0, 1000))
def test_loft_is_sound_whatever_its_winding(reverse, seed):
    rng = np.random.default_rng(seed)
    outline = circle(9)[:, :3] * rng.uniform(0.8, 1.2, (9, 1))
    rings = np.stack([outline + [0, 0, z] for z in (0, 0.5, 2)])
    solid(loft(rings[:, ::-1] if reverse else rings, GREY))


@given(st.integers(0, 1000), st.integers(2, 40), st.booleans())
def test_spline(seed, count, closed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(5, 3))
    curve = spline(points, count, closed)
    assert curve.shape == (count, 3)
    np.testing.assert_allclose(curve[0], points[0], atol=1e-12)
    if not closed:
        np.testing.assert_array_equal(curve[-1], points[-1])
    dense = spline(points, 20 if closed else 17, closed)
    np.testing.assert_allclose(dense[::4], points, atol=1e-12)


def test_spline_keeps_straight_lines_straight():
    np.testing.assert_allclose(spline([(0, 0), (1, 2), (2, 4)], 5)[:, 1], [0, 1, 2, 3, 4])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: revolve([([(0.1, 0), (1, 0), (0, 1)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0), (1, 0), (1e-18, 1)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0), (1, 0), (0, 0.5), (1, 1), (0, 1)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0), (-1, 0), (0, 1)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0), (1, 0), (1, 0), (0, 1)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0, 0), (1, 0, 0)], GREY)]), "strips"),
        (lambda: revolve([([(0, 0), (np.nan, 0), (0, 1)], GREY)]), "strips"),
        (lambda: revolve([]), "strips"),
        (lambda: revolve([([(0, 0), (1, 0), (0, 1)], GREY)], 2), "sections"),
        (lambda: loft(np.zeros((1, 4, 3)), GREY), "rings"),
        (lambda: loft(np.zeros((4, 3)), GREY), "rings"),
        (lambda: tube(np.array([[0, 0, 0], [0, 0, 1]]), 0.1, GREY, UP), "up"),
        (lambda: tube(np.zeros((3, 3)), 0.1, GREY, UP), "path"),
        (lambda: tube(np.zeros((3, 2)), 0.1, GREY, UP), "path"),
        (lambda: tube(np.zeros((1, 3)), 0.1, GREY, UP), "path"),
        (lambda: box((1, 1), 0.1, GREY), "size"),
        (lambda: box((1, 1, 0.2), 0.1, GREY), "radius"),
        (lambda: box((1, 1, 1), 0, GREY), "radius"),
        (lambda: spline([(0, 0)], 4), "points"),
        (lambda: spline([(0, 0), (1, 1)], 1), "count"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        call()
