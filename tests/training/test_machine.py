"""Devices, precision, and the shares of several processes."""

from typing import NamedTuple

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from posecore.training import machine
from posecore.training.machine import Processes, choose_device, each_tensor, launched, uses_bfloat16

CPU = torch.device("cpu")
IMAGES, POINTS = nn.Sequential(nn.Conv2d(3, 4, 3)), nn.Sequential(nn.Conv1d(3, 4, 1), nn.ReLU())


@given(st.integers(1, 6), st.integers(1, 4), st.integers(0, 2))
def test_the_shares_make_the_batch(count, rows, extra):
    batch = {"x": torch.rand(count * rows, 2), "y": [torch.arange(count * rows)], "name": "a"}
    shares = [Processes(rank, count).share(batch) for rank in range(count)]
    assert torch.equal(torch.cat([share["x"] for share in shares]), batch["x"])
    assert torch.equal(torch.cat([share["y"][0] for share in shares]), batch["y"][0])
    assert {len(share["x"]) for share in shares} == {rows}
    assert {share["name"] for share in shares} == {"a"}


@pytest.mark.parametrize(
    "batch",
    [
        {"x": torch.ones(5, 2)},
        {"x": torch.ones(4, 2), "K": torch.eye(3)},
        {"name": "no tensor"},
        torch.ones(()),
    ],
)
def test_a_batch_that_cannot_be_divided_is_refused(batch):
    assert Processes().share(batch) is batch
    with pytest.raises(ValueError, match="^batches: .*one length that 2 divides"):
        Processes(0, 2).share(batch)


def test_one_alone_is_its_own_mean():
    values = torch.tensor([1.0, 2.0])
    assert torch.equal(Processes().mean(values), values)
    assert Processes.joined(CPU) == Processes(0, 1)


class Pair(NamedTuple):
    one: torch.Tensor
    two: torch.Tensor


def test_every_tensor_is_replaced_and_the_rest_stays():
    one = torch.ones(2)
    batch = {"a": one, "b": [one, "text", (one, 3)], "c": Pair(one, one), "d": None}
    doubled = each_tensor(batch, lambda tensor: 2 * tensor)
    assert doubled["b"][1] == "text" and doubled["b"][2][1] == 3 and doubled["d"] is None
    assert isinstance(doubled["b"], list) and isinstance(doubled["b"][2], tuple)
    assert isinstance(doubled["c"], Pair)
    seen = []
    each_tensor(doubled, lambda tensor: seen.append(tensor.tolist()))
    assert seen == [[2.0, 2.0]] * 5
    assert batch["a"] is one


@pytest.mark.parametrize("features", [{"avx512_bf16": True}, {"amx_bf16": True}, {"avx2": True}])
def test_bfloat16_where_the_processor_has_it_and_images_are_convolved(features, monkeypatch):
    monkeypatch.setattr(machine.torch.cpu, "get_capabilities", lambda: features)
    native = "avx2" not in features
    assert uses_bfloat16("auto", CPU, IMAGES) is native
    assert uses_bfloat16("auto", CPU, POINTS) is False
    for model in (IMAGES, POINTS):
        assert uses_bfloat16("bfloat16", CPU, model) is True
        assert uses_bfloat16("float32", CPU, model) is False


def test_the_device(monkeypatch):
    expected = "cuda" if torch.cuda.is_available() else "cpu"
    assert choose_device("auto").type == expected
    assert choose_device("cpu") == CPU


@pytest.mark.parametrize("name", ["", "gpu", "cpu:x", "cuda:99", None, 1.5])
def test_a_device_that_is_not_there_is_refused(name):
    with pytest.raises(ValueError, match="^device: "):
        choose_device(name)


@pytest.mark.parametrize("precision", ["half", None, 16, ""])
def test_a_precision_that_is_unknown_is_refused(precision):
    with pytest.raises(ValueError, match="^precision: .*'bfloat16'"):
        uses_bfloat16(precision, CPU, IMAGES)


def test_a_device_that_holds_no_numbers_is_refused():
    with pytest.raises(ValueError, match="^device: expected .* that computes, got 'meta'"):
        choose_device("meta")


@pytest.mark.parametrize(
    ("variables", "place"),
    [
        ({}, (0, 1)),
        ({"WORLD_SIZE": "1"}, (0, 1)),
        ({"RANK": "0"}, (0, 1)),
        ({"WORLD_SIZE": "4", "RANK": "3"}, (3, 4)),
        ({"RANK": "3"}, "RANK: expected an integer from 0 to 0, below WORLD_SIZE; .* got '3'"),
        ({"RANK": "one"}, "RANK: .* got 'one'"),
        ({"RANK": "-1"}, "RANK: .* got '-1'"),
        ({"WORLD_SIZE": "2"}, "RANK: .* from 0 to 1, .* got nothing"),
        ({"WORLD_SIZE": "2", "RANK": "2"}, "RANK: .* from 0 to 1, .* got '2'"),
        ({"WORLD_SIZE": "2", "RANK": ""}, "RANK: .* got ''"),
        ({"WORLD_SIZE": "0"}, "WORLD_SIZE: expected an integer of at least 1; .* got '0'"),
        ({"WORLD_SIZE": "0", "RANK": "0"}, "WORLD_SIZE: "),
        ({"WORLD_SIZE": ""}, "WORLD_SIZE: .* got ''"),
        ({"WORLD_SIZE": "two", "RANK": "0"}, "WORLD_SIZE: .* got 'two'"),
    ],
)
def test_what_torchrun_says(variables, place, monkeypatch):
    for name in ("WORLD_SIZE", "RANK"):
        monkeypatch.delenv(name, raising=False)
        if name in variables:
            monkeypatch.setenv(name, variables[name])
    if isinstance(place, tuple):
        assert launched() == place
        return
    for ask in (launched, lambda: Processes.joined(CPU)):
        with pytest.raises(ValueError, match=f"^{place}"):
            ask()
