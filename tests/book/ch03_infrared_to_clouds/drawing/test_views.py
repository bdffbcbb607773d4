"""Chapter 3's figures of images show what they are given, and say what they show."""

import numpy as np
import pytest

from book.ch03_infrared_to_clouds.drawing import views

IMAGE = np.random.default_rng(0).integers(0, 90, (24, 40), np.uint8)
MASK = np.zeros((24, 40), bool)
MASK[5:15, 10:30] = True


def test_bright_keeps_order_and_uses_all_of_the_range():
    bright = views.bright(IMAGE)
    order = np.argsort(IMAGE, axis=None, kind="stable")
    assert (np.diff(bright.ravel()[order].astype(int)) >= 0).all()
    assert bright.max() == 255 and not views.bright(np.zeros((3, 3))).any()


def test_outlines_and_masks():
    figure = views.outlines([IMAGE] * 3, {"true": [MASK] * 3, "cloud": [MASK, ~MASK, 0 * MASK]})
    assert len(figure.axes) == 3 and "true in orange" in figure.alt and figure.png()
    assert len(views.masks(IMAGE, {"mask": MASK, "cut": IMAGE}).axes) >= 3


def test_thresholds_are_drawn_where_they_are():
    figure = views.li_steps(np.array([0, 1, 1, 200, 255], np.uint8), [91.4, 60.0])
    (axes,) = figure.axes
    places = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1]
    assert places == pytest.approx([91.4, 60.0]) and "91.4, 60.0" in figure.alt


def test_silhouettes_and_gallery():
    rows = {"mask": [MASK] * 3, "cloud": np.full((3, 24, 40), 0.5)}
    assert len(views.silhouettes(rows, "six pictures").axes) == 6
    cloud = np.random.default_rng(1).normal(0, 0.1, (20, 3)) + [0, 0, 0.8]
    case = IMAGE, [IMAGE] * 3, [(MASK, MASK), (MASK, ~MASK), (MASK, 0 * MASK)], (cloud, cloud)
    figure = views.gallery({"best": case}, "one case")
    assert len(figure.axes) == 5 and figure.png()
    drawn = figure.axes[4].collections[1].get_offsets()
    assert np.allclose(drawn, 100 * cloud[:, [2, 1]])
