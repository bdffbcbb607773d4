"""The loop trains as a bare loop does, stops at what is wrong, and goes on bit for bit."""

import contextlib
import errno
import functools
import os
import random
import tempfile

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from posecore import files
from posecore.training import fit, seeded
from posecore.training.loop import SCHEDULES

X = torch.linspace(-1, 1, 24).reshape(12, 2)
Y = (X.sin().sum(1, keepdim=True) + 0.3).clone()


def batches(generator):
    rows = torch.randint(len(X), (6,), generator=generator)
    return {"x": X[rows], "y": Y[rows]}


def loss(net, batch):
    return (net(batch["x"]) - batch["y"]).square().mean()


def small(dropout=0.0, seed=0):
    with seeded(seed):
        return nn.Sequential(
            *(nn.Linear(2, 8), nn.BatchNorm1d(8), nn.Tanh(), nn.Dropout(dropout), nn.Linear(8, 1))
        )


def plain(seed=0):
    with seeded(seed):
        return nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 1))


def equal(a, b):
    one, two = a.state_dict(), b.state_dict()
    return one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)


# It trains ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("clip", [None, 0.05])
@pytest.mark.parametrize("schedule", ["constant", "linear", "cosine"])
def test_it_is_the_bare_loop(schedule, clip):
    items = [{"x": X[i::3], "y": Y[i::3]} for i in range(3)]
    ours, bare = plain(), plain()
    options = {"steps": 20, "lr": 0.05, "schedule": schedule, "clip": clip}
    history = fit(ours, items, loss, optimiser=torch.optim.Adam, **options)
    descent = torch.optim.Adam(bare.parameters(), lr=0.05)
    factors = {
        "constant": lambda step: 1.0,
        "linear": lambda step: 1 - step / 20,
        "cosine": lambda step: 0.5 * (1 + np.cos(np.pi * step / 20)),
    }
    scheduler = torch.optim.lr_scheduler.LambdaLR(descent, factors[schedule])
    values = []
    for step in range(20):
        descent.zero_grad()
        value = loss(bare, items[step % 3])
        value.backward()
        if clip:
            nn.utils.clip_grad_norm_(bare.parameters(), clip)
        descent.step()
        scheduler.step()
        values.append(value.item())
    np.testing.assert_allclose(history.losses["loss"], values, rtol=1e-5)
    for one, two in zip(ours.parameters(), bare.parameters(), strict=True):
        # Factors on the rate are computed in another order.
        torch.testing.assert_close(one, two, rtol=1e-5, atol=1e-6)
    default = plain()
    fit(default, items, loss, **options)
    for one, two in zip(ours.parameters(), default.parameters(), strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-5)  # Adam divides small by small


def test_it_learns_and_leaves_the_model_ready():
    net = plain()
    history = fit(net, batches, loss, steps=150, lr=0.05)
    assert np.mean(history.losses["loss"][-10:]) < 0.05 * history.losses["loss"][0]
    assert not any(module.training for module in net.modules())
    assert history.steps == 150 and history.seconds > 0


def test_a_schedule_is_told_how_much_is_done():
    told = []
    fit(plain(), batches, loss, steps=4, schedule=lambda done: told.append(done) or 1.0)
    assert told == [0.0, 0.25, 0.5, 0.75]
    for name, factor in SCHEDULES.items():
        assert factor(0.0) == 1.0
        assert factor(1.0) == (1.0 if name == "constant" else 0.0)


def test_a_rate_of_a_group_keeps_its_ratio():
    def optimiser(parameters, lr):
        first, *others = parameters
        return torch.optim.SGD([{"params": [first], "lr": 10 * lr}, {"params": others}], lr=lr)

    seen = []

    class Watched(torch.optim.SGD):
        def step(self, closure=None):
            seen.append([group["lr"] for group in self.param_groups])
            super().step(closure)

    def watched(parameters, lr):
        groups = optimiser(parameters, lr).param_groups
        return Watched([{"params": g["params"], "lr": g["lr"]} for g in groups], lr=lr)

    fit(plain(), batches, loss, steps=2, lr=0.1, schedule="linear", optimiser=watched)
    np.testing.assert_allclose(seen, [[1.0, 0.1], [0.5, 0.05]])


