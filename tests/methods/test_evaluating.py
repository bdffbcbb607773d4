"""`evaluate`, on made-up files and on real LM-O results."""

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_tools.bop import RotationWarning, read_results
from posecore import rotations
from posecore.methods.main import main
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


@pytest.mark.parametrize("content", [None, "{}"])
def test_models_without_a_list_are_noted(files, capsys, content):
    path = files / "models" / "models_info.json"
    path.unlink() if content is None else path.write_text(content)
    assert evaluate(files) == 0
    line = (
        f"note: {path.parent}: no entry for object 1 in models_info.json: its diameter is measured"
    )
    assert capsys.readouterr().err.count(line + ", no symmetries are known\n") == 1


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


def test_results_are_written_before_anything_is_printed(files, monkeypatch, capsys):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError(32, "Broken pipe")

    out = files / "out.json"
    monkeypatch.setattr("sys.stdout", Closed())
    assert evaluate(files, "--json", str(out), "--curve", str(files / "c.png")) == 141
    assert json.loads(out.read_text())["poses"]
    assert (files / "c.png").stat().st_size > 1000
    assert "error:" not in capsys.readouterr().err


def test_a_full_disk_is_one_line(files, monkeypatch, capsys):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("sys.stdout", Full())
    assert evaluate(files) == 2
    err = capsys.readouterr().err
    assert err.splitlines()[-1] == "error: [Errno 28] No space left on device: 'standard output'"


def test_a_closed_error_stream_stops_nothing(files, monkeypatch, capsys):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("sys.stderr", Closed())
    assert evaluate(files, "--json", str(files / "out.json")) == 0  # it has notes
    assert (files / "out.json").is_file()


@pytest.mark.slow
def test_json_to_where_no_file_is(files):
    words = [str(files / "est.csv"), str(files / "gt.csv"), "--models", str(files / "models")]
    done = subprocess.run(
        [sys.executable, "-m", "posecore", "evaluate", *words, "--json", "/dev/stdout"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["poses"]  # nothing else is in it
    assert "ADD < 0.1 d" in done.stderr


def test_json_to_nowhere(files, capsys):
    assert evaluate(files, "--json", "/dev/null") == 0
    assert Path("/dev/null").is_char_device()
    assert "ADD < 0.1 d" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (["--json", "est.csv"], "--json"),
        (["--json", "gt.csv"], "--json"),
        (["--json", "camera.json"], "--json"),
        (["--json", "models/models_info.json"], "--json"),
        (["--json", "c.png", "--curve", "c.png"], "--json"),
    ],
)
def test_no_input_is_written_over(files, capsys, options, name):
    options = [str(files / word) if "." in word else word for word in options]
    before = {path: path.read_bytes() for path in files.rglob("*") if path.is_file()}
    assert evaluate(files, *options) == 2
    assert capsys.readouterr().err.startswith(f"error: {name}: expected")
    assert before == {path: path.read_bytes() for path in files.rglob("*") if path.is_file()}


def test_both_files_in_metres_are_noticed(files, capsys):
    for name in ("est.csv", "gt.csv"):
        text = (files / name).read_text().replace(" 1000,", " 1,").replace(",3 0", ",0.003 0")
        (files / name).write_text(text)
    assert evaluate(files) == 0
    err = capsys.readouterr().err
    assert "note: the estimates: half of the objects are 0.001 m from the camera" in err
    assert "note: the ground truth: half of the objects are" in err


def test_plausible_units_are_not_told_of(files, capsys):
    assert evaluate(files) == 0
    assert "unit" not in capsys.readouterr().err


def test_one_truth_behind_the_camera_ends_nothing(files, capsys):
    path = files / "gt.csv"
    path.write_text(path.read_text().replace("0 0 1000", "0 0 -1000", 1))
    assert evaluate(files) == 0
    out, err = capsys.readouterr()
    assert "note: 1 of 4 true poses are not all in front of the camera" in err
    assert cells(out, "correct, % of all", "2D projection < 5 px")[0] == "66.7"  # of three
    assert cells(out, "correct, % of all", "ADD < 0.1 d")[0] == "50.0"  # of four


