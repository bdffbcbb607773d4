"""Masks without labels: Li's threshold beside scikit-image, the cuboid beside rays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.filters import threshold_li

from posecore.methods.infrared import masks
from posecore.methods.infrared.masks import CUBOID, cuboid_mask, li_threshold, object_mask
from posecore.rotations import axis_angle_to_matrix

K = np.array([[120.0, 3, 38.5], [0, 110, 24.0], [0, 0, 1]])
SIZE = (80, 47)
SEEDS = st.integers(0, 10**6)


def picture(seed):
    """Two humps, of bytes."""
    rng = np.random.default_rng(seed)
    dark, bright = rng.uniform(1, 60), rng.uniform(60, 220)
    count = rng.integers(1, 900)
    values = np.concatenate([rng.poisson(dark, 1000 - count), rng.normal(bright, 20, count)])
    return np.clip(np.round(values), 0, 255).astype(np.uint8).reshape(20, 50)


@given(SEEDS, st.sampled_from(["bytes", "floats", "zeros around"]))
def test_the_threshold_is_that_of_scikit_image(seed, kind):
    values = picture(seed)
    if kind == "floats":
        values = values + np.random.default_rng(seed).uniform(0, 1, values.shape)
    elif kind == "zeros around":
        values[:, 20:] = 0
    assert li_threshold(values) == pytest.approx(threshold_li(values), rel=1e-9)


@given(SEEDS, st.floats(1e-6, 1e6))
def test_scaled_values_have_a_scaled_threshold(seed, factor):
    values = picture(seed).astype(np.float64)
    assert li_threshold(factor * values) == pytest.approx(factor * li_threshold(values), rel=1e-6)


@given(st.lists(st.integers(0, 50), min_size=1, max_size=30))
def test_it_parts_the_values(values):
    threshold = li_threshold(np.array(values))
    assert min(values) <= threshold <= max(values)
    if min(values) < max(values):
        assert 0 < sum(value > threshold for value in values) < len(values)
    else:
        assert threshold == values[0]


@given(SEEDS)
def test_no_other_threshold_is_a_better_start(seed):
    """Where it ends it stays: it is between the two means as its equation has it."""
    values = picture(seed).astype(np.float64)
    threshold = li_threshold(values, tolerance=1e-9)
    low = values.min()
    dark, bright = (part.mean() - low for part in
                    (values[values <= threshold], values[values > threshold]))  # fmt: skip
    if dark > 0:
        expected = (bright - dark) / (np.log(bright) - np.log(dark)) + low
        assert threshold == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("counts", [(1, 999), (500, 500), (999, 1), (99_999, 1)])
@pytest.mark.parametrize("values", [(0, 1), (0, 255), (3, 200), (0.5, 0.5000001)])
def test_two_values_are_told_apart(values, counts):
    image = np.repeat(values, counts)
    threshold = li_threshold(image)
    assert values[0] <= threshold < values[1]


def test_few_bright_pixels_among_many_that_are_black():
    """Where the mean of what is dark is 0 the equation has no answer, and nothing moves."""
    image = np.array([0] * 5000 + [1, 200, 200])
    assert li_threshold(image) == pytest.approx(threshold_li(image))


def test_a_step_at_which_it_ends():
    values = np.r_[np.arange(1, 400), [3000] * 30].astype(float)
    first = values.mean()
    assert li_threshold(values, tolerance=1e3) != li_threshold(values, tolerance=1e-9) != first
    assert li_threshold(values) == pytest.approx(li_threshold(values, tolerance=1e-9), abs=0.5)


@pytest.mark.parametrize("values", [[], [-1, 2], [0, np.nan], [np.inf, 1]])
def test_values_that_have_no_threshold(values):
    with pytest.raises(ValueError, match="values"):
        li_threshold(np.array(values))


def test_a_tolerance_that_cannot_be():
    with pytest.raises(ValueError, match="^tolerance"):
        li_threshold(np.array([1, 2]), tolerance=0)


# The cuboid ---------------------------------------------------------------------------------------


def hit(R, t, sides, centre):
    """(H, W) whether the ray of a pixel meets the cuboid: by its three slabs."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T @ R  # in its frame
    start = -t @ R - centre
    walls = np.stack([(side * np.array(sides) / 2 - start) / rays for side in (-1, 1)])
    return walls.min(0).max(-1) <= walls.max(0).min(-1)


@given(SEEDS)
def test_the_cuboid_is_where_rays_meet_it(seed):
    rng = np.random.default_rng(seed)
    R = axis_angle_to_matrix(rng.normal(size=3))
    t = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.6, 2)])
    sides, centre = rng.uniform(0.05, 0.3, 3), rng.uniform(-0.1, 0.1, 3)
    found = cuboid_mask(K, R, t, SIZE, sides=sides, centre=centre)
    assert found.dtype == bool and found.shape == SIZE[::-1]
    # Corners are rounded to float32: a pixel on an edge may fall on either side.
    assert (found != hit(R, t, sides, centre)).sum() <= 1


