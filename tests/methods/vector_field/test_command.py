"""`train vector_field` and `estimate vector_field` together, on other data than BOP's."""

import json

import cv2
import numpy as np
import pytest

import data_tools
from data_tools.bop import read_results
from posecore.methods.main import main
from posecore.methods.vector_field.runs import read_run
from tests.methods.vector_field.commands import estimate_words

pytestmark = pytest.mark.slow


def test_a_world_and_a_field_without_refiner(tmp_path, capsys):
    words = ["--objects", "5", "--steps", "2", "--refiner-steps", "0", "--projection", "none"]
    words += ["--scale", "tiny"]
    out = tmp_path / "a" / "run"
    assert main(["train", "vector_field", "--data", "tabletop", "--out", str(out), *words]) == 0
    assert read_run(out).options["projection"] == "none"
    assert not (out / "refiner.safetensors").exists()
    output = tmp_path / "out.csv"
    words = estimate_words(out, "tabletop", output, "--split", "easy")
    capsys.readouterr()
    assert main(words) == 2
    assert "--system OPEPL" in capsys.readouterr().err
    assert main([*words, "--system", "OPEPL"]) == 0
    assert output.exists()


def test_an_own_object_without_lists(source, tmp_path, capsys):
    """Trained and found again without a split, which there is none of; in it, it goes on."""
    views = data_tools.open(source, split="train")
    own = tmp_path / "mug"
    for name in ("rgb", "mask", "pose"):
        (own / name).mkdir(parents=True)
    shown = [(v, o) for v in views for o in v.objects if o.object_id == 1 and o.mask.sum() > 30]
    for number, (view, item) in enumerate(shown):
        cv2.imwrite(str(own / f"rgb/{number}.jpg"), view.rgb[..., ::-1])
        cv2.imwrite(str(own / f"mask/{number}.png"), item.mask[..., None] * np.uint8([0, 255, 0]))
        np.save(own / f"pose/pose{number}.npy", np.column_stack([item.R, item.t]))
    np.savetxt(own / "camera.txt", shown[0][0].K)
    views.models().mesh(1).export(own / "model.obj")
    data, run = f"linemod:{own}", tmp_path / "run"
    words = ["train", "vector_field", "--data", data, "--out", str(run), "--steps", "8"]
    words += ["--refiner-steps", "2"]
    for _ in range(2):
        assert main(words) == 0
    assert read_run(run).options["split"] is None
    output = tmp_path / "out.csv"
    assert main(estimate_words(run, data, output)) == 0
    assert len(read_results(output)) > 0
    capsys.readouterr()
    assert main([*words[:-2], "--batch", "10000000"]) == 2
    assert "--batch: expected a batch that fits into" in capsys.readouterr().err


def test_a_folder_of_pictures(source, run, tmp_path, capsys):
    """The same poses as of the dataset that they are from; drawn, and with their names."""
    views = list(data_tools.open(source, split="test"))
    photos = tmp_path / "photos"
    photos.mkdir()
    for view in views:
        cv2.imwrite(str(photos / f"IMG_{view.image_id + 40}.png"), view.rgb[..., ::-1])
    camera, output = tmp_path / "K.json", tmp_path / "poses.csv"
    camera.write_text(json.dumps(views[0].K.tolist()))
    words = estimate_words(run, f"pictures:{photos}", output)
    assert main(words) == 2
    assert "error: --camera: expected a file, as there is no" in capsys.readouterr().err
    assert main([*words, "--camera", str(camera)]) == 0
    assert f"{output}: " in capsys.readouterr().out
    found, names = read_results(output), (tmp_path / "poses_images.csv").read_text()
    assert "0,40,IMG_40.png\n" in names and names.count("\n") == 1 + len(views)
    drawn = sorted(path.name for path in (tmp_path / "poses_pictures").iterdir())
    assert drawn == sorted(f"poses_IMG_{view.image_id + 40}.png" for view in views)
    usual = tmp_path / "usual.csv"
    assert main(estimate_words(run, source, usual, "--split", "test")) == 0
    expected = read_results(usual)
    assert not (tmp_path / "usual_images.csv").exists()
    np.testing.assert_array_equal(found.image_id, expected.image_id + 40)
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    np.testing.assert_allclose(found.score, expected.score, atol=1e-12)


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
    assert main(estimate_words(tmp_path / "run", data, output, "--split", "test")) == 0
    assert set(read_results(output).images) <= {(6, number) for number in range(len(shown))}
    assert len(read_results(output)) > 0
