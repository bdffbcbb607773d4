"""What a training is made from: the same in another process, another where loss or data are."""

import functools
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from posecore.training.origins import origin

WEIGHT = 2.0
TABLE = torch.arange(6.0)


def scaled(net, batch):
    """Twice."""
    return helper(batch) * WEIGHT


def helper(batch):
    return batch + TABLE


def edited(function, old, new):
    """The function as another edition of its source would make it."""
    import inspect

    space = dict(function.__globals__)
    exec(inspect.getsource(function).replace(old, new), space)
    space[function.__name__].__module__ = function.__module__
    return space[function.__name__]


def test_an_edit_counts_and_a_comment_does_not():
    assert origin(edited(scaled, "", "")) == origin(scaled)
    assert origin(edited(scaled, "Twice", "Two times")) == origin(scaled)
    assert origin(edited(scaled, "    return", "    # so\n    return")) == origin(scaled)
    for old, new in [("* WEIGHT", "+ WEIGHT"), ("WEIGHT", "3"), ("helper(batch)", "batch")]:
        assert origin(edited(scaled, old, new)) != origin(scaled)


def test_what_a_function_uses_counts(monkeypatch):
    before = origin(scaled)
    monkeypatch.setitem(globals(), "WEIGHT", 3.0)
    assert origin(scaled) != before
    monkeypatch.undo()
    monkeypatch.setitem(globals(), "TABLE", TABLE + 1)
    assert origin(scaled) != before
    monkeypatch.undo()
    monkeypatch.setitem(globals(), "helper", lambda batch: batch)
    assert origin(scaled) != before
    monkeypatch.undo()
    assert origin(scaled) == before


def test_what_it_encloses_counts_and_what_it_notes_does_not():
    def made(weight, data=TABLE, most=1):
        calls = []

        def loss(net, batch, least=0, *, most=most):
            calls.append(len(batch))
            return weight * (batch + data).clamp(least, most)

        return loss, calls

    loss, calls = made(1.0)
    before = origin(loss)
    calls.append(3)
    loss.calls = 4
    assert origin(loss) == before == origin(made(1.0, TABLE.clone())[0])
    for other in (made(2.0), made(1.0, TABLE + 1), made(1.0, TABLE[:5]), made(1.0, TABLE.int())):
        assert origin(other[0]) != before
    assert origin(made(1.0, most=2)[0]) != before
    assert origin(functools.partial(scaled, net=1)) != origin(functools.partial(scaled, net=2))


class Weighted:
    def __init__(self, weight):
        self.weight = weight
        self._calls = 0

    def __call__(self, net, batch):
        self._calls += 1
        return self.weight * self.twice

    def method(self, net, batch):
        return self.weight

    @functools.cached_property
    def twice(self):
        return 2 * self.weight


def test_objects_are_what_they_hold():
    one, other = Weighted(1.0), Weighted(2.0)
    before = origin(one)
    assert one(None, None) == 2 and one._calls == 1
    assert origin(one) == before == origin(Weighted(1.0)) != origin(other)
    assert origin(one.method) == origin(Weighted(1.0).method) != origin(other.method)
    assert origin([one]) != origin([other])


def test_data_are_their_numbers():
    batches = [{"x": TABLE, "y": np.ones((2, 3))} for _ in range(3)]
    same = [{"y": np.ones((2, 3)), "x": TABLE.clone()} for _ in range(3)]
    assert origin(batches) == origin(same) != origin(batches[:2])
    same[1]["y"][1, 2] = 2
    assert origin(batches) != origin(same)
    large = torch.zeros(3 * 10**6)
    assert origin(large) == origin(large.clone()) != origin(large + 1)
    assert origin(large) != origin(large[1:]) and origin(torch.zeros(3, 4)) != origin(
        torch.zeros(12)
    )
    assert origin(TABLE.bfloat16()) != origin(TABLE)
    assert origin(TABLE[::2]) == origin(TABLE[::2].clone())
    for some in (torch.zeros(0), np.array([None]), torch.zeros(2, device="meta"), {1, 2}, object()):
        assert len(origin(some)) == 8
    loader = DataLoader(TensorDataset(TABLE), batch_size=2)
    before = origin(loader)
    next(iter(loader))
    assert origin(loader) == before
    assert origin(DataLoader(TensorDataset(TABLE + 1), batch_size=2)) != before


def test_a_network_is_its_layers():
    assert origin(nn.Linear(2, 3)) == origin(nn.Linear(2, 3)) != origin(nn.Linear(3, 3))


def test_what_holds_itself_ends():
    loop = {"x": TABLE}
    loop["self"] = loop
    assert len(origin(loop)) == 8


@pytest.mark.slow
def test_it_is_the_same_in_another_process():
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_origins as t;"
        "print(t.origin(t.scaled), t.origin(t.Weighted(1.5)), t.origin({'a', 'b', 1}))"
    )
    folder = __file__.rpartition("/")[0]
    found = {
        subprocess.run(
            [sys.executable, "-c", program, folder], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    }
    assert len(found) == 1
