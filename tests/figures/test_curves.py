"""What figures show is what the metrics say."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posecore import figures, metrics

A_FEW = settings(max_examples=15)  # each draws a figure

ERRORS = arrays(np.float64, st.integers(1, 20), elements=st.floats(0, 0.2))


@given(ERRORS)
@A_FEW
def test_the_curve_is_the_accuracy(errors):
    axes = figures.accuracy_curves({"ours": errors}).axes[0]
    x, y = axes.lines[0].get_data()
    assert axes.lines[0].get_drawstyle() == "steps-post"
    assert (x[0], x[-1]) == (0, 100)
    assert (np.diff(x) >= 0).all()
    thresholds = np.linspace(1e-4, 0.0999, 97)
    shown = y[np.searchsorted(x, thresholds * 1000, side="left") - 1]
    np.testing.assert_allclose(shown, 100 * metrics.accuracy_curve(errors, thresholds))


def test_curves_are_told_apart_and_named():
    figure = figures.accuracy_curves({"a": [0.01], "b": [0.02, np.inf]}, name="ADD-S")
    axes = figure.axes[0]
    assert axes.get_xlabel() == "threshold on ADD-S, mm"
    first, second = axes.lines
    assert first.get_color() != second.get_color()
    assert first.get_linestyle() != second.get_linestyle()
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["a (area 90.0 %)", "b (area 40.0 %)"]


@pytest.mark.parametrize("count", [2, 6, 21])
def test_one_curve_stands_out(count):
    errors = {f"object {i}": [0.01 * i] for i in range(count)}
    figure = figures.accuracy_curves(errors | {"all": [0.0, 0.05]}, highlight="all")
    *others, last = figure.axes[0].lines
    assert len(others) == count
    assert last.get_label().startswith("all ")
    assert last.get_color() == "black"
    assert last.get_linewidth() > max(line.get_linewidth() for line in others)
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    if count > 8:
        assert labels == ["each of 21 others", "all (area 75.0 %)"]
        assert {line.get_color() for line in others} == {"0.65"}
    else:
        assert len(labels) == count + 1
    figure.draw_without_rendering()  # lays it out
    inside = figure.axes[0].get_window_extent()
    legend = figure.axes[0].get_legend().get_window_extent()
    assert figure.bbox.y0 <= legend.y0 and legend.y1 <= figure.bbox.y1
    assert legend.x1 <= figure.bbox.x1
    assert inside.width > 0.5 * figure.bbox.width
    assert legend.x0 >= inside.x1 or count != 6  # a long legend stands beside the curves


def test_a_curve_says_what_it_shows():
    errors = {"a": [0.01], "b": [0.02, np.inf]}
    alt = figures.accuracy_curves(errors, name="ADD-S").alt
    assert alt == (
        "Accuracy over the threshold on ADD-S, 0 to 100 mm. a: area 90.0 %; b: area 40.0 %."
    )
    assert figures.accuracy_curves(errors, alt="mine").alt == "mine"


def _outlines(axes):
    """Counts and edges of the outlines, without the pale areas under them."""
    return [patch.get_data()[:2] for patch in axes.patches if not patch.get_fill()]


@given(ERRORS, ERRORS, st.integers(1, 12), st.booleans())
@A_FEW
def test_every_finite_error_is_counted_once(one, two, bins, log):
    if log and not max(one.max(), two.max()) > 1e-300:
        return
    missing = np.append(two, np.inf)
    figure = figures.error_histogram({"one": one, "two": missing}, bins=bins, log=log)
    axes = figure.axes[0]
    (counts_one, edges), (counts_two, same) = _outlines(axes)
    assert (counts_one.sum(), counts_two.sum()) == (len(one), len(two))
    assert len(edges) == bins + 1
    np.testing.assert_array_equal(edges, same)
    assert (np.diff(edges) > 0).all()
    everything = 1000 * np.concatenate([one, two])
    assert edges[0] <= everything[everything > 0].min(initial=np.inf)
    assert edges[-1] >= everything.max()
    assert axes.get_xscale() == ("log" if log else "linear")
    assert "1 missing" in figure.alt


@pytest.mark.parametrize("log", [False, True])
def test_a_histogram_puts_errors_into_their_bins(log):
    errors = [0.001, 0.002, 0.002, 0.1]
    figure = figures.error_histogram({"a": errors}, bins=2, log=log)
    ((counts, edges),) = _outlines(figure.axes[0])
    np.testing.assert_allclose(edges, [1, 10 if log else 50.5, 100])
    np.testing.assert_array_equal(counts, [3, 1])
    assert figure.axes[0].get_xlabel() == "ADD, mm"


def test_medians_are_marked():
    errors = {"a": [0.01, 0.02, 0.03], "b": [0.05, np.inf, 0.06], "c": [0.01, np.inf, np.inf]}
    figure = figures.error_histogram(errors, name="translation error", unit="cm", factor=100)
    axes = figure.axes[0]
    marks = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "v"]
    assert marks == pytest.approx([2, 6])
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == [
        "a (median 2 cm)",
        "b (median 6 cm, 1 missing)",
        "c (median infinite, 2 missing)",
    ]
    assert figure.alt == "Histogram of translation error in cm. " + "; ".join(labels) + "."


@pytest.mark.parametrize("value", [0.0, 0.01])
def test_equal_errors_have_a_bin(value):
    ((counts, edges),) = _outlines(figures.error_histogram({"a": [value] * 3}, bins=5).axes[0])
    assert counts.sum() == counts[2] == 3 or (value == 0 and counts.sum() == counts[0] == 3)
    assert edges[-1] > edges[0]


def test_zeros_are_in_the_first_bin_of_a_logarithmic_axis():
    errors = {"a": [0.0, 0.001, 1.0]}
    ((counts, _),) = _outlines(figures.error_histogram(errors, bins=3, log=True).axes[0])
    np.testing.assert_array_equal(counts, [2, 0, 1])


@pytest.mark.parametrize("count", [2, 7])
@pytest.mark.parametrize("draw", [figures.accuracy_curves, figures.error_histogram])
def test_long_labels_leave_room_for_the_curves(draw, count):
    errors = {
        f"a method with quite a long name and then some more of it {i}": [0.01, 0.02 + i]
        for i in range(count)
    }
    figure = draw(errors)
    figure.png()  # a warning that there is no room would be an error here
    axes = figure.axes[0]
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert [" ".join(text.split("\n")).split(" (")[0] for text in texts] == list(errors)
    assert max(len(line) for text in texts for line in text.split("\n")) <= 32
    assert axes.get_window_extent().width > 0.4 * figure.bbox.width


def test_the_line_at_the_top_is_not_cut_in_half():
    figure = figures.accuracy_curves({"a": [0.0]})
    assert not figure.axes[0].lines[0].get_clip_on()


def test_tensors_are_errors_too():
    errors = torch.tensor([0.01, 0.02], requires_grad=True)
    figure = figures.error_histogram({"a": errors}, bins=4)
    assert _outlines(figure.axes[0])[0][0].sum() == 2
    assert "area 85.0 %" in figures.accuracy_curves({"a": errors}).alt


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: figures.accuracy_curves({}), "errors"),
        (lambda: figures.accuracy_curves([0.1]), "errors"),
        (lambda: figures.accuracy_curves({"a": []}), "errors"),
        (lambda: figures.accuracy_curves({"a": [np.nan]}), "errors"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, 0), "max_threshold"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, factor=0), "factor"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, factor=np.nan), "factor"),
        (lambda: figures.accuracy_curves({"_a": [1.0]}), "errors"),
        (lambda: figures.error_histogram({"_a": [1.0]}), "errors"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, highlight="b"), "highlight"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, alt=""), "alt"),
        (lambda: figures.error_histogram({}), "errors"),
        (lambda: figures.error_histogram({"a": []}), "errors"),
        (lambda: figures.error_histogram({"a": [-1.0]}), "errors"),
        (lambda: figures.error_histogram({"a": [np.nan]}), "errors"),
        (lambda: figures.error_histogram({"a": [np.inf]}), "errors"),
        (lambda: figures.error_histogram({"a": [0.0]}, log=True), "errors"),
        (lambda: figures.error_histogram({"a": [1.0]}, bins=0), "bins"),
        (lambda: figures.error_histogram({"a": [1.0]}, factor=0), "factor"),
        (lambda: figures.error_histogram({"a": [1.0]}, alt=" "), "alt"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()
