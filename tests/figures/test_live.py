"""Curves of a training show what was recorded, and in a notebook one picture is left."""

import nbformat
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nbclient import NotebookClient

from posecore.figures import live
from posecore.figures.live import Display, training_curves
from posecore.training import History

A_FEW = settings(max_examples=15)  # each draws a figure

VALUES = st.lists(st.floats(0.125, 8, width=32), min_size=1, max_size=200)


@given(VALUES)
@A_FEW
def test_short_curves_show_every_step(values):
    axes = training_curves({"loss": values}).axes[0]
    x, y = axes.lines[0].get_data()
    np.testing.assert_array_equal(x, np.arange(1, len(values) + 1))
    np.testing.assert_allclose(y, values)
    assert not axes.collections and axes.get_yscale() == "log"
    assert axes.get_xlim() == (0, len(values))


@given(st.integers(201, 5000))
@A_FEW
def test_long_curves_show_means_within_a_band(count):
    values = np.random.default_rng(count).normal(size=count)
    axes = training_curves({"loss": values}).axes[0]
    x, y = axes.lines[0].get_data()
    assert len(x) == 200 and (np.diff(x) > 0).all()
    counts = np.diff([*(x[:-1] + x[1:]) / 2, 0])[:-1]  # between pieces, at least
    assert (counts > 0).all()
    # Pieces differ by one step in length: the mean of means is nearly the mean.
    np.testing.assert_allclose(y.mean(), values.mean(), atol=2 / np.sqrt(count))
    band = axes.collections[0].get_datalim(axes.transData)
    np.testing.assert_allclose([band.y0, band.y1], [values.min(), values.max()])
    assert axes.get_yscale() == "linear"  # some are negative


def test_what_was_measured_stands_beside_it():
    losses = {"loss": [3.0, 2.0, 1.0], "error": [1.0, 1.0, 1.0]}
    figure = training_curves(losses, {"degrees": [9.0, 5.0]}, [1, 3], steps=10)
    left, right = figure.axes
    assert left.get_xlim() == right.get_xlim() == (0, 10)
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["loss", "error"]
    assert right.get_ylabel() == "degrees" and right.get_legend() is None
    np.testing.assert_array_equal(right.lines[0].get_data(), [[1, 3], [9, 5]])
    first, second = left.lines
    assert first.get_linestyle() != second.get_linestyle()
    assert "3 steps: loss from 3 to 1; error from 1 to 1; degrees from 9 to 5." in figure.alt
    assert training_curves(losses, alt="Two falling curves.").alt == "Two falling curves."
    assert len(training_curves(losses, {"degrees": []}, []).axes) == 1


@pytest.mark.slow
@pytest.mark.parametrize("values", [[np.inf, np.inf], [1.0, np.inf], [np.nan, -1.0], [0.0, 0.0]])
def test_what_is_no_number_is_left_out(values):
    figure = training_curves({"loss": [2.0, 1.0]}, {"degrees": values}, [1, 2])
    assert len(figure.png()) > 1000
    finite = [value > 0 for value in values if np.isfinite(value)]
    assert figure.axes[1].get_yscale() == ("log" if finite and all(finite) else "linear")


@pytest.mark.parametrize("low, high, labels", [(2, 80, {"10"}), (0.02, 300, {"0.1", "100"})])
def test_a_logarithmic_axis_says_plain_numbers(low, high, labels):
    figure = training_curves({"loss": [high, low]})
    figure.draw_without_rendering()
    axis = figure.axes[0].yaxis
    shown = {tick.label1.get_text() for tick in axis.get_major_ticks() + axis.get_minor_ticks()}
    assert labels <= shown and not any("$" in text for text in shown)


@pytest.mark.parametrize(
    "arguments, name",
    [
        (({},), "losses"),
        (({"loss": []},), "losses"),
        (({"loss": [[1.0]]},), "losses"),
        (({"loss": [1.0], "error": [1.0, 2.0]},), "losses"),
        (({"loss": ["a"]},), "losses"),
        (({"loss": 3.0},), "losses"),
        (({"loss": [1.0]}, {"degrees": [1.0]}, [1, 2]), r"measured\['degrees'\]"),
        (({"loss": [1.0]}, {"degrees": ["a"]}, [1]), "measured"),
    ],
)
def test_bad_input_is_refused(arguments, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        training_curves(*arguments)
    with pytest.raises(ValueError, match="^alt: "):
        training_curves({"loss": [1.0]}, alt=" ")
    with pytest.raises(ValueError, match="^steps: "):
        training_curves({"loss": [1.0]}, steps=0)


class Clock:
    """Drawing takes half a second, a step a tenth."""

    now = 0.0

    def __call__(self):
        return self.now


def test_drawing_takes_a_small_part_of_the_time(monkeypatch):
    clock, drawn = Clock(), []

    def draw(display):
        drawn.append((clock.now, display.history.steps))
        clock.now += 0.5

    monkeypatch.setattr(live.time, "perf_counter", clock)
    monkeypatch.setattr(Display, "_draw", draw)
    history = History()
    with Display(1000, history, show=True) as display:
        for _ in range(1000):
            history.record({"loss": 1.0})
            clock.now += 0.1
            display.update()
    assert 8 <= len(drawn) <= 13  # 100 s and a twentieth of it, and the last
    assert drawn[-1][1] == 1000


def test_where_nobody_looks_nothing_is_drawn(capfd, monkeypatch):
    monkeypatch.setattr(live, "training_curves", lambda *given, **named: 1 / 0)
    history = History()
    with Display(2, history) as display:
        history.record({"loss": 1.0})
        display.update()
    assert capfd.readouterr() == ("", "")


def test_a_run_without_a_step_ends_quietly(capfd):
    with pytest.raises(KeyError), Display(2, History(), show=True):
        raise KeyError
    assert "0/2" in capfd.readouterr().err


CELL = """
import torch
from posecore.figures import live
from posecore.training import fit
live.SECONDS, live.SHARE = 0.0, 1.0  # draw at every step
history = fit(torch.nn.Linear(1, 1), [torch.ones(2, 1)], lambda net, x: net(x).square().mean(),
              steps=4)
history
"""


@pytest.mark.slow
def test_one_still_picture_is_left_in_a_notebook():
    from book.tools.execution import clean_outputs

    nb = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    shown = []
    client = NotebookClient(nb, timeout=120)
    client.on_cell_executed = lambda cell, cell_index, execute_reply: shown.append(cell)
    client.execute()
    clean_outputs(nb)
    picture, text = nb.cells[0].outputs
    assert picture.output_type == "display_data"
    words = picture.data["text/plain"]
    assert words.startswith("Training curves over 4 steps: loss")
    assert picture.data["text/html"].startswith(f'<img alt="{words}" src="data:image/png;base64,')
    assert text.data["text/plain"].startswith("4 steps in ")
