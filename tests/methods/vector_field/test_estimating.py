"""`estimate vector_field`: from a run to figures, and what it refuses."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.bop import read_results
from posecore.methods.main import main
from posecore.methods.vector_field.estimating import ReducedImages
from posecore.methods.vector_field.systems import STAGES, Estimate, VectorFieldSystem
from tests.methods.refusing import refused
from tests.methods.vector_field.commands import estimate_words

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("system", ["OPEPL", "OPEPL-R", "OPEPL-DR"])
def test_from_a_run_to_figures(run, source, tmp_path, capsys, system):
    output, report = tmp_path / "out.csv", tmp_path / "report.json"
    assert main(estimate_words(run, source, output, "--split", "test", "--system", system)) == 0
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
    assert main(estimate_words(run, source, output, "--split", "test")) == 0
    assert main(["evaluate", str(output), source, "--split", "test", "--json", str(report)]) == 0
    shares = json.loads(report.read_text())["correct, % of all ground truth"]
    assert shares["ADD < 0.1 d"]["all poses"] == shares["5 deg 2 cm"]["all poses"] == 100


def test_images_are_reduced_as_batches_are():
    """What a run is given of wider images is what its network was trained on."""
    dataset = data_tools.open("tabletop", split="easy", scale="tiny")
    view, asked = dataset[3], []

    class System:
        def estimate(self, images, K):
            asked.append((images, K))
            return ["poses"]

    image = torch.from_numpy(view.rgb).permute(2, 0, 1)[None].float() / 255
    expected = batches.load(dataset, progress=False).frames(torch.tensor([3]), (48, 36))
    assert ReducedImages(System(), 48).estimate(image, view.K) == ["poses"]
    torch.testing.assert_close(asked[0][0], expected["rgb"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(asked[0][1], expected["K"][0], rtol=1e-5)
    for width in (None, 96, 500):
        ReducedImages(System(), width).estimate(image, view.K)
        assert asked[-1] == (image, view.K)


def test_targets_choose_the_images(run, source, folder, tmp_path):
    targets = json.loads((folder / "bop" / "test_targets_bop19.json").read_text())
    one = [target for target in targets if target["im_id"] == targets[0]["im_id"]]
    (tmp_path / "one.json").write_text(json.dumps(one))
    words = ["--split", "test", "--targets", str(tmp_path / "one.json")]
    assert main(estimate_words(run, source, tmp_path / "out.csv", *words)) == 0
    found = read_results(tmp_path / "out.csv")
    assert set(found.images) <= {(one[0]["scene_id"], one[0]["im_id"])}


def test_no_poses_are_a_file_too(run, source, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(VectorFieldSystem, "estimate", lambda *_: [])
    assert main(estimate_words(run, source, tmp_path / "out.csv", "--split", "test")) == 0
    assert len(read_results(tmp_path / "out.csv")) == 0


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
    refused(capsys, estimate_words(run, source, "out.csv", "--split", "test", *options), message)
    assert list(tmp_path.iterdir()) == []


def test_data_without_the_runs_objects(run, source, tmp_path, capsys):
    content = json.loads((run / "run.json").read_text())
    for model in content["models"]:
        model["object_id"] += 90
    (tmp_path / "run.json").write_text(json.dumps(content))
    words = estimate_words(tmp_path, source, tmp_path / "out.csv", "--split", "test")
    refused(capsys, words, "--data: expected data with one of the run's objects [91, 93]")


def test_data_without_colours(run, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder / "bop", "rgb")
    for path in Path("rgb").glob("*/*/rgb"):
        shutil.rmtree(path)
    words = estimate_words(run, "bop:rgb", "out.csv", "--split", "test")
    refused(capsys, words, "--data: expected data with colour images")
    assert not Path("out.csv").exists()
