import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.shapes import Material
from data_tools.shapes.implicit import ball, below, blend, carve, common, limb, radial, skin

GREY = Material((0.5, 0.5, 0.5))
seeds = st.integers(0, 2**32 - 1)


def solid(part):
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    assert part.closed
    assert mesh.is_watertight
    assert mesh.area_faces.min() > 0
    assert mesh.volume > 0
    return mesh


@given(seeds)
def test_ball_is_a_distance_for_spheres_and_its_sign_is_right_for_all(seed):
    rng = np.random.default_rng(seed)
    points, centre, radii = rng.normal(size=(30, 3)), rng.normal(size=3), rng.uniform(0.5, 2, 3)
    distance = np.linalg.norm(points - centre, axis=1)
    np.testing.assert_allclose(ball(centre, 0.7)(points), distance - 0.7, atol=1e-12)
    inside = (((points - centre) / radii) ** 2).sum(1) < 1
    np.testing.assert_array_equal(ball(centre, radii)(points) < 0, inside)
    assert ball(centre, radii)(centre) == -radii.min()


@given(seeds)
def test_limb_against_samples_of_its_bone(seed):
    rng = np.random.default_rng(seed)
    a, b, points = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(20, 3)) * 2
    bone = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
    nearest = np.linalg.norm(points[:, None] - bone, axis=-1).min(1)
    np.testing.assert_allclose(limb(a, b, 0.3)(points), nearest - 0.3, atol=2e-3)
    tapered = limb(a, b, 0.3, 0.1)
    np.testing.assert_allclose(tapered(np.stack([a, b])), [-0.3, -0.1], atol=1e-12)


@given(seeds)
def test_blends_agree_with_set_operations_away_from_joints(seed):
    rng = np.random.default_rng(seed)
    one, two = ball(rng.normal(size=3), 1.0), limb(rng.normal(size=3), rng.normal(size=3), 0.8)
    points = rng.normal(size=(200, 3)) * 2
    a, b = one(points), two(points)
    width = 0.2
    for shape, exact, apart in (
        (blend([one, two], width), np.minimum(a, b), np.abs(a - b)),
        (carve(one, [two], width), np.maximum(a, -b), np.abs(a + b)),
        (common(one, two, width), np.maximum(a, b), np.abs(a - b)),
    ):
        value = shape(points)
        np.testing.assert_allclose(value[apart > width], exact[apart > width], atol=1e-12)
        assert np.abs(value - exact).max() <= width / 4 + 1e-12
    assert (blend([one, two], width)(points) <= np.minimum(a, b)).all()
    assert (carve(one, [two], width)(points) >= np.maximum(a, -b)).all()


@given(st.floats(0.01, 1.0), st.floats(-2.0, 2.0))
def test_blend_is_a_parabola_that_meets_the_shapes_smoothly(width, gap):
    """The polynomial smooth minimum: min(a, b) - (w - |a - b|)^2 / 4w."""
    value = blend([below(0.0), below(gap)], width)(np.zeros(3))
    expected = min(0.0, -gap) - max(width - abs(gap), 0) ** 2 / (4 * width)
    assert value == pytest.approx(expected, abs=1e-12)


def test_below():
    np.testing.assert_array_equal(below(2.0)(np.array([[0, 0, 1.5], [9, 9, 3.0]])), [-0.5, 1.0])


@settings(deadline=None, max_examples=8)
@given(seeds)
def test_skin_of_a_blend(seed):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-0.3, 0.3, (3, 3))
    shape = blend([ball(c, rng.uniform(0.35, 0.5)) for c in centres], 0.1)
    part = skin(shape, (-1, -1, -1), (1, 1, 1), 0.06, GREY)
    mesh = solid(part)
    assert mesh.euler_number == 2
    assert np.abs(shape(part.vertices)).max() < 2e-3
    steps = np.arange(-0.98, 1, 0.04)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1)
    assert mesh.volume == pytest.approx((shape(grid) < 0).sum() * 0.04**3, rel=0.02)


