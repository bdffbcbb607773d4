import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.batches.warps import require_size, resample, turned_crop, widened
from posecore.cameras import crop_and_resize_intrinsics, project
from posecore.rotations import is_rotation

numbers = st.floats(-1, 1)


@st.composite
def cameras(draw):
    """Any focal lengths, skew and centre; a box that may leave the image, and a turn."""
    fx, fy = draw(st.floats(50, 900)), draw(st.floats(50, 900))
    skew, cx, cy = 20 * draw(numbers), 160 + 200 * draw(numbers), 120 + 200 * draw(numbers)
    K = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
    box = np.array([100 * draw(numbers), 100 * draw(numbers), *[draw(st.floats(5, 300))] * 2])
    return K, box, draw(st.floats(-np.pi, np.pi))


@given(cameras(), st.tuples(st.integers(1, 300), st.integers(1, 300)), st.integers(0, 2**32))
def test_the_new_camera_sees_points_where_the_map_puts_them(camera, size, seed):
    K, box, turn = camera
    rng = np.random.default_rng(seed)
    points = rng.uniform((-1, -1, 0.3), (1, 1, 2), (20, 3))
    to_new, new_K, Rz = turned_crop(K, box, turn, size)
    old = np.concatenate([project(K, points), np.ones((20, 1))], 1)
    mapped = old @ to_new.T
    seen = project(new_K, points @ Rz.T)
    assert np.allclose(seen, mapped[:, :2], rtol=1e-9, atol=1e-7)
    assert np.array_equal(mapped[:, 2], np.ones(20))
    assert is_rotation(Rz)
    assert Rz[2].tolist() == [0, 0, 1] and Rz[:, 2].tolist() == [0, 0, 1]
    assert np.isclose(np.arctan2(Rz[1, 0], Rz[0, 0]), turn) or np.isclose(abs(turn), np.pi)
    # The middle of the box is the middle of the result: the half pixels are in the right place.
    middle = to_new @ [*(box[:2] + (box[2:] - 1) / 2), 1]
    assert np.allclose(middle[:2], (np.array(size) - 1) / 2, atol=1e-7)


@given(cameras())
def test_without_a_turn_it_is_a_crop(camera):
    K, box, _ = camera
    to_new, new_K, Rz = turned_crop(K, box, 0.0, (64, 48))
    assert np.allclose(new_K, crop_and_resize_intrinsics(K, box, (64, 48)), rtol=1e-12, atol=1e-9)
    assert np.allclose(to_new @ K, new_K, rtol=1e-12, atol=1e-9)
    assert np.array_equal(Rz, np.eye(3))


def test_a_quarter_turn_goes_from_x_to_y():
    K = np.array([[100, 0, 31.5], [0, 100, 31.5], [0, 0, 1]])
    to_new, new_K, _ = turned_crop(K, [0, 0, 64, 64], np.pi / 2, (64, 64))
    assert np.allclose(to_new @ [63, 31.5, 1], [31.5, 63, 1])
    assert np.allclose(new_K, K, atol=1e-12)
    image = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    turned = np.rot90(image, -1)  # clockwise as one sees it
    assert np.array_equal(resample(image[..., 0], to_new, (64, 64), 7), turned[..., 0])
    assert np.abs(resample(image, to_new, (64, 64)).astype(int) - turned).max() <= 1


def test_any_number_of_leading_dimensions():
    K = np.eye(3)[None].repeat(6, 0).reshape(2, 3, 3, 3)
    to_new, new_K, Rz = turned_crop(K, np.ones((3, 4)), np.zeros((2, 1)), (5, 5))
    assert to_new.shape == new_K.shape == (2, 3, 3, 3)
    assert Rz.shape == (2, 1, 3, 3)


@given(st.integers(0, 2**32), st.booleans())
def test_labels_are_those_of_the_nearest_pixel(seed, wide):
    """Against a loop-free brute force; at most at ties of rounding the two may differ."""
    rng = np.random.default_rng(seed)
    dtype, fill = (np.uint16, 0) if wide else (np.uint8, 254)
    image = rng.integers(1, 250, (40, 50)).astype(dtype)
    box = np.array([*rng.uniform(-10, 20, 2), *rng.uniform(8, 60, 2)])
    K = np.array([[60, 0, 25], [0, 70, 18], [0, 0, 1]])
    to_new, _, _ = turned_crop(K, box, rng.uniform(-3, 3), (33, 27))
    got = resample(image, to_new, (33, 27), fill)
    y, x = np.mgrid[:27, :33]
    at = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(to_new).T
    nearest = np.floor(at[..., :2] + 0.5).astype(int)
    inside = ((nearest >= 0) & (nearest < (50, 40))).all(-1)
    column, row = np.clip(nearest, 0, (49, 39)).transpose(2, 0, 1)
    expected = np.where(inside, image[row, column], fill)
    tie = (np.abs(at[..., :2] - np.floor(at[..., :2]) - 0.5) < 1e-3).any(-1)
    assert got.dtype == dtype
    assert np.array_equal(got[~tie], expected[~tie])


