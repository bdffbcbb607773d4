import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.shapes import Material
from data_tools.shapes.building import around, on_plane
from data_tools.textures import PATTERNS, albedo, infrared
from data_tools.textures.prints import FRONT, keyboard, label, look_up, noise, screen

DARK, LIGHT = (0.1, 0.2, 0.0), (0.7, 0.8, 1.0)
seeds = st.integers(0, 2**32 - 1)
every_pattern = pytest.mark.parametrize("pattern", PATTERNS)
VARIED = ("blotches", "brushed", "cloth", "label", "marble", "noise", "planks", "print", "pulp")
VARIED += ("screen", "speckle", "strands", "tabby", "tiles", "wood")


def shares(pattern, points, seed=0, scale=1.0, look=infrared):
    """How much of the second colour there is, as infrared shows it when it runs from 0 to 1."""
    material = Material(DARK, LIGHT, pattern, scale, infrared=0.0, second_infrared=1.0, seed=seed)
    points = np.asarray(points)
    return look((material,), np.zeros(len(points), int), points, np.zeros_like(points))


def cloud(seed, count=400, reach=0.5):
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 3))


@every_pattern
@settings(max_examples=15)
@given(seed=seeds)
def test_both_lights_mix_by_the_same_share(pattern, seed):
    points = cloud(seed, 100, 3.0)
    share = shares(pattern, points)
    assert share.shape == (100,) and share.dtype == np.float32
    assert 0 <= share.min() and share.max() <= 1
    colour = shares(pattern, points, look=albedo)
    assert colour.shape == (100, 3) and colour.dtype == np.float32
    expected = np.array(DARK) + share[:, None] * (np.array(LIGHT) - DARK)
    np.testing.assert_allclose(colour, expected, atol=1e-6)


@every_pattern
def test_each_point_stands_for_itself(pattern):
    """Neither the order nor the number of the points matters."""
    points = cloud(1)
    whole = shares(pattern, points, 3)
    order = np.random.default_rng(0).permutation(len(points))
    np.testing.assert_array_equal(shares(pattern, points[order], 3), whole[order])
    # Matrix products of other sizes may round differently; the ramps make that at most a few ulp.
    np.testing.assert_allclose(shares(pattern, points[:7], 3), whole[:7], atol=2e-3)
    assert whole.std() > 0.01 or pattern == ""


@every_pattern
def test_seeds_are_variants(pattern):
    points = cloud(2)
    one, two = shares(pattern, points, 2), shares(pattern, points, 5)
    assert (np.abs(one - two).max() > 0.1) == (pattern in VARIED or pattern == "face")


@every_pattern
def test_patterns_are_band_limited(pattern):
    """Two points a hundredth of a repeat apart look alike nearly everywhere: edges are ramps."""
    points = cloud(3, 3000)
    scale = 0.12 if pattern == "eye" else 1.0
    step = 0.01 * np.random.default_rng(0).normal(size=(3000, 3)) / np.sqrt(3)
    if pattern in ("ribs", "petals", "dots", "label"):
        points[:, :2] *= 0.5 / np.hypot(*points[:, :2].T)[:, None]  # around an axis
        step /= 4  # of the way around
    if pattern == "face":
        points, step = points * 0.2, step * 0.05  # which is in metres
    change = np.abs(
        shares(pattern, points + step, scale=scale) - shares(pattern, points, scale=scale)
    )
    assert np.quantile(change, 0.9) < 0.35
    assert change.mean() < 0.12
    if pattern not in ("blotches", "marble", "speckle", "eye"):  # noise is steep in a few places
        assert change.max() < 0.75


def test_plain_materials_and_shared_infrared():
    plain = Material(DARK, infrared=0.3)
    inked = Material(DARK, LIGHT, "stripes", 5, infrared=0.4)  # second_infrared None: as the first
    points = cloud(0)
    index = np.arange(len(points)) % 2
    colour = albedo((plain, inked), index, points, points)
    np.testing.assert_array_equal(colour[::2], np.broadcast_to(np.float32(DARK), (200, 3)))
    assert colour[1::2].std(0).min() > 0.1
    bright = infrared((plain, inked), index, points, points)
    np.testing.assert_array_equal(bright, np.where(index == 0, np.float32(0.3), np.float32(0.4)))


def test_scale_counts_repeats_per_metre():
    x = np.linspace(0, 1, 4001)[:-1]
    share = shares("stripes", np.stack([x, 0 * x, 0 * x], -1), scale=8.0)
    assert ((share[1:] > 0.5) & (share[:-1] <= 0.5)).sum() == 8
    np.testing.assert_allclose(share.mean(), 0.5, atol=0.01)


def test_place_is_affine():
    turned = Material(
        DARK,
        LIGHT,
        "rings",
        2,
        infrared=0,
        second_infrared=1,
        place=(1.0, 0, 0, 0, 0, 1.0, 0, 0, 3.0, 0, 0, 0.25),
    )
    x = np.linspace(-1, 1, 101)
    points = np.stack([x, 0.3 * x, 7 * x], -1)
    expected = shares("rings", np.stack([0 * x, 0 * x, 2 * (3 * x + 0.25)], -1))
    found = infrared((turned,), np.zeros(101, int), points, points)
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("pattern", ["checker", "pulp", "rings"])
def test_patterns_for_symmetric_objects(pattern):
    points = cloud(5)
    turned = points * [-1, -1, 1]
    np.testing.assert_allclose(shares(pattern, points), shares(pattern, turned), atol=1e-4)


