"""`evaluate` of categories, on made-up files and on the world that has them."""

import dataclasses
import json

import numpy as np
import pytest

import data_tools
from data_tools.bop import write_category_results, write_results
from posecore.methods.category_evaluating import category_poses
from posecore.methods.main import main
from posecore.metrics import CategoryPoseTable, evaluate_categories, nocs_axes
from tests.methods.conftest import Three
from tests.methods.refusing import refused


def some(**changes):
    """A can, a mug and a mug that hides its handle, in two images."""
    names = ["can", "mug", "mug"]
    columns = {
        "category": names,
        "R": np.tile(np.eye(3), (3, 1, 1)),
        "t": np.array([[0, 0, 1], [0.2, 0, 1], [0, 0, 1.0]]),
        "size": np.full((3, 3), 0.1),
        "axis": nocs_axes(names, [1, 1, 0]),
        "image_id": [0, 0, 1],
        "score": [0.9, 0.8, 0.7],
    }
    return CategoryPoseTable.from_arrays(**(columns | changes))


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_category_results("gt.csv", some(), axes=True)
    t = some().t + [0, 0.01, 0]
    write_category_results("est.csv", some(t=t)[:2])
    return tmp_path


def row(text, label, section=""):
    after = text[text.index("\n" + section) :]
    line = next(line for line in after.splitlines() if line.startswith(f"  {label} "))
    return line[2 + len(label) :].split()


def test_the_table(files, capsys):
    assert main(["evaluate", "est.csv", "gt.csv", "--json", "out.json"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0].split() == ["can", "mug", "mean"]
    assert row(out, "ground truth") == ["1", "2", "-"]
    assert row(out, "3D IoU > 0.75") == ["100.0", "50.0", "75.0"]  # 0.09 / 0.11
    assert row(out, "5 deg 2 cm") == ["100.0", "100.0", "100.0"]  # of the pairs
    missed = "average precision of the pose, % (what is missed"
    assert row(out, "5 deg 2 cm", missed) == ["100.0", "50.0", "75.0"]
    assert row(out, "translation, mm") == ["10.000"] * 3
    assert "1 of 2 mugs do not show their handle" in err
    values = json.loads((files / "out.json").read_text())["average precision of the 3D box, %"]
    assert values["3D IoU > 0.75"] == {
        "categories": {"can": pytest.approx(100), "mug": 50},
        "mean of categories": 75,
    }


def test_the_protocol_of_the_code(files, capsys):
    write_category_results("est.csv", some(t=some().t + [0, 0.05, 0]))
    for options, box in (([], "0.0"), (["--protocol", "code"], "100.0")):
        assert main(["evaluate", "est.csv", "gt.csv", *options]) == 0
        assert row(capsys.readouterr().out, "3D IoU > 0.5") == [box] * 3  # of truly 1 / 3


def test_what_is_left_out_or_odd_is_said(files, capsys):
    names, images = ["can", "spoon", "mug"], [0, 0, 9]
    size = np.full((3, 3), 1e-4)
    odd = some(category=names, image_id=images, size=size, score=1.0, t=some().t / 1000)
    write_category_results("est.csv", odd)
    assert main(["evaluate", "est.csv", "gt.csv"]) == 0
    err = capsys.readouterr().err
    assert "1 of 3 estimates are ignored: the ground truth does not have their images" in err
    assert "estimates of spoon are ignored: the ground truth holds only can, mug" in err
    assert "all scores are equal" in err
    assert err.count("should be in millimetres") == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["gt.csv", "--models", "models"], "--models"),
        (["gt.csv", "--objects", "3"], "--objects"),
        (["gt.csv", "--curve", "c.png"], "--curve"),
        (["gt.csv", "--camera", "c.json"], "--camera"),
        (["gt.csv", "--rotations", "as_read"], "--rotations"),
        (["gt.csv", "--split", "test"], "--split"),
        (["gt.csv", "--json", "gt.csv"], "--json"),
        (["est.csv"], "est.csv: expected the header"),
        (["plain.csv"], "plain.csv: expected the header"),
        (["empty.csv"], "true poses, got none"),
        (["bop:lmo"], "GROUND_TRUTH"),
        (["categories"], "--split"),
        (["categories", "--split", "test"], "'synthetic', 'shifted', got 'test'"),
    ],
)
def test_what_cannot_be_is_refused(files, capsys, options, message):
    write_results("plain.csv", some())
    write_category_results("empty.csv", some()[:0], axes=True)
    refused(capsys, ["evaluate", "est.csv", *options], message)


def test_plain_results_have_no_categories(files, capsys):
    write_results("plain.csv", some())
    refused(capsys, ["evaluate", "plain.csv", "plain.csv", "--protocol", "code"], "--protocol")
    words = ["evaluate", "plain.csv", "categories", "--split", "synthetic"]
    refused(capsys, words, "plain.csv: expected the header")


def test_other_datasets_have_no_category_poses():
    with pytest.raises(ValueError, match="dataset: expected objects with category and size"):
        category_poses(Three())


@pytest.mark.slow
def test_the_world_is_a_ground_truth(tmp_path, capsys):
    """Its own poses as estimates, bottles, bowls and cans turned: everything is right."""
    dataset = data_tools.open("categories", split="synthetic", progress=False)
    truth = category_poses(dataset)
    items = [item for view in dataset for item in view.objects]
    assert truth.category.tolist() == [item.category for item in items]
    np.testing.assert_array_equal(truth.size, np.stack([item.size for item in items]))
    for name, axis in zip(truth.category, truth.axis, strict=True):
        assert axis.any() == (name in ("bottle", "bowl", "can")) or name == "mug"
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    symmetric = (truth.axis != 0).any(-1)
    R = np.where(symmetric[:, None, None], truth.R @ turn, truth.R)
    path = tmp_path / "est.csv"
    write_category_results(path, dataclasses.replace(truth, R=R))
    assert main(["evaluate", str(path), "categories", "--split", "synthetic"]) == 0
    out = capsys.readouterr().out
    assert row(out, "5 deg 2 cm") == row(out, "3D IoU > 0.75") == ["100.0"] * 7
    whole = evaluate_categories(truth, dataclasses.replace(truth, axis=0 * truth.axis))
    assert set(whole) == {"bottle", "bowl", "camera", "can", "laptop", "mug"}