def test_parts_of_a_loss_are_recorded_and_only_one_is_minimised():
    def parts(net, batch):
        error = net(batch["x"]) - batch["y"]
        return {"loss": error.square().mean(), "largest": error.abs().max()}

    one, two = plain(), plain()
    history = fit(one, batches, parts, steps=5)
    assert list(history.losses) == ["loss", "largest"]
    assert {len(values) for values in history.losses.values()} == {5}
    assert fit(two, batches, loss, steps=5).losses["loss"] == history.losses["loss"]
    assert equal(one, two)


def test_what_is_evaluated_is_the_model_at_rest():
    states = []

    def evaluate(net):
        states.append((net.training, torch.is_grad_enabled()))
        return {"error": loss(net, {"x": X, "y": Y}), "noise": torch.rand(())}

    one, two = small(0.5), small(0.5)
    history = fit(one, batches, loss, steps=10, evaluate=evaluate, evaluate_every=4)
    assert history.measured_at == [4, 8, 10]
    assert states == [(False, False)] * 3
    assert history.measured["error"][-1] == loss(one, {"x": X, "y": Y}).item()
    # Neither its random numbers nor its mode reach the training.
    assert fit(two, batches, loss, steps=10).losses == history.losses
    assert equal(one, two)


def test_frozen_weights_stay():
    net = plain()
    net[0].weight.requires_grad_(False)
    before = net[0].weight.clone()
    fit(net, batches, loss, steps=3)
    assert torch.equal(net[0].weight, before)
    assert not torch.equal(net[2].weight, plain()[2].weight)


@pytest.mark.parametrize("kind", [dict, tuple, list])
def test_a_batch_may_be_a_tensor_or_tensors_in_something(kind):
    def of_kind(generator):
        batch = batches(generator)
        return batch if kind is dict else kind(batch.values())

    def its_loss(net, batch):
        x, y = batch.values() if kind is dict else batch
        return (net(x) - y).square().mean()

    assert (
        fit(plain(), of_kind, its_loss, steps=3).losses
        == fit(plain(), batches, loss, steps=3).losses
    )


# Images ------------------------------------------------------------------------------------------


def convolution():
    with seeded(0):
        return nn.Sequential(nn.Conv2d(3, 4, 3), nn.ReLU(), nn.Flatten(), nn.Linear(4 * 36, 1))


def images(generator):
    return {"x": torch.rand(2, 3, 8, 8, generator=generator), "y": torch.ones(2, 1)}


@pytest.mark.parametrize("asked", [None, True, False])
def test_images_and_convolutions_lie_channels_last(asked):
    seen = []

    def watched(net, batch):
        seen.append(batch["x"].is_contiguous(memory_format=torch.channels_last))
        return loss(net, batch)

    net = convolution()
    fit(net, images, watched, steps=2, channels_last=asked, precision="float32")
    assert seen == [asked is not False] * 2
    assert net[0].weight.is_contiguous(memory_format=torch.channels_last) is (asked is not False)


@pytest.mark.parametrize(
    "precision, dtype", [("float32", torch.float32), ("bfloat16", torch.bfloat16)]
)
def test_precision_is_that_of_the_products(precision, dtype):
    seen = []

    def watched(net, batch):
        seen.append(net(batch["x"]).dtype)
        return loss(net, batch)

    net = plain()
    fit(net, batches, watched, steps=1, precision=precision)
    assert seen == [dtype]
    assert {value.dtype for value in net.parameters()} == {torch.float32}


# The same bits -----------------------------------------------------------------------------------


def careless(net, batch):
    """A loss that takes numbers from everywhere."""
    noise = random.random() + np.random.rand() + torch.rand(())  # noqa: NPY002
    return loss(net, batch) * (1 + 0.1 * noise)


def test_nothing_random_comes_in_or_gets_out():
    results = []
    for noise in range(2):
        torch.manual_seed(noise)
        random.seed(noise)
        np.random.seed(noise)  # noqa: NPY002
        before = torch.get_rng_state(), random.getstate(), np.random.get_state()  # noqa: NPY002
        net = small(0.5)
        fit(net, batches, careless, steps=5, seed=3)
        results.append(net)
        after = torch.get_rng_state(), random.getstate(), np.random.get_state()  # noqa: NPY002
        assert torch.equal(before[0], after[0])
        assert before[1] == after[1]
        assert np.array_equal(before[2][1], after[2][1]) and before[2][2] == after[2][2]
    assert equal(*results)
    other = small(0.5)
    fit(other, batches, careless, steps=5, seed=4)
    assert not equal(other, results[0])


