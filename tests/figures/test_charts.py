"""One chart: what is drawn where, how it looks, and what it says."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from posecore import figures
from posecore.figures.style import COLOURS, STYLES, new_picture

X = np.arange(1.0, 6)
WORDS = {"xlabel": "time, s", "ylabel": "height, m"}


def drawn(lines, **words):
    figure = figures.chart(lines, **WORDS | words)
    return figure, figure.axes[0]


def test_curves_lie_where_they_are_given():
    figure, axes = drawn({"a": X**2, "b": ([0, 9], [1, 2])}, x=X)
    (a, b) = axes.lines
    np.testing.assert_array_equal(a.get_xydata(), np.stack([X, X**2], 1))
    np.testing.assert_array_equal(b.get_xydata(), [[0, 1], [9, 2]])
    assert (a.get_color(), a.get_linestyle()) == (COLOURS[0], STYLES[0])
    assert (b.get_color(), b.get_linestyle()) == (COLOURS[1], STYLES[1])
    assert axes.get_xlabel() == "time, s" and axes.get_ylabel() == "height, m"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b"]
    assert figure.alt == "height, m over time, s: a from 1 to 25; b from 1 to 2."


def test_one_curve_has_no_legend_and_underscored_ones_are_in_none():
    assert drawn({"a": X}, x=X)[1].get_legend() is None
    assert drawn({"_a": X, "_b": X}, x=X)[1].get_legend() is None
    assert drawn({"a": X, "b": X}, x=X, legend=None)[1].get_legend() is None
    assert "_" not in drawn({"_a": X}, x=X)[0].alt


def test_marks_bands_and_limits():
    _, axes = drawn(
        {"a": X},
        x=X,
        marks={"m": ([2, 3], [4, 5])},
        bands={"a": (X - 1, X + 1), "free": (0 * X, 0 * X + 1)},
        upright={"u": 2.5},
        level={"_l": 3.5},
        looks={"m": {"ms": 9}, "u": {"color": "red"}},
    )
    line, marks, upright, level = axes.lines
    assert marks.get_linestyle() == "None" and marks.get_marker() == "o"
    assert marks.get_markersize() == 9 and marks.get_color() == COLOURS[1]
    assert set(upright.get_xdata()) == {2.5} and upright.get_color() == "red"
    assert set(level.get_ydata()) == {3.5}
    own, free = axes.collections
    assert to_hex(own.get_facecolor()[0]) == line.get_color().lower()
    assert to_hex(free.get_facecolor()[0]) != line.get_color().lower()
    box = own.get_paths()[0].get_extents()
    assert (box.y0, box.y1) == (0, 6)
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["a", "m", "free", "u"]


@pytest.mark.parametrize("log, scales", [("", "linear linear"), ("x", "log linear"),
                                         ("y", "linear log"), ("xy", "log log")])  # fmt: skip
def test_scales_ends_and_ticks(log, scales):
    figure, axes = drawn(
        {"a": X}, x=X, log=log, xlim=(1, 5), ylim=(0.5, None), xticks=[1, 2, 5],
        yticks={1: "one", 4: "four"}, title="t",
    )  # fmt: skip
    assert f"{axes.get_xscale()} {axes.get_yscale()}" == scales
    assert axes.get_xlim() == (1, 5) and axes.get_ylim()[0] == 0.5
    figure.png()
    assert [t.get_text() for t in axes.get_xticklabels()] == ["1", "2", "5"]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["one", "four"]
    assert not len(axes.get_xticks(minor=True)) and axes.get_title() == "t"


def test_gaps_markers_size_and_words():
    figure, axes = drawn({"a": [1, np.nan, 3]}, x=[1, 2, 3], markers=True, size=(3, 2), alt="mine")
    assert axes.lines[0].get_marker() == "o" and np.isnan(axes.lines[0].get_ydata()[1])
    assert tuple(figure.get_size_inches()) == (3, 2) and figure.alt == "mine"


@pytest.mark.parametrize("grid, expected", [("both", [1, 1]), ("x", [1, 0]), ("y", [0, 1])])
def test_lines_across_the_chart(grid, expected):
    _, axes = drawn({"a": X}, x=X, grid=grid)
    lines = (axes.get_xgridlines()[0], axes.get_ygridlines()[0])
    assert [line.get_visible() for line in lines] == expected


def test_several_axes_of_one_figure():
    figure = new_picture(6, 3, "words")
    for axes in figure.subplots(1, 2):
        curves = figures.draw_chart(axes, {"a": [1, 2]}, x=[0, 1], **WORDS)
    assert [one.dtype for one in curves["a"]] == [np.float64] * 2 and len(figure.axes) == 2


@pytest.mark.parametrize(
    "lines, words, name",
    [
        ({}, {}, "lines"),
        ({"a": X}, {}, "'a'"),
        ({"a": X[:3]}, {"x": X}, "'a'"),
        ({"a": np.eye(3)}, {"x": X}, "'a'"),
        ({"a": X}, {"x": X, "log": "z"}, "log"),
        ({"a": X}, {"x": X, "grid": "z"}, "grid"),
        ({"a": X}, {"x": X, "marks": {"m": (X, X[:2])}}, "'m'"),
        ({"a": X}, {"x": X, "bands": {"b": (X, X[:2])}}, "'b'"),
        ({"a": X}, {"x": X, "alt": " "}, "alt"),
    ],
)
def test_bad_arguments_are_named(lines, words, name):
    with pytest.raises(ValueError, match=name):
        drawn(lines, **words)


def test_the_same_chart_is_the_same_file():
    assert drawn({"a": X}, x=X)[0].png() == drawn({"a": X}, x=X)[0].png()
