"""Checkpoints are whole or not at all, and a damaged one is named."""

import re
import tempfile
from pathlib import Path

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from posecore.training import History, fit
from posecore.training.checkpoints import Checkpoints


def run(folder, steps=0, **options):
    """A model, a history and their checkpoints, after so many steps."""
    model, history = nn.Linear(2, 1), History()
    with torch.no_grad():
        model.weight.fill_(steps)
    for step in range(steps):
        history.record({"loss": float(step)})
    settings = options.pop("settings", {"lr": "0.1"})
    return model, history, Checkpoints(folder, settings, model, {"history": history}, **options)


def saved(folder, *steps):
    for step in steps:
        run(folder, step)[2].save(step)


@given(st.lists(st.integers(0, 40), min_size=1, max_size=5, unique=True).map(sorted))
@settings(max_examples=10)
def test_the_newest_comes_back_and_the_one_before_is_kept(steps):
    with tempfile.TemporaryDirectory() as folder:
        saved(folder, *steps)
        model, history, checkpoints = run(folder)
        assert checkpoints.load() == steps[-1]
        assert model.weight.tolist() == [[steps[-1]] * 2]
        assert history.losses.get("loss", []) == [float(step) for step in range(steps[-1])]
        names = {path.name for path in Path(folder).iterdir()}
        assert names == {f"state-{s:08}.pt" for s in steps[-2:]} | {
            f"weights-{s:08}.safetensors" for s in steps[-2:]
        }


@given(data=st.data())
@settings(max_examples=40)
def test_damage_is_found_named_and_the_checkpoint_before_is_taken(data):
    with tempfile.TemporaryDirectory() as folder:
        saved(folder, 3, 5)
        file = data.draw(st.sampled_from(sorted(Path(folder).glob("*05.*"))))
        content = bytearray(file.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1))
        if data.draw(st.booleans()):
            content[place] ^= 1 << data.draw(st.integers(0, 7))
        else:
            del content[place:]  # a file that was cut off
        file.write_bytes(content)
        model, history, checkpoints = run(folder)
        with pytest.warns(UserWarning, match=rf"{re.escape(file.name)} is damaged; training goes"):
            assert checkpoints.load() == 3
        assert model.weight.tolist() == [[3.0, 3.0]] and history.steps == 3
        # What was made anew takes the place of what was damaged.
        run(folder, 5)[2].save(5)
        assert run(folder)[2].load() == 5


def test_where_all_are_damaged_it_begins_anew(tmp_path):
    saved(tmp_path, 1)
    next(tmp_path.glob("*.safetensors")).unlink()
    with pytest.warns(UserWarning, match=r"weights-00000001\.safetensors"):
        assert run(tmp_path)[2].load() == 0


def test_weights_are_for_anybody_and_nothing_is_executed(tmp_path):
    saved(tmp_path, 4)
    weights = safetensors.torch.load_file(tmp_path / "weights-00000004.safetensors")
    assert weights["weight"].tolist() == [[4.0, 4.0]]

    class Bomb:
        def __reduce__(self):
            return print, ("executed",)

    model, history, _ = run(tmp_path / "other", 2)
    history.state_dict = lambda: {"bomb": Bomb()}
    parts = {"history": history}
    Checkpoints(tmp_path / "other", {}, model, parts).save(2)
    with pytest.raises(Exception, match="Weights only load failed"):
        Checkpoints(tmp_path / "other", {}, model, parts).load()


def test_another_model_is_refused(tmp_path):
    saved(tmp_path, 1)
    model, history = nn.Linear(1, 2), History()
    checkpoints = Checkpoints(tmp_path, {"lr": "0.1"}, model, {"history": history})
    with pytest.raises(ValueError, match="^resume: expected a run with this model, got .*weight"):
        checkpoints.load()


@pytest.mark.parametrize("settings", [{}, {"lr": "0.2"}, {"lr": "0.1", "seed": "0"}])
def test_other_settings_are_refused(tmp_path, settings):
    saved(tmp_path, 1)
    with pytest.raises(ValueError, match=f"^resume: .*{'seed' if len(settings) > 1 else 'lr'} "):
        run(tmp_path, settings=settings)[2].load()


def test_without_a_folder_and_in_other_processes_nothing_is_written(tmp_path):
    run(None, 3)[2].save(3)
    run(tmp_path / "run", 3, writes=False)[2].save(3)
    assert not list(tmp_path.iterdir())
    assert run(None)[2].load() == run(tmp_path / "run")[2].load() == 0


def test_what_others_keep_in_the_folder_stays(tmp_path):
    for name in ("state-1.pt", "notes.txt", ".state-00000001.pt.0123456789abcdef.tmp"):
        (tmp_path / name).write_text("mine")
    saved(tmp_path, 1, 2, 3)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"state-1.pt", "notes.txt"} <= names
    assert not any(name.endswith(".tmp") for name in names)


@pytest.mark.slow
def test_a_warning_points_at_fit(tmp_path):
    def loss(net, batch):
        return net(batch).sum()

    options = {"steps": 2, "resume": tmp_path}
    fit(nn.Linear(1, 1), [torch.ones(1, 1)], loss, **options)
    (tmp_path / "state-00000002.pt").write_bytes(b"")
    with pytest.warns(UserWarning, match="is damaged") as caught:
        fit(nn.Linear(1, 1), [torch.ones(1, 1)], loss, **options)
    assert [Path(warning.filename).name for warning in caught] == ["test_checkpoints.py"]


def test_after_the_oldest_damaged_checkpoint_training_begins_anew(tmp_path):
    net = nn.Linear(2, 1)
    checkpoints = Checkpoints(tmp_path, {}, net, {})
    for step in (1, 2):
        checkpoints.save(step)
    for state in tmp_path.glob("state-*.pt"):
        state.write_bytes(b"damaged")
    with pytest.warns(UserWarning) as caught:
        assert checkpoints.load() == 0
    newest, oldest = (str(one.message) for one in caught)
    assert newest.endswith("state-00000002.pt is damaged; training goes on from before it")
    assert oldest.endswith("state-00000001.pt is damaged; training begins anew")
