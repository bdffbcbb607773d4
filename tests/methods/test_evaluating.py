"""`evaluate`, on made-up files and on real LM-O results."""

import contextlib
import io
import json
import re
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_tools.bop import RotationWarning, read_results
from posecore import rotations
from posecore.__main__ import main
from posecore.metrics.evaluation import match

HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"
EYE = "1 0 0 0 1 0 0 0 1"
TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
100 0 0
0 100 0
0 0 100
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


@pytest.fixture
def files(tmp_path):
    """Ground truth of objects 1 and 2, estimates that are 3 mm off, and the model of object 1."""
    models = tmp_path / "models"
    models.mkdir()
    (models / "obj_000001.ply").write_text(TETRAHEDRON)
    info = {"1": {"diameter": 141.42, "min_x": 0, "min_y": 0, "min_z": 0,
                  "size_x": 100, "size_y": 100, "size_z": 100}}  # fmt: skip
    (models / "models_info.json").write_text(json.dumps(info))
    camera = {"fx": 500, "fy": 500, "cx": 320, "cy": 240, "width": 640, "height": 480}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    truth = [f"1,{i},{o},1,{EYE},0 0 1000,-1" for i in range(4) for o in (1, 2)]
    (tmp_path / "gt.csv").write_text(HEADER + "\n".join(truth))
    estimates = [f"1,{i},{o},1,{EYE},3 0 1000,-1" for i in range(3) for o in (1, 2)]
    (tmp_path / "est.csv").write_text(HEADER + "\n".join(estimates))
    return tmp_path


def evaluate(folder, *options, estimates="est.csv", truth="gt.csv"):
    files = [str(folder / estimates), str(folder / truth), "--models", str(folder / "models")]
    return main(["evaluate", *files, *options])


def cells(text, section, label):
    """The numbers of one line of the printed table."""
    after = text[text.index("\n" + section) :]
    line = next(row for row in after.splitlines() if row.startswith("  " + label + " "))
    return line[2 + len(label) :].split()


def test_the_table(files, capsys):
    assert evaluate(files) == 0
    out, err = capsys.readouterr()
    assert cells(out, "poses", "estimated") == ["3", "3", "6", "-"]
    assert cells(out, "correct, % of all", "ADD < 0.1 d") == ["75.0", "-", "75.0*", "75.0*"]
    assert cells(out, "correct, % of the est", "ADD < 0.1 d") == ["100.0", "-", "100.0*", "100.0*"]
    assert cells(out, "median", "ADD, mm") == ["3.000", "-", "3.000*", "3.000*"]
    assert cells(out, "median", "translation, mm") == ["3.000"] * 4
    assert "no model of objects [2]" in err


def test_json_and_curve_are_written(files, capsys):
    assert evaluate(files, "--json", str(files / "out.json"), "--curve", str(files / "c.png")) == 0
    content = json.loads((files / "out.json").read_text())
    values = content["median of the estimated"]["ADD, mm"]
    assert values["objects"] == {"1": pytest.approx(3), "2": None}
    picture = cv2.imread(str(files / "c.png"))
    assert picture is not None
    assert picture.std() > 5


def test_objects_can_be_chosen(files, capsys):
    assert evaluate(files, "--objects", "2") == 0
    head = capsys.readouterr().out.splitlines()[0]
    assert head.split() == ["obj", "2"]


def test_without_a_camera_there_are_no_pixels(files, capsys):
    (files / "camera.json").unlink()
    assert evaluate(files) == 0
    out, err = capsys.readouterr()
    assert "projection" not in out
    assert "camera.json" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--objects", "7"], "objects.*7"),
        (["--camera", "nowhere.json"], "nowhere.json"),
        (["--split", "test"], "--split"),
        (["--curve", "curve.bmpx"], "--curve"),
        (["--curve", "curve.PNG", "--objects", "2"], "--curve.*model"),
        (["--curve", "nowhere/curve.png"], "--curve.*folder"),
        (["--json", "nowhere/out.json"], "--json.*folder"),
    ],
)
def test_wrong_options_are_named(files, capsys, options, message):
    assert evaluate(files, *options) == 2
    assert re.search(message, capsys.readouterr().err)