def test_the_papers_cuboid_straight_ahead():
    found = cuboid_mask(K, np.eye(3), np.array([0, 0, 0.75]), SIZE)
    near = 0.75 + 0.1 - CUBOID[2] / 2  # its front face covers the others
    assert abs(found.any(0).sum() - (120 * CUBOID[0] + 3 * CUBOID[1]) / near) <= 1
    assert abs(found.any(1).sum() - 110 * CUBOID[1] / near) <= 1
    assert found[24, 38]


def test_all_of_an_image_or_nothing():
    assert cuboid_mask(K, np.eye(3), np.array([0, 0, 0.2]), SIZE, sides=(2, 2, 0.1)).all()
    assert not cuboid_mask(K, np.eye(3), np.array([5.0, 0, 1]), SIZE).any()


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("t", {"t": [0, 0, -0.7]}),
        ("t", {"t": [0, 0, 0.02]}),
        ("t", {"t": [0, 0, np.nan]}),
        ("t", {"t": [0, 0.7]}),
        ("R", {"R": np.eye(4)}),
        ("K", {"K": np.zeros((3, 3))}),
        ("R", {"R": 2 * np.eye(3)}),
        ("R", {"R": np.full((3, 3), np.nan)}),
        ("size", {"size": (80, 0)}),
        ("size", {"size": (80.5, 47)}),
        ("size", {"size": 80}),
        ("t", {"t": [0, 0, 1e12]}),
        ("t", {"sides": (1e-12, 1e-12, 1e-12)}),
        ("sides", {"sides": (0.1, np.inf, 0.1)}),
        ("centre", {"centre": (np.nan, 0, 0)}),
        ("sides", {"sides": (0.1, 0.1, 0)}),
        ("sides", {"sides": (0.1, 0.1)}),
        ("centre", {"centre": (0.1, 0.1)}),
    ],
)
def test_a_cuboid_that_cannot_be(name, changes):
    usual = {"K": K, "R": np.eye(3), "t": [0, 0, 0.7], "size": SIZE}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        cuboid_mask(**(usual | changes))


# Both ---------------------------------------------------------------------------------------------


def test_a_mask_is_what_is_bright_within_the_cuboid():
    """The threshold is that of an image which is black outside of it."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 20, SIZE[::-1]).astype(np.uint8)
    image[15:30, 30:45] = 180  # a face
    image[:, 70:] = 250  # a window
    pose = K, np.eye(3), np.array([0, 0, 0.9])
    region = cuboid_mask(*pose, SIZE)
    threshold = threshold_li(np.where(region, image, 0))
    found = object_mask(image, *pose)
    assert np.array_equal(found, region & (image > threshold))
    assert found[20, 40] and not found[:, 70:].any() and found.sum() < region.sum()


def test_a_face_that_fills_the_cuboid_is_kept_whole():
    image = np.random.default_rng(0).integers(100, 220, SIZE[::-1]).astype(np.uint8)
    pose = K, np.eye(3), np.array([0, 0, 1.2])
    assert object_mask(image, *pose).sum() > 0.8 * cuboid_mask(*pose, SIZE).sum()


def test_without_a_cuboid_it_is_the_threshold_of_all():
    image = picture(0)
    found = object_mask(image, K, np.eye(3), np.array([0, 0, -1.0]), sides=None)
    assert np.array_equal(found, image > threshold_li(image))


def test_nothing_is_left_of_a_cuboid_outside_the_image(monkeypatch):
    monkeypatch.setattr(masks, "li_threshold", None)  # it is not asked
    found = object_mask(np.ones(SIZE[::-1]), K, np.eye(3), np.array([5.0, 0, 1]))
    assert not found.any()


def test_of_a_black_image_nothing_is_left():
    assert not object_mask(np.zeros(SIZE[::-1]), K, np.eye(3), np.array([0, 0, 0.9])).any()


@pytest.mark.parametrize("image", [np.zeros((3, 47, 80)), np.zeros(80)])
def test_what_is_no_image(image):
    with pytest.raises(ValueError, match=r"^image: expected shape \(H, W\)"):
        object_mask(image, K, np.eye(3), np.array([0, 0, 0.9]))


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_images_of_other_numbers(value):
    image = np.ones(SIZE[::-1])
    image[0, 0] = value
    with pytest.raises(ValueError, match="^image: expected finite numbers of at least 0"):
        object_mask(image, K, np.eye(3), np.array([0, 0, 0.9]))


def test_a_sum_that_overflows():
    with pytest.raises(ValueError, match="^values: expected numbers whose sum is finite"):
        li_threshold(np.array([1.7e308, 1.7e308, 0]))
