"""Pictures show the pixels they were given, and poses where the camera sees them."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from posecore import cameras, figures, poses, rotations

A_FEW = settings(max_examples=15)  # each draws a figure

K = np.array([[120.0, 0, 40], [0, 110.0, 30], [0, 0, 1]])
IMAGE = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
GREY = IMAGE[..., 0]
R = rotations.axis_angle_to_matrix([[0.3, -0.5, 0.2], [1.0, 0, 0]])
T = np.array([[0.05, -0.02, 0.6], [-0.1, 0.0, 0.9]])
SIZE = np.array([0.1, 0.2, 0.3])


@given(arrays(np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(3))))
@A_FEW
def test_colours_are_shown_as_they_are(image):
    for given_ in (image, torch.from_numpy(image), (image / 255.0).astype(np.float32)):
        shown = figures.picture(given_).axes[0].images[0].get_array()
        shown = shown if shown.dtype == np.uint8 else shown * 255
        np.testing.assert_allclose(shown, image, atol=1e-4)


def test_pixels_are_drawn_one_by_one_with_the_first_centre_at_the_origin():
    image = figures.picture(GREY).axes[0].images[0]
    assert image.get_extent() == [-0.5, 79.5, 59.5, -0.5]
    assert image.get_interpolation() == "nearest"


@pytest.mark.parametrize(
    ("image", "limits", "expected"),
    [
        (np.array([[3, 9]], np.uint8), None, (0, 255)),
        (np.array([[True]]), None, (0, 1)),
        (np.array([[0.4, np.nan, 2.0]]), None, (0.4, 2.0)),
        (np.array([[0.4, 2.0]]), (0, 3), (0, 3)),
        (np.array([[7.0]]), None, (7.0, 8.0)),
    ],
)
def test_limits_of_brightness(image, limits, expected):
    shown = figures.picture(image, limits=limits).axes[0].images[0]
    assert shown.get_clim() == expected
    np.testing.assert_array_equal(shown.get_array().filled(np.nan), image)


def test_a_colour_bar_names_its_unit():
    depth = np.array([[0.5, np.nan], [1.5, 1.0]])
    figure = figures.picture(depth, title="what the sensor saw", colour_bar="depth, m")
    image, bar = figure.axes
    assert bar.get_ylabel() == "depth, m"
    assert image.images[0].get_cmap().name == "viridis"
    assert image.get_title() == "what the sensor saw"
    assert figure.alt == "what the sensor saw, 2 x 2 pixels, colours show depth, m"


@pytest.mark.slow
@given(st.integers(1, 7), st.one_of(st.none(), st.integers(1, 4)))
@A_FEW
def test_a_grid_holds_its_images_in_order(count, columns):
    images = [np.full((2, 3), number, np.uint8) for number in range(count)]
    titles = [f"image {number}" for number in range(count)]
    figure = figures.picture_grid(images, titles, columns=columns)
    assert [int(axes.images[0].get_array()[0, 0]) for axes in figure.axes] == list(range(count))
    assert [axes.get_title() for axes in figure.axes] == titles
    across = min(count, 4) if columns is None else columns
    places = [axes.get_subplotspec() for axes in figure.axes]
    assert [(place.rowspan.start, place.colspan.start) for place in places] == [
        divmod(number, across) for number in range(count)
    ]
    assert figure.alt == f"{count} images: " + "; ".join(titles)


def test_masks_stay_visible_beside_photographs():
    """A mask used to be drawn from 0 to 255 beside an image in bytes: all black."""
    depth = np.array([[0.5, 2.0]])
    figure = figures.picture_grid([GREY, GREY > 100, depth, depth + 1, IMAGE])
    limits = [axes.images[0].get_clim() for axes in figure.axes[:4]]
    assert limits == [(0, 255), (0, 1), (0.5, 3.0), (0.5, 3.0)]
    shared = figures.picture_grid([GREY > 100, depth], colour_bar="x")
    assert [axes.images[0].get_clim() for axes in shared.axes[:2]] == [(0, 2.0), (0, 2.0)]


def test_numbers_are_labels_and_titles_too():
    figure = figures.pose_picture(IMAGE, K, R, T, SIZE, labels=[1, 12])
    assert figure.alt == "Image with the projected axes and 3D box of 1, 12"
    assert figures.picture_grid([GREY], np.array([7])).axes[0].get_title() == "7"


def test_boxes_are_drawn_in_other_colours_than_axes():
    axes = figures.pose_picture(IMAGE, K, R, T, SIZE).axes[0]
    of = {
        part: {line.get_color() for line in axes.lines if part in line.get_gid()}
        for part in ("axis", "edge")
    }
    assert len(of["axis"]) == 3 and len(of["edge"]) == 2 and not of["axis"] & of["edge"]


def test_a_name_without_a_box_stands_where_the_axes_are_not():
    figure = figures.pose_picture(IMAGE, K, np.eye(3), [0, 0, 0.6], labels=["mug"])
    figure.draw_without_rendering()
    (name,) = [text for text in figure.axes[0].texts if text.get_text() == "mug"]
    x, y = figure.axes[0].transData.inverted().transform(name.get_window_extent()).mean(0)
    assert x < 40 and y < 30  # x goes right and y goes down from the origin at (40, 30)


def test_a_grid_has_one_scale():
    stack = np.stack([np.full((2, 2), 1.0), np.full((2, 2), 3.0)])
    figure = figures.picture_grid(stack, colour_bar="depth, m")
    assert [axes.images[0].get_clim() for axes in figure.axes[:2]] == [(1, 3), (1, 3)]
    assert [axes.get_ylabel() for axes in figure.axes] == ["", "", "depth, m"]
    assert figure.alt == "2 images. Colours show depth, m"


@given(arrays(np.float64, array_shapes(min_dims=0, max_dims=1, max_side=4)))
@A_FEW
def test_every_pose_has_its_axes(batch):
    many = np.broadcast_to(R[0], (*batch.shape, 3, 3))
    t = np.broadcast_to(T[0], (*batch.shape, 3))
    figure = figures.pose_picture(IMAGE, K, many, torch.tensor(t.copy()), axis_length=0.1)
    lines = [line for line in figure.axes[0].lines if line.get_gid() == "axis z"]
    ends = cameras.project(K, poses.apply(R[0], T[0], [[0, 0, 0], [0, 0, 0.1]]))
    assert len(lines) == max(batch.size, 1)
    for line in lines:
        np.testing.assert_allclose(line.get_xydata(), ends, rtol=1e-12)


def test_boxes_lengths_and_labels():
    figure = figures.pose_picture(IMAGE, K, R, T, SIZE, labels=["mug", "can"])
    axes = figure.axes[0]
    assert sum("edge" in line.get_gid() for line in axes.lines) == 24
    assert [text.get_text() for text in axes.texts if len(text.get_text()) > 1] == ["mug", "can"]
    ends = cameras.project(K, poses.apply(R[0], T[0], [[0, 0, 0], [0.15, 0, 0]]))
    np.testing.assert_allclose(axes.lines[12].get_xydata(), ends)  # half the longest edge
    assert figure.alt == "Image with the projected axes and 3D box of mug, can"


def test_without_a_box_the_axes_are_a_tenth_of_the_distance():
    figure = figures.pose_picture(GREY, K, R[0], T[0], labels=["mug"], title="frame 3")
    length = 0.1 * np.linalg.norm(T[0])
    ends = cameras.project(K, poses.apply(R[0], T[0], [[0, 0, 0], [length, 0, 0]]))
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xydata(), ends)
    assert figure.alt == "frame 3 with the projected axes of mug"


def test_a_pose_behind_the_camera_leaves_the_picture_as_it_is():
    figure = figures.pose_picture(IMAGE, K, R[0], -T[0], SIZE, labels=["lost"])
    assert not figure.axes[0].lines
    assert not figure.axes[0].texts


POSE = (IMAGE, K, R, T)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: figures.picture(np.zeros((2, 2, 4))), "image"),
        (lambda: figures.picture(np.zeros(3)), "image"),
        (lambda: figures.picture(np.zeros((0, 3))), "image"),
        (lambda: figures.picture(np.full((2, 2, 3), 1.5)), "image"),
        (lambda: figures.picture(np.full((2, 2, 3), np.nan)), "image"),
        (lambda: figures.picture(np.full((2, 2), np.inf)), "image"),
        (lambda: figures.picture(np.full((2, 2), np.nan)), "image"),
        (lambda: figures.picture("image.png"), "image"),
        (lambda: figures.picture([[1, 2], [3]]), "image"),
        (lambda: figures.picture(IMAGE, colour_bar="m"), "colour_bar"),
        (lambda: figures.picture(GREY, limits=(1, 1)), "limits"),
        (lambda: figures.picture(GREY, limits=(1, 2, 3)), "limits"),
        (lambda: figures.picture(GREY, width=0), "width"),
        (lambda: figures.picture(GREY, alt=""), "alt"),
        (lambda: figures.picture_grid([]), "images"),
        (lambda: figures.picture_grid(3), "images"),
        (lambda: figures.picture_grid([np.zeros(3)]), "images"),
        (lambda: figures.picture_grid([GREY], ["a", "b"]), "titles"),
        (lambda: figures.picture_grid([GREY], "a"), "titles"),
        (lambda: figures.picture_grid([GREY], (title for title in "a")), "titles"),
        (lambda: figures.pose_picture(IMAGE, K, R, T, labels={"a", "b"}), "labels"),
        (lambda: figures.picture_grid([GREY], columns=0), "columns"),
        (lambda: figures.pose_picture(IMAGE, K * 0, R, T), "K"),
        (lambda: figures.pose_picture(IMAGE, K, R[..., :2], T), "R"),
        (lambda: figures.pose_picture(IMAGE, K, R, T[0]), "t"),
        (lambda: figures.pose_picture(*POSE, np.ones((3, 3))), "size"),
        (lambda: figures.pose_picture(*POSE, -SIZE), "size"),
        (lambda: figures.pose_picture(*POSE, SIZE, centre=[1, 2]), "centre"),
        (lambda: figures.pose_picture(*POSE, axis_length=-1), "axis_length"),
        (lambda: figures.pose_picture(*POSE, labels=["a"]), "labels"),
        (lambda: figures.pose_picture(*POSE, labels="ab"), "labels"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        call()