def test_skin_of_a_sphere_and_of_a_torus():
    sphere = skin(ball((0.1, 0, 0), 0.5), (-1, -1, -1), (1, 1, 1), 0.08, GREY)
    radius = np.linalg.norm(sphere.vertices - [0.1, 0, 0], axis=1)
    # The start is off by up to step^2 / 2R; of that, the gradient errs by (0.05 step)^2 / 2R^2.
    np.testing.assert_allclose(radius, 0.5, atol=0.08**2 * (0.05 * 0.08) ** 2 / 0.5)

    def torus(p):
        return np.hypot(np.hypot(p[..., 0], p[..., 1]) - 0.6, p[..., 2]) - 0.2

    ring = solid(skin(torus, (-1, -1, -0.5), (1, 1, 0.5), 0.07, GREY))
    assert ring.euler_number == 0
    assert ring.volume == pytest.approx(2 * np.pi**2 * 0.6 * 0.04, rel=0.02)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_radial_surface_lies_on_the_shape(seed):
    rng = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(subdivisions=2)
    shape = blend([ball((0, 0, 0), 0.5), ball(rng.uniform(-0.4, 0.4, 3), 0.3)], 0.05)
    directions = np.array(sphere.vertices)
    part = radial(shape, (0, 0, 0), directions, np.array(sphere.faces), 1.2, GREY)
    solid(part)
    assert np.abs(shape(part.vertices)).max() < 2e-4
    along = part.vertices / np.linalg.norm(part.vertices, axis=1, keepdims=True)
    np.testing.assert_allclose(along, directions, atol=1e-9)


def test_sheets_that_touch_are_joined_and_not_pinched():
    pair = blend([ball((-0.3, -0.3, 0), 0.42), ball((0.31, 0.29, 0), 0.42)], 1e-3)
    for shift in np.linspace(0, 0.1, 6):
        solid(skin(pair, (-1, -1 + shift, -1), (1, 1, 1), 0.1, GREY))


def test_radial_takes_the_outermost_surface():
    def shells(p):
        r = np.linalg.norm(p, axis=-1)
        return np.where(r < 0.4, r - 0.2, np.abs(r - 0.7) - 0.1)

    sphere = trimesh.creation.icosphere(subdivisions=1)
    part = radial(shells, (0, 0, 0), np.array(sphere.vertices), np.array(sphere.faces), 1.2, GREY)
    np.testing.assert_allclose(np.linalg.norm(part.vertices, axis=1), 0.8, atol=2e-4)


LOW, HIGH = (-1, -1, -1), (1, 1, 1)
DIRECTIONS = np.eye(3)
FACES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: skin(ball((0, 0, 0), 1.2), LOW, HIGH, 0.1, GREY), "low, high"),
        (lambda: skin(ball((0.8, 0, 0), 0.3), LOW, HIGH, 0.1, GREY), "low, high"),
        (lambda: skin(ball((5, 0, 0), 0.3), LOW, HIGH, 0.1, GREY), "shape"),
        (lambda: skin(ball((0, 0, 0), 0.5), LOW, HIGH, 0, GREY), "step"),
        (lambda: skin(ball((0, 0, 0), 0.5), HIGH, LOW, 0.1, GREY), "low, high"),
        (lambda: blend([ball((0, 0, 0), 1)], 0), "width"),
        (lambda: blend([], 0.1), "shapes"),
        (lambda: carve(ball((0, 0, 0), 1), [], -1), "width"),
        (lambda: common(ball((0, 0, 0), 1), below(0), np.nan), "width"),
        (lambda: ball((0, 0, 0), 0), "radii"),
        (lambda: ball((0, 0, 0), (1, 2, -1)), "radii"),
        (lambda: limb((0, 0, 0), (0, 0, 0), 1), "start, end"),
        (lambda: radial(ball((3, 0, 0), 1), (0, 0, 0), DIRECTIONS, FACES, 1, GREY), "centre"),
        (lambda: radial(ball((0, 0, 0), 2), (0, 0, 0), DIRECTIONS, FACES, 1, GREY), "centre"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        call()
