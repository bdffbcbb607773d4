"""`train vector_field` and `estimate vector_field`: from data to figures, and what they refuse."""

import dataclasses
import json
import math
import os
import shutil
import signal
import subprocess
import sys
from functools import partial, wraps
from pathlib import Path

import cv2
import numpy as np
import pytest
import safetensors.torch
import torch

import data_tools
from book.ch08_vector_fields import field_training
from data_tools.__main__ import main as data_main
from data_tools.batches import Augmentation
from data_tools.bop import read_results
from posecore.__main__ import main
from posecore.methods.vector_field import estimating, frozen_fields, training
from posecore.methods.vector_field.learning import Objective, Pool, Windows
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.masked_fields import look_at
from posecore.methods.vector_field.models import ObjectModel
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.plans import PLANS, halved
from posecore.methods.vector_field.runs import read_run
from posecore.methods.vector_field.systems import STAGES, Estimate, VectorFieldSystem
from posecore.nets.resnet import ResNet
from posecore.training import fit, seeded
from posecore.training.loop import ADAM
from posecore.training.muon import Muon

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {name: value for name, value in os.environ.items() if "proxy" not in name.lower()}
ENVIRONMENT["PYTHONPATH"] = os.pathsep.join([str(ROOT), *sys.path])
WEIGHTS = ("net.safetensors", "refiner.safetensors")
TRAINING = ["--objects", "1", "3", "--steps", "12", "--refiner-steps", "6"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("commands")


@pytest.fixture(scope="module")
def source(folder):
    """`tabletop` as a BOP dataset."""
    assert data_main(["export", str(folder / "bop"), "--scale", "tiny", "--count", "12"]) == 0
    return f"bop:{folder / 'bop'}"


def training(source, out, *more):
    return ["train", "vector_field", "--data", source, "--out", str(out), *TRAINING, *more]


def estimating(run, source, output, *more):
    words = ["--run", str(run), "--data", source, "--output", str(output), *more]
    return ["estimate", "vector_field", *words]


@pytest.fixture(scope="module")
def run(source, folder):
    """A run that nothing disturbed."""
    assert main(training(source, folder / "run")) == 0
    return folder / "run"


def contents(run, names=("run.json", *WEIGHTS)):
    return {name: (run / name).read_bytes() for name in names}


# Paper scale --------------------------------------------------------------------------------------


def test_the_papers_numbers():
    paper, varied = PLANS["paper"], Augmentation()
    assert (paper.width, paper.most) == (64, None)
    assert (paper.window, paper.batch) == ((640, 480), 32)
    assert (paper.lr, paper.epochs, paper.steps) == (1e-4, 200, None)
    assert (paper.optimiser, paper.looks, paper.pixels, paper.augment) == (ADAM, None, None, varied)
    assert (paper.begin, paper.forward_only) == (0, False)
    assert varied.turn == pytest.approx(math.radians(30))
    assert 1 / varied.zoom <= 0.8 and varied.zoom >= 1.2 and varied.blur > 0
    epochs = [0, 19, 20, 39, 40, 58, 60, 199]  # 58 / 200 * 10 is a little below 2.9
    assert [paper.schedule(epoch / 200) for epoch in epochs] == [
        0.5 ** (epoch // 20) for epoch in epochs
    ]
    assert [halved(step / 100) for step in range(100)] == [0.5 ** (s // 10) for s in range(100)]


def test_the_books_numbers_are_those_of_its_experiments(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "book")
    book, chapter = PLANS["book"], field_training
    sizes = chapter.width(), chapter.most()
    assert (book.width, book.most, book.augment) == (*sizes, chapter.VARIED)
    assert (book.window, book.batch, book.steps, book.looks) == ((96, 96), 32, 9000, 8)
    assert (book.visible, book.shift, book.pixels) == (0.15, 0.22, 256)
    assert (book.optimiser, book.lr, book.schedule) == (Muon, 8e-3, "cosine")
    assert (book.begin, book.forward_only) == (0.15, True)


def test_a_step_at_paper_scale(rng):
    """Shapes, and one step of the whole network on two whole images."""
    paper = PLANS["paper"]
    (width, height), K = paper.window, [[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]]
    points = rng.uniform(-0.05, 0.05, (300, 3))
    model = ObjectModel(6, points, points[:9], 0.15)
    instance = torch.full((2, height, width), -1)
    instance[:, 200:260, 300:380] = 0
    batch = {
        "rgb": torch.rand(2, 3, height, width),
        "instance": instance,
        "K": torch.tensor([K, K]),
        "object_id": torch.full((2, 1), 6),
        "R": torch.eye(3).expand(2, 1, 3, 3),
        "t": torch.tensor([0.0, 0, 1]).expand(2, 1, 3),
        "done": torch.tensor(0.0),
    }
    seen = {}

    def loss(net, batch):
        seen["features"] = net.features(batch["rgb"])
        net.features = lambda images: seen["features"]
        parts = Objective([model], VectorFieldLoss(), paper.pixels)(net, batch)
        seen["mask"] = net.mask(seen["features"])
        del net.features
        return parts

    with seeded(0):
        net = VectorFieldNet(1, 9, paper.width)
    before = {name: value.clone() for name, value in net.named_parameters()}
    history = fit(net, [batch], loss, steps=1, lr=paper.lr, schedule=paper.schedule, device="cpu")
    assert seen["features"].shape == (2, 32, height, width)
    assert seen["mask"].shape == (2, 2, height, width)
    assert math.isfinite(history.losses["loss"][0])
    same = [name for name, value in net.named_parameters() if torch.equal(value, before[name])]
    assert same == []


# From a dataset to figures ------------------------------------------------------------------------


def test_a_run_holds_all_that_its_models_need(run, source):
    assert not list(run.glob(".*"))
    found = read_run(run)
    assert found.options == {
        "data": source, "split": "train", "objects": [1, 3], "scale": "tiny", "steps": 12,
        "refiner_steps": 6, "batch": 4, "projection": "pixel", "weight": "dynamic",
        "begin": 0.15, "forward_only": True, "imagenet": None, "seed": 0,
    }  # fmt: skip
    known = data_tools.open(source, split="train").models()
    for model in found.models:
        assert model.keypoints.shape == (9, 3) and model.points.shape == (2000, 3)
        info = known.info(model.object_id)
        assert model.diameter == info.diameter
        np.testing.assert_array_equal(model.symmetries, info.symmetries())
    for name, model in (("net", found.new_net()), ("refiner", found.new_refiner())):
        found.load_weights(name, model)
        assert not model.training
        last = max((run / "checkpoints" / name).glob("weights-*"))
        kept = safetensors.torch.load_file(last)
        assert kept.keys() == model.state_dict().keys()
        assert all(torch.equal(value, kept[key]) for key, value in model.state_dict().items())


@pytest.mark.parametrize("system", ["OPEPL", "OPEPL-R", "OPEPL-DR"])
def test_from_a_run_to_figures(run, source, tmp_path, capsys, system):
    output, report = tmp_path / "out.csv", tmp_path / "report.json"
    assert main(estimating(run, source, output, "--split", "test", "--system", system)) == 0
    assert "poses in 10 images" in capsys.readouterr().out
    found = read_results(output)
    assert len(found) > 5
    assert set(found.object_id.tolist()) <= {1, 3}
    assert ((found.score >= 0) & (found.score <= 1)).all()
    for image in set(found.images):
        mine = [key == image for key in found.images]
        assert len(set(found.time[mine])) == 1 and found.time[mine][0] > 0
    words = [str(output), source, "--split", "test", "--json", str(report)]
    assert main(["evaluate", *words]) == 0
    assert json.loads(report.read_text())["poses"]["estimated"]["all poses"] > 0


def test_true_poses_are_all_right(run, source, tmp_path, monkeypatch):
    """Units, cameras, colours and the numbers of images on their way through files."""
    dataset = data_tools.open(source, split="test")
    views = iter(dataset)

    def truth(system, images, K):
        view = next(views)
        np.testing.assert_array_equal(images[0].permute(1, 2, 0) * 255, view.rgb)
        np.testing.assert_array_equal(K, view.K)
        spent = dict.fromkeys(STAGES, 0.0)
        return [
            Estimate(0, o.object_id, o.R, o.t, 1.0, 1.0, False, (o.R, o.t), None, None, spent)
            for o in view.objects
        ]

    monkeypatch.setattr(VectorFieldSystem, "estimate", truth)
    output, report = tmp_path / "out.csv", tmp_path / "report.json"
    assert main(estimating(run, source, output, "--split", "test")) == 0
    assert main(["evaluate", str(output), source, "--split", "test", "--json", str(report)]) == 0
    shares = json.loads(report.read_text())["correct, % of all ground truth"]
    assert shares["ADD < 0.1 d"]["all poses"] == shares["5 deg 2 cm"]["all poses"] == 100


def test_targets_choose_the_images(run, source, folder, tmp_path):
    targets = json.loads((folder / "bop" / "test_targets_bop19.json").read_text())
    one = [target for target in targets if target["im_id"] == targets[0]["im_id"]]
    (tmp_path / "one.json").write_text(json.dumps(one))
    words = ["--split", "test", "--targets", str(tmp_path / "one.json")]
    assert main(estimating(run, source, tmp_path / "out.csv", *words)) == 0
    found = read_results(tmp_path / "out.csv")
    assert set(found.images) <= {(one[0]["scene_id"], one[0]["im_id"])}


def test_a_world_and_a_field_without_refiner(tmp_path, capsys):
    words = ["--objects", "5", "--steps", "2", "--refiner-steps", "0", "--projection", "none"]
    words += ["--weight", "0.05", "--scale", "tiny"]
    out = tmp_path / "a" / "run"
    assert main(["train", "vector_field", "--data", "tabletop", "--out", str(out), *words]) == 0
    assert read_run(out).options["weight"] == 0.05
    assert not (out / "refiner.safetensors").exists()
    output = tmp_path / "out.csv"
    words = estimating(out, "tabletop", output, "--split", "easy")
    capsys.readouterr()
    assert main(words) == 2
    assert "--system OPEPL" in capsys.readouterr().err
    assert main([*words, "--system", "OPEPL"]) == 0
    assert output.exists()


def test_linemod_as_pvnet_lays_it_out(source, tmp_path, capsys):
    """No visible fractions, no boxes, one object in each image."""
    views = data_tools.open(source, split="train")
    cat = tmp_path / "linemod" / "cat"
    for name in ("JPEGImages", "mask", "pose"):
        (cat / name).mkdir(parents=True)
    shown = [(v, o) for v in views for o in v.objects if o.object_id == 1 and o.mask.sum() > 30]
    for number, (view, item) in enumerate(shown):
        cv2.imwrite(str(cat / f"JPEGImages/{number:06d}.jpg"), view.rgb[..., ::-1])
        cv2.imwrite(str(cat / f"mask/{number:04d}.png"), item.mask * np.uint8(255))
        np.save(cat / f"pose/pose{number}.npy", np.column_stack([item.R, item.t]))
    for split in ("train", "test"):
        lines = [f"LINEMOD/cat/JPEGImages/{number:06d}.jpg" for number in range(len(shown))]
        (cat / f"{split}.txt").write_text("\n".join(lines))
    views.models().mesh(1).export(cat / "cat.ply")
    data = f"linemod:{tmp_path / 'linemod'}"
    words = ["--data", data, "--out", str(tmp_path / "run"), "--steps", "8", "--refiner-steps", "2"]
    assert main(["train", "vector_field", *words]) == 0
    assert [model.object_id for model in read_run(tmp_path / "run").models] == [6]
    output = tmp_path / "out.csv"
    assert main(estimating(tmp_path / "run", data, output, "--split", "test")) == 0
    assert set(read_results(output).images) <= {(6, number) for number in range(len(shown))}
    assert len(read_results(output)) > 0


def taught(monkeypatch, words):
    """What a command's training learns from: its pools, its batches and its loss."""
    pools, given = [], {}

    class KeptPool(Pool):
        def __init__(self, windows, **options):
            super().__init__(windows, **options)
            pools.append(self)

    def kept_fit(model, batches, objective, **options):
        given.update(options, batches=batches, loss=objective.loss)
        return fit(model, batches, objective, **options)

    monkeypatch.setattr(field_training, "Pool", KeptPool)
    monkeypatch.setattr(field_training, "fit", kept_fit)
    assert main([*words, "--refiner-steps", "0"]) == 0
    return pools, given


@pytest.mark.parametrize("steps", [2, 20])
def test_windows_are_cut_once(source, tmp_path, monkeypatch, steps):
    dataset = data_tools.open(source, split="train")
    objects = [item for view in dataset for item in view.objects if item.object_id in (1, 3)]
    shown = sum(item.visible_fraction >= 0.15 for item in objects)
    assert 8 < shown < 64
    words = training(source, tmp_path, "--steps", str(steps))
    pools, given = taught(monkeypatch, words)
    (pool,) = pools
    assert pool.size == min(4 * steps, shown)
    assert (pool.steps, pool.count, pool.step) == (steps, 4, steps)
    assert given["optimiser"] is Muon
    assert (given["loss"].begin, given["loss"].forward_only) == (0.15, True)


def test_a_pool_has_bounds(source, tmp_path, monkeypatch):
    monkeypatch.setattr(field_training, "AT_ONCE", 4)
    monkeypatch.setattr(field_training, "IN_POOL", 9)
    (pool,), _ = taught(monkeypatch, training(source, tmp_path))
    assert pool.size == 12  # whole batches


def test_a_plan_without_a_pool(source, tmp_path, monkeypatch):
    plain = dataclasses.replace(
        PLANS["tiny"], looks=None, begin=0.0, forward_only=False, optimiser=ADAM, visible=0.1
    )
    monkeypatch.setitem(field_training.PLANS, "tiny", plain)
    pools, given = taught(monkeypatch, training(source, tmp_path))
    assert pools == [] and isinstance(given["batches"], Windows)
    assert (given["batches"].steps, given["batches"].count) == (12, 4)
    assert given["optimiser"] is ADAM
    assert (given["loss"].begin, given["loss"].forward_only) == (0, False)
    assert read_run(tmp_path).options["forward_only"] is False


def test_the_loss_that_was_asked_for(source, tmp_path, monkeypatch):
    words = training(source, tmp_path, "--begin", "0.5", "--no-forward-only", "--weight", "0.1")
    loss = taught(monkeypatch, words)[1]["loss"]
    assert (loss.begin, loss.forward_only, loss.weight) == (0.5, False, 0.1)
    assert [loss.beta(done) for done in (0, 0.49, 0.5, 1)] == [0, 0, 0.1, 0.1]
    found = read_run(tmp_path).options
    assert (found["begin"], found["forward_only"]) == (0.5, False)


# Stopped, and several processes -------------------------------------------------------------------

KILLED = """
import functools, os, signal, sys
from posecore.__main__ import main
from posecore.commands import field_training
training.fit = functools.partial(training.fit, save_seconds=0)
step, calls = field_training.Objective.__call__, []
def dying(*arguments):
    calls.append(1)
    if len(calls) == 8:
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
    return step(*arguments)
field_training.Objective.__call__ = dying
main(sys.argv[1:])
"""


def test_a_run_that_was_killed_goes_on_bit_for_bit(run, source, tmp_path, monkeypatch, capsys):
    words, out = training(source, tmp_path / "again"), tmp_path / "again"
    done = subprocess.run([sys.executable, "-c", KILLED, *words], env=ENVIRONMENT)
    assert done.returncode == -getattr(signal, "SIGKILL", signal.SIGTERM)
    assert (out / "checkpoints/net/state-00000007.pt").exists()
    assert not (out / "net.safetensors").exists()

    # Once more, now by the keyboard, while the refiner is trained.
    monkeypatch.setattr(field_training, "fit", partial(fit, save_seconds=0))
    loss, calls = field_training.RefinerTraining.loss, []

    @wraps(loss)
    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return loss(*arguments)

    monkeypatch.setattr(field_training.RefinerTraining, "loss", interrupted)
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
    monkeypatch.setattr(Windows, "_draw", None)  # nor are windows cut again
    before = contents(run)
    assert main(training(source, run)) == 0
    assert contents(run) == before


def test_two_processes(run, source, tmp_path, capsys):
    out = tmp_path / "two"
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    words = [*launch, "-m", "posecore", *training(source, out)]
    done = subprocess.run(
        [sys.executable, *words], env=ENVIRONMENT | {"OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["net", "refiner"]
    assert (out / "run.json").read_bytes() == (run / "run.json").read_bytes()
    for name in WEIGHTS:
        two, one = (safetensors.torch.load_file(path / name) for path in (out, run))
        assert two.keys() == one.keys()
        assert all(value.isfinite().all() for value in two.values())
    assert contents(out, WEIGHTS) != contents(run, WEIGHTS)  # batches are normalised in halves
    output = tmp_path / "out.csv"
    assert main(estimating(out, source, output, "--split", "test")) == 0
    assert len(read_results(output)) > 0
    assert main(["evaluate", str(output), source, "--split", "test"]) == 0


# What cannot be -----------------------------------------------------------------------------------


def refused(capsys, words, message):
    capsys.readouterr()
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1 and err.startswith("error: "), err
    assert message in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "bop:nowhere"], "nowhere"),
        (["--data", "nonsense"], "source: expected"),
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
        (["--begin", "1.5"], "--begin: expected"),
        (["--begin", "-0.1"], "--begin: expected"),
        (["--begin", "nan"], "--begin: expected"),
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
    refused(capsys, training(source, "run", *options), message)
    assert not Path("run").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--steps", "13"], ["--refiner-steps", "0"], ["--seed", "1"], ["--objects", "1"],
        ["--batch", "2"], ["--weight", "0.05"], ["--projection", "unit"], ["--begin", "0.2"],
        ["--no-forward-only"],
    ],
)  # fmt: skip
def test_another_runs_options_are_named(run, source, capsys, options):
    before = contents(run)
    name = options[0].replace("--no-", "--")
    refused(capsys, training(source, run, *options), f"{name}: expected")
    assert contents(run) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--run", "nowhere"], "--run: expected a folder that `train vector_field` wrote"),
        (["--data", "bop:nowhere"], "nowhere"),
        (["--data", "tabletop", "--split", "test"], "split: expected"),
        (["--split", "holidays"], "split: expected"),
        (["--targets", "none.json"], "none.json"),
        (["--data", "tabletop", "--split", "easy", "--targets", "t.json"], "--targets"),
        (["--threshold", "2"], "threshold"),
        (["--seed", "-1"], "seed"),
        (["--device", "moon"], "device"),
        (["--output", "nowhere/out.csv"], "--output"),
    ],
)
def test_bad_options_of_estimates(run, source, tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    refused(capsys, estimating(run, source, "out.csv", "--split", "test", *options), message)
    assert list(tmp_path.iterdir()) == []


def cut(path):
    path.write_bytes(path.read_bytes()[:-9])


def change(**entries):
    def changed(path):
        path.write_text(json.dumps(json.loads(path.read_text()) | entries))

    return changed


def spoil(path):
    weights = safetensors.torch.load_file(path)
    weights["mask_layer.bias"].fill_(math.nan)
    safetensors.torch.save_file(weights, path)


def of_another(path):
    safetensors.torch.save_file(VectorFieldNet(2, 9, 16).state_dict(), path)


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("run.json", cut, "run.json: damaged JSON"),
        ("run.json", Path.unlink, "run.json"),
        ("run.json", lambda path: path.write_text("[]"), "run.json: damaged"),
        ("run.json", change(models=[]), "run.json: damaged"),
        ("run.json", change(models=[{"object_id": 1}]), "run.json: damaged"),
        ("run.json", change(width="8"), "run.json: damaged"),
        ("run.json", change(most=4), "run.json: damaged"),
        ("run.json", change(width=16), "net.safetensors: expected the weights of this run"),
        ("run.json", change(refiner_width=8), "refiner.safetensors: expected the weights"),
        ("run.json", change(method="other"), "run.json: damaged"),
        ("run.json", change(options=3), "run.json: damaged"),
        ("net.safetensors", cut, "net.safetensors: expected the weights of this run"),
        ("net.safetensors", of_another, "net.safetensors: expected the weights of this run"),
        ("net.safetensors", spoil, "net.safetensors: expected finite weights"),
        ("net.safetensors", Path.unlink, "trained its net"),
        ("refiner.safetensors", Path.unlink, "trained its refiner"),
    ],
)
def test_damaged_runs_are_named(run, source, tmp_path, capsys, name, damage, message):
    for file in ("run.json", *WEIGHTS):
        shutil.copy(run / file, tmp_path)
    damage(tmp_path / name)
    output = tmp_path / "out.csv"
    refused(capsys, estimating(tmp_path, source, output, "--split", "test"), message)
    assert not output.exists()


