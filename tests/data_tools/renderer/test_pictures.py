import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.renderer import Ambient, Light, prepare, render_colour, render_infrared
from data_tools.shapes import Material

K = np.array([[40.0, 0, 19.5], [0, 40.0, 14.5], [0, 0, 1]])
SIZE = (40, 30)
AHEAD = np.eye(3), np.array([0, 0, 1.0])
LIGHT = Light((0, 0, 0))


@pytest.fixture(scope="module")
def paint(make_triangles):
    """`paint(corners, ...)`: triangles of one material."""

    def painted(*corners, **material):
        mesh = make_triangles(*corners).mesh
        material = {"colour": (1, 1, 1), **material}
        return prepare(dataclasses.replace(mesh, materials=(Material(**material),)))

    return painted


@pytest.fixture(scope="module")
def wall(paint):
    """A white wall that fills the picture."""
    return paint(((-9, -9, 0), (0, 9, 0), (9, -9, 0)))


def test_a_wall_is_as_bright_as_it_must_be(wall):
    picture = render_colour(
        [wall], [AHEAD], K, SIZE, [Light((0, 0, 0), (2, 1, 0.5))], ambient=Ambient(0, 0)
    )
    y, x = np.indices(SIZE[::-1])
    square = ((x - 19.5) / 40) ** 2 + ((y - 14.5) / 40) ** 2 + 1
    expected = square[..., None] ** -1.5 * [2, 1, 0.5]
    assert picture.dtype == np.float32
    np.testing.assert_allclose(picture, expected, rtol=1e-5)


@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0])
def test_infrared_light_falls_with_the_square_of_the_distance(paint, distance):
    item = paint(((-9, -9, 0), (0, 9, 0), (9, -9, 0)), infrared=0.6)
    pose = np.eye(3), np.array([0, 0, distance])
    picture = render_infrared([item], [pose], K, (41, 31), [Light((0, 0, 0), 0.3)], ambient=0.02)
    near_centre = picture[14:16, 19:21].mean()
    assert picture.shape == (31, 41) and picture.dtype == np.float32
    assert near_centre == pytest.approx(0.6 * (0.02 + 0.3 / distance**2), rel=2e-3)


@pytest.mark.parametrize("samples", [1, 2, 3, 4])
def test_edges_are_smoothed(paint, samples):
    # Left of column 20.25 there is a white plate; the pixel of column 20 is 3/4 covered.
    edge = (20.25 - 19.5) / 40
    plate = paint(
        ((-9, -9, 0), (edge, 9, 0), (edge, -9, 0)), ((-9, -9, 0), (-9, 9, 0), (edge, 9, 0))
    )
    white = Ambient(1, 1)
    picture = render_colour(
        [plate], [AHEAD], K, SIZE, [], ambient=white, background=(0.2, 0, 0), samples=samples
    )
    np.testing.assert_allclose(picture[:, :20], 1, rtol=1e-5)
    np.testing.assert_allclose(
        picture[:, 21:], [[[0.2, 0, 0]]] * 30 + np.zeros((30, 19, 3)), rtol=1e-5
    )
    shares = {1: 1, 2: 0.5, 3: 2 / 3, 4: 0.75}  # samples at 20 + (k + 0.5) / n - 0.5 < 20.25
    covered = picture[:, 20, 1]
    np.testing.assert_allclose(covered, shares[samples], rtol=1e-5)
    np.testing.assert_allclose(picture[:, 20, 0], covered + 0.2 * (1 - covered), rtol=1e-5)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_every_pixel_is_the_mean_of_its_samples(make_scene, seed):
    """Against a picture of twice the size, of which 2 x 2 pixels are averaged."""
    objects, poses, camera, size = make_scene(seed, size=(60, 40))
    lights = [Light((0.5, -0.6, -0.2), shadows=False)]
    picture = render_colour(objects, poses, camera, size, lights, background=0.3)
    scale = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]])
    large = render_colour(
        objects, poses, scale @ camera, (120, 80), lights, background=0.3, samples=1
    )
    expected = large.reshape(40, 2, 60, 2, 3).mean((1, 3))
    # Pixels without contrast to a neighbour are shaded once: they may differ a little.
    error = np.abs(picture - expected).max(-1) / (expected.max(-1) + 0.05)
    assert np.mean(error < 0.02) > 0.97 and np.mean(error) < 0.01


def test_fine_patterns_are_smoothed(make_triangles):
    # Stripes of 0.7 pixels: what is left is hardly more than their mean.
    mesh = make_triangles(((-9, -9, 0), (0, 9, 0), (9, -9, 0))).mesh
    material = Material(colour=(1, 1, 1), second=(0, 0, 0), pattern="stripes", scale=57.0)
    item = prepare(dataclasses.replace(mesh, materials=(material,)))
    rough, smooth = (
        render_colour([item], [AHEAD], K, SIZE, [], ambient=Ambient(1, 1), samples=n)
        for n in (1, 4)
    )
    assert smooth.std() < 0.5 * rough.std()
    assert smooth.mean() == pytest.approx(rough.mean(), abs=0.05)


