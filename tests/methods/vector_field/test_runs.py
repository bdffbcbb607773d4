"""The folder of a run: what it holds, and damage to it."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

import data_tools
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.runs import read_run
from tests.methods.refusing import refused
from tests.methods.vector_field.commands import WEIGHTS, estimate_words

pytestmark = pytest.mark.slow


def test_a_run_holds_all_that_its_models_need(run, source):
    # Another test may be about to find that this run is finished, and holds its lock.
    assert not [path for path in run.glob(".*") if not path.name.startswith(".training.lock")]
    found = read_run(run)
    assert found.options == {
        "data": source, "split": "train", "objects": [1, 3], "scale": "tiny", "steps": 12,
        "refiner_steps": 6, "batch": 4, "projection": "pixel", "weight": 0.05,
        "warmup": 0.0, "ignore_reversed": True, "imagenet": None, "seed": 0,
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


def test_run_folders_keep_their_form(tmp_path):
    """What was trained before has to stay readable."""
    points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    model = {"object_id": 3, "points": 50 * points, "keypoints": points, "diameter": 0.2}
    model |= {"symmetries": None, "centre": [0.05, 0.05, 0.05], "size": [0.1, 0.1, 0.1]}
    options = {"data": "tabletop", "objects": [3], "scale": "tiny", "weight": 0.05, "seed": 0}
    content = {
        "method": "vector_field", "options": options | {"warmup": 0.1, "ignore_reversed": True},
        "width": 8, "max_channels": 48, "refiner_width": 4, "image_width": 64, "models": [model],
    }  # fmt: skip
    file = tmp_path / "run.json"
    file.write_text(json.dumps(content))
    found = read_run(tmp_path)
    assert (found.object_ids, found.new_net().keypoints) == ([3], 4)
    assert found.options == content["options"]
    found.write()
    assert json.loads(file.read_text()) == content

    # Before options and sizes had their names of today, and images were reduced.
    older = content | {"options": options | {"begin": 0.1, "forward_only": True}, "most": 48}
    older["models"] = [{name: model[name] for name in model if name not in ("centre", "size")}]
    for name in ("max_channels", "image_width"):
        del older[name]
    file.write_text(json.dumps(older))
    again = read_run(tmp_path)
    assert (again.options, again.max_channels) == (found.options, 48)
    assert again.image_width is None
    np.testing.assert_array_equal(again.models[0].centre, [0.05] * 3)


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
        ("run.json", change(max_channels=4), "run.json: damaged"),
        ("run.json", change(image_width=0), "run.json: damaged"),
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
    refused(capsys, estimate_words(tmp_path, source, output, "--split", "test"), message)
    assert not output.exists()
