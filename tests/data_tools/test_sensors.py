import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.sensors import (
    depth_sensor,
    infrared_sensor,
    linear_to_srgb,
    rgb_sensor,
    srgb_to_linear,
)

K = np.array([[300.0, 0, 79.5], [0, 300.0, 59.5], [0, 0, 1]])
QUIET = {"shot_noise": 0, "read_noise": 0, "blur": 0}
SURE = {"disparity_noise": 0, "disparity_step": 0, "edge_loss": 0, "faintest": 0}


def new(seed=0):
    return np.random.default_rng(seed)


def flat(value, shape=(120, 160)):
    return np.full(shape, value, np.float32)


def test_srgb_at_known_values():
    assert linear_to_srgb(np.array([0, 0.0031308, 0.2140411, 1, 7])) == pytest.approx(
        [0, 0.0404500, 0.5, 1, 1], abs=1e-6
    )


@given(st.floats(0, 1))
def test_srgb_there_and_back(value):
    assert srgb_to_linear(linear_to_srgb(np.array(value))) == pytest.approx(value, abs=1e-7)
    assert linear_to_srgb(srgb_to_linear(np.array(value))) == pytest.approx(value, abs=1e-7)


@given(st.floats(0, 1.5), st.floats(0.1, 3))
def test_a_quiet_camera_shows_the_exposed_light(light, exposure):
    image = rgb_sensor(flat(light, (4, 5, 3)), new(), exposure=exposure, **QUIET)
    expected = 255 * linear_to_srgb(np.float32(light) * np.float32(exposure))
    assert image.dtype == np.uint8 and image.shape == (4, 5, 3)
    assert np.abs(image - expected).max() <= 0.5 + 1e-4
    image = infrared_sensor(
        flat(light, (4, 5)), new(), exposure=exposure, column_noise=0, bits=12, **QUIET
    )
    assert image.dtype == np.uint16
    assert np.abs(image - 4095 * min(light * exposure, 1)).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("light", [0.05, 0.4])
def test_noise_is_that_of_photons_and_electronics(light):
    options = {"shot_noise": 0.03, "read_noise": 0.01, "blur": 0, "column_noise": 0}
    image = infrared_sensor(flat(light, (400, 400)), new(), bits=16, **options) / 65535
    expected = np.sqrt(0.03**2 * light + 0.01**2)
    # 160 000 samples know a deviation to 0.2 %, a mean to 1/400 of the deviation.
    assert image.std() == pytest.approx(expected, rel=0.01)
    assert image.mean() == pytest.approx(light, abs=expected / 80)
    del options["column_noise"]
    linear = srgb_to_linear(rgb_sensor(flat(light, (400, 400, 3)), new(), **options) / 255)
    assert linear.std() == pytest.approx(expected, rel=0.02)  # 8 bits add a little


def test_columns_differ():
    image = infrared_sensor(flat(0.5), new(), column_noise=0.02, bits=16, **QUIET) / 65535
    assert (image == image[0]).all()
    assert image[0].std() == pytest.approx(0.02, rel=0.2)


def test_blur_spreads_a_point_and_keeps_its_light():
    point = flat(0, (41, 41))
    point[20, 20] = 0.9
    options = {**QUIET, "blur": 1.5, "column_noise": 0, "bits": 16}
    image = infrared_sensor(point, new(), **options) / 65535
    _, x = np.indices(image.shape)
    assert image.sum() == pytest.approx(0.9, rel=1e-3)
    assert (image * (x - 20) ** 2).sum() / image.sum() == pytest.approx(1.5**2, rel=0.02)


def test_too_much_light_saturates():
    assert (rgb_sensor(flat(9, (9, 9, 3)), new()) == 255).all()
    assert (infrared_sensor(flat(9, (9, 9)), new()) == 255).all()
    assert (infrared_sensor(flat(9, (9, 9)), new(), bits=10) == 1023).all()


def test_a_quiet_depth_camera_measures_the_depth():
    depth = np.fromfunction(lambda y, x: 0.6 + 0.001 * x + 0.002 * y, (120, 160))
    np.testing.assert_allclose(depth_sensor(depth, K, new(), **SURE), depth, rtol=1e-6)


