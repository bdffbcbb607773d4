"""A history keeps every value, and its state is all of it."""

import io

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.training import History

VALUES = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(VALUES, VALUES), max_size=30), st.lists(VALUES, max_size=5))
def test_it_comes_back_from_a_file_to_the_bit(losses, measured):
    history = History(seconds=1.5)
    for one, two in losses:
        history.record({"loss": one, "other": two})
    for number, value in enumerate(measured):
        history.measure(number + 1, {"error": value})
    file = io.BytesIO()
    torch.save(history.state_dict(), file)
    file.seek(0)
    again = History()
    again.load_state_dict(torch.load(file, weights_only=True))
    assert again == history
    assert again.steps == len(losses)
    again.record({"loss": 1.0, "other": 2.0})
    assert again.steps == history.steps + 1  # no list is shared


def test_it_says_where_it_ended():
    history = History(seconds=61.2)
    assert repr(history) == "0 steps in 61 s: nothing yet"
    for step in range(20):
        history.record({"loss": 20.0 - step})
    history.measure(20, {"degrees": 2.5})
    assert repr(history) == "20 steps in 61 s: loss 1.5, degrees 2.5"


def test_its_picture_shows_both():
    history = History()
    with pytest.raises(ValueError, match="^losses: "):
        history.plot()
    for step in range(5):
        history.record({"loss": 1 / (1 + step)})
    assert len(history.plot().axes) == 1
    history.measure(5, {"degrees": 2.5})
    figure = history.plot()
    assert len(figure.axes) == 2
    assert figure.alt == (
        "Training curves over 5 steps: loss from 1 to 0.2; degrees from 2.5 to 2.5."
    )
    assert history.plot(alt="A falling curve.").alt == "A falling curve."


def test_names_stay():
    history = History()
    history.record({"loss": 1.0})
    history.measure(1, {"degrees": 1.0})
    with pytest.raises(ValueError, match="^loss: "):
        history.record({"los": 1.0})
    with pytest.raises(ValueError, match="^evaluate: "):
        history.measure(2, {})
    assert history.steps == 1 and history.measured_at == [1]