@pytest.mark.parametrize("text", ["1e-99999999999999999999", "-0e99999999999999999999", "1e300"])
def test_numbers_at_the_ends_of_what_can_be_written(files, capsys, text):
    path = files / "est.csv"
    path.write_text(path.read_text().replace("3 0 1000", f"3 {text} 1000"))
    assert evaluate(files) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("width", 0, "camera.json: width: expected at least 1 pixel, got 0"),
        ("fx", 0, "camera.json: fx: expected a focal length in pixels, got 0"),
        ("fy", 1e-300, "camera.json: fy: expected a focal length"),
        ("cx", 2**2000, "camera.json: cx: expected a finite number"),
    ],
)
def test_cameras_that_cannot_be(files, capsys, name, value, message):
    path = files / "camera.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    assert evaluate(files) == 2
    assert message in capsys.readouterr().err


def test_a_camera_of_a_dataset_that_cannot_be(dataset, capsys):
    path = dataset / "test" / "000001" / "scene_camera.json"
    content = json.loads(path.read_text())
    content["2"]["cam_K"][0] = 0
    path.write_text(json.dumps(content))
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]) == 2
    err = capsys.readouterr().err
    assert f"error: bop:{dataset}: scene 1, image 2: K: expected [[fx, s, cx]" in err


@pytest.mark.parametrize("value", [2**70, 10**18, 10**4500], ids=["2**70", "10**18", "10**4500"])
def test_ids_that_fit_nowhere(dataset, capsys, value):
    path = dataset / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    content["0"][0]["obj_id"] = value
    sys.set_int_max_str_digits(0)
    try:
        path.write_text(json.dumps(content))
    finally:
        sys.set_int_max_str_digits(4300)
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]) == 2
    err = capsys.readouterr().err
    assert "scene_gt.json" in err and len(err.splitlines()) == 1


def test_placeholders_are_left_out(dataset, capsys):
    scene = dataset / "test" / "000001"
    path = scene / "scene_gt.json"
    content = json.loads(path.read_text())
    content["0"][0] |= {"cam_R_m2c": [-1] * 9, "cam_t_m2c": [-1] * 3}
    path.write_text(json.dumps(content))
    info = {"visib_fract": 1.0, "bbox_visib": [0, 0, 1, 1]}
    infos = {image: [info] * len(poses) for image, poses in content.items()}
    infos["0"] = [{"visib_fract": -1, "bbox_visib": [-1] * 4}, info]
    (scene / "scene_gt_info.json").write_text(json.dumps(infos))
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]) == 0
    out, err = capsys.readouterr()
    assert cells(out, "poses", "ground truth")[:2] == ["3", "4"]
    assert "scene_gt.json: 1 of 8 poses are placeholders" in err


def test_an_own_object_is_ground_truth(tmp_path, capsys):
    """PVNet's layout of one object, in metres."""
    own = tmp_path / "mug"
    for name in ("rgb", "pose"):
        (own / name).mkdir(parents=True)
    lines = TETRAHEDRON.replace("100", "0.1")
    (own / "model.ply").write_text(lines)
    (own / "camera.txt").write_text("500 0 20\n0 500 15\n0 0 1\n")
    for i in range(3):
        cv2.imwrite(str(own / "rgb" / f"{i}.png"), np.full((30, 40, 3), 90, np.uint8))
        np.save(own / "pose" / f"pose{i}.npy", np.column_stack([np.eye(3), [0, 0, 1.0]]))
    rows = [f"1,{i},1,1,{EYE},3 0 1000,-1" for i in range(2)]
    (tmp_path / "est.csv").write_text(HEADER + "\n".join(rows))
    words = ["evaluate", str(tmp_path / "est.csv"), f"linemod:{own}"]
    assert main(words) == 0, capsys.readouterr().err
    out, err = capsys.readouterr()
    assert cells(out, "poses", "estimated") == ["2"]
    assert cells(out, "correct, % of all", "ADD < 0.1 d") == ["66.7"]
    assert cells(out, "median", "2D projection, px")[0].startswith("1.4")
    assert "millimetres" not in err
    assert main([*words, "--targets", "t.json"]) == 2
    assert "--targets" in capsys.readouterr().err
    for i in range(3):
        np.save(own / "pose" / f"pose{i}.npy", np.column_stack([np.eye(3), [0, 0, 700.0]]))
    assert main(words) == 0
    assert "the ground truth: half of the objects are 700 m" in capsys.readouterr().err