@pytest.mark.parametrize("z", [0.6, 1.2, 2.4])
def test_depth_noise_grows_with_the_square(z):
    options = {**SURE, "disparity_noise": 0.05}
    measured = depth_sensor(flat(z, (300, 400)), K, new(), **options)
    disparity = 300 * 0.075 / measured
    assert disparity.std() == pytest.approx(0.05, rel=0.03)
    expected = z**2 / (300 * 0.075) * 0.05
    assert measured.std() == pytest.approx(expected, rel=0.04)


def test_depth_comes_in_steps_of_disparity():
    depth = np.fromfunction(lambda y, x: 0.6 + 0.004 * x, (120, 160))
    measured = depth_sensor(depth, K, new(), **{**SURE, "disparity_step": 0.25})
    steps = 300 * 0.075 / measured / 0.25
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    assert np.abs(300 * 0.075 / depth - 300 * 0.075 / measured).max() <= 0.125 + 1e-5


def test_the_projector_throws_a_shadow_to_the_left():
    depth = flat(1.5)
    depth[40:80, 60:100] = 0.75
    measured = depth_sensor(depth, K, new(), **SURE)
    # Disparities of 15 and 30 pixels: a band of 15 left of the square.
    expected = np.zeros(depth.shape, bool)
    expected[40:80, 45:60] = True
    differ = (measured == 0) != expected
    assert differ.sum() <= 80  # a column of 40 pixels at each end may be rounded away
    assert not differ[:, 47:58].any() and not differ[:40].any() and not differ[80:].any()


def test_slanted_surfaces_throw_no_shadow_on_themselves():
    for slope in (-0.02, 0.005, 0.02):
        depth = np.fromfunction(lambda y, x, k=slope: 2 + k * (x - 80) / 2, (20, 160))
        assert (depth_sensor(depth, K, new(), **SURE) > 0).all()


