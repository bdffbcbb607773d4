"""The first and last figures of chapter 2 show what the records say, in pictures and in words."""

import numpy as np
import pytest

import data_tools
from book.ch02_small_worlds.drawing import page
from posecore import cameras

pytestmark = pytest.mark.slow


def test_the_question_shows_each_world_twice():
    figure = page.question()
    assert len(figure.axes) == 6
    titles = [axes.get_title() for axes in figure.axes]
    assert [title.split(":")[0] for title in titles[:3]] == ["headset", "tabletop", "categories"]
    shown = [np.asarray(axes.images[0].get_array()) for axes in figure.axes]
    assert all(image.shape == shown[0].shape for image in shown)
    assert shown[1].std() > 10 and not np.array_equal(shown[1], shown[4])
    assert "axes" in figure.alt and figure.png() == page.question().png()


def test_the_axes_on_the_glasses_start_at_the_glasses():
    view = data_tools.open("headset", split="test", whole=False)[13]
    glasses = view.objects[0]
    place = cameras.project(view.K, glasses.t[None])[0]
    axes = page.question().axes[3]
    height = axes.images[0].get_array().shape[0]
    starts = np.array([line.get_xydata()[0] for line in axes.lines])
    # The picture was cut at both sides and enlarged, all about the middle of a row.
    zoom = height / view.shape[0]
    expected = (place[1] + 0.5) * zoom - 0.5
    assert np.abs(starts[:, 1] - expected).min() < 1e-6


def test_boxes_of_a_view_are_drawn_for_what_is_seen():
    view = data_tools.open("tabletop", split="occluded")[0]
    figure = page.bop_picture(view)
    seen = sum(item.visible_fraction > 0.3 for item in view.objects)
    edges = [line for line in figure.axes[0].lines if "edge" in (line.get_gid() or "")]
    assert seen >= 1 and len(edges) == 12 * seen
    assert "box" in figure.alt and len(figure.png()) < 120_000


def test_the_films_figure_has_a_row_for_each_driver_and_sorted_errors():
    pictures = np.arange(4 * 20, dtype=np.uint8)[:, None, None] * np.ones((47, 80), np.uint8)
    who = np.repeat(np.arange(4), 20)
    errors = {"shuffled": np.array([3.0, 1.0, 2.0]), "drivers": np.array([20.0, 10.0])}
    strips, curves = page.films(pictures, who, errors, every=4).axes
    shown = np.asarray(strips.images[0].get_array())
    assert shown.shape == (4 * 47, 5 * 60)  # 150 and above are white
    greys = [[20 * d + 4 * k for k in range(5)] for d in range(4)]
    np.testing.assert_allclose(150 * shown[::47, ::60], greys, rtol=1e-6)
    for line, (name, values) in zip(curves.lines, errors.items(), strict=True):
        assert line.get_label() == name
        assert line.get_xdata().tolist() == sorted(values.tolist())
        assert line.get_ydata()[-1] == 100