def test_foreign_images_are_told_of_and_ignored(files, capsys):
    assert evaluate(files) == 0
    expected, _ = capsys.readouterr()
    foreign = f"\n9,0,1,1,{EYE},0 0 1000,-1\n1,77,1,1,{EYE},0 0 1000,-1"
    (files / "est.csv").write_text((files / "est.csv").read_text() + foreign)
    assert evaluate(files) == 0
    out, err = capsys.readouterr()
    assert out == expected
    assert "2 of 8 estimates are ignored" in err


def test_metres_are_noticed(files, capsys):
    text = (files / "est.csv").read_text().replace("3 0 1000", "0.003 0 1")
    (files / "est.csv").write_text(text)
    assert evaluate(files) == 0
    assert "should be in millimetres" in capsys.readouterr().err


def test_a_mesh_in_metres_is_noticed(files, capsys):
    path = files / "models" / "obj_000001.ply"
    path.write_text(path.read_text().replace("100", "0.1"))
    assert evaluate(files) == 0
    assert "object 1: the mesh measures 0.0001 m" in capsys.readouterr().err


def test_objects_that_are_not_asked_for_need_no_mesh(files, capsys):
    path = files / "models" / "models_info.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps(info | {"2": info["1"]}))
    assert evaluate(files, "--objects", "1") == 0
    assert "obj_000002" not in capsys.readouterr().err
    assert evaluate(files) == 0
    _, err = capsys.readouterr()
    assert "obj_000002.ply: no such file" in err
    assert "no model of objects [2]" in err


def test_values_that_json_has_no_word_for(files, capsys):
    """Estimates behind the camera have infinite errors in pixels."""
    (files / "est.csv").write_text((files / "est.csv").read_text().replace(" 1000,", " -1000,"))
    assert evaluate(files, "--json", str(files / "out.json")) == 0
    content = json.loads((files / "out.json").read_text(), parse_constant=pytest.fail)
    assert content["median of the estimated"]["MSPD, px"]["objects"]["1"] is None
    assert cells(capsys.readouterr().out, "median", "MSPD, px")[0] == "inf"


@pytest.mark.parametrize("name", ["est.csv", "gt.csv", "camera.json", "models/obj_000001.ply",
                                  "models/models_info.json"])  # fmt: skip
def test_damaged_files_are_named(files, capsys, name):
    content = (files / name).read_bytes()
    (files / name).write_bytes(content[:-9])
    assert evaluate(files) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert name.split("/")[-1] in err


def test_models_are_asked_for(files, capsys):
    assert main(["evaluate", str(files / "est.csv"), str(files / "gt.csv")]) == 2
    assert "--models" in capsys.readouterr().err


def test_missing_files_are_named(files, capsys):
    assert evaluate(files, estimates="none.csv") == 2
    assert "none.csv" in capsys.readouterr().err


@pytest.fixture
def dataset(files):
    """The same ground truth as a BOP dataset, with another camera for every image."""
    scene = files / "test" / "000001"
    scene.mkdir(parents=True)
    pose = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 1000]}
    truth = {str(i): [{"obj_id": o, **pose} for o in (1, 2)] for i in range(4)}
    (scene / "scene_gt.json").write_text(json.dumps(truth))
    K = [[500 + 100 * i, 0, 320, 0, 500 + 100 * i, 240, 0, 0, 1] for i in range(4)]
    cameras = {str(i): {"cam_K": K[i], "depth_scale": 1} for i in range(4)}
    (scene / "scene_camera.json").write_text(json.dumps(cameras))
    return files


def test_a_bop_dataset_is_ground_truth(dataset, capsys):
    truth = f"bop:{dataset}"
    assert main(["evaluate", str(dataset / "est.csv"), truth]) == 0
    out, _ = capsys.readouterr()
    assert cells(out, "correct, % of all", "ADD < 0.1 d") == ["75.0", "-", "75.0*", "75.0*"]
    assert cells(out, "median", "MSPD, px")[0] == "1.800"  # of 1.5, 1.8 and 2.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--split", "train"], "split.*train"),
        (["--targets", "none.json"], "none.json"),
        (["--camera", "camera.json"], "--camera"),
    ],
)
def test_wrong_options_of_a_dataset_are_named(dataset, capsys, options, message):
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}", *options]) == 2
    assert re.search(message, capsys.readouterr().err)


