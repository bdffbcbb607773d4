"""The folder of a run, whatever the method, with a method made up."""

import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import safetensors.torch
import torch
from torch import nn

from posecore.methods.runs import Run, read_run, resumed


@dataclass(frozen=True)
class Thing:
    number: int
    points: np.ndarray


@dataclass(frozen=True)
class ThingRun(Run):
    method: ClassVar[str] = "things"

    width: int
    things: list[Thing]


def read(path):
    def make(path, content):
        things = [Thing(one["number"], np.array(one["points"])) for one in content["things"]]
        np.array([one.number for one in things], np.int64)  # as networks are made: may overflow,
        torch.empty([one.number for one in things])  # or be refused
        return ThingRun(path, content["options"], content["width"], things)

    return read_run(path, ThingRun, make)


@pytest.fixture
def run(tmp_path):
    things = [Thing(3, np.arange(6.0).reshape(2, 3))]
    run = ThingRun(tmp_path / "new" / "run", {"data": "here", "steps": 4}, 8, things)
    run.write()
    return run


def test_what_is_written_is_read(run):
    content = json.loads((run.path / "run.json").read_text())
    assert list(content) == ["method", "options", "width", "things"]
    assert content["method"] == "things"
    again = read(run.path)
    assert (again.path, again.options, again.width) == (run.path, run.options, run.width)
    np.testing.assert_array_equal(again.things[0].points, run.things[0].points)


def test_what_cannot_be_written_is_refused(run):
    with pytest.raises(TypeError, match="set"):
        ThingRun(run.path, {"objects": {1}}, 8, []).write()
    with pytest.raises(ValueError, match="JSON"):
        ThingRun(run.path, {"weight": np.nan}, 8, []).write()
    assert read(run.path).options == run.options


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[:-3], "run.json: damaged JSON"),
        (lambda text: "[]", "run.json: damaged: method: expected an entry of this name"),
        (lambda text: text.replace('"width"', '"height"'), "run.json: damaged: no entry 'width'"),
        (
            lambda text: text.replace('"things", ', '"others", '),
            "run.json: damaged: method: expected things, got others",
        ),
        (
            lambda text: text.replace('"steps"', '"scale"'),
            "run.json: damaged: scale: expected one of 'tiny', .*, got 4",
        ),
        (
            lambda text: text.replace('{"data": "here", "steps": 4}', "[]"),
            "run.json: damaged: options: expected options by their names, got list",
        ),
        (
            lambda text: text.replace('"number": 3', f'"number": {2**70}'),
            "run.json: damaged: OverflowError: ",
        ),
        (
            lambda text: text.replace('"number": 3', '"number": -1'),
            "run.json: damaged: RuntimeError: ",
        ),
    ],
)
def test_damage_is_named(run, damage, message):
    file = run.path / "run.json"
    file.write_text(damage(file.read_text()))
    with pytest.raises(ValueError, match=message):
        read(run.path)


def test_a_folder_without_a_run(tmp_path):
    with pytest.raises(ValueError, match="^--run: expected a folder that `train things` wrote"):
        read(tmp_path)


def test_going_on_needs_the_same_options(run, tmp_path):
    assert resumed(tmp_path, {"steps": 4}, read) is None
    assert resumed(run.path, {"data": "here", "steps": 4}, read).things[0].number == 3
    with pytest.raises(ValueError, match="^--steps: expected 4 as .* was begun with.*got 5"):
        resumed(run.path, {"steps": 5}, read)
    with pytest.raises(ValueError, match="^--more-steps: expected None as"):
        run.require_options({"data": "here", "more_steps": 1})


def test_weights_come_back(run):
    run.write_weights("net", model := nn.Linear(3, 2))
    other = nn.Linear(3, 2).train()
    run.load_weights("net", other)
    assert torch.equal(other.weight, model.weight) and torch.equal(other.bias, model.bias)
    assert not other.training


@pytest.mark.parametrize("kind", ["none", "cut", "other", "spoilt"])
def test_weights_of_something_else(run, kind):
    path, model = run.path / "net.safetensors", nn.Linear(3, 2)
    run.write_weights("net", nn.Linear(3, 4) if kind == "other" else model)
    if kind == "none":
        path.unlink()
    elif kind == "cut":
        path.write_bytes(path.read_bytes()[:-5])
    elif kind == "spoilt":
        weights = safetensors.torch.load_file(path)
        weights["bias"][1] = np.inf
        safetensors.torch.save_file(weights, path)
    message = {
        "none": "^--run: expected a run that has trained its net",
        "cut": "net.safetensors: expected the weights of this run",
        "other": "net.safetensors: expected the weights of this run",
        "spoilt": "net.safetensors: expected finite weights, got others in bias",
    }[kind]
    with pytest.raises(ValueError, match=message):
        run.load_weights("net", nn.Linear(3, 2))


def rewritten(change, metadata):
    def function(path):
        kept = {name: change(tensor) for name, tensor in safetensors.torch.load_file(path).items()}
        with safetensors.safe_open(path, "pt") as file:
            safetensors.torch.save_file(kept, path, file.metadata() if metadata else None)

    return function


def flip(path):
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(bytes(data))


SPOILT = {
    "a flipped bit": (flip, "other weights than were written: digest "),
    "all nan": (rewritten(lambda t: t * np.nan, True), "other weights than were written"),
    "zeros": (rewritten(lambda t: t * 0, True), "other weights than were written"),
    "others": (rewritten(lambda t: t + 1, True), "other weights than were written"),
    "halves": (rewritten(lambda t: t.half(), True), "other weights than were written"),
    "all nan, no digest": (rewritten(lambda t: t * np.nan, False), "expected finite weights"),
    "zeros, no digest": (rewritten(lambda t: t * 0, False), "no weights, or only zeros"),
    "halves, no digest": (
        rewritten(lambda t: t.half(), False),
        r"expected torch\.float32 in weight, got torch\.float16",
    ),
    "doubles, no digest": (rewritten(lambda t: t.double(), False), r"expected torch\.float32"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_weights_that_are_not_those_that_were_written(run, kind):
    run.write_weights("net", nn.Linear(3, 2))
    change, words = SPOILT[kind]
    change(run.path / "net.safetensors")
    with pytest.raises(ValueError, match=rf"net\.safetensors: .*{words}"):
        run.load_weights("net", nn.Linear(3, 2))


def test_weights_of_before_that_hold_no_digest_are_loaded(run):
    model = nn.Linear(3, 2)
    safetensors.torch.save_file(model.state_dict(), run.path / "net.safetensors")
    run.load_weights("net", other := nn.Linear(3, 2))
    assert torch.equal(other.weight, model.weight)
