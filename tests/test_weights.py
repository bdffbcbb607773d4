"""The digest by which the weights of a network are known."""

import re

import pytest
import safetensors
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from posecore.weights import digest, fill, pack, unpack

NET = {"layer.weight": torch.arange(6.0).reshape(2, 3), "layer.bias": torch.ones(2)}


def changed(name: str, tensor: torch.Tensor) -> str:
    return digest({**NET, name: tensor})


def test_the_same_weights_have_one_digest_whatever_their_order() -> None:
    first = digest(NET)
    assert re.fullmatch("[0-9a-f]{16}", first)
    assert digest(dict(reversed(NET.items()))) == first
    assert digest({name: tensor.clone() for name, tensor in NET.items()}) == first


def test_it_stays_what_it_is() -> None:
    """Ledgers and notes beside weights keep it: another one would make every network stale."""
    assert digest(NET) == "304d5a46fba9002b"


def test_names_values_shapes_and_kinds_count() -> None:
    weight, bias = NET.values()
    others = [
        digest({}),
        digest({"layer.weight": weight}),
        digest({"layer.weights": weight, "layer.bias": bias}),
        digest({"layer.weight": weight.reshape(3, 2), "layer.bias": bias}),
        changed("layer.bias", torch.tensor([1.0, 1.0000001])),
        changed("layer.bias", bias.double()),
        changed("layer.bias", bias.half()),
        changed("layer.bias", bias.bfloat16()),
        changed("layer.bias", bias.reshape(1, 2)),
        changed("more", torch.zeros(0)),
        changed("more", torch.zeros(0, 3)),
        changed("more", torch.zeros(())),
    ]
    assert len({digest(NET), *others}) == len(others) + 1


def test_bits_count_and_not_values() -> None:
    nan, zero = torch.tensor([float("nan")]), torch.tensor([0.0])
    assert digest({"w": nan}) == digest({"w": nan.clone()})
    assert digest({"w": zero}) != digest({"w": -zero})


def test_how_they_lie_in_memory_does_not_count() -> None:
    weight = torch.rand(4, 3, generator=torch.Generator().manual_seed(0))
    for other in (
        weight.T.contiguous().T,
        torch.stack([weight, weight])[1],
        weight.clone().requires_grad_(),
        nn.Parameter(weight),
        weight.conj(),
    ):
        assert digest({"w": other}) == digest({"w": weight})


def test_a_network_and_its_weights_read_again() -> None:
    net = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2)).bfloat16()
    before = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    assert digest(net.state_dict()) == digest(before)
    with torch.no_grad():
        net[0].bias += 1
    assert digest(net.state_dict()) != digest(before)


@given(st.lists(st.floats(width=32), max_size=4), st.lists(st.floats(width=32), max_size=4))
def test_two_of_the_same_digest_are_the_same_to_the_bit(a: list[float], b: list[float]) -> None:
    one, two = (torch.tensor(numbers, dtype=torch.float32) for numbers in (a, b))
    same = len(a) == len(b) and torch.equal(one.view(torch.int32), two.view(torch.int32))
    assert (digest({"w": one}) == digest({"w": two})) == same


# Files --------------------------------------------------------------------------------------------


def test_tied_weights_are_written_once_for_each_name() -> None:
    one = torch.arange(6.0).reshape(2, 3)
    found = unpack(pack({"one": one, "tied": one, "part": one[1:]}))
    assert torch.equal(found["tied"], one) and torch.equal(found["part"], one[1:])


def test_a_file_holds_the_digest_of_its_tensors_and_any_reader_reads_it(tmp_path) -> None:
    data = pack(NET | {"turned": NET["layer.weight"].T})
    assert pack(NET | {"turned": NET["layer.weight"].T}) == data
    found = unpack(data)
    assert found.keys() == {*NET, "turned"}
    assert all(torch.equal(found[name], NET[name]) for name in NET)
    assert safetensors.torch.load(data).keys() == found.keys()
    (tmp_path / "net.safetensors").write_bytes(data)
    with safetensors.safe_open(tmp_path / "net.safetensors", "pt") as file:
        assert file.metadata() == {"digest": digest(found)}


@given(st.data())
def test_no_flipped_bit_of_a_tensor_passes(data: st.DataObject) -> None:
    packed = bytearray(pack(NET))
    bodies = 4 * sum(tensor.numel() for tensor in NET.values())
    place = data.draw(st.integers(1, bodies))
    packed[-place] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(ValueError, match="^other weights than were written: digest"):
        unpack(bytes(packed))


@given(place=st.integers(0, 10**6), value=st.integers(0, 255))
def test_any_changed_byte_is_refused_or_changes_nothing(place: int, value: int) -> None:
    packed = bytearray(pack(NET))
    packed[place % len(packed)] = value
    try:
        found = unpack(bytes(packed))
    except ValueError:
        return
    assert digest(found) == digest(NET)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "damaged: "),
        (bytes(300), "damaged: "),
        (pack(NET)[:-1], "damaged: "),
        (safetensors.torch.save({}), "no weights, or only zeros"),
        (safetensors.torch.save({"a": torch.zeros(3)}), "no weights, or only zeros"),
        (pack({"a": torch.tensor([1, torch.nan])}), "expected finite weights, got others in a"),
        (pack({"b": torch.tensor(-torch.inf)}), "expected finite weights, got others in b"),
    ],
)
def test_what_no_network_has_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=f"^{words}"):
        unpack(data)


def test_a_model_is_filled_with_its_own_dtypes() -> None:
    model = nn.Linear(3, 2)
    fill(model, {"weight": torch.ones(2, 3), "bias": torch.zeros(2)})
    assert model.weight.sum() == 6 and not model.bias.any()
    before = model.weight.clone()
    with pytest.raises(ValueError, match=r"^expected torch.float32 in bias, got torch.float16$"):
        fill(model, {"weight": torch.zeros(2, 3), "bias": torch.ones(2).half()})
    assert torch.equal(model.weight, before)
    with pytest.raises(RuntimeError, match="Missing key"):
        fill(model, {"weight": torch.zeros(2, 3)})
