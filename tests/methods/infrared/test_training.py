"""`train infrared`: what it learns from, that it can be stopped, and what it refuses."""

from dataclasses import replace
from functools import partial, wraps
from pathlib import Path

import pytest
import torch

from posecore.methods import training as every_training
from posecore.methods.infrared.losses import CloudLoss
from posecore.methods.infrared.network import CloudNet
from posecore.methods.infrared.projection import Projector
from posecore.methods.infrared.recipe import RECIPES
from posecore.methods.infrared.runs import read_run
from posecore.methods.infrared.training import folds_of
from posecore.methods.main import main
from posecore.training import fit
from tests.methods.infrared.commands import WEIGHTS, contents, train_words
from tests.methods.infrared.dots import SIZE, cameras
from tests.methods.refusing import refused


@pytest.mark.parametrize(
    ("scenes", "folds", "expected"),
    [
        ([5, 2, 5, 9], 1, [[2, 5, 9]]),
        ([5, 2, 5, 9], 2, [[5], [2, 9]]),
        ([5, 2, 5, 9], 3, [[5, 9], [2, 9], [2, 5]]),
        ([4], 1, [[4]]),
    ],
)
def test_folds_leave_out_scenes_in_turns(scenes, folds, expected):
    assert folds_of(torch.tensor(scenes), folds) == expected


def test_more_folds_than_scenes():
    with pytest.raises(ValueError, match="^--folds: expected at most the 2 scenes"):
        folds_of(torch.tensor([1, 1, 2]), 3)


@pytest.mark.slow
def test_a_step_at_the_papers_scale():
    recipe = RECIPES["paper"]
    net = CloudNet(
        recipe.image, recipe.points, width=recipe.width, blocks=recipe.blocks, hidden=recipe.hidden
    )
    net.low.copy_(torch.tensor([-0.2, -0.2, 0.5])), net.high.copy_(torch.tensor([0.2, 0.2, 1]))
    K = torch.tensor([[1.17 * 320, 0, 159.5], [0, 1.17 * 320, 93.5], [0, 0, 1]])
    poses = torch.from_numpy(cameras()).float()
    masks = torch.zeros(1, 3, 94, 160)
    masks[..., 20:70, 60:100] = 1
    batch = {
        "images": torch.rand(1, 1, 188, 320), "t": torch.tensor([[0, 0, 0.75]]),
        "own": poses[1:2], "K": K.expand(1, 3, 3, 3), "T_world_cam": poses[None],
        "masks": masks, "shades": 0.5 * masks, "done": torch.tensor(0.9),
    }  # fmt: skip
    parts = recipe.new_loss(recipe.image)(net, batch)
    parts["loss"].backward()
    assert parts.keys() == {"loss", "translation", "mask", "intensity"}
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
        assert parameter.grad.any(), name


def test_it_learns_a_dot(triples):
    """In a few dozen steps masks are met better, and places too."""
    recipe = replace(
        RECIPES["tiny"], image=SIZE, grid=(32, 24, 16), extent=0.5, points=60, width=4, blocks=3,
        hidden=32, mirror=False, looks=None, max_scale=1.0, batch=6, steps=60,
        loss=partial(CloudLoss, blur=(2.0, 0.6), keep=(0.5, 1.0)),
    )  # fmt: skip
    net = recipe.new_net(triples)
    loss = recipe.new_loss(triples.size)
    assert loss.projector == Projector(SIZE, (32, 24, 16), 0.5)
    history = fit(net, recipe.batches(triples), loss, steps=60, show=False, **recipe.fit)
    for name, share in (("mask", 0.5), ("translation", 0.5)):
        values = history.losses[name]
        assert sum(values[-5:]) < share * sum(values[:5]), name


# The command --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_holds_all_that_its_networks_need(run):
    found = read_run(run)
    assert found.options == {
        "data": "headset", "split": "test", "scale": "tiny", "steps": 4, "batch": 2,
        "masks": "exact", "folds": 2, "small": False, "seed": 0,
    }  # fmt: skip
    assert found.scenes == [[13, 15], [12, 14]]
    tiny = RECIPES["tiny"]
    assert (found.image, found.points, found.width) == (tiny.image, tiny.points, tiny.width)
    one, other = found.load_nets()
    assert not torch.equal(one.points.weight, other.points.weight)
    assert one.low.tolist() != other.low.tolist()  # each knows the places of its own scenes only
    assert not list(run.glob(".*"))


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_bit_for_bit(run, tmp_path, monkeypatch, capsys):
    """In the second network, by the keyboard."""
    monkeypatch.setattr(every_training, "fit", partial(fit, save_seconds=0))
    loss, calls = CloudLoss.__call__, []

    @wraps(loss)
    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 7:
            raise KeyboardInterrupt
        return loss(*arguments)

    monkeypatch.setattr(CloudLoss, "__call__", interrupted)
    words, out = train_words(tmp_path / "again"), tmp_path / "again"
    with pytest.raises(SystemExit, match="130"):
        main(words)
    assert "goes on" in capsys.readouterr().err
    assert (out / "net0.safetensors").exists() and not (out / "net1.safetensors").exists()
    assert main(words) == 0
    assert len(calls) == 7 + 2
    assert contents(out) == contents(run)


@pytest.mark.slow
def test_a_finished_run_stays_as_it_is(run, monkeypatch):
    monkeypatch.setattr(CloudLoss, "__call__", None)
    before = contents(run)
    assert main(train_words(run)) == 0
    assert contents(run) == before


@pytest.mark.slow
def test_one_network_of_all_scenes_by_the_threshold(tmp_path):
    words = train_words(tmp_path, "--folds", "1", "--masks", "threshold", "--steps", "1")
    assert main(words) == 0
    found = read_run(tmp_path)
    assert found.names == ["net"] and found.scenes == [[12, 13, 14, 15]]
    assert found.options["masks"] == "threshold"
    assert (tmp_path / "net.safetensors").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "nonsense"], "--data: expected"),
        (["--data", "tabletop", "--split", "easy"], "--data: tabletop: data: expected infrared"),
        (["--split", "holidays"], "--split: expected"),
        (["--objects", "1"], "--objects: expected nothing"),
        (["--folds", "0"], "--folds: expected"),
        (["--folds", "5"], "--folds: expected at most the 4 scenes"),
        (["--steps", "0"], "--steps: expected"),
        (["--batch", "0"], "--batch: expected"),
        (["--seed", "-1"], "--seed: expected"),
        (["--device", "moon"], "device: expected"),
        (["--out", "FILE"], "--out: expected a folder"),
    ],
)
def test_bad_options(tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_text("")
    refused(capsys, train_words("run", *options), message)
    assert not Path("run").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [["--steps", "5"], ["--batch", "3"], ["--masks", "threshold"], ["--folds", "3"],
     ["--seed", "1"], ["--small"]],
)  # fmt: skip
def test_another_runs_options_are_named(run, capsys, options):
    before = contents(run, ("run.json", *WEIGHTS))
    refused(capsys, train_words(run, *options), f"{options[0]}: expected")
    assert contents(run, ("run.json", *WEIGHTS)) == before