def test_shadows_fall_where_casters_throw_them(paint, wall):
    plate = paint(((-0.1, -0.1, 0.5), (0.1, -0.1, 0.5), (0, 0.1, 0.5)))
    pose = np.eye(3), np.zeros(3)
    lamp = Light((0.5, 0, 0), radius=0)
    options = {"ambient": Ambient(0, 0)}
    scene = [wall, plate], [AHEAD, pose], K, SIZE
    lit = render_colour(*scene, [dataclasses.replace(lamp, shadows=False)], **options)
    dark = render_colour(*scene, [lamp], **options)
    none = render_colour(*scene, [lamp], casters=[], **options)
    np.testing.assert_array_equal(none, lit)
    # The shadow's middle on the wall: from the lamp through the plate's, at x = -0.5: pixel -0.5.
    shade = (dark < 0.01 * lit).all(-1)
    assert shade.any() and not shade[:, 20:].any()
    np.testing.assert_allclose(dark[:, 25:], lit[:, 25:], rtol=1e-5)


def test_a_picture_is_the_background_where_nothing_is(shapes):
    for background, expected in (
        (0.25, np.full((30, 40, 3), 0.25)),
        ((0.1, 0.2, 0.3), np.broadcast_to([0.1, 0.2, 0.3], (30, 40, 3))),
        (np.random.default_rng(0).random((30, 40, 3)), None),
    ):
        picture = render_colour([], [], K, SIZE, [LIGHT], background=background)
        target = background if expected is None else expected
        np.testing.assert_allclose(picture, target, rtol=1e-6)
        away = np.eye(3), np.array([0, 0, -1.0])
        picture = render_colour([shapes[0]], [away], K, SIZE, [LIGHT], background=background)
        np.testing.assert_allclose(picture, target, rtol=1e-6)
    image = np.random.default_rng(0).random((30, 40))
    picture = render_infrared([], [], K, SIZE, [LIGHT], background=image)
    np.testing.assert_allclose(picture, image, rtol=1e-6)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_any_scene_gives_finite_light_and_the_same_each_time(make_scene, seed):
    scene = make_scene(seed, size=(40, 30))
    rng = np.random.default_rng(seed)
    lights = [Light(rng.normal(0, 0.5, 3), radius=rng.choice([0, 0.05])) for _ in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pictures = [
            render(*scene, lights, shadow_texels=64)
            for render in (render_colour, render_infrared)
            for _ in range(2)
        ]
    assert all(np.isfinite(p).all() and (p >= 0).all() for p in pictures)
    assert pictures[0].tobytes() == pictures[1].tobytes()
    assert pictures[2].tobytes() == pictures[3].tobytes()


@pytest.mark.parametrize("z", [0.0, 0.03])
def test_a_camera_and_a_lamp_inside_an_object(shapes, z):
    pose = np.eye(3), np.array([0, 0, z])
    picture = render_colour([shapes[0]], [pose], K, SIZE, [LIGHT])
    assert np.isfinite(picture).all() and (picture > 0.1).all()  # the inner wall, and it is lit


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"lights": ["lamp"]}, "lights"),
        ({"ambient": 0.5}, "ambient"),
        ({"background": -1}, "background"),
        ({"background": (1, 2)}, "background"),
        ({"background": np.zeros((30, 40))}, "background"),
        ({"background": np.nan}, "background"),
        ({"casters": [1]}, "casters"),
        ({"casters": [-1]}, "casters"),
        ({"samples": 0}, "samples"),
        ({"samples": 2.0}, "samples"),
        ({"samples": 9}, "samples"),
        ({"shadow_texels": 8}, "shadow_texels"),
        ({"objects": ["cube"]}, "objects"),
        ({"poses": []}, "poses"),
        ({"K": np.eye(2)}, "K"),
        ({"size": (0, 3)}, "size"),
        ({"near": -1}, "near"),
    ],
)
def test_bad_input(wall, change, name):
    good = {"objects": [wall], "poses": [AHEAD], "K": K, "size": SIZE, "lights": [LIGHT]}
    with pytest.raises(ValueError, match=f"^{name}: "):
        render_colour(**{**good, **change})
    if name == "background" and np.shape(change["background"]) == (30, 40):
        change = {"background": np.zeros((30, 40, 3))}
    if name == "ambient":
        change = {"ambient": -1}
    with pytest.raises(ValueError, match=f"^{name}: "):
        render_infrared(**{**good, **change})
