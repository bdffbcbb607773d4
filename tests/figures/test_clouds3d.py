"""Stills show the points from the sides they name, to one scale, the nearest in front."""

import matplotlib
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posecore import figures
from posecore.figures.clouds3d import AZIMUTH, ELEVATION
from posecore.figures.scene import directions

A_FEW = settings(max_examples=15)  # each draws a figure

CLOUD = arrays(
    np.float64, st.tuples(st.integers(1, 6), st.just(3)), elements=st.integers(-9, 9).map(float)
)
# view -> the coordinates drawn across and upwards
PANELS = {
    "z": {"front": "xz", "side": "yz", "top": "xy"},
    "-y": {"front": "xy", "side": "zy", "top": "xz"},
}


def _shown(panel):
    return np.asarray(panel.collections[0].get_offsets())


@given(CLOUD, st.sampled_from(["z", "-y"]), st.sampled_from([("m", 1), ("cm", 100), ("mm", 1000)]))
@A_FEW
def test_panels_show_the_coordinates_they_name(points, up, unit):
    figure = figures.point_clouds(
        {"a": torch.from_numpy(points)}, up=up, unit=unit[0], views=("front", "side", "top")
    )
    for panel, (view, letters) in zip(figure.axes, PANELS[up].items(), strict=True):
        assert panel.get_title() == view
        assert panel.get_xlabel() == f"{letters[0]}, {unit[0]}"
        assert panel.get_ylabel() == f"{letters[1]}, {unit[0]}"
        wanted = points[:, ["xyz".index(letter) for letter in letters]] * unit[1]
        np.testing.assert_allclose(_shown(panel), np.rint(_shown(panel)), atol=1e-9)
        np.testing.assert_array_equal(_sorted(np.rint(_shown(panel))), _sorted(wanted))


def _sorted(rows):
    return rows[np.lexsort(rows.T)]


def test_y_runs_down_in_the_view_of_a_camera():
    figure = figures.point_clouds({"a": [[0, -1, 2], [1, 1, 3]]}, up="-y", views=("front", "top"))
    front, top = figure.axes
    assert front.yaxis_inverted()
    assert not front.xaxis_inverted()
    assert not top.yaxis_inverted()


@pytest.mark.slow
@given(CLOUD)
@A_FEW
def test_all_panels_have_one_scale_and_hold_all_points(points):
    figure = figures.point_clouds({"a": points})
    widths = [np.ptp(panel.get_xlim()) for panel in figure.axes]
    heights = [np.ptp(panel.get_ylim()) for panel in figure.axes]
    np.testing.assert_allclose(widths + heights, widths[0])
    for panel in figure.axes:
        assert panel.get_aspect() == 1
        low, high = np.sort([panel.get_xlim(), panel.get_ylim()], axis=1).T
        assert ((_shown(panel) >= low) & (_shown(panel) <= high)).all()


def test_near_points_hide_far_ones_whatever_set_they_are_of():
    near_and_far = {"a": [[0, -1, 0], [0, 1, 0]], "b": [[0, 0, 0], [0.1, 2, 0.1]]}
    colours = {"a": "red", "b": "blue"}
    panel = figures.point_clouds(near_and_far, colours=colours, views=("front",)).axes[0]
    drawn = panel.collections[0]
    letters = ["r" if colour[0] == 1 else "b" for colour in drawn.get_facecolors()]
    assert letters == ["b", "r", "b", "r"]  # y = 2, 1, 0, -1: the nearest is drawn last
    paths = [len(path.vertices) for path in drawn.get_paths()]
    assert paths[0] == paths[2] != paths[1] == paths[3]  # each set keeps its marker


def test_the_oblique_view_is_seen_from_before_and_above():
    figure = figures.point_clouds({"a": [[0.1, 0.2, 0.3]]}, views=("oblique",), unit="m")
    right, up, _ = directions(AZIMUTH, ELEVATION, "z")
    point = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(_shown(figure.axes[0]), [[right @ point, up @ point]])
    # x to the right, y away and z upwards; the length of the bar is named.
    assert right[0] > 0
    assert up[1] > 0
    assert up[2] > 0
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts[:3] == ["x", "y", "z"]
    assert texts[3].endswith(" m")