class Stopped(Exception):
    pass


@pytest.mark.slow
@settings(max_examples=8)
@given(
    stops=st.lists(st.integers(0, 11), max_size=4),
    save_seconds=st.sampled_from([0.0, 1e9]),
    schedule=st.sampled_from(sorted(SCHEDULES)),
    optimiser=st.sampled_from(
        [torch.optim.AdamW, functools.partial(torch.optim.SGD, momentum=0.9)]
    ),
)
def test_a_run_that_was_stopped_anywhere_ends_in_the_same_bits(
    stops, save_seconds, schedule, optimiser
):
    calls, left = [], []

    def fragile(net, batch):
        calls.append(None)
        if not left:
            raise Stopped
        left.pop()
        return careless(net, batch)

    options = {"steps": 12, "lr": 0.05, "schedule": schedule, "optimiser": optimiser, "clip": 0.5}
    whole = small(0.3)
    expected = fit(whole, batches, careless, **options)
    with tempfile.TemporaryDirectory() as folder:
        options |= {"resume": folder, "save_seconds": save_seconds}
        for number, most in enumerate([*stops, 12]):
            net = small(0.3, seed=number)  # what it begins with is the first one's
            left[:] = [None] * most
            with contextlib.suppress(Stopped):
                history = fit(net, batches, fragile, **options)
                break
        assert equal(net, whole)
        assert history.losses == expected.losses
        # And it is not made again.
        calls.clear()
        net = small()
        assert fit(net, batches, fragile, **options).losses == expected.losses
        assert equal(net, whole) and not calls and not net.training


def test_a_cell_that_was_interrupted_and_is_run_again_begins_as_it_began(tmp_path):
    def interrupted(net, batch):
        interrupted.calls += 1
        if interrupted.calls == 4:
            raise KeyboardInterrupt
        return loss(net, batch)

    interrupted.calls = 0
    net, whole = small(), small()
    with pytest.raises(KeyboardInterrupt):
        fit(net, batches, interrupted, steps=8, resume=tmp_path)
    assert not equal(net, whole)  # the same object, half trained
    fit(net, batches, interrupted, steps=8, resume=tmp_path)
    fit(whole, batches, loss, steps=8)
    assert equal(net, whole)


def test_a_finished_run_is_made_again_on_demand(tmp_path, monkeypatch):
    one, two, three = plain(), plain(seed=1), plain(seed=1)
    fit(one, batches, loss, steps=4, resume=tmp_path)
    monkeypatch.setenv("POSECORE_RETRAIN", "1")
    fit(two, batches, loss, steps=4, resume=tmp_path)
    fit(three, batches, loss, steps=4)
    assert equal(two, three) and not equal(two, one)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("state-00000000.pt", "state-00000004.pt"),
        *("weights-00000000.safetensors", "weights-00000004.safetensors"),
    ]


def test_tied_weights_and_layouts_survive(tmp_path):
    class Tied(nn.Module):
        def __init__(self):
            super().__init__()
            self.convolution = nn.Conv2d(3, 4, 3)
            self.one, self.two = nn.Linear(4, 4), nn.Linear(4, 4)
            self.two.weight = self.one.weight

        def forward(self, x):
            return self.two(self.one(self.convolution(x).mean((2, 3))))

    with seeded(0):
        net = Tied()
    options = {"steps": 3, "precision": "float32"}
    fit(net, images, loss, resume=tmp_path, **options)
    again = Tied()
    fit(again, images, loss, resume=tmp_path, **options)
    assert equal(net, again)
    assert again.two.weight is again.one.weight
    assert again.convolution.weight.is_contiguous(memory_format=torch.channels_last)


# Files -------------------------------------------------------------------------------------------