@given(st.integers(0, 2**32))
def test_depth_and_labels_come_from_the_same_pixel(seed):
    rng = np.random.default_rng(seed)
    labels = rng.integers(1, 250, (40, 50)).astype(np.uint8)
    to_new, _, _ = turned_crop(np.eye(3), [0, 0, 50, 40], rng.uniform(-3, 3), (64, 64))
    wide = resample(labels.astype(np.uint16), to_new, (64, 64), 0)
    assert np.array_equal(wide, resample(labels, to_new, (64, 64), 0))


def test_whole_pixels_are_copied():
    image = np.random.default_rng(1).integers(0, 256, (30, 40, 3)).astype(np.uint8)
    to_new, _, _ = turned_crop(np.eye(3), [7, 5, 20, 16], 0.0, (20, 16))
    assert np.array_equal(resample(image, to_new, (20, 16)), image[5:21, 7:27])
    assert np.array_equal(resample(image[..., 0], to_new, (20, 16), 0), image[5:21, 7:27, 0])


def test_colours_are_interpolated_linearly():
    y, x = np.mgrid[:64, :64]
    ramp = (2 * x + y).astype(np.uint8)  # a plane stays a plane
    to_new, _, _ = turned_crop(np.eye(3), [20.25, 18.5, 12, 12], 0.3, (48, 48))
    back = np.linalg.inv(to_new)
    at = np.stack([x[:48, :48], y[:48, :48], np.ones((48, 48))], -1) @ back.T
    got = resample(ramp, to_new, (48, 48)).astype(float)
    assert np.abs(got - (2 * at[..., 0] + at[..., 1])).max() < 0.6  # rounded to whole values


@pytest.mark.parametrize("k", [2, 3, 5])
def test_shrunk_images_are_means(k):
    image = np.random.default_rng(k).integers(0, 256, (12 * k, 16 * k)).astype(np.uint8)
    to_new, _, _ = turned_crop(np.eye(3), [0, 0, 16 * k, 12 * k], 0.0, (16, 12))
    expected = image.reshape(12, k, 16, k).mean((1, 3))
    assert np.abs(resample(image, to_new, (16, 12)) - expected).max() <= 0.51


@pytest.mark.parametrize("times", [15, 300, 1e5])
def test_boxes_far_larger_than_the_image(times):
    """Take no more room than others, and are still means as far as that goes."""
    image = np.random.default_rng(0).integers(0, 256, (90, 120)).astype(np.uint8)
    box = [60 - 20 * times, 45 - 20 * times, 40 * times, 40 * times]
    to_new, _, _ = turned_crop(np.eye(3), box, 0.3, (40, 40))
    tracemalloc.start()
    got = resample(image, to_new, (40, 40))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert got.shape == (40, 40)
    assert peak < 2e6
    if times == 15:
        assert got[19:21, 19:21].std() < 20  # means of 225 pixels, whose own deviation is 74


def test_outside_the_image():
    image = np.full((10, 10), 9, np.uint8)
    to_new, _, _ = turned_crop(np.eye(3), [5, 0, 10, 10], 0.0, (10, 10))
    assert (resample(image, to_new, (10, 10)) == 9).all()
    labels = resample(image, to_new, (10, 10), 254)
    assert (labels[:, :5] == 9).all() and (labels[:, 5:] == 254).all()


@given(st.integers(1, 5000), st.integers(1, 5000))
def test_sizes(width, height):
    assert require_size("size", (width, np.int64(height))) == (width, height)
    assert require_size("size", width) == (width, width)


@given(st.integers(0, 2**32), st.integers(1, 99), st.integers(1, 99), st.floats(0.1, 5))
def test_widened_boxes(seed, width, height, margin):
    boxes = np.random.default_rng(seed).uniform(0.5, 90, (7, 4))
    wide = widened(boxes, (width, height), margin)
    assert np.allclose(wide[:, 2] / wide[:, 3], width / height)
    for new, old in zip(wide, boxes, strict=True):
        assert np.allclose(new[:2] + new[2:] / 2, old[:2] + old[2:] / 2)
        # One side is the old one times the margin, the other is not shorter.
        assert np.isclose((new[2:] / old[2:]).min(), margin)


BAD = [
    (lambda: widened([[0, 0, 1, 0]], (4, 4), 1.0), "boxes"),
    (lambda: turned_crop(np.zeros((3, 3)), [0, 0, 1, 1], 0.0, (4, 4)), "K"),
    (lambda: turned_crop(np.eye(3), [0, 0, 0, 1], 0.0, (4, 4)), "box"),
    (lambda: turned_crop(np.eye(3), [0, 0, 1, 1], 0.0, (4, 0)), "size"),
    (lambda: require_size("size", 0), "size"),
    (lambda: require_size("size", 2.5), "size"),
    (lambda: require_size("size", (1, 2, 3)), "size"),
    (lambda: require_size("size", "ab"), "size"),
]


@pytest.mark.parametrize("call, name", BAD)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
