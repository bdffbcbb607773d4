"""What a page shipped is loaded, or trained again, and the page says which."""

import importlib
import json
from pathlib import Path

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from book.tools import measuring
from book.tools.checking import problems
from book.tools.checkpoints import load_or_train, read_about, resume_folder, stale_weights
from book.tools.contents import find_page
from book.tools.measuring import train
from posecore.weights import digest
from tests.book.tools.small_book import SPECKS, edit, forget

EXPERIMENTS = """
import data_tools
import torch

from book.tools.checkpoints import Training
from folio.ch01_poses.helper import shift


def train_codec():
    return {"weight": torch.rand(2, 3) + shift(), "bias": torch.ones(2)}


def train_eyes():
    views = data_tools.open("specks", split="train")
    return {"w": torch.tensor([float(view.rgb.max()) for view in views])}


CHECKPOINTS = {"codec": Training(train_codec)}
"""
CODEC = "codec.safetensors"


@pytest.fixture
def chapter(folio: Path, monkeypatch):
    """The folder of a chapter that shipped one network, at book scale."""
    monkeypatch.setenv("POSECORE_SCALE", "book")
    folder = folio / "ch01_poses"
    (folder / "experiments.py").write_text(EXPERIMENTS)
    train("1", folio)
    return folder


def load(model, key="codec"):
    """As a page does."""
    forget()
    return load_or_train(importlib.import_module("folio.ch01_poses.experiments"), key, model)


def shipped(chapter):
    return chapter / "weights" / CODEC


def ship(chapter, weights):
    shipped(chapter).write_bytes(safetensors.torch.save(weights))


def note(chapter, **changes):
    """Change what is kept of the training; None takes it away."""
    path = shipped(chapter).with_suffix(".json")
    about = json.loads(path.read_bytes()) | changes
    path.write_text(json.dumps({key: value for key, value in about.items() if value is not None}))


def test_what_is_shipped_is_loaded(chapter, capsys):
    model = nn.Linear(3, 2)
    capsys.readouterr()
    assert load(model) is model
    weights = safetensors.torch.load_file(shipped(chapter))
    assert torch.equal(model.weight, weights["weight"]) and not model.training
    assert capsys.readouterr().out == f"codec: loaded from {CODEC}\n"
    assert stale_weights(shipped(chapter)) == ()


def test_halves_are_loaded_into_a_model_of_floats(chapter, capsys):
    """A large network ships as float16, to stay below 2 MB."""
    experiments = chapter / "experiments.py"
    edit(experiments, ("torch.ones(2)}", "torch.ones(2).half()}"), ("shift(),", "shift().half(),"))
    edit(experiments, ("torch.rand(2, 3) + shift().half()", "(torch.rand(2, 3) + shift()).half()"))
    forget()
    train("1", chapter.parent)
    halves = safetensors.torch.load_file(shipped(chapter))
    assert {tensor.dtype for tensor in halves.values()} == {torch.float16}
    model = load(nn.Linear(3, 2))
    assert model.weight.dtype == torch.float32
    assert torch.equal(model.weight, halves["weight"].float())
    assert capsys.readouterr().out.endswith(f"codec: loaded from {CODEC}\n")
    assert stale_weights(shipped(chapter)) == ()


def test_what_is_trained_here_is_what_would_be_shipped(chapter, capsys, monkeypatch):
    expected = load(nn.Linear(3, 2))
    capsys.readouterr()
    monkeypatch.setenv("POSECORE_RETRAIN", "1")
    model = nn.Linear(3, 2)
    before = torch.get_rng_state()
    load(model)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(model.weight, expected.weight) and not model.training
    assert capsys.readouterr().out == "codec: POSECORE_RETRAIN is 1, so it is trained here\n"