def test_labels_read_from_left_to_right_around_a_can():
    """Seen from outside, z up, the angle grows to the right, and so does the print's u."""
    angle, height = np.meshgrid(np.linspace(0.001, 0.999, 300), np.linspace(0.99, 0.01, 60))
    turns = 2 * np.pi * angle.ravel()
    points = np.stack([0.03 * np.cos(turns), 0.03 * np.sin(turns), 0.1 * height.ravel()], -1)
    material = around(
        Material(DARK, LIGHT, "label", infrared=0, second_infrared=1, seed=3), 0.0, 0.1
    )
    found = infrared((material,), np.zeros(len(points), int), points, points).reshape(60, 300)
    expected = label(3)[(np.linspace(0.01, 0.99, 60) * 191.99).astype(int)]
    expected = expected[:, (np.linspace(0.001, 0.999, 300) * 511.99).astype(int)]
    assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > 0.98
    flat = on_plane(Material(DARK, LIGHT, "print", seed=3), (0, 0, 0), (1, 0, 0), (0, 1, 0))
    x, y = np.meshgrid(np.linspace(0.01, 0.99, 50), np.linspace(0.99, 0.01, 40))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1)
    colour = albedo((flat,), np.zeros(len(points), int), points, points)[:, 0].reshape(40, 50)
    rows = (np.linspace(0.01, 0.99, 40) * 191.99).astype(int)
    columns = (np.linspace(0.01, 0.99, 50) * FRONT * 511.99).astype(int)
    assert np.corrcoef(colour.ravel(), label(3)[rows][:, columns].ravel())[0, 1] > 0.98


@given(seeds)
def test_look_up_against_a_loop(seed):
    rng = np.random.default_rng(seed)
    picture = rng.random((6, 9)).astype(np.float32)
    u, v = rng.uniform(-1, 2, 20), rng.uniform(-0.2, 1.2, 20)
    for x, y, value in zip(u, v, look_up(picture, u, v), strict=True):
        column, row = (x % 1) * 9 - 0.5, np.clip(y * 6 - 0.5, 0, 5)
        total = 0.0
        for i in range(6):
            for j in range(-1, 10):
                weight = max(0, 1 - abs(row - i)) * max(0, 1 - abs(column - j))
                total += weight * picture[i, j % 9]
        assert value == pytest.approx(total, abs=1e-6)


@given(seeds)
def test_noise_is_periodic_and_continuous(seed):
    points = np.random.default_rng(seed).uniform(-2, 2, (50, 3))
    value = noise(points)
    assert (0 <= value).all() and (value <= 1).all()
    np.testing.assert_allclose(noise(points + [1, -2, 3]), value, atol=1e-5)
    assert np.abs(noise(points + 1e-4) - value).max() < 0.02
    ends = np.array([[0, 0, 0], [1, 1, 1], [1 - 1e-9, 0, -1e-12]])
    np.testing.assert_allclose(noise(ends), noise(ends[:1])[0], atol=1e-5)


def test_noise_fills_its_range_without_direction():
    rng = np.random.default_rng(0)
    values = noise(rng.random((20_000, 3)))
    assert values.mean() == pytest.approx(0.5, abs=0.02)
    assert 0.15 < values.std() < 0.25
    points = rng.random((5_000, 3))
    change = [np.abs(noise(points + 0.02 * axis) - noise(points)).mean() for axis in np.eye(3)]
    np.testing.assert_allclose(change, np.mean(change), rtol=0.15)
    assert 0.03 < np.mean(change) < 0.15


def test_pictures():
    assert label(0).shape == (192, 512) and keyboard().shape == (160, 400)
    assert screen(0).shape == (160, 256)
    pictures = [label(k) for k in range(8)] + [screen(k) for k in range(4)]
    for picture in [*pictures, keyboard()]:
        assert picture.dtype == np.float32
        assert 0 <= picture.min() and picture.max() <= 1
        assert picture.std() > 0.15
    for k in range(7):
        assert np.abs(label(k) - label(k + 1)).mean() > 0.02
    seam = np.abs(label(1)[:, 0] - label(1)[:, -1])
    assert seam.max() < 0.5  # blurred around, too


GREY = (Material(DARK),)
P, ROWS = np.zeros((4, 3)), np.zeros(4, int)


@pytest.mark.parametrize("look", [albedo, infrared])
@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((GREY, ROWS, np.zeros((4, 2)), P), "points"),
        ((GREY, ROWS, np.zeros(4), P), "points"),
        ((GREY, ROWS, np.full((4, 3), np.nan), P), "points"),
        ((GREY, ROWS, np.full((4, 3), np.inf), P), "points"),
        ((GREY, ROWS, P, np.zeros((3, 3))), "normals"),
        ((GREY, ROWS[:3], P, P), "index"),
        ((GREY, ROWS + 1, P, P), "index"),
        ((GREY, ROWS - 1, P, P), "index"),
        ((GREY, ROWS.astype(float), P, P), "index"),
        (((), ROWS, P, P), "index"),
        (((Material(DARK, pattern="plaid"),), ROWS, P, P), "pattern"),
    ],
)
def test_bad_input(look, arguments, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        look(*arguments)


@pytest.mark.parametrize("look", [albedo, infrared])
def test_no_points(look):
    assert len(look(GREY, ROWS[:0], P[:0], P[:0])) == 0
    assert len(look((), ROWS[:0], P[:0], P[:0])) == 0
