"""What a training is made from: another where loss or data are, and never another by itself."""

import contextlib
import enum
import functools
import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from data_tools.batches import Batches
from posecore.training import fit, origins, seeded
from tests.launched import two_launched

WEIGHT = 2.0
WEIGHTS = {"turn": 1.0, "shift": [1, 2]}
TABLE = torch.arange(6.0)


def scaled(net, batch):
    """Twice."""
    return helper(batch) * WEIGHT * WEIGHTS["turn"]


def helper(batch):
    return batch + TABLE


def edited(function, old, new):
    """The function as another edition of its source would make it."""
    space = dict(function.__globals__)
    exec(inspect.getsource(function).replace(old, new), space)
    space[function.__name__].__module__ = function.__module__
    return space[function.__name__]


def changed(one, other):
    """The name of what differs; kept as a checkpoint keeps it, and both ways round."""
    first, second = (json.loads(json.dumps(origins.origins(x, "loss"))) for x in (one, other))
    found = origins.difference(first, second)
    assert found == origins.difference(second, first)
    assert origins.difference(first, first) is None
    return found


# Functions ---------------------------------------------------------------------------------------


def test_an_edit_counts_and_a_comment_does_not():
    assert changed(scaled, edited(scaled, "", "")) is None
    assert changed(scaled, edited(scaled, "Twice", "Two times")) is None
    assert changed(scaled, edited(scaled, "    return", "    # so\n    return")) is None
    for old, new in [("* WEIGHT", "+ WEIGHT"), ("* WEIGHT *", "* 3 *"), ("helper(batch)", "batch")]:
        assert changed(scaled, edited(scaled, old, new)) == "loss"


@pytest.mark.parametrize(
    "name, value",
    [
        ("WEIGHT", 3.0),
        ("WEIGHTS", {"turn": 1.5, "shift": [1, 2]}),
        ("WEIGHTS", {"turn": 1.0, "shift": [1, 3]}),
        ("TABLE", TABLE + 1),
        ("helper", edited(helper, "+", "-")),
    ],
)
def test_what_a_function_uses_of_its_module_counts(monkeypatch, name, value):
    before = origins.origins(scaled, "loss")
    assert origins.difference(before, origins.origins(scaled, "loss")) is None
    monkeypatch.setitem(globals(), name, value)
    found = origins.difference(before, origins.origins(scaled, "loss"))
    assert found.startswith("loss.") and name in found


class Kind(enum.Enum):
    L1 = 1
    L2 = 2


def made(weight=1.0, data=TABLE, most=1, least=0, kind=Kind.L1, name="mean", parts=(1.0, 2)):
    def loss(net, batch, least=least, *, most=most):
        return weight * (batch + data).clamp(least, most), kind, name, parts

    return loss


@pytest.mark.parametrize(
    "change",
    [
        {"weight": 2.0},
        {"weight": 1},
        {"weight": 1.001},
        {"weight": torch.tensor([1.0, 2.0])},
        {"data": TABLE + 1},
        {"data": TABLE[:5]},
        {"data": TABLE.int()},
        {"data": TABLE.flip(0)},
        {"most": 2},
        {"least": 1},
        {"least": None},
        {"kind": Kind.L2},
        {"name": "sum"},
        {"parts": (1.0, 3)},
        {"parts": [1.0, 2, 3]},
    ],
)
def test_what_it_encloses_counts_and_its_defaults(change):
    assert changed(made(), made(data=TABLE.clone())) is None
    assert changed(made(), made(**change)).startswith("loss")


def test_partial_and_decorated_functions():
    assert changed(functools.partial(scaled, net=1), functools.partial(scaled, net=1)) is None
    assert changed(functools.partial(scaled, net=1), functools.partial(scaled, net=2))
    assert changed(functools.partial(scaled), functools.partial(scaled, net=2))
    smooth = functools.partial(nn.functional.smooth_l1_loss, beta=0.5)
    assert changed(smooth, functools.partial(nn.functional.smooth_l1_loss, beta=0.5)) is None
    assert changed(smooth, functools.partial(nn.functional.smooth_l1_loss, beta=0.1))
    cached = functools.lru_cache(made())
    assert changed(cached, functools.lru_cache(made())) is None
    assert changed(cached, functools.lru_cache(made(2.0))) == "loss.weight"
    assert changed(*(torch.compile(made(), backend="eager") for _ in range(2))) is None
    assert changed(*(torch.compile(made(w), backend="eager") for w in (1.0, 2.0)))


