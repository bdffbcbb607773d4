"""What figures show is what the metrics say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posecore import figures, metrics


@given(arrays(np.float64, st.integers(1, 20), elements=st.floats(0, 0.2)))
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


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: figures.accuracy_curves({}), "errors"),
        (lambda: figures.accuracy_curves({"a": []}), "errors"),
        (lambda: figures.accuracy_curves({"a": [np.nan]}), "errors"),
        (lambda: figures.accuracy_curves({"a": [1.0]}, 0), "max_threshold"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()
