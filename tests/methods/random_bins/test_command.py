"""`train random_bins` and `estimate random_bins`."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import data_tools
from posecore.methods.random_bins.estimating import PictureEstimator
from posecore.methods.random_bins.runs import RandomBinsRun
from posecore.methods.runs import read_net_run
from tests.methods.poses_commands import (
    check_evaluated,
    check_rows,
    estimate_words,
    estimated,
    train_words,
    trained,
)
from tests.methods.refusing import refused

METHOD = "random_bins"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory, shared_cache):
    """Nothing in it is to be changed."""
    return trained(METHOD, tmp_path_factory.mktemp("bins"))


@pytest.fixture(scope="module")
def views(shared_cache):
    return data_tools.open("headset", split="test", scale="tiny")


def test_poses_are_what_the_network_says_of_each_picture(run, views, recording, tmp_path):
    table = estimated(METHOD, run, tmp_path / "poses.csv")
    check_rows(table)
    net = read_net_run(run, RandomBinsRun).load_net()
    with torch.no_grad():
        said = net(torch.from_numpy(np.stack([view.ir for view in views]))[:, None].float() / 255)
    np.testing.assert_allclose(table.R, said.R, atol=1e-4)
    np.testing.assert_allclose(table.t, said.t, atol=1e-4)
    check_evaluated(METHOD, run, recording, tmp_path)


def test_regression_on_some_glasses(tmp_path):
    words = ("--kind", "regression", "--objects", "2", "1")
    found = read_net_run(trained(METHOD, tmp_path / "run", *words), RandomBinsRun)
    assert found.kind == "regression" and found.object_ids == [1, 2]
    assert found.options["objects"] == [1, 2] and found.image == [80, 47]
    check_rows(estimated(METHOD, tmp_path / "run", tmp_path / "poses.csv"))


def test_pictures_of_16_bits_are_those_of_their_upper_8(run, views):
    found = read_net_run(run, RandomBinsRun)
    estimator = PictureEstimator(found.load_net(), found.image, found.object_ids)
    view = views[0]
    picture, object_id = estimator.look(view)
    deep = replace(view, ir=view.ir.astype(np.uint16) * 256 + 77)
    assert torch.equal(estimator.look(deep)[0], picture) and object_id == 1
    with pytest.raises(ValueError, match="^--data: expected data with infrared images"):
        estimator.look(replace(view, ir=None, rgb=np.zeros((47, 80, 3), np.uint8)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "nonsense"], "--data: expected"),
        (["--data", "tabletop", "--split", "easy"], "--data: tabletop: data: expected infrared"),
        (["--objects", "5"], "--objects: expected some of 1, 2, 3, 4"),
        (["--steps", "0"], "--steps: expected"),
    ],
)
def test_bad_options_of_train(tmp_path, capsys, options, message):
    refused(capsys, train_words(METHOD, tmp_path / "run", *options), message)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": [80]}, "image: expected"),
        ({"image": [80, 0]}, "image: expected"),
        ({"low": [0.0]}, "low: expected six finite numbers"),
        ({"net": {"width": 0}}, "width: expected"),
        ({"kind": "boxes"}, "kind: expected"),
    ],
)
def test_a_damaged_run_is_named(run, tmp_path, capsys, changes, message):
    content = json.loads((run / "run.json").read_text()) | changes
    (tmp_path / "run.json").write_text(json.dumps(content))
    refused(capsys, estimate_words(METHOD, tmp_path, tmp_path / "poses.csv"), message)