# Objects -----------------------------------------------------------------------------------------


class Weighted:
    def __init__(self, weight, shift=0, table=TABLE, last=None):
        self.weight, self._shift, self._table, self._last = weight, shift, [table], last

    def __call__(self, net, batch):
        return self.weight * self.twice + self._part()

    def method(self, net, batch):
        return self.weight * self._part()

    def _part(self):
        return self._shift

    @functools.cached_property
    def twice(self):
        return 2 * self.weight


def test_objects_are_what_they_hold():
    one = Weighted(1.0)
    for get in (lambda x: x, lambda x: x.method, lambda x: x.__call__, lambda x: [x]):
        assert changed(get(one), get(Weighted(1.0))) is None
        assert "weight" in changed(get(one), get(Weighted(2.0)))
        # Of what is private the arrays, and not those of what is private in it.
        assert changed(get(one), get(Weighted(1.0, 1))) is None
        assert "_table[0]" in changed(get(one), get(Weighted(1.0, 0, TABLE + 1)))
        lasts = [Weighted(1.0, last=Weighted(1.0, table=table)) for table in (TABLE, TABLE + 1)]
        assert changed(*map(get, lasts)) is None
    assert one(None, None) == 2
    assert changed(one, Weighted(1.0)) is None  # what is cached is there or not


def test_code_of_methods_counts(monkeypatch):
    before = origins.origins(Weighted(1.0), "loss"), origins.origins(Weighted(1.0).method, "loss")
    monkeypatch.setattr(Weighted, "_part", edited(made, "weight", "batch"))
    after = origins.origins(Weighted(1.0), "loss"), origins.origins(Weighted(1.0).method, "loss")
    for one, other in zip(before, after, strict=True):
        assert origins.difference(one, other) == "loss._part()"


def test_an_object_may_say_what_it_is_made_from():
    one, other = Weighted(1.0), Weighted(2.0)
    one.made_from = other.made_from = {"seed": 0}
    assert changed(one, other) is None
    other.made_from = {"seed": 1}
    assert changed(one, other) == "loss.made_from['seed']"


def test_modules():
    class Criterion(nn.Module):
        def __init__(self, weight, rows):
            super().__init__()
            self.weight = weight
            self.register_buffer("rows", rows)
            self.inner = nn.SmoothL1Loss(beta=weight)

        def forward(self, net, batch):
            return batch

    one = Criterion(1.0, TABLE)
    assert changed(one, Criterion(1.0, TABLE.clone()).eval()) is None
    assert changed(one, Criterion(2.0, TABLE)) == "loss.weight"
    assert changed(one, Criterion(1.0, TABLE + 1)) == "loss.rows"
    with seeded(0):
        a, b, c = nn.Linear(2, 3), nn.Linear(2, 3), nn.Linear(3, 3)
    assert changed(a, b) is None and changed(a, c) == "loss.in_features"
    assert changed(nn.CrossEntropyLoss(TABLE), nn.CrossEntropyLoss(TABLE + 1)) == "loss.weight"


# Data --------------------------------------------------------------------------------------------


def test_data_are_their_numbers():
    batches = [{"x": TABLE, "y": np.ones((2, 3))} for _ in range(3)]
    same = [{"y": np.ones((2, 3)), "x": TABLE.clone()} for _ in range(3)]
    assert changed(batches, same) is None
    assert changed(batches, batches[:2]) == "loss"
    same[1]["y"][1, 2] = 2
    assert changed(batches, same) == "loss[1]['y']"
    labels = torch.zeros(200_000, dtype=torch.uint8)
    labels[::2] = 1
    assert changed(labels, labels.clone()) is None
    labels[777] = 1
    assert changed(labels, labels.clone().index_fill_(0, torch.tensor([777]), 0))
    large = torch.linspace(0, 1, 3 * 10**6)
    assert changed(large, large.clone()) is None
    assert changed(large, large * 1.01) and changed(large, large[1:]) and changed(large, -large)
    for one in (TABLE.bfloat16(), TABLE.double(), TABLE[:, None], TABLE.numpy().astype(complex)):
        assert changed(TABLE, one)
    assert changed(TABLE[::2], TABLE[::2].clone()) is None
    assert changed(TABLE, TABLE.log()) and changed(TABLE.log(), TABLE.log()) is None
    assert (
        changed(DataLoader(TensorDataset(TABLE)), DataLoader(TensorDataset(TABLE.clone()))) is None
    )
    assert changed(DataLoader(TensorDataset(TABLE)), DataLoader(TensorDataset(TABLE + 1)))

    def make(rows, generator, scale):
        return rows * scale

    drawn = [Batches(make, rows, 2, seed=0, scale=1) for rows in (TABLE, TABLE.clone(), TABLE + 1)]
    assert changed(*drawn[:2]) is None and changed(*drawn[1:]) == "loss.rows"


