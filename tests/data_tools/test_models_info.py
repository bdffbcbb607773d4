"""The command `models_info`: a real model as it was published, own meshes, and what is refused."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from data_tools.bop import Models
from data_tools.main import main


@pytest.fixture
def meshes(tmp_path, monkeypatch):
    """A folder with a can in metres, and a box in millimetres beside its origin."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.cylinder(0.04, 0.1, sections=64).export("can.stl")
    box = trimesh.creation.box((100, 60, 40))
    box.apply_translation([20, 0, 10]).export("obj_000003.ply")
    return tmp_path


def run(capsys, *arguments):
    status = main(["models_info", *map(str, arguments)])
    return status, *capsys.readouterr()


def test_a_published_model_is_met_to_the_digits_given(capsys):
    folder = Path(os.environ.get("POSECORE_DATA", "")) / "lmo" / "models"
    if not folder.is_dir():
        pytest.skip("POSECORE_DATA has no lmo/models")
    status, out, _ = run(capsys, folder)
    published = json.loads((folder / "models_info.json").read_text())
    found = json.loads(out)
    assert status == 0 and found.keys() == published.keys()
    for object_id, entry in published.items():
        assert found[object_id].keys() == entry.keys()
        for name, value in entry.items():
            if name == "diameter":  # with six decimals
                assert round(found[object_id][name], 6) == value
            else:
                assert found[object_id][name] == pytest.approx(value, rel=1e-15)


def test_the_list_is_printed(meshes, capsys):
    status, out, err = run(capsys, "obj_000003.ply")
    assert status == 0 and err == ""
    (entry,) = json.loads(out).values()
    assert entry["diameter"] == pytest.approx(np.linalg.norm([100, 60, 40]))
    expected = [-30, -30, -10, 100, 60, 40]
    names = [f"{kind}_{axis}" for kind in ("min", "size") for axis in "xyz"]
    assert [entry[name] for name in names] == pytest.approx(expected)


def test_a_folder_for_the_readers(meshes, capsys):
    status, out, err = run(
        capsys, "can.stl", "--unit", "m", "--id", 7,
        "--symmetry", "z:continuous", "--symmetry", "x:2", "--output", "models",
    )  # fmt: skip
    assert status == 0
    assert out.splitlines()[0].startswith("object 7: can.stl: diameter 128.062 mm, box 80 x 80 x")
    assert "listed: 1 discrete, 1 continuous symmetries" in out
    assert "of can.stl the shape is written, colours and textures are not" in err
    models = Models(meshes / "models")
    assert models.ids == (7,)
    info = models.info(7)
    assert info.diameter == pytest.approx(np.hypot(0.08, 0.1), rel=1e-6)
    assert len(info.symmetries_discrete) == len(info.symmetries_continuous) == 1
    np.testing.assert_allclose(np.ptp(models.mesh(7).vertices, 0), [0.08, 0.08, 0.1], rtol=1e-6)
    again = run(capsys, "can.stl", "--unit", "m", "--output", "models")
    assert again[0] == 1 and again[2].endswith(
        "error: --output: expected a new or an empty folder, got models\n"
    )
    assert sorted(os.listdir(meshes)) == ["can.stl", "models", "obj_000003.ply"]


