"""What a page shipped is loaded, or trained again, and the page says which."""

import importlib
import json
import sys

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from book.tools import measuring as ledgers
from book.tools.checkpoints import load_or_train, resume_folder

PAGE = "05_turns"
EXPERIMENTS = """
import torch

def train_codec():
    return {"weight": torch.rand(2, 3), "bias": torch.ones(2)}

def train_nothing():
    return {}

CHECKPOINTS = {"codec": train_codec, "nothing": train_nothing}
"""


@pytest.fixture
def book(tmp_path, monkeypatch):
    """A book with one page, which ships one network, at book scale."""
    name = f"book_of_{tmp_path.name}"
    folder = tmp_path / name
    (folder / "experiments").mkdir(parents=True)
    (folder / "experiments" / f"{PAGE}.py").write_text(EXPERIMENTS)
    monkeypatch.setenv("POSECORE_SCALE", "book")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    module = importlib.import_module(f"{name}.experiments.{PAGE}")
    with torch.random.fork_rng():
        torch.manual_seed(ledgers.SEED)
        weights = module.train_codec()
    ship(folder, weights, code=ledgers.code_hash(module.__name__), scale="book")
    yield folder
    for loaded in [key for key in sys.modules if key.startswith(name)]:
        del sys.modules[loaded]


def ship(book, weights, **about):
    (book / "checkpoints").mkdir(exist_ok=True)
    data = safetensors.torch.save(weights, {"posecore": json.dumps(about)})
    shipped(book).write_bytes(data)


def shipped(book):
    return book / "checkpoints" / f"{PAGE}.codec.safetensors"


def test_what_is_shipped_is_loaded(book, capsys):
    model = nn.Linear(3, 2)
    assert load_or_train(PAGE, "codec", model, book=book) is model
    weights = safetensors.torch.load_file(shipped(book))
    assert torch.equal(model.weight, weights["weight"]) and not model.training
    assert capsys.readouterr().out == f"codec: loaded from {PAGE}.codec.safetensors\n"


def test_what_is_trained_here_is_what_would_be_shipped(book, capsys, monkeypatch):
    expected = load_or_train(PAGE, "codec", nn.Linear(3, 2), book=book)
    capsys.readouterr()
    monkeypatch.setenv("POSECORE_RETRAIN", "1")
    model = nn.Linear(3, 2)
    before = torch.get_rng_state()
    load_or_train(PAGE, "codec", model, book=book)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(model.weight, expected.weight) and not model.training
    assert capsys.readouterr().out == "codec: POSECORE_RETRAIN is 1, so it is trained here\n"


def test_code_that_has_changed_is_told(book, capsys):
    ship(book, {"weight": torch.ones(2, 3), "bias": torch.ones(2)}, code="old", scale="book")
    model = load_or_train(PAGE, "codec", nn.Linear(3, 2), book=book)
    assert model.weight.tolist() == [[1.0] * 3] * 2
    assert "loaded from" in (said := capsys.readouterr().out)
    assert said.endswith("; stale: the code has changed since\n")


def cut(book):
    shipped(book).write_bytes(shipped(book).read_bytes()[:-9])


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda book: shipped(book).unlink(), f"there is no {PAGE}.codec.safetensors, so"),
        (cut, f"{PAGE}.codec.safetensors is damaged ("),
        (lambda book: shipped(book).write_bytes(b""), "is damaged ("),
        (lambda book: ship(book, {"a": torch.ones(1)}, scale="book"), "is of another model ("),
        (lambda book: ship(book, {"a": torch.ones(1)}, scale="tiny"), "made at tiny scale"),
        (lambda book: ship(book, {"a": torch.ones(1)}), "made at None scale and this is book"),
    ],
)
def test_what_cannot_be_loaded_is_trained_and_said_why(book, capsys, change, words):
    expected = load_or_train(PAGE, "codec", nn.Linear(3, 2), book=book)
    capsys.readouterr()
    change(book)
    model = load_or_train(PAGE, "codec", nn.Linear(3, 2), book=book)
    assert torch.equal(model.weight, expected.weight)
    said = capsys.readouterr().out
    assert words in said and said.endswith(", so it is trained here\n") and said.count("\n") == 1


def test_tiny_always_trains(book, capsys, monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    load_or_train(PAGE, "codec", nn.Linear(3, 2), book=book)
    assert "made at book scale and this is tiny, so it is trained" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("06_absent", "codec", nn.Linear(3, 2)), "^page: .*'05_turns'"),
        ((PAGE, "codes", nn.Linear(3, 2)), "^key: .*'codec'"),
        ((PAGE, "nothing", nn.Linear(3, 2)), "^model: .*train_nothing, got .*weight"),
    ],
)
def test_bad_input_is_refused(book, arguments, words):
    with pytest.raises(ValueError, match=words):
        load_or_train(*arguments, book=book)


@settings(max_examples=10)
@given(st.lists(st.one_of(st.integers(), st.text(max_size=5)), max_size=3))
def test_a_resume_folder_is_one_name_in_the_cache(details):
    folder = resume_folder(ledgers.train, *details)
    assert folder == resume_folder(ledgers.train, *details)
    assert folder.parent.name == "training" and folder.is_absolute()
    assert folder.name.startswith("ledgers-train-") and folder.name.isascii()
    assert folder != resume_folder(ledgers.train, *details, "another")
    assert not folder.exists()


def test_other_code_or_scale_resumes_elsewhere(monkeypatch):
    one = resume_folder(ledgers.train, 1)
    assert one != resume_folder(ledgers.claims, 1)
    monkeypatch.setenv("POSECORE_SCALE", "book")
    assert one != resume_folder(ledgers.train, 1)