def test_edges_are_lost():
    depth = flat(1.5)
    depth[40:80, 60:100] = 0.75
    lost = depth_sensor(depth, K, new(), **{**SURE, "edge_loss": 1}) == 0
    square = (depth < 1).astype(np.uint8)
    ring = cv2.morphologyEx(square, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    assert lost[ring].all() and not lost[:30].any() and not lost[45:75, 65:95].any()


def test_little_light_is_lost():
    options = {**SURE, "faintest": 0.05}
    share = [
        (depth_sensor(flat(z), K, new(), **options, reflectance=r) == 0).mean()
        for z, r in ((1, 0.5), (1, 0.01), (8, 0.5), (3.16, 0.5))
    ]
    assert share[:3] == [0, 1, 1]
    assert 0.3 < share[3] < 0.7  # at the threshold itself some of both
    y, x = np.indices((120, 160))
    rays = np.stack([(x - 79.5) / 300, (y - 59.5) / 300, np.ones((120, 160))], -1)
    for cosine, lost in ((0.9, 0), (0.01, 1)):
        # Normals at a fixed angle to the line of sight.
        view = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        side = np.cross(view, [0, 1, 0])
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        normals = cosine * view + np.sqrt(1 - cosine**2) * side
        measured = depth_sensor(flat(1), K, new(), normals=normals, **options)
        assert (measured == 0).mean() == lost


def test_mirrors_blind_the_camera():
    normals = np.zeros((120, 160, 3))
    normals[..., 2] = -1
    lost = depth_sensor(flat(1), K, new(), normals=normals, specular=0.95, **SURE) == 0
    # The cosine is 0.995 30 pixels from the centre, and its power 0.74; 0.97 and 0.14 at 77 pixels.
    away = np.hypot(*(np.indices(lost.shape) - np.array([59.5, 79.5])[:, None, None]))
    assert lost[away < 10].mean() > 0.98 and not lost[away > 95].any()
    dull = depth_sensor(flat(1), K, new(), normals=normals, specular=0.1, **SURE)
    assert (dull > 0).all()


def test_nothing_is_measured_where_nothing_is():
    depth = flat(1)
    depth[:, 80:] = 0
    measured = depth_sensor(depth, K, new())
    assert not measured[:, 80:].any() and (measured[20:, 20:70] > 0).mean() > 0.95
    assert not depth_sensor(flat(0), K, new()).any()


def test_too_near_for_the_projector():
    assert not depth_sensor(flat(1e-6), K, new(), **SURE).any()


@given(st.integers(0, 2**32 - 1))
def test_any_scene_gives_finite_numbers_and_the_same_each_time(seed):
    rng = new(seed)
    shape = (20, 30)
    depth = rng.choice([0, 0.3, 1, 5], shape) * rng.uniform(1, 1.1, shape)
    normals = rng.normal(size=(*shape, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    share = rng.uniform(0, 1, shape)
    options = {"normals": normals, "reflectance": share, "specular": share}
    one, two = (depth_sensor(depth, K, new(seed), **options) for _ in range(2))
    assert one.dtype == np.float32 and one.tobytes() == two.tobytes()
    assert np.isfinite(one).all() and (one >= 0).all() and not one[depth == 0].any()
    kept = one > 0
    np.testing.assert_allclose(one[kept], depth[kept], rtol=0.5)
    light = rng.exponential(0.5, (*shape, 3))
    for sensor, image in ((rgb_sensor, light), (infrared_sensor, light[..., 0])):
        one, two = (sensor(image, new(seed)) for _ in range(2))
        assert one.tobytes() == two.tobytes() and one.shape == image.shape
        assert sensor(image, new(seed + 1)).tobytes() != one.tobytes()


def test_input_is_left_alone():
    light, depth = flat(0.5, (9, 9, 3)), flat(1)
    rgb_sensor(light, new())
    infrared_sensor(light[..., 0], new())
    depth_sensor(depth, K, new())
    assert (light == 0.5).all() and (depth == 1).all()


GREY, COLOUR = flat(0.5), flat(0.5, (9, 9, 3))


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: rgb_sensor(GREY, new()), "linear"),
        (lambda: rgb_sensor(-COLOUR, new()), "linear"),
        (lambda: rgb_sensor(COLOUR * np.nan, new()), "linear"),
        (lambda: rgb_sensor(COLOUR[:0], new()), "linear"),
        (lambda: rgb_sensor("light", new()), "linear"),
        (lambda: rgb_sensor(COLOUR, 0), "generator"),
        (lambda: rgb_sensor(COLOUR, new(), exposure=0), "exposure"),
        (lambda: rgb_sensor(COLOUR, new(), shot_noise=-1), "shot_noise"),
        (lambda: rgb_sensor(COLOUR, new(), read_noise=np.inf), "read_noise"),
        (lambda: rgb_sensor(COLOUR, new(), blur=-1), "blur"),
        (lambda: infrared_sensor(COLOUR, new()), "linear"),
        (lambda: infrared_sensor(GREY, None), "generator"),
        (lambda: infrared_sensor(GREY, new(), bits=7), "bits"),
        (lambda: infrared_sensor(GREY, new(), bits=8.0), "bits"),
        (lambda: infrared_sensor(GREY, new(), column_noise=-1), "column_noise"),
        (lambda: depth_sensor(COLOUR, K, new()), "depth"),
        (lambda: depth_sensor(-GREY, K, new()), "depth"),
        (lambda: depth_sensor(GREY, np.eye(2), new()), "K"),
        (lambda: depth_sensor(GREY, np.zeros((3, 3)), new()), "K"),
        (lambda: depth_sensor(GREY, K, 3), "generator"),
        (lambda: depth_sensor(GREY, K, new(), normals=GREY), "normals"),
        (lambda: depth_sensor(GREY, K, new(), reflectance=-1), "reflectance"),
        (lambda: depth_sensor(GREY, K, new(), reflectance=COLOUR), "reflectance"),
        (lambda: depth_sensor(GREY, K, new(), specular=1.5), "specular"),
        (lambda: depth_sensor(GREY, K, new(), baseline=0), "baseline"),
        (lambda: depth_sensor(GREY, K, new(), disparity_noise=-1), "disparity_noise"),
        (lambda: depth_sensor(GREY, K, new(), disparity_step=-1), "disparity_step"),
        (lambda: depth_sensor(GREY, K, new(), faintest=np.nan), "faintest"),
        (lambda: depth_sensor(GREY, K, new(), edge_loss=2), "edge_loss"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        call()