def test_a_full_disk_is_told_and_costs_nothing(tmp_path, monkeypatch):
    whole, net = small(0.2), small(0.2)
    fit(whole, batches, loss, steps=8)
    sync, calls = os.fsync, []

    def full(descriptor):
        calls.append(None)
        if len(calls) > 7:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(descriptor)

    options = {"steps": 8, "resume": tmp_path, "save_seconds": 0.0}
    with monkeypatch.context() as patched, pytest.raises(OSError, match="No space"):
        patched.setattr(files.os, "fsync", full)
        fit(net, batches, loss, **options)
    assert not list(tmp_path.glob(".*"))
    history = fit(net, batches, loss, **options)
    assert equal(net, whole) and history.steps == 8
    assert len(list(tmp_path.iterdir())) == 4


def test_settings_that_differ_are_named(tmp_path):
    options = {"steps": 4, "resume": tmp_path, "recipe": {"data": "tabletop"}}
    fit(plain(), batches, loss, **options)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def other_loss(net, batch):
        return loss(net, batch)

    wider = nn.Sequential(nn.Linear(2, 9), nn.Linear(9, 1))
    for change, words in [
        ({"steps": 5}, "steps 5, as now, got 4"),
        ({"seed": 1}, "seed 1"),
        ({"lr": 0.1}, "lr 0.1, as now, got 0.001"),
        ({"schedule": "linear"}, "schedule linear, as now, got cosine"),
        ({"schedule": lambda done: 1.0}, "schedule .*lambda"),
        ({"clip": 1.0}, "clip 1.0, as now, got inf"),
        ({"optimiser": torch.optim.SGD}, "optimiser SGD"),
        ({"optimiser": functools.partial(torch.optim.Adam, eps=1e-3)}, "optimiser Adam"),
        ({"precision": "bfloat16"}, "precision bfloat16"),
        ({"channels_last": True}, "channels_last True"),
        ({"recipe": {"data": "headset"}}, "data headset, as now, got tabletop"),
        ({"recipe": None}, "data absent, as now, got tabletop"),
        ({"loss": other_loss}, "loss .*other_loss"),
        ({"model": wider}, "model Sequential of 37 weights"),
    ]:
        given = {"model": plain(), "batches": batches, "loss": loss} | options | change
        with pytest.raises(ValueError, match=f"^resume: expected a run with {words}"):
            fit(**given)
    assert kept == {path.name: path.read_bytes() for path in tmp_path.iterdir()}


# What is wrong -----------------------------------------------------------------------------------


def test_a_loss_that_is_not_finite_stops_it_and_the_checkpoint_of_before_stays(tmp_path):
    def poisoned(generator):
        batch = batches(generator)
        poisoned.calls += 1
        if poisoned.calls == 4:
            batch["y"] = batch["y"].clone()
            batch["y"][2] = torch.inf
        return batch

    poisoned.calls = 0
    net = plain()
    with pytest.raises(ValueError, match=r"^loss: .*step 3, got inf in 'loss'; .*before: y$"):
        fit(net, poisoned, loss, steps=8, resume=tmp_path, save_seconds=0.0)
    assert all(value.isfinite().all() for value in net.parameters())
    again, whole = plain(), plain()
    fit(again, poisoned, loss, steps=8, resume=tmp_path)
    fit(whole, batches, loss, steps=8)
    assert equal(again, whole)


def test_a_gradient_that_is_not_finite_is_named():
    def root(net, batch):
        return (net(batch["x"]) * 0).abs().sqrt().sum()

    net = plain()
    with pytest.raises(ValueError, match=r"^loss: expected finite gradients at step 0, got .*2\."):
        fit(net, batches, root, steps=3)
    assert equal(net, plain())


def test_a_weight_that_is_not_finite_is_named():
    net = plain()
    nn.init.constant_(net[0].bias, torch.nan)
    with pytest.raises(ValueError, match=r"^loss: .*step 0, got nan .*before: 0\.bias$"):
        fit(net, batches, loss, steps=3)
    huge = functools.partial(torch.optim.SGD, weight_decay=1e30)
    with pytest.raises(ValueError, match=r"^lr: .* after 1 steps, got others in \['0\.weight'"):
        fit(plain(), batches, loss, steps=1, lr=1e30, optimiser=huge)