def test_rounding_is_no_difference():
    with seeded(0):
        data = torch.randn(1000, 30)
    assert changed(data @ data.T, (data.double() @ data.double().T).float()) is None
    assert changed(data.mean().item(), data.double().mean().item()) is None


@pytest.mark.parametrize(
    "value",
    [
        torch.zeros(0), np.array([None]), np.array(["a"]), torch.zeros(2, device="meta"), {1, 2},
        object(), torch.eye(2).to_sparse(), float("nan"), 1e300, np.full(3, 1e300), None, range(3),
        torch.Generator(), np.random.default_rng(0), torch.device("cpu"), torch.float32, 10**400,
        torch.tensor(1 + 1j), slice(1),
        np.float32(2), np.datetime64("2020-01-01"), {object(): 1}, len, torch, torch.sin, "a" * 999,
        torch.nested.nested_tensor([TABLE, TABLE[:2]], layout=torch.jagged),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_anything_may_be_there(value):
    assert changed(value, value) is None
    assert changed(made(value), made(value)) is None


def test_what_holds_itself_ends():
    loop = {"x": TABLE}
    loop["self"] = loop
    deep = []
    for _ in range(5000):
        deep = [deep]
    assert changed(loop, loop) is None and changed(deep, deep) is None
    many = [{"x": TABLE, "y": [TABLE] * 100} for _ in range(1000)]
    assert len(origins.origins(many, "data")) <= origins.PARTS


def test_files_may_lie_elsewhere():
    assert changed(made(name="/tmp/one"), made(name="/home/two")) is None


# Trainings ---------------------------------------------------------------------------------------

X = torch.linspace(-1, 1, 24).reshape(12, 2)
Y = X.sin().sum(1, keepdim=True)


def net():
    with seeded(0):
        return nn.Linear(2, 1)


def weighted(weight):
    def loss(net, batch):
        return weight * (net(batch["x"]) - batch["y"]).square().mean()

    return loss


def drawn(generator):
    rows = torch.randint(len(X), (6,), generator=generator)
    return {"x": X[rows], "y": Y[rows]}


@pytest.mark.parametrize("steps", [3, 5])
def test_another_loss_or_other_data_are_not_the_run_that_was_begun(tmp_path, monkeypatch, steps):
    items = [{"x": X[i::3], "y": Y[i::3]} for i in range(3)]

    def stopped(history):
        raise InterruptedError

    def run(data, loss, number, schedule="cosine"):
        options = {"steps": 5, "resume": tmp_path / str(number), "save_seconds": 0}
        evaluate = stopped if steps == 3 else dict  # a training stops before its end
        options |= {"evaluate": lambda net: evaluate({}), "evaluate_every": 4}
        return fit(net(), data, loss, schedule=schedule, **options)

    def begun(data, loss, number, schedule="cosine"):
        if steps == 5:
            return run(data, loss, number, schedule)
        with pytest.raises(InterruptedError):
            run(data, loss, number, schedule)

    for number, data in enumerate((drawn, items)):
        begun(data, weighted(1.0), number)
        begun(data, weighted(1.0), number)
        with pytest.raises(ValueError, match=r"^resume: expected a run of the same loss\.weight, "):
            run(data, weighted(2.0), number)
        if data is items:
            data = [*items[:2], {"x": X[2::3], "y": Y[2::3] + 1}]
            words = r"batches\[2\]\['y'\]"
        else:
            monkeypatch.setitem(globals(), "Y", Y + 1)
            words = r"batches\.Y"
        with pytest.raises(ValueError, match=f"^resume: expected a run of the same {words}, got "):
            run(data, weighted(1.0), number)
        monkeypatch.undo()
    begun(items, weighted(1.0), 2, lambda done: 1.0)
    with pytest.raises(ValueError, match="^resume: expected a run of the same schedule, got "):
        run(items, weighted(1.0), 2, lambda done: 0.5)


def test_a_run_is_made_again_of_another_loss(tmp_path, monkeypatch):
    fit(net(), drawn, weighted(1.0), steps=3, resume=tmp_path)
    monkeypatch.setenv("POSECORE_RETRAIN", "1")
    history = fit(net(), drawn, weighted(2.0), steps=3, resume=tmp_path)
    monkeypatch.delenv("POSECORE_RETRAIN")
    assert fit(net(), drawn, weighted(2.0), steps=3, resume=tmp_path).losses == history.losses
    with pytest.raises(ValueError, match=r"^resume: .* loss\.weight, got"):
        fit(net(), drawn, weighted(1.0), steps=3, resume=tmp_path)


def test_before_the_first_step_it_may_be_another(tmp_path):
    def broken(net, batch):
        raise InterruptedError

    broken.__qualname__ = weighted(1.0).__qualname__
    with pytest.raises(InterruptedError):
        fit(net(), drawn, broken, steps=3, resume=tmp_path)
    fit(net(), drawn, weighted(2.0), steps=3, resume=tmp_path)
    with pytest.raises(ValueError, match="^resume: .*the same loss"):
        fit(net(), drawn, weighted(1.0), steps=3, resume=tmp_path)


def test_what_changes_while_it_runs_is_no_origin(tmp_path):
    class Noting:
        def __init__(self, weight):
            self.weight, self.calls, self.seen, self.mean = weight, 0, [], torch.zeros(())
            self.last, self.cache = None, {}

        def __call__(self, net, batch):
            nonlocal count
            count, self.calls = count + 1, self.calls + 1
            self.seen.append(self.calls)
            self.mean.mul_(0.9).add_(1.0)
            self.last = self.cache[len(self.cache)] = batch["x"]
            if count == stop:
                raise InterruptedError
            return weighted(self.weight)(net, batch)

    count, stop = 0, 4
    noting = Noting(1.0)
    with pytest.raises(InterruptedError):
        fit(net(), drawn, noting, steps=6, resume=tmp_path, save_seconds=0)
    noting_again = Noting(1.0)
    for loss in (noting, noting_again, noting, Noting(1.0)):
        assert fit(net(), drawn, loss, steps=6, resume=tmp_path).steps == 6
    with pytest.raises(ValueError, match=r"^resume: .*the same loss\.weight, got"):
        fit(net(), drawn, Noting(2.0), steps=6, resume=tmp_path)


def test_a_run_of_before_origins_were_kept_goes_on(tmp_path, monkeypatch):
    with monkeypatch.context() as before:
        before.setattr("posecore.training.loop.origins", lambda value, name: {})
        fit(net(), drawn, weighted(1.0), steps=3, resume=tmp_path)
    assert fit(net(), drawn, weighted(2.0), steps=3, resume=tmp_path).steps == 3


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this test forks")
def test_the_same_program_is_never_refused(tmp_path):
    """Killed, gone on and handed back; by as many threads, by more, and by two processes."""
    script = Path(__file__).with_name("same_run.py")
    path = os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])
    with contextlib.ExitStack() as stack:
        pythons = {}
        for threads in (1, 2):  # and so many kinds of order in sets
            words = {"OMP_NUM_THREADS": str(threads), "PYTHONHASHSEED": str(threads)}
            python = subprocess.Popen(
                [sys.executable, script],
                env=os.environ | words | {"PYTHONPATH": path},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            pythons[threads] = stack.enter_context(python)

        def run(*words, threads=1, variables=({},)):
            programs = [((str(tmp_path / words[0]), *words[1:]), more) for more in variables]
            python = pythons[threads]
            print(json.dumps(programs), file=python.stdin, flush=True)
            return json.loads(python.stdout.readline())

        def finished(*words, **options):
            ((status, text),) = run(*words, **options)
            assert status == 0
            return text.split()

        for step, threads in (("7", 1), ("2", 2)):
            ((status, _),) = run("one", step, threads=threads)
            assert status < 0
        *losses, calls = finished("one")
        assert int(calls) == 3
        ends = [status for status, _ in run("two", "7", variables=two_launched())]
        assert min(ends) < 0 and 0 not in ends  # one may be killed before the other is
        assert finished("two")[2] == "5"  # begun by two, it goes on with one
        # Handed back, and refused to others.
        assert finished("one", threads=2) == [*losses, "0"]
        names = {"weight": "loss.__call__().WEIGHT", "data": "batches", "code": "loss"}
        ((_, refusals),) = run("one", "-", *names)
        for line, name in zip(refusals.splitlines(), names.values(), strict=True):
            assert line.startswith(f"resume: expected a run of the same {name}")
