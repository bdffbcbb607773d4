"""Every form of batches is the batch of a step."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from data_tools.batches import Batches
from posecore.training.feed import Feed


class Counting:
    """Counts without end, and knows how far it is."""

    def __init__(self):
        self.at = 0

    def __iter__(self):
        return self

    def __next__(self):
        self.at += 1
        return self.at - 1

    def state_dict(self):
        return {"at": self.at}

    def load_state_dict(self, state):
        self.at = state["at"]


@given(st.integers(0, 2**40), st.integers(0, 10**6))
def test_a_function_gets_numbers_of_its_step(seed, step):
    feed = Feed(lambda generator: torch.rand(4, generator=generator), seed, True)
    assert torch.equal(feed(step), feed(step))
    assert not torch.equal(feed(step), feed(step + 1))
    assert not torch.equal(feed(step), Feed(feed.batches, seed + 1, True)(step))


@given(st.integers(1, 7), st.integers(0, 100))
def test_a_sequence_is_taken_in_turns(count, step):
    feed = Feed(list(range(count)), 0, True)
    assert feed(step) == step % count and feed.state_dict() == {}


@given(st.integers(0, 20), st.integers(0, 20))
def test_an_iterable_with_a_state_goes_on(before, after):
    first = Feed(Counting(), 0, True)
    for step in range(before):
        assert first(step) == step
    second = Feed(Counting(), 0, True)
    second(0)
    second.load_state_dict(first.state_dict())
    assert [second(before + i) for i in range(after)] == list(range(before, before + after))


def test_the_batches_of_worlds_go_on():
    def make(rows, generator):
        return {"rows": rows, "noise": torch.rand(len(rows), generator=generator)}

    whole, first, second = (
        Feed(Batches(make, torch.arange(10), 4, seed=1), 0, True) for _ in range(3)
    )
    expected = [whole(step) for step in range(7)]
    for step in range(3):
        first(step)
    second.load_state_dict(first.state_dict())
    for step in range(3, 7):
        batch = second(step)
        assert torch.equal(batch["rows"], expected[step]["rows"])
        assert torch.equal(batch["noise"], expected[step]["noise"])


def test_a_loader_is_begun_again():
    feed = Feed(DataLoader(list(range(6)), batch_size=4), 0, False)
    assert [feed(step).tolist() for step in range(4)] == [[0, 1, 2, 3], [4, 5]] * 2
    with pytest.raises(ValueError, match="^batches: .*to be resumed"):
        Feed(DataLoader(list(range(6))), 0, True)


@pytest.mark.parametrize("wrong", [None, 3, "text", b"bytes", [], (), {}, torch.ones(3)])
def test_bad_input_is_refused(wrong):
    with pytest.raises(ValueError, match="^batches: expected a function, a sequence or"):
        Feed(wrong, 0, False)
