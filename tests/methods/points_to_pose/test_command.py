"""`train points_to_pose` and `estimate points_to_pose`, on true and on predicted clouds."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from posecore.methods.infrared.clouds import CloudSet, read_clouds
from posecore.methods.main import main
from posecore.methods.points_to_pose.centred_clouds import predict_poses
from posecore.methods.points_to_pose.pose_clouds import visible_points
from posecore.methods.points_to_pose.recipe import RECIPES
from posecore.methods.points_to_pose.runs import PointsToPoseRun
from posecore.methods.runs import read_net_run
from posecore.poses import apply, from_matrix, relative
from tests.methods.poses_commands import (
    check_evaluated,
    check_rows,
    estimate_words,
    estimated,
    train_words,
    trained,
)
from tests.methods.refusing import refused

METHOD = "points_to_pose"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory, shared_cache):
    """Of P2P on what is visible. Nothing in it is to be changed."""
    return trained(METHOD, tmp_path_factory.mktemp("p2p"))


@pytest.fixture(scope="module")
def file(seen, data, tmp_path_factory):
    """Clouds as `clouds infrared` writes them: what is seen, and a few points besides."""
    view = data.T_world_cam[seen.view]
    points = (seen.points.double() - view[:, None, :3, 3]) @ view[:, :3, :3]
    rows = torch.zeros(len(data), dtype=torch.int64)
    rows[seen.view] = torch.arange(len(seen))
    points = torch.cat([points, points[:, :10]], 1)[rows]
    t = points.mean(1).float()
    clouds = CloudSet(
        points=(points - t[:, None]).half(), intensities=torch.zeros(points.shape[:2]).half(),
        t=t, scale=torch.ones(len(data)), net=torch.zeros(len(data), dtype=torch.int64),
        scene_id=data.scene_id, image_id=data.image_id, group=data.group,
        T_world_cam=data.T_world_cam, made_from={},
    )  # fmt: skip
    path = tmp_path_factory.mktemp("clouds") / "clouds.safetensors"
    clouds.write(path)
    return path


def check_poses(table, net, clouds, data):
    """They are what the network says of these clouds, seen from the cameras."""
    R, t = predict_poses(net, RECIPES["tiny"].prepared(clouds))
    for row, view in enumerate(clouds.view.tolist()):
        camera = from_matrix(data.T_world_cam[view].numpy())
        expected = relative(*camera, R[row].double().numpy(), t[row].double().numpy())
        np.testing.assert_allclose(table.R[row], expected[0], atol=5e-3)
        np.testing.assert_allclose(table.t[row], expected[1], atol=2e-3)


def drawn_by_view(seen, views):
    """The clouds with points that follow from the seed and the view's numbers alone."""
    points = []
    for number in seen.view.tolist():
        view = views[number]
        mask = np.logical_or.reduce([item.mask for item in view.objects])
        rng = np.random.default_rng([0, view.scene_id, view.image_id])
        found, _ = visible_points(view.depth, mask, view.K, seen.points.shape[1], rng)
        points.append(torch.from_numpy(apply(*from_matrix(view.T_world_cam), found)).float())
    return replace(seen, points=torch.stack(points))


def test_poses_of_what_is_visible(run, seen, views, data, recording, tmp_path):
    table = estimated(METHOD, run, tmp_path / "poses.csv")
    check_rows(table)
    net = read_net_run(run, PointsToPoseRun).load_net()
    check_poses(table, net, drawn_by_view(seen, views), data)
    check_evaluated(METHOD, run, recording, tmp_path)


def test_poses_of_predicted_clouds(run, file, data, tmp_path):
    """Of which as many points are drawn as the network learned from."""
    check_rows(estimated(METHOD, run, tmp_path / "poses.csv", "--clouds", str(file)))


def test_p2r_on_predicted_clouds_of_some_glasses(file, tmp_path):
    words = ("--kind", "p2r", "--clouds", str(file), "--objects", "3", "1")
    out = trained(METHOD, tmp_path / "run", *words)
    found = read_net_run(out, PointsToPoseRun)
    assert found.kind == "p2r" and found.object_ids == [1, 3] and found.points == 64
    assert found.options == {
        "data": "headset", "split": "test", "objects": [1, 3], "scale": "tiny", "kind": "p2r",
        "steps": 3, "batch": 4, "seed": 0, "clouds": str(file),
    }  # fmt: skip
    check_rows(estimated(METHOD, out, tmp_path / "poses.csv", "--clouds", str(file)))


