import itertools
import json

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_tools.batches import Batches


def make(rows, *, generator, scale=1.0):
    return {"rows": rows, "noise": scale * torch.rand(3, generator=generator)}


def same(a, b):
    return all(torch.equal(x[name], y[name]) for x, y in zip(a, b, strict=True) for name in x)


@given(st.integers(1, 40), st.integers(1, 12), st.integers(0, 2**40))
def test_each_row_once_an_epoch(count, size, seed):
    size = min(size, count)
    rows = torch.arange(100, 100 + count)
    batches = Batches(make, rows, size, seed=seed)
    assert len(batches) == count // size
    for epoch in range(3):
        assert batches.step == epoch * len(batches)
        seen = torch.cat([batch["rows"] for batch in itertools.islice(batches, len(batches))])
        assert len(seen.unique()) == len(seen) == size * (count // size)
        assert torch.isin(seen, rows).all()


@given(st.integers(0, 30), st.integers(0, 2**40))
def test_a_run_goes_on_bit_for_bit(done, seed):
    rows = torch.arange(22).reshape(11, 2)
    batches = Batches(make, rows, 3, seed=seed, scale=2.0)
    list(itertools.islice(batches, done))
    state = json.loads(json.dumps(batches.state_dict()))
    rest = list(itertools.islice(batches, 7))
    other = Batches(make, rows, 3, seed=seed, scale=2.0)
    other.load_state_dict(state)
    assert other.state_dict() == state
    assert same(rest, itertools.islice(other, 7))
    assert rest[0]["rows"].shape == (3, 2)


def test_epochs_and_seeds_differ():
    def first(seed, skip):
        batches = Batches(make, torch.arange(50), 50, seed=seed)
        return list(itertools.islice(batches, skip + 1))[-1]

    a, b, c = first(0, 0), first(0, 1), first(1, 0)
    for x, y in ((a, b), (a, c), (b, c)):
        assert not torch.equal(x["rows"], y["rows"])
        assert not torch.equal(x["noise"], y["noise"])
    assert not torch.equal(a["rows"], torch.arange(50))


def test_a_failure_loses_no_batch():
    fails = [True]

    def moody(rows, *, generator):
        if fails.pop() if fails else False:
            raise RuntimeError
        return make(rows, generator=generator)

    batches = Batches(moody, torch.arange(9), 3, seed=0)
    with pytest.raises(RuntimeError):
        next(iter(batches))
    other = Batches(make, torch.arange(9), 3, seed=0)
    assert same([next(iter(batches))], [next(iter(other))])


def draw(count, *, generator):
    return {"x": torch.rand(count, generator=generator)}


@given(st.integers(0, 6), st.integers(0, 2**40))
def test_drawn_batches_end_and_say_how_far_they_are(done, seed):
    whole = list(Batches(draw, steps=6, seed=seed, batch_size=3))
    assert [float(batch["done"]) for batch in whole] == pytest.approx([i / 6 for i in range(6)])
    assert not torch.equal(whole[0]["x"], whole[1]["x"])
    first = Batches(draw, steps=6, seed=seed, batch_size=3)
    list(itertools.islice(first, done))
    second = Batches(draw, steps=6, seed=seed, batch_size=3)
    second.load_state_dict(json.loads(json.dumps(first.state_dict())))
    assert same(second, whole[done:])
    assert same(second, whole) and len(second) == 6  # and from the beginning


def test_without_an_end():
    batches = Batches(draw, seed=0, batch_size=1)
    assert [batch.keys() for batch in itertools.islice(batches, 9)] == [{"x"}] * 9
    with pytest.raises(TypeError, match="without end"):
        len(batches)
    last = Batches(lambda generator: 5, seed=0, steps=1)
    assert list(last) == [5]  # what is no dict stays as it is


ROWS = torch.arange(6)
STATE = Batches(make, ROWS, 2, seed=0).state_dict()


def load(state):
    Batches(make, ROWS, 2, seed=0).load_state_dict(state)


def load_drawn(other):
    Batches(draw, batch_size=2, seed=0).load_state_dict(other.state_dict())


BAD = [
    (lambda: Batches(None, ROWS, 2, seed=0), "make"),
    (lambda: Batches(make, [1, 2], 2, seed=0), "rows"),
    (lambda: Batches(make, torch.tensor(3), 1, seed=0), "rows"),
    (lambda: Batches(make, ROWS[:0], 1, seed=0), "rows"),
    (lambda: Batches(make, ROWS, 0, seed=0), "batch_size"),
    (lambda: Batches(make, ROWS, 7, seed=0), "batch_size"),
    (lambda: Batches(make, ROWS, 2, seed=-1), "seed"),
    (lambda: Batches(make, ROWS, 2, seed=0.5), "seed"),
    (lambda: Batches(draw, seed=0, steps=0), "steps"),
    (lambda: Batches(draw, seed=0, batch_size=0), "batch_size"),
    (lambda: Batches(draw, seed=0, batch_size=2.5), "batch_size"),
    (lambda: load({"step": 0}), "state"),
    (lambda: load(None), "state"),
    (lambda: load(STATE | {"seed": 1}), "state: expected seed 0"),
    (lambda: load(Batches(make, ROWS[:4], 2, seed=0).state_dict()), "state: expected rows 6"),
    (lambda: load(Batches(make, ROWS, 3, seed=0).state_dict()), "state: expected batch_size 2"),
    (lambda: load(STATE | {"step": -1}), "state"),
    (lambda: load(STATE | {"steps": 4}), "state: expected steps None"),
    (lambda: load(STATE | {"batch_size": 4}), "state: expected batch_size 2"),
    (lambda: load(STATE | {"count": None}), "state: expected what state_dict gave"),
    (lambda: load_drawn(Batches(draw, batch_size=3, seed=0)), "state: expected batch_size 2"),
]


@pytest.mark.parametrize("call, name", BAD)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
