"""Photographs within figures: windows, crops, pale backgrounds, grain."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore import figures
from posecore.figures import photographs
from posecore.figures.style import new_picture


def smooth_image(height=90, width=120):
    yy, xx = np.mgrid[0:height, 0:width] / width
    return np.uint8(255 * np.stack([xx, yy, 1 - xx], -1))


@given(st.tuples(st.integers(1, 30), st.integers(1, 30)), st.data(), st.floats(0, 1), st.booleans())
def test_a_window_is_within_the_image_and_around_all(shape, data, margin, pointed):
    mask = np.zeros(shape, bool)
    mask[data.draw(st.integers(0, shape[0] - 1)), data.draw(st.integers(0, shape[1] - 1))] = True
    points = None
    if pointed:
        points = np.array(data.draw(st.lists(st.tuples(*[st.floats(-99, 99)] * 2), min_size=1)))
    x0, y0, x1, y1 = photographs.window_around(mask, points, margin)
    assert 0 <= x0 < x1 <= shape[1] and 0 <= y0 < y1 <= shape[0]
    assert photographs.crop(mask, (x0, y0, x1, y1)).sum() == 1
    for x, y in () if points is None else points:
        assert x0 <= np.clip(x, 0, shape[1] - 1) <= x1 and y0 <= np.clip(y, 0, shape[0] - 1) <= y1


@pytest.mark.parametrize("mask", [np.zeros((4, 5), bool), np.ones(4, bool)])
def test_bad_masks_are_named(mask):
    with pytest.raises(ValueError, match="mask"):
        photographs.window_around(mask)


def test_a_window_of_a_pose_has_the_object_in_its_middle():
    K = np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]])
    assert photographs.window_of_pose((90, 120), K, [0, 0, 2.0], 0.4, 1.0) == (40, 25, 80, 65)
    x0, y0, x1, y1 = photographs.window_of_pose((90, 120), K, [9.0, -9, 1], 0.4)
    assert 0 <= x0 < x1 <= 120 and 0 <= y0 < y1 <= 90
    with pytest.raises(ValueError, match="diameter"):
        photographs.window_of_pose((90, 120), K, [0, 0, 1.0], 0)


@pytest.mark.parametrize("kind", ["colour", "bytes", "numbers"])
def test_a_crop_keeps_the_coordinates_of_the_whole(kind):
    image = smooth_image()
    image = {"colour": image, "bytes": image[..., 0], "numbers": image[..., 0] / 255}[kind]
    axes = new_picture(3, 3, "words").subplots()
    shown = photographs.show_crop(axes, image, (20, 30, 60, 80), pale=0.5)
    assert shown.get_extent() == [19.5, 59.5, 79.5, 29.5]
    assert axes.get_xlim() == (19.5, 59.5) and axes.get_ylim() == (79.5, 29.5)
    top = 1 if kind == "numbers" else 255
    part = image[30:80, 20:60]
    np.testing.assert_allclose(shown.get_array(), part / 2 + top / 2, atol=top / 200)
    axes.plot([-500], [500])
    assert axes.get_xlim() == (19.5, 59.5)
    assert photographs.show_crop(axes, image).get_extent()[:2] == [-0.5, 119.5]


def test_photographs_are_smooth_unless_their_pixels_are_to_be_seen():
    def interpolation(image, width):
        return figures.picture(image, width=width).axes[0].images[0].get_interpolation()

    assert interpolation(smooth_image(), 2.0) == "bicubic"
    assert interpolation(smooth_image(), 5.0) == "nearest"
    assert interpolation(smooth_image()[..., 0] > 99, 2.0) == "nearest"


def test_grain_goes_and_edges_stay():
    rng = np.random.default_rng(0)
    image = np.zeros((40, 60, 3)) + [60, 90, 120]
    image[:, 30:] += 100
    noisy = (image + rng.normal(0, 6, image.shape)).clip(0, 255).astype(np.uint8)
    kept = noisy.copy()
    for one, plain in ((noisy, image), (noisy[..., 0], image[..., 0])):
        calm = photographs.without_grain(one)
        assert calm.shape == one.shape and calm.dtype == np.uint8
        off, before = np.abs(calm - plain), np.abs(one - plain)
        assert off.mean() < 0.7 * before.mean()
        assert abs(np.diff(calm.astype(int), axis=1)[:, 29].mean() - 100) < 5
    np.testing.assert_array_equal(noisy, kept)


def test_lines_become_thin_and_axes_bare():
    axes = new_picture(2, 2, "words").subplots()
    axes.plot([0, 1], lw=5)
    photographs.thin_lines(axes, 1.5)
    assert axes.lines[0].get_linewidth() == 1.5 and axes.lines[0].get_path_effects()
    photographs.bare(axes)
    assert not len(axes.get_xticks()) and not len(axes.get_yticks())
    assert axes.spines["left"].get_visible()
    photographs.bare(axes, None)
    assert not axes.spines["left"].get_visible()