# The figures of the real data's own README, for object 5, all vertices of its mesh.
REAL = {
    "project": {"ADD, mm": "8.723", "ADD-S, mm": "4.121", "2D projection, px": "3.342"},
    "as_read": {"ADD, mm": "8.707", "ADD-S, mm": "4.140", "2D projection, px": "3.331"},
}


@pytest.fixture(scope="module")
def real_reports(real_data):
    """What is printed for the real results, as read and projected: mode -> (output, notes)."""
    results, models = real_data / "bop_results", real_data / "lmo" / "models"
    files = [str(results / f"{name}_lmo-test.csv") for name in ("megapose", "gt")]
    reports = {}
    for mode in REAL:
        out, err = io.StringIO(), io.StringIO()
        options = ["--models", str(models), "--objects", "5", "--rotations", mode]
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            assert main(["evaluate", *files, *options]) == 0
        reports[mode] = out.getvalue(), err.getvalue()
    return reports


@pytest.mark.slow
@pytest.mark.parametrize("mode", REAL)
def test_real_results_of_megapose(real_reports, mode):
    out, err = real_reports[mode]
    assert cells(out, "poses", "ground truth") == ["199"]
    assert cells(out, "poses", "estimated") == ["168"]
    assert cells(out, "correct, number", "ADD < 0.1 d") == ["122"]
    assert cells(out, "correct, number", "ADD-S < 0.1 d") == ["156"]
    assert cells(out, "correct, number", "2D projection < 5 px") == ["116"]
    assert cells(out, "correct, % of all", "ADD < 0.1 d") == ["61.3"]
    assert cells(out, "correct, % of the est", "ADD < 0.1 d") == ["72.6"]
    assert cells(out, "median", "translation, mm") == ["8.163"]
    for label, value in REAL[mode].items():
        assert cells(out, "median", label) == [value]
    if mode == "project":
        assert round(float(cells(out, "median", "rotation, deg")[0]), 2) == 3.53
        assert "0.0096" in err
    else:
        assert "rotation, deg" not in out
        assert "not rotations" in err


@pytest.mark.slow
def test_the_readme_shows_what_is_printed(real_reports):
    out, err = real_reports["project"]
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    example = readme.split("```\nnote: ")[1].split("```")[0]
    lines = example.splitlines()[2:]
    assert len(lines) > 10
    section = ""
    for line in lines:
        if line.startswith("  "):
            label, number = re.fullmatch(r"  (\S.*?) {2,}(\S+)", line).groups()
            assert cells(out, section, label) == [number]
        else:
            section = line
    noted = " ".join(example.splitlines()[:2]).split(".csv: ")[1]
    assert noted in err


def test_the_readme_python_runs(real_data):
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    code = readme.split("```python\n")[1].split("```")[0]
    code = code.replace("path/to/lmo", str(real_data / "lmo"))
    *statements, last = code.strip().splitlines()
    names = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RotationWarning)  # LM-O's, told of above
        exec("\n".join(statements), names)
        assert eval(last.split("#")[0], names) == pytest.approx(float(last.split("#")[1]))


def test_three_formulas_three_errors(real_data):
    """The trap in real ground truth: only the projected matrices have an angle between them."""
    results = real_data / "bop_results"
    estimates, truth = (
        read_results(results / f"{name}_lmo-test.csv", rotations="as_read")
        for name in ("megapose", "gt")
    )
    estimates, truth = (rows[rows.object_id == 5] for rows in (estimates, truth))
    matched = match(estimates, truth)
    R_est, R_gt = estimates.R[matched[matched >= 0]], truth.R[matched >= 0]

    def median_angle(relative):
        cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
        return np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))

    assert f"{median_angle(R_est @ np.linalg.inv(R_gt)):.2f}" == "6.36"
    assert f"{median_angle(R_est @ R_gt.transpose(0, 2, 1)):.2f}" == "2.64"
    projected = [rotations.special_procrustes(R) for R in (R_est, R_gt)]
    angle = np.degrees(np.median(rotations.geodesic_distance(*projected)))
    assert f"{angle:.2f}" == "3.53"
    with pytest.raises(ValueError, match="R_2"):
        rotations.geodesic_distance(R_est, R_gt)