@given(st.floats(1e-3, 1e3))
@A_FEW
def test_the_bar_is_as_long_as_it_says(scale):
    cloud = {"a": [[0, 0, 0], [scale, scale / 3, 0]]}
    panel = figures.point_clouds(cloud, views=("oblique",), unit="cm").axes[0]
    bar = panel.lines[-1].get_xdata()
    said = float(panel.texts[-1].get_text().removesuffix(" cm"))
    assert (bar[1] - bar[0]) * np.ptp(panel.get_xlim()) == pytest.approx(said)


def test_lines_axes_and_boxes_are_drawn_and_named():
    figure = figures.point_clouds(
        {"a": [[0, 0, 0]]},
        axes=(np.eye(3), np.zeros(3)),
        axis_length=0.5,
        boxes=(np.eye(3), np.zeros(3), [0.2, 0.4, 0.6]),
        lines={"ray": [[[0, 0, 0], [1, 0, 1]]]},
        views=("front",),
        unit="m",
    )
    _, ray, boxes, x, _, z = figure.axes[0].collections
    np.testing.assert_allclose(ray.get_segments(), [[[0, 0], [1, 1]]])
    assert len(boxes.get_segments()) == 12
    np.testing.assert_allclose(np.abs(np.concatenate(boxes.get_segments())).max(0), [0.1, 0.3])
    np.testing.assert_allclose(x.get_segments(), [[[0, 0], [0.5, 0]]], atol=1e-12)
    np.testing.assert_allclose(z.get_segments(), [[[0, 0], [0, 0.5]]], atol=1e-12)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["a", "ray", "boxes"]  # axes carry their letters
    assert figure.alt == "a (1 points), ray, boxes, axes; seen from: front; in m"


def test_lines_need_no_points():
    figure = figures.point_clouds({}, lines={"ray": [[[0, 0, 0], [1, 0, 1]]]}, alt="a ray")
    assert figure.alt == "a ray"
    assert figure.png().startswith(b"\x89PNG")


def test_no_window_is_opened():
    figures.point_clouds({"a": [[0, 0, 0]]})
    pyplot = matplotlib.pyplot if hasattr(matplotlib, "pyplot") else None
    assert pyplot is None or not pyplot.get_fignums()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"clouds": {}}, "clouds"),
        ({"views": ()}, "views"),
        ({"views": "front"}, "views"),
        ({"views": ("back",)}, "views"),
        ({"unit": "inch"}, "unit"),
        ({"up": "x"}, "up"),
        ({"alt": ""}, "alt"),
        ({"axes": (np.eye(3),)}, "axes"),
    ],
)
def test_bad_input_is_named(arguments, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        figures.point_clouds(**{"clouds": {"a": [[0, 0, 0]]}, **arguments})


@pytest.mark.parametrize("views", [("oblique",), ("front", "top")])
def test_long_names_stay_inside_the_figure(views):
    clouds = {f"a rather long name, number {n}": [[n, 0, 0]] for n in range(6)}
    figure = figures.point_clouds(clouds, views=views)
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert legend.x0 >= 0
    assert legend.x1 <= figure.bbox.x1
    assert legend.y0 >= 0


def test_axes_take_the_place_of_the_compass():
    """Two sets of x, y and z in one corner cannot be told apart."""
    cloud = {"a": np.random.default_rng(0).normal(size=(20, 3))}
    letters = {}
    for axes in (None, (np.eye(3), np.zeros(3))):
        figure = figures.point_clouds(cloud, axes=axes, views=("oblique",))
        letters[axes is None] = [text.get_text() for text in figure.axes[0].texts]
    for drawn in letters.values():
        assert sorted(drawn)[-3:] == ["x", "y", "z"]
        assert len(drawn) == 4  # and the length of the scale