def test_symmetries_of_some_of_several_objects(meshes, capsys):
    trimesh.creation.box((60, 60, 40)).export("obj_000004.ply")
    status, out, _ = run(
        capsys, ".", "--symmetry", "4=z:4", "--symmetry", "3=x:2@0,0,10", "--output", "list.json"
    )
    assert status == 0 and out.endswith("list.json\n")
    entries = json.loads((meshes / "list.json").read_text())
    assert list(entries) == ["3", "4"]
    half, quarter = (np.reshape(entries[i]["symmetries_discrete"], (-1, 4, 4)) for i in "34")
    np.testing.assert_allclose(
        half, [[[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 20], [0, 0, 0, 1]]], atol=1e-9
    )
    np.testing.assert_allclose(
        quarter[0], [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-15
    )
    before = (meshes / "list.json").read_bytes()
    status, _, err = run(capsys, ".", "--output", "list.json")
    assert status == 1 and err == (
        "error: --output: expected a new file, got list.json, which is there\n"
    )
    assert (meshes / "list.json").read_bytes() == before


def test_what_does_not_fit_is_refused_and_what_would_is_said(meshes, capsys):
    status, out, err = run(capsys, "obj_000003.ply", "--symmetry", "z:2", "--output", "x.json")
    assert status == 1 and out == ""
    assert err.startswith(
        "error: object 3: --symmetry z:2: expected motions that leave the surface"
    )
    assert err.endswith("about the middle of its box they are: z:2@20,0,10\n")
    status, _, err = run(capsys, "obj_000003.ply", "--symmetry", "z:4@20,0,10")
    assert status == 1 and err.endswith("; --tolerance allows more\n")
    assert not (meshes / "x.json").exists()
    status, out, err = run(
        capsys, "obj_000003.ply", "--symmetry", "z:4@20,0,10", "--tolerance", "0.2"
    )
    assert status == 0 and len(json.loads(out)["3"]["symmetries_discrete"]) == 3
    assert err.startswith("note: object 3: z:4@20,0,10 moves points of the surface by up to 16 %")


def test_notes(meshes, capsys):
    _, _, err = run(capsys, "can.stl")
    assert err.splitlines() == [
        "note: can.stl counts as object 1, see --id",
        "note: object 1 is 0.000128 m large: its mesh was read in mm, see --unit",
    ]
    _, _, err = run(capsys, "can.stl", "--unit", "m")
    assert "the list is in mm, as in BOP; the meshes, in m, are not: --output FOLDER" in err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nothing.ply"], "[Errno 2] no such mesh: 'nothing.ply'"),
        (["notes.txt"], "path: expected a mesh that ends in .ply, .obj, .stl, or a folder, got"),
        (["empty"], "path: expected a folder with meshes called obj_000001.ply, obj_000002.ply"),
        (["can.stl", "obj_000003.ply"], "path: expected several meshes called obj_000001.ply"),
        (["obj_000003.ply", "."], "path: expected one mesh of each object, got obj_000003.ply and"),
        ([".", "--id", "3"], "--id: expected a single mesh to go with it, got ."),
        (["can.stl", "--id", "-3"], "--id: expected an integer of at least 0, got -3"),
        (["obj_000003.ply", "--symmetry", "4=z:2"], "--symmetry 4=z:2: expected an object of 3 "),
        (["obj_000003.ply", "--symmetry", "z:x"], "--symmetry z:x: fold: expected a whole number"),
        (["obj_000003.ply", "--symmetry", ""], "--symmetry: expected a text that is not empty"),
        (["obj_000003.ply", "--tolerance", "0"], "--tolerance: expected a finite number above 0"),
        (["obj_000003.ply", "--output", "x.ply"], "--output: expected a file that ends in .json"),
        (["obj_000003.ply", "--output", "no/x"], "--output: expected a place in a folder that"),
        (["broken.ply"], "broken.ply: no PLY file, or cut off in its header"),
    ],
)
def test_refusals(meshes, capsys, arguments, line):
    (meshes / "empty").mkdir()
    (meshes / "broken.ply").write_text("ply")
    status, out, err = run(capsys, *arguments)
    assert status == 1 and out == ""
    assert err.splitlines()[-1].startswith(f"error: {line}")


def test_several_objects_need_to_be_told_apart(meshes, capsys):
    trimesh.creation.box((60, 60, 40)).export("obj_000004.ply")
    status, _, err = run(capsys, ".", "--symmetry", "z:2")
    assert status == 1
    assert err.endswith("expected which object it is of, such as --symmetry 3=z:2, got none\n")


def test_a_full_disk_leaves_nothing(meshes, capsys, monkeypatch):
    import data_tools.bop.model_writing as writing

    def full(path, data):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(writing, "write_bytes", full)
    status, _, err = run(capsys, "obj_000003.ply", "--output", "models")
    assert status == 1 and "No space left on device" in err
    assert sorted(os.listdir(meshes)) == ["can.stl", "obj_000003.ply"]
