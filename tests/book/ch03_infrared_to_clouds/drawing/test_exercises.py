"""The figures of chapter 3's exercises show the numbers that they are given, and say so."""

import numpy as np
import pytest

from book.ch03_infrared_to_clouds.drawing import exercises as draw


def test_brightness_marks_the_thresholds_and_both_means():
    values = np.array([[10, 20], [100, 140]], np.uint8)
    figure = draw.brightness(values, 60.5, 47.25)
    (axes,) = figure.axes
    assert [line.get_xdata()[0] for line in axes.lines] == [60.5, 15, 120, 47.25]
    assert sum(patch.get_height() for patch in axes.patches) == 4
    assert "means 15.0 and 120.0" in figure.alt and "next threshold is 47.2" in figure.alt


def test_outlines_are_those_of_the_masks():
    photos, mask = [np.zeros((4, 6), np.uint8)] * 2, np.zeros((4, 6), bool)
    mask[1:3, 2:5] = True
    figure = draw.outlines(photos, {"left": mask, "right": ~mask})
    assert [axes.get_title() for axes in figure.axes[:2]] == ["left", "right"]
    border = next(line for line in figure.axes[0].lines if line.get_gid() == "outline")
    assert np.nanmin(border.get_xydata(), 0).tolist() == [1.5, 0.5]
    assert np.nanmax(border.get_xydata(), 0).tolist() == [4.5, 2.5]
    assert "left, 25% of the picture; right, 75%" in figure.alt


def test_shares_are_written_into_their_voxels():
    volume = np.zeros((2, 3, 4))
    volume[0, 1, 2], volume[1, 1, 2] = 0.75, 0.2
    figure = draw.shares({"a point": volume, "nowhere": 0 * volume})
    texts = [[(t.get_text(), *t.get_position()) for t in axes.texts] for axes in figure.axes]
    assert texts == [[("0.75", 2, 1)], [("0.20", 2, 1)], [], []]
    assert figure.axes[0].get_title() == "a point\nz = 0"
    assert "0.95 a point, 0.00 nowhere" in figure.alt
    assert figure.axes[-1].get_xlabel() == "x, voxels"


def test_slices_stand_beside_what_is_seen_of_them():
    occupancy, intensity = np.full((2, 3, 4), 0.5), np.full((2, 3, 4), 0.25)
    figure = draw.slices(occupancy, intensity, np.full((3, 4), 0.75), np.full((3, 4), 0.1875))
    shown = [float(np.asarray(axes.images[0].get_array()).max()) for axes in figure.axes]
    assert shown == [0.5, 0.5, 0.75, 0.25, 0.25, 0.1875]
    assert figure.axes[2].get_title() == "seen: silhouette"
    assert "silhouette of up to 0.75, and a picture of up to 0.19" in figure.alt


def test_a_cloud_stands_beside_its_photograph():
    photo = np.full((8, 12), 51, np.uint8)
    figure = draw.clouds(photo, np.ones((4, 6)), np.full((4, 6), 0.5))
    shown = [float(np.asarray(axes.images[0].get_array()).max()) for axes in figure.axes]
    assert shown == pytest.approx([0.2, 1, 0.5])
    assert "silhouette of a cloud" in figure.alt


def test_sections_show_two_sides_and_the_cut():
    solid = np.zeros((2, 3, 4), bool)
    solid[0, 1, 2] = solid[1, 0, 3] = True
    figure = draw.sections({"solid": solid, "most": solid | True}, 1, 5.0)
    front, _, side, _, cut, _ = figure.axes
    assert np.array_equal(front.images[0].get_array(), solid.any(0))
    assert np.array_equal(side.images[0].get_array(), solid.any(2).T)
    assert np.array_equal(cut.images[0].get_array(), solid[:, 1])
    assert front.images[0].get_extent() == [0, 20, 15, 0]
    assert side.images[0].get_extent() == [0, 10, 15, 0]
    assert front.lines[0].get_ydata()[0] == 7.5
    assert front.get_title().startswith("solid\n2 voxels")
    assert "2 in solid, 24 in most" in figure.alt and "1 in solid, 8 in most" in figure.alt
    assert all(axes.get_xlabel().endswith(", mm") for axes in figure.axes)