def test_data_without_the_runs_objects(run, source, tmp_path, capsys):
    content = json.loads((run / "run.json").read_text())
    for model in content["models"]:
        model["object_id"] += 90
    (tmp_path / "run.json").write_text(json.dumps(content))
    words = estimating(tmp_path, source, tmp_path / "out.csv", "--split", "test")
    refused(capsys, words, "--data: expected data with one of the run's objects [91, 93]")


def test_data_without_colours_or_masks(run, source, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for missing, message in (("mask_visib", "--data: expected data with masks"), ("rgb", "colour")):
        shutil.copytree(folder / "bop", missing)
        for path in Path(missing).glob(f"*/*/{missing}"):
            shutil.rmtree(path)
        refused(capsys, training(f"bop:{missing}", "out"), message)
    words = estimating(run, "bop:rgb", "out.csv", "--split", "test")
    refused(capsys, words, "--data: expected data with colour images")
    assert not Path("out.csv").exists() and not Path("out").exists()


def test_a_field_that_sees_nothing(source, tmp_path, capsys, monkeypatch):
    def blind(net, images):
        return look_at(net, images, min_pixels=10**6)

    monkeypatch.setattr(frozen_fields, "look_at", blind)
    words = training(source, tmp_path / "run", "--steps", "1")
    assert main(words) == 2
    assert "--steps: expected enough" in capsys.readouterr().err
    assert (tmp_path / "run" / "net.safetensors").exists()


def test_no_poses_are_a_file_too(run, source, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(VectorFieldSystem, "estimate", lambda *_: [])
    assert main(estimating(run, source, tmp_path / "out.csv", "--split", "test")) == 0
    assert len(read_results(tmp_path / "out.csv")) == 0
    assert estimating._table([]).R.shape == (0, 3, 3)
