"""`train vector_field`: what it learns from, that it can be stopped, and what it refuses."""

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
from functools import partial, wraps
from pathlib import Path

import pytest
import safetensors.torch

from data_tools.batches import CropPool, RandomCrops
from data_tools.bop import read_results
from posecore.methods import training as every_training
from posecore.methods.main import main
from posecore.methods.vector_field import predictions, training
from posecore.methods.vector_field.masked_fields import predict_fields
from posecore.methods.vector_field.objective import Objective
from posecore.methods.vector_field.recipe import RECIPES
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.runs import read_run
from posecore.nets.resnet import ResNet
from posecore.training import fit
from posecore.training.loop import ADAM
from tests.launched import two_launched
from tests.methods.refusing import refused
from tests.methods.vector_field.commands import (
    WEIGHTS,
    contents,
    estimate_words,
    train_words,
)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
ENVIRONMENT = {name: value for name, value in os.environ.items() if "proxy" not in name.lower()}
ENVIRONMENT["PYTHONPATH"] = os.pathsep.join([str(ROOT), *sys.path])


def taught(monkeypatch, words):
    """What a command's training is given: crops, batches, loss and all else of `fit`."""
    given = {}

    def kept_fit(model, batches, objective, **options):
        given.update(options, batches=batches, loss=objective.loss)
        return fit(model, batches, objective, **options)

    monkeypatch.setattr(every_training, "fit", kept_fit)
    assert main([*words, "--refiner-steps", "0"]) == 0
    return given


@pytest.mark.parametrize(("steps", "crops"), [(2, 8), (20, 64)])
def test_crops_are_cut_once_and_no_more_than_are_drawn(source, tmp_path, monkeypatch, steps, crops):
    given = taught(monkeypatch, train_words(source, tmp_path, "--steps", str(steps)))
    drawn = given["batches"]
    pool = drawn.make.__self__
    assert isinstance(pool, CropPool) and len(pool) == crops
    assert (drawn.steps, drawn.batch_size) == (steps, 4)
    tiny = RECIPES["tiny"]
    for name, value in tiny.fit_field.items():
        assert given[name] == value
    assert (given["loss"].weight, given["loss"].ignore_reversed) == (0.05, True)


def test_a_recipe_without_a_pool(source, tmp_path, monkeypatch):
    plain = dataclasses.replace(
        RECIPES["tiny"], pool=None, ignore_reversed=False, optimiser=ADAM, image_width=64
    )
    monkeypatch.setitem(training.RECIPES, "tiny", plain)
    given = taught(monkeypatch, train_words(source, tmp_path))
    crops = given["batches"].make.__self__
    assert isinstance(crops, RandomCrops) and crops.zoom == 64 / 96 and crops.size == (64, 48)
    assert given["optimiser"] is ADAM and not given["loss"].ignore_reversed
    found = read_run(tmp_path)
    assert (found.options["ignore_reversed"], found.image_width) == (False, 64)


def test_the_loss_that_was_asked_for(source, tmp_path, monkeypatch):
    more = ["--warmup", "0.5", "--no-ignore-reversed", "--weight", "0.1"]
    loss = taught(monkeypatch, train_words(source, tmp_path, *more))["loss"]
    assert (loss.warmup, loss.ignore_reversed, loss.weight) == (0.5, False, 0.1)
    assert [loss.beta(done) for done in (0, 0.49, 0.5, 1)] == [0, 0, 0.1, 0.1]
    found = read_run(tmp_path).options
    assert (found["warmup"], found["ignore_reversed"]) == (0.5, False)


# Stopped, and several processes ------------------------------------------------------------------

KILLED = """
import functools, os, signal, sys
from posecore.methods.main import main
from posecore.methods import training as every_training
from posecore.methods.vector_field.objective import Objective
every_training.fit = functools.partial(every_training.fit, save_seconds=0)
step, calls = Objective.__call__, []
def dying(*arguments):
    calls.append(1)
    if len(calls) == 8:
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
    return step(*arguments)
Objective.__call__ = dying
main(sys.argv[1:])
"""


def test_a_run_that_was_killed_goes_on_bit_for_bit(run, source, tmp_path, monkeypatch, capsys):
    words, out = train_words(source, tmp_path / "again"), tmp_path / "again"
    done = subprocess.run([sys.executable, "-c", KILLED, *words], env=ENVIRONMENT)
    assert done.returncode == -getattr(signal, "SIGKILL", signal.SIGTERM)
    assert (out / "checkpoints/net/state-00000007.pt").exists()
    assert not (out / "net.safetensors").exists()

    # Once more, now by the keyboard, while the refiner is trained.
    monkeypatch.setattr(every_training, "fit", partial(fit, save_seconds=0))
    loss, calls = RefinerTraining.loss, []

    @wraps(loss)
    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return loss(*arguments)

    monkeypatch.setattr(RefinerTraining, "loss", interrupted)
    with pytest.raises(SystemExit, match="130"):
        main(words)
    assert "goes on" in capsys.readouterr().err
    assert (out / "checkpoints/refiner/state-00000003.pt").exists()
    assert not (out / "refiner.safetensors").exists()

    assert main(words) == 0
    assert len(calls) == 4 + 3
    assert contents(out) == contents(run)