ARGUMENTS = {"model": None, "batches": batches, "loss": loss, "steps": 2}


@pytest.mark.parametrize(
    "change, words",
    [
        ({"model": 3}, "^model: "),
        ({"model": nn.ReLU()}, "^model: .*parameters to train, got ReLU"),
        ({"batches": None}, "^batches: "),
        ({"batches": "tabletop"}, "^batches: "),
        ({"batches": []}, "^batches: "),
        ({"batches": {"x": X, "y": Y}}, "^batches: "),
        ({"batches": X}, "^batches: "),
        ({"batches": iter([])}, "^batches: expected a batch for step 0"),
        ({"batches": iter([{"x": X, "y": Y}])}, "^batches: expected a batch for step 1"),
        ({"steps": 0}, "^steps: "),
        ({"steps": 2.5}, "^steps: "),
        ({"lr": 0}, "^lr: "),
        ({"lr": float("nan")}, "^lr: "),
        ({"schedule": "cosinus"}, "^schedule: .*'cosine'"),
        ({"clip": 0}, "^clip: "),
        ({"seed": -1}, "^seed: "),
        ({"seed": None}, "^seed: "),
        ({"device": "abacus"}, "^device: "),
        ({"device": "cuda:77"}, "^device: "),
        ({"device": 1.5}, "^device: "),
        ({"precision": "float16"}, "^precision: "),
        ({"save_seconds": -1}, "^save_seconds: "),
        ({"evaluate": len, "evaluate_every": 0}, "^evaluate_every: "),
        ({"evaluate": lambda net: 3.0}, "^evaluate: .*numbers by name"),
        ({"loss": lambda net, batch: None}, "^loss: "),
        ({"loss": lambda net, batch: {"error": loss(net, batch)}}, "^loss: .*'loss'"),
        ({"loss": lambda net, batch: net(batch["x"])}, r"^loss\['loss'\]: .*shape \(6, 1\)"),
        ({"loss": lambda net, batch: {"loss": loss(net, batch), "a": 1.0}}, r"^loss\['a'\]: "),
        ({"loss": lambda net, batch: batch["y"].mean()}, "^loss: .*depends on the model"),
    ],
)
def test_bad_input_is_refused(change, words):
    given = ARGUMENTS | {"model": plain()} | change
    with pytest.raises(ValueError, match=words):
        fit(**given)


def test_a_resume_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ValueError, match=r"^resume: expected a folder, got the file"):
        fit(plain(), batches, loss, steps=2, resume=tmp_path / "file")
    with pytest.raises(ValueError, match="^resume: expected the name of a file or a folder"):
        fit(plain(), batches, loss, steps=2, resume="")
    with pytest.raises(ValueError, match="^batches: .*to be resumed"):
        fit(plain(), iter([batches(None)]), loss, steps=2, resume=tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_names_of_losses_stay():
    def changing(net, batch):
        changing.calls += 1
        return {"loss": loss(net, batch)} | ({"b": torch.ones(())} if changing.calls > 1 else {})

    changing.calls = 0
    with pytest.raises(ValueError, match=r"^loss: .*\['loss'\] at every step, got \['b', 'loss'\]"):
        fit(plain(), batches, changing, steps=3)


def test_nothing_is_printed_where_nobody_looks(capfd):
    fit(plain(), batches, loss, steps=3)
    assert capfd.readouterr() == ("", "")
    fit(plain(), batches, loss, steps=3, show=True)
    out, err = capfd.readouterr()
    assert out == "" and "/3 [" in err


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("resume", {"resume": "a\0b"}),
        ("resume", {"resume": 5}),
        ("optimiser", {"optimiser": "adam"}),
        ("evaluate", {"evaluate": lambda net: {"a": "x"}}),
        ("evaluate", {"evaluate": lambda net: {"a": torch.zeros(2)}}),
        ("evaluate", {"evaluate": lambda net: {"a": None}}),
    ],
)
def test_what_cannot_be_is_refused_by_its_argument(name, options):
    def loss(net, batch):
        return net(batch).square().mean()

    with pytest.raises(ValueError, match=f"^{name}: expected "):
        fit(torch.nn.Linear(2, 1), [torch.ones(4, 2)], loss, steps=1, show=False, **options)