def test_clouds_of_other_cameras_are_refused(run, file, tmp_path, capsys):
    clouds = read_clouds(file)
    moved = clouds.T_world_cam.clone()
    moved[:, 0, 3] += 1.0
    replace(clouds, T_world_cam=moved).write(tmp_path / "moved")
    words = estimate_words(METHOD, run, tmp_path / "poses", "--clouds", str(tmp_path / "moved"))
    refused(capsys, words, "--clouds: expected a cloud of the camera of")
    assert not (tmp_path / "poses").exists()


def test_a_finished_run_stays_as_it_is(run):
    names = ("run.json", "net.safetensors")
    before = [(run / name).read_bytes() for name in names]
    assert main(train_words(METHOD, run)) == 0
    assert [(run / name).read_bytes() for name in names] == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "nonsense"], "--data: expected"),
        (
            ["--data", "tabletop", "--split", "easy"],
            "--data: expected glasses on a head, objects 1 to 4",
        ),
        (["--split", "holidays"], "--split: expected"),
        (["--objects", "5"], "--objects: expected some of 1, 2, 3, 4"),
        (["--steps", "0"], "--steps: expected"),
        (["--batch", "0"], "--batch: expected"),
        (["--seed", "-1"], "--seed: expected"),
        (["--device", "moon"], "device: expected"),
        (["--clouds", "nowhere"], "--clouds: expected a file that `clouds infrared` wrote"),
        (["--clouds", "FILE"], "--clouds: FILE: damaged"),
        (["--out", "FILE"], "--out: expected a folder"),
    ],
)
def test_bad_options_of_train(tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_text("")
    refused(capsys, train_words(METHOD, "run", *options), message)
    assert not Path("run").exists()


@pytest.mark.parametrize(
    "options", [["--steps", "5"], ["--batch", "3"], ["--kind", "p2r"], ["--seed", "1"]]
)
def test_another_runs_options_are_named(run, capsys, options):
    refused(capsys, train_words(METHOD, run, *options), f"{options[0]}: expected")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--run", "nowhere"], "--run: expected a folder that `train points_to_pose` wrote"),
        (["--split", "holidays"], "--split: expected"),
        (["--output", "nowhere/poses"], "--output: expected a file in a folder that exists"),
        (["--output", "RUN/net.safetensors"], "--output: expected a file that the command does"),
        (["--output", "CLOUDS"], "--output: expected a file that the command does not read"),
        (["--clouds", "nowhere"], "--clouds: expected a file that `clouds infrared` wrote"),
        (["--device", "moon"], "device: expected"),
    ],
)
def test_bad_options_of_estimate(run, file, tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    options = [word.replace("RUN", str(run)).replace("CLOUDS", str(file)) for word in options]
    words = estimate_words(METHOD, run, "poses", "--clouds", str(file), *options)
    refused(capsys, words, message)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "p2q"}, "kind: expected"),
        ({"points": 0}, "points: expected"),
        ({"objects": []}, "objects: expected"),
        ({"objects": [-1]}, "objects: expected"),
        ({"net": {"keypoints": 0}}, "keypoints: expected"),
        ({"net": {"depth": 3}}, "depth"),
        ({"net": 3}, "damaged"),
        ({"method": "cloudpose"}, "method: expected points_to_pose"),
    ],
)
def test_a_damaged_run_is_named(run, tmp_path, changes, message):
    shutil.copytree(run, tmp_path / "run")
    file = tmp_path / "run" / "run.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    with pytest.raises(ValueError, match=message) as caught:
        read_net_run(tmp_path / "run", PointsToPoseRun)
    assert f"{file}: damaged" in str(caught.value)


def test_a_run_without_its_network(run, tmp_path, capsys):
    shutil.copy(run / "run.json", tmp_path)
    words = estimate_words(METHOD, tmp_path, tmp_path / "poses.csv")
    refused(capsys, words, "a run that has trained its net")