def test_estimates_of_what_is_no_target_cost_no_precision(dataset, capsys):
    """Each image holds two of object 1; one of them is a target, and both are found."""
    scene = dataset / "test" / "000001"
    content = json.loads((scene / "scene_gt.json").read_text())
    pose = {"obj_id": 1, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    for poses in content.values():
        poses.append(pose | {"cam_t_m2c": [300, 0, 1000]})
    (scene / "scene_gt.json").write_text(json.dumps(content))
    infos = {
        image: [{"visib_fract": visible, "bbox_visib": [0, 0, 1, 1]} for visible in (0.9, 0.9, 0.5)]
        for image in content
    }
    (scene / "scene_gt_info.json").write_text(json.dumps(infos))
    targets = [
        {"scene_id": 1, "im_id": i, "obj_id": o, "inst_count": 1} for i in range(4) for o in (1, 2)
    ]
    (dataset / "targets.json").write_text(json.dumps(targets))
    rows = [f"1,{i},1,{s},{EYE},{x} 0 1000,-1" for i in range(4) for x, s in ((0, 0.5), (300, 0.9))]
    (dataset / "est.csv").write_text(HEADER + "\n".join(rows))
    words = [str(dataset / "est.csv"), f"bop:{dataset}", "--targets", "targets.json"]
    assert main(["evaluate", *words]) == 0
    out, _ = capsys.readouterr()
    assert cells(out, "average precision of the box, %", "3D IoU > 0.5")[0] == "100.0"
    assert cells(out, "poses", "ground truth")[0] == "4"


@pytest.fixture
def seen(dataset):
    """The BOP dataset with depth, and how much is visible: less of object 1 in each image."""
    scene = dataset / "test" / "000001"
    (scene / "depth").mkdir()
    shares = [0.9, 0.5, 0.2, 0.05]
    infos = {
        str(i): [{"visib_fract": s, "bbox_visib": [0, 0, 1, 1]} for s in (share, 0.9)]
        for i, share in enumerate(shares)
    }
    (scene / "scene_gt_info.json").write_text(json.dumps(infos))
    for i in range(4):
        cv2.imwrite(str(scene / "depth" / f"{i:06d}.png"), np.zeros((480, 640), np.uint16))
    return dataset


def test_bop_scores_of_a_dataset_with_depth(seen, capsys):
    """Three of four are 3 mm off, of 14 cm; the fourth is hardly visible and was not found.

    Their silhouettes, 10 cm wide, miss 3 mm on either side: VSD is 0.11, below eight thresholds of
    ten, but for the smallest image, whose pixels are coarse.
    """
    assert main(["evaluate", str(seen / "est.csv"), f"bop:{seen}"]) == 0
    out, err = capsys.readouterr()
    recalls = [float(cells(out, "BOP average recall, %", n)[0]) for n in ("VSD", "MSSD", "MSPD")]
    assert recalls == [pytest.approx(60, abs=5), 75, 75]
    mean = float(cells(out, "BOP average recall, %", "AR, their mean")[0])
    assert mean == pytest.approx(np.mean(recalls), abs=0.1)
    section = "BOP24 detection, average precision, %"
    assert cells(out, section, "MSSD")[0] == "100.0"
    assert cells(out, section, "AP, their mean") == ["100.0", "-", "-", "100.0*"]
    assert "note: 1 of 8 true poses are less than 10% visible" in err
    assert "VSD" not in err


def test_only_what_is_visible_enough(seen, capsys):
    words = ["evaluate", str(seen / "est.csv"), f"bop:{seen}", "--visible"]
    assert main([*words, "0.3"]) == 0
    out, err = capsys.readouterr()
    assert cells(out, "poses", "ground truth") == ["2", "4", "6", "-"]
    assert cells(out, "BOP average recall, %", "MSSD")[0] == "100.0"
    assert "less than 10%" not in err
    for value in ("0.95", "-0.1", "1.5", "nan"):
        assert main([*words, value]) == 2
        assert capsys.readouterr().err.startswith("error: --visible: expected")
    (seen / "test" / "000001" / "scene_gt_info.json").unlink()
    assert main([*words, "0.3"]) == 2
    assert "error: --visible: expected a scene_gt_info.json" in capsys.readouterr().err


def test_delta_of_vsd(seen, capsys):
    """A wall 5 cm before the object hides it, or does not."""
    for path in (seen / "test" / "000001" / "depth").iterdir():
        cv2.imwrite(str(path), np.full((480, 640), 940, np.uint16))
    words = ["evaluate", str(seen / "est.csv"), f"bop:{seen}"]
    assert main(words) == 0
    assert cells(capsys.readouterr().out, "BOP average recall, %", "VSD")[0] == "0.0"
    assert main([*words, "--vsd-delta", "200"]) == 0
    assert float(cells(capsys.readouterr().out, "BOP average recall, %", "VSD")[0]) > 50
    assert main([*words, "--vsd-delta", "-1"]) == 2
    assert "error: --vsd-delta: expected" in capsys.readouterr().err


def test_why_there_is_no_vsd(files, dataset, capsys):
    assert evaluate(files) == 0
    assert "no VSD and no AR, which need depth images: a CSV file has none" in (
        capsys.readouterr().err
    )
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]) == 0
    out, err = capsys.readouterr()
    assert f"no VSD and no AR, which need depth images: {dataset / 'test'} has none" in err
    assert "VSD" not in out and "AR," not in out
    assert "MSSD" in out