def test_a_finished_run_stays_as_it_is(run, source, monkeypatch):
    monkeypatch.setattr(Objective, "__call__", None)
    monkeypatch.setattr(RandomCrops, "draw", None)  # nor are crops cut again
    before = contents(run)
    assert main(train_words(source, run)) == 0
    assert contents(run) == before


def test_two_processes(run, source, tmp_path, capsys):
    out = tmp_path / "two"
    words = [sys.executable, "-m", "posecore", *train_words(source, out)]
    both = [
        subprocess.Popen(
            words, env=ENVIRONMENT | {"OMP_NUM_THREADS": "1"} | launched,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for launched in two_launched()
    ]  # fmt: skip
    with both[0], both[1]:
        try:
            said = [process.communicate(timeout=240) for process in both]
        finally:
            for process in both:
                process.kill()
    assert [process.returncode for process in both] == [0, 0], said
    lines = "".join(out for out, _ in said).splitlines()
    assert [line.split(":")[0] for line in lines] == ["net", "refiner"]
    assert (out / "run.json").read_bytes() == (run / "run.json").read_bytes()
    for name in WEIGHTS:
        two, one = (safetensors.torch.load_file(path / name) for path in (out, run))
        assert two.keys() == one.keys()
        assert all(value.isfinite().all() for value in two.values())
    assert contents(out, WEIGHTS) != contents(run, WEIGHTS)  # batches are normalised in halves
    output = tmp_path / "out.csv"
    assert main(estimate_words(out, source, output, "--split", "test")) == 0
    assert len(read_results(output)) > 0
    assert main(["evaluate", str(output), source, "--split", "test"]) == 0


# What cannot be ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "bop:nowhere"], "nowhere"),
        (["--data", "nonsense"], "--data: expected"),
        (["--data", "linemod:nowhere"], "nowhere"),
        (["--data", "categories"], "1019, ..., which categories has, got [1, 3]"),
        (["--split", "holidays"], "split: expected"),
        (["--objects", "1", "99"], "--objects: expected some of 1, 2, 3, 4, 5, 6, 7, 8, which"),
        (["--steps", "0"], "--steps"),
        (["--refiner-steps", "-1"], "--refiner-steps"),
        (["--batch", "0"], "--batch"),
        (["--seed", "-1"], "--seed"),
        (["--weight", "heavy"], "--weight: expected dynamic"),
        (["--weight", "-1"], "--weight"),
        (["--weight", "nan"], "--weight"),
        (["--warmup", "1.5"], "--warmup: expected"),
        (["--warmup", "-0.1"], "--warmup: expected"),
        (["--warmup", "nan"], "--warmup: expected"),
        (["--device", "moon"], "device"),
        (["--imagenet", "nowhere.pth"], "nowhere.pth"),
        (
            ["--imagenet", "WIDE.safetensors"],
            "--imagenet: path: expected conv1.weight of shape (8",
        ),
        (["--out", "FILE"], "--out: expected a folder"),
    ],
)
def test_bad_options_of_training(source, tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    safetensors.torch.save_file(ResNet(16).state_dict(), "WIDE.safetensors")
    Path("FILE").write_text("")
    refused(capsys, train_words(source, "run", *options), message)
    assert not Path("run").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--steps", "13"], ["--refiner-steps", "0"], ["--seed", "1"], ["--objects", "1"],
        ["--batch", "2"], ["--weight", "0.1"], ["--projection", "unit"], ["--warmup", "0.2"],
        ["--no-ignore-reversed"],
    ],
)  # fmt: skip
def test_another_runs_options_are_named(run, source, capsys, options):
    before = contents(run)
    name = options[0].replace("--no-", "--")
    refused(capsys, train_words(source, run, *options), f"{name}: expected")
    assert contents(run) == before


def test_data_without_colours_or_masks(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for missing, message in (("mask_visib", "--data: expected data with masks"), ("rgb", "colour")):
        shutil.copytree(folder / "bop", missing)
        for path in Path(missing).glob(f"*/*/{missing}"):
            shutil.rmtree(path)
        refused(capsys, train_words(f"bop:{missing}", "out"), message)
    assert not Path("out").exists()


def test_a_field_that_sees_nothing(source, tmp_path, capsys, monkeypatch):
    def blind(net, images):
        return predict_fields(net, images, min_pixels=10**6)

    monkeypatch.setattr(predictions, "predict_fields", blind)
    words = train_words(source, tmp_path / "run", "--steps", "1")
    assert main(words) == 2
    assert "--steps: expected enough" in capsys.readouterr().err
    assert (tmp_path / "run" / "net.safetensors").exists()