# What has changed since ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: edit(c / "helper.py", ("0.125", "0.25")), "helper.OFFSET"),
        (
            lambda c: edit(c / "experiments.py", ("torch.rand", "torch.randn")),
            "experiments.train",
        ),
        (
            lambda c: edit(c / "experiments.py", ("train_codec", "train_decoder")),
            "folio.ch01_poses.experiments:train_codec is gone",
        ),
        (lambda c: note(c, definitions=None), "how it was trained is not kept"),
    ],
)
def test_what_has_changed_is_told_and_the_weights_are_loaded(change, words, chapter, capsys):
    change(chapter)
    weights = safetensors.torch.load_file(shipped(chapter))
    forget()
    (line,) = stale_weights(shipped(chapter))
    assert line.startswith(words)
    capsys.readouterr()
    model = load(nn.Linear(3, 2))
    assert torch.equal(model.weight, weights["weight"])
    assert capsys.readouterr().out == f"codec: loaded from {CODEC}; stale: {line}\n"


def test_what_computes_nothing_changes_nothing(chapter):
    edit(chapter / "helper.py", ("return OFFSET", "return OFFSET  # an eighth"))
    edit(chapter / "experiments.py", ("def train_codec():", "def train_codec() -> dict:"))
    edit(chapter / "specks.py", ("FAINTEST = 7", "FAINTEST = 9"))  # it opens no dataset
    forget()
    assert stale_weights(shipped(chapter)) == ()


def test_a_dataset_that_has_changed_is_told(chapter):
    line = 'CHECKPOINTS = {"eyes": Training(train_eyes, data=("specks/train",))}'
    edit(chapter / "experiments.py", ('CHECKPOINTS = {"codec": Training(train_codec)}', line))
    forget()
    (path,) = train("1", chapter.parent)
    assert stale_weights(path) == ()
    edit(chapter / "specks.py", ("FAINTEST = 7", "FAINTEST = 9"))
    forget()
    assert stale_weights(path) == ("specks.FAINTEST",)
    (chapter / "specks.py").write_text(SPECKS.replace('"train": 4', '"train": 5'))
    forget()
    assert stale_weights(path) == ("specks: train count",)


# What cannot be loaded ----------------------------------------------------------------------------


def cut(chapter):
    shipped(chapter).write_bytes(shipped(chapter).read_bytes()[:-9])


def damage(chapter):
    shipped(chapter).with_suffix(".json").write_text('{"module": "folio')


def flip(chapter):
    """One bit of the last tensor."""
    data = bytearray(shipped(chapter).read_bytes())
    data[-2] ^= 1
    shipped(chapter).write_bytes(bytes(data))


def spoil(change):
    def function(chapter):
        weights = safetensors.torch.load_file(shipped(chapter))
        ship(chapter, {name: change(tensor) for name, tensor in weights.items()})

    return function


def spoil_and_note(chapter):
    """With a digest that fits."""
    spoil(lambda tensor: tensor * torch.nan)(chapter)
    note(chapter, digest=digest(safetensors.torch.load_file(shipped(chapter))))


OTHER = f"{CODEC} holds other weights than were trained"
SPOILT = [
    (flip, OTHER),
    (spoil(lambda tensor: tensor * torch.nan), OTHER),
    (spoil(lambda tensor: tensor * 0), OTHER),
    (spoil(lambda tensor: tensor.double()), OTHER),
    (spoil(lambda tensor: tensor.half()), OTHER),
    (spoil(lambda tensor: torch.ones_like(tensor)), OTHER),
    (spoil_and_note, f"{CODEC}: expected finite weights, got others in "),
]


@pytest.mark.parametrize("change, words", SPOILT)
def test_spoilt_weights_are_no_fresh_ones_nor_fit_to_be_committed(chapter, change, words):
    change(chapter)
    (line,) = stale_weights(shipped(chapter))
    assert line.startswith(words)
    page = find_page("01_poses", chapter.parent)
    lines = [line for line in problems(chapter.parent, [page]) if "weights" in line]
    assert len(lines) == 1 and lines[0].startswith(f"ch01_poses/weights: {words}")


def test_a_network_that_is_gone_is_no_fit_book(chapter):
    page = find_page("01_poses", chapter.parent)
    assert not [line for line in problems(chapter.parent, [page]) if "weights" in line]
    shipped(chapter).unlink()
    line = f"ch01_poses/weights: {CODEC} is missing beside codec.json"
    assert line in problems(chapter.parent, [page])