def test_a_mesh_without_faces_is_not_drawn(seen, capsys):
    path = seen / "models" / "obj_000001.ply"
    text = path.read_text().replace("element face 4", "element face 0")
    path.write_text(text[: text.index("3 0 2 1")])
    assert main(["evaluate", str(seen / "est.csv"), f"bop:{seen}"]) == 0
    out, err = capsys.readouterr()
    assert "no VSD and no AR of objects [1]: their meshes have no faces" in err
    assert "VSD" not in out and "MSSD" in out


def test_time_of_an_image(files, capsys):
    text = (files / "est.csv").read_text()
    (files / "est.csv").write_text(text.replace(",-1", ",0.25"))
    assert evaluate(files, "--json", str(files / "out.json")) == 0
    assert capsys.readouterr().out.endswith("\n\ntime of an image, mean of 3: 0.250 s\n")
    content = json.loads((files / "out.json").read_text())
    assert content["time"] == {"seconds of an image": {"mean": 0.25, "images": 3}}
    (files / "est.csv").write_text(text.replace(",-1", ",0.25", 1).replace(",-1", ",0.5"))
    assert evaluate(files) == 0
    out, err = capsys.readouterr()
    assert "time" not in out
    assert "note: no time of an image: time: expected the same for all estimates" in err


def test_estimates_of_what_an_image_does_not_hold(dataset, capsys):
    path = dataset / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    del content["2"][1]
    path.write_text(json.dumps(content))
    assert main(["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]) == 0
    assert "note: 1 of the estimates are of objects" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["--targets", "--visible"])
def test_options_of_a_dataset_for_a_file(files, capsys, name):
    assert evaluate(files, name, "0.5") == 2
    assert f"error: {name}: expected nothing, as the ground truth is no" in capsys.readouterr().err


def test_models_with_which_bop_measures(dataset, capsys):
    """Others than those that are taken by default: said in a note, unless they are the same."""
    words = ["evaluate", str(dataset / "est.csv"), f"bop:{dataset}"]
    other = dataset / "models_eval"
    shutil.copytree(dataset / "models", other)
    assert main(words) == 0
    assert "models_eval" not in capsys.readouterr().err
    path = other / "obj_000001.ply"
    path.write_text(path.read_text().replace("100 0 0", "100.5 0 0"))
    assert main(words) == 0
    assert f"note: models are those of {dataset / 'models'}; BOP measures with {other}" in (
        capsys.readouterr().err
    )
    assert main([*words, "--models", str(other)]) == 0
    assert "models_eval" not in capsys.readouterr().err


def test_a_world_has_to_be_exported(files, capsys):
    assert evaluate(files, truth="tabletop") == 2
    assert "data_tools export" in capsys.readouterr().err
