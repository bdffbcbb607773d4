"""`train infrared` and `clouds infrared` together."""

import shutil

import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.main import main as data_main
from posecore.methods.infrared import command
from posecore.methods.infrared.clouds import read_clouds
from posecore.methods.infrared.runs import read_run
from posecore.methods.main import main
from tests.methods.infrared.commands import clouds_words, train_words
from tests.methods.refusing import refused

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def written(run, folder):
    """Nothing in it is to be changed."""
    path = folder / "clouds.safetensors"
    assert main(clouds_words(run, path)) == 0
    return path


def test_clouds_of_all_views_by_networks_that_do_not_know_them(run, written):
    found, views = read_clouds(written), data_tools.open("headset", split="test")
    data = batches.load(views, progress=False)
    nets, scenes = read_run(run).load_nets(), read_run(run).scenes
    assert len(found) == len(data) == 48 and found.points.shape == (48, 256, 3)
    for name in ("scene_id", "image_id", "group", "T_world_cam"):
        assert torch.equal(getattr(found, name), getattr(data, name))
    assert found.net.bincount().tolist() == [24, 24]
    for row, (scene, net) in enumerate(
        zip(found.scene_id.tolist(), found.net.tolist(), strict=True)
    ):
        assert scene not in scenes[net]
        if row % 16 < 3:
            image = torch.from_numpy(views[row].ir)[None, None].float() / 255
            with torch.no_grad():
                expected = nets[net](image)
            torch.testing.assert_close(found.points[row].float(), expected.points[0], atol=2e-4,
                                       rtol=0)  # fmt: skip
            torch.testing.assert_close(found.t[row], expected.t[0], atol=1e-5, rtol=0)


def test_what_is_there_is_not_made_again(run, written, capsys, monkeypatch, tmp_path):
    before = written.read_bytes()
    monkeypatch.setattr(command, "predict", None)
    capsys.readouterr()
    assert main(clouds_words(run, written)) == 0
    assert "there already" in capsys.readouterr().out
    assert written.read_bytes() == before
    monkeypatch.undo()
    damaged = tmp_path / "clouds.safetensors"
    damaged.write_bytes(before[:-5])
    assert main(clouds_words(run, damaged)) == 0
    assert "48 clouds of 256 points" in capsys.readouterr().out
    assert damaged.read_bytes() == before


def test_other_weights_make_other_clouds(run, written, tmp_path):
    other = tmp_path / "run"
    assert main(train_words(other, "--steps", "1")) == 0
    path = tmp_path / "clouds.safetensors"
    shutil.copy(written, path)
    assert main(clouds_words(other, path)) == 0
    assert read_clouds(path).made_from != read_clouds(written).made_from


def test_a_recording_without_masks(run, written, tmp_path, capsys):
    """Neither needs them: training has the threshold, and a cloud is made of its image."""
    path = tmp_path / "recording"
    words = ["export", str(path), "--world", "headset", "--scale", "tiny", "--count", "4"]
    assert data_main(words) == 0
    for name in ("masks", "full_masks"):
        shutil.rmtree(path / "test" / name)
    data, out = f"hmdpose:{path}", tmp_path / "run"
    refused(capsys, train_words(out, data=data), "data: expected masks, or masks='threshold'")
    words = train_words(out, "--masks", "threshold", "--steps", "1", data=data)
    assert main(words) == 0
    for number, trained in enumerate((out, run)):
        output = tmp_path / f"{number}.safetensors"
        assert main(clouds_words(trained, output, data=data)) == 0
        found = read_clouds(output)
        assert len(found) == 12
    # By the same networks: those of the same images are the same.
    torch.testing.assert_close(found.points, read_clouds(written).points[:12])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--run", "nowhere"], "--run: expected a folder that `train infrared` wrote"),
        (["--data", "nonsense"], "--data: expected"),
        (["--split", "holidays"], "--split: expected"),
        (["--output", "nowhere/clouds"], "--output: expected a file in a folder that exists"),
        (["--output", "."], "--output: expected a file, got the folder"),
        (["--output", "RUN/net0.safetensors"], "--output: expected a file that the command does"),
        (["--device", "moon"], "device: expected"),
    ],
)
def test_bad_options(run, tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    options = [word.replace("RUN", str(run)) for word in options]
    refused(capsys, clouds_words(run, "clouds", *options), message)
    assert not list(tmp_path.iterdir())


def test_a_run_without_its_networks(run, tmp_path, capsys):
    shutil.copy(run / "run.json", tmp_path)
    refused(capsys, clouds_words(tmp_path, tmp_path / "c"), "a run that has trained its net0")


def test_a_split_has_to_be_named(run, tmp_path, capsys):
    words = clouds_words(run, tmp_path / "c")
    del words[words.index("--split") : words.index("--split") + 2]
    refused(capsys, words, "--split: expected")


def test_small_networks_and_their_clouds(tmp_path, capsys):
    out, path = tmp_path / "run", tmp_path / "clouds.safetensors"
    assert main(train_words(out, "--small", "--steps", "1")) == 0
    run = read_run(out)
    assert (run.image, run.points, run.blocks) == ((80, 47), 512, 5)
    capsys.readouterr()
    assert main(clouds_words(out, path)) == 0
    assert "48 clouds of 512 points" in capsys.readouterr().out
    assert len(read_clouds(path)) == 48