@pytest.mark.parametrize(
    "change, words",
    [
        *SPOILT,
        (lambda c: shipped(c).unlink(), f"there is no {CODEC}, so"),
        (cut, f"{CODEC} is damaged ("),
        (lambda c: shipped(c).write_bytes(b""), f"{CODEC} is damaged ("),
        (lambda c: ship(c, {"a": torch.ones(1)}), f"{CODEC} is of another model ("),
        (lambda c: note(c, scale="tiny"), f"{CODEC} was made at tiny scale and this is book"),
        (lambda c: note(c, digest=None), "codec.json is damaged: KeyError('digest')"),
        (damage, "codec.json is damaged: JSONDecodeError("),
        (
            lambda c: shipped(c).with_suffix(".json").unlink(),
            f"no codec.json says how {CODEC} was made",
        ),
    ],
)
def test_what_cannot_be_loaded_is_trained_and_said_why(chapter, capsys, change, words):
    expected = load(nn.Linear(3, 2))
    capsys.readouterr()
    change(chapter)
    model = load(nn.Linear(3, 2))
    assert torch.equal(model.weight, expected.weight)
    said = capsys.readouterr().out
    assert said.startswith(f"codec: {words}") and said.count("\n") == 1
    assert said.endswith(", so it is trained here\n") and str(chapter) not in said


def test_what_is_said_of_files_that_are_not_whole(chapter):
    path = shipped(chapter)
    about = read_about(path)
    assert about["function"] == "train_codec" and about["scale"] == "book"
    cut(chapter)
    (line,) = stale_weights(path)
    assert line.startswith(f"{CODEC} cannot be read: ")
    damage(chapter)
    for read in (read_about, stale_weights):
        with pytest.raises(ValueError, match=r"^codec\.json is damaged: JSONDecodeError"):
            read(path)
    path.with_suffix(".json").unlink()
    assert read_about(path) == {}
    assert stale_weights(path) == ("no codec.json says how it was trained",)


def test_tiny_always_trains(chapter, capsys, monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    capsys.readouterr()
    load(nn.Linear(3, 2))
    words = f"codec: {CODEC} was made at book scale and this is tiny, so it is trained here\n"
    assert capsys.readouterr().out == words


def test_bad_input_is_refused(chapter, capsys):
    with pytest.raises(ValueError, match=r"^key: expected .*'codec'.*, got 'codes'"):
        load(nn.Linear(3, 2), "codes")
    edit(chapter / "experiments.py", ('"weight"', '"height"'))
    shipped(chapter).unlink()
    with pytest.raises(ValueError, match=r"^model: .*train_codec, got .*weight"):
        load(nn.Linear(3, 2))
    edit(chapter / "experiments.py", ("CHECKPOINTS", "OTHERS"))
    with pytest.raises(ValueError, match="^key: "):
        load(nn.Linear(3, 2))


# Trainings that go on -----------------------------------------------------------------------------


@settings(max_examples=10)
@given(st.lists(st.one_of(st.integers(), st.text(max_size=5)), max_size=3))
def test_a_resume_folder_is_one_name_in_the_cache(details):
    folder = resume_folder(measuring.status, *details)
    assert folder == resume_folder(measuring.status, *details)
    assert folder.parent.name == "training" and folder.is_absolute()
    assert folder.name.startswith("measuring-status-") and folder.name.isascii()
    assert folder != resume_folder(measuring.status, *details, "another")
    assert not folder.exists()


def test_other_code_scale_or_data_resumes_elsewhere(chapter, monkeypatch):
    def where(**more):
        forget()
        experiments = importlib.import_module("folio.ch01_poses.experiments")
        return resume_folder(experiments.train_eyes, 1, **more)

    one, two = where(), where(data=("specks/train",))
    assert one != two and where() == one and where(data=("specks/train",)) == two
    edit(chapter / "specks.py", ("FAINTEST = 7", "FAINTEST = 9"))
    assert where() == one and where(data=("specks/train",)) != two
    edit(chapter / "specks.py", ("FAINTEST = 9", "FAINTEST = 7  # again"))
    assert where(data=("specks/train",)) == two
    edit(chapter / "experiments.py", ("view.rgb.max()", "view.rgb.min()"))
    assert where() != one
    edit(chapter / "experiments.py", ("view.rgb.min()", "view.rgb.max()"))
    assert where() == one
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    assert where() != one
    with pytest.raises(ValueError, match="function: expected a function at the top level"):
        resume_folder(lambda: None)
