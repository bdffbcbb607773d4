import json
import subprocess
import sys
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

import data_tools
from data_tools.main import main
from data_tools.worlds import tabletop
from data_tools.worlds.world import Size

pytestmark = pytest.mark.slow


@pytest.fixture
def cache(tiny_cache, monkeypatch):
    """A cache with a world in it, that is not to be changed."""
    monkeypatch.setenv("POSECORE_CACHE", str(tiny_cache))
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    return tiny_cache


@pytest.fixture
def empty(tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    return tmp_path / "cache"


def test_make_check_clean(empty, monkeypatch, capsys):
    small = {"tiny": Size(24, 18, {"train": 5})}
    monkeypatch.setattr(tabletop, "WORLD", replace(tabletop.WORLD, sizes=small, shard_size=2))
    store = tabletop.WORLD.store("train")
    make = ["make", "tabletop", "--split", "train", "--processes", "1", "--quiet"]
    assert main([*make, "--shard", "2/2"]) == 0
    assert capsys.readouterr().out == f"{store.folder}: 1 of 3 files made\n"
    assert store.missing() == [0, 2]

    assert main(["check", "tabletop", "--split", "train"]) == 1
    out, err = capsys.readouterr()
    assert out == f"{store.folder}: 1 of 3 files are good\n"
    assert [line.endswith("missing") for line in err.splitlines()] == [True, True]

    assert main([*make, "--shard", "1/2"]) == 0
    assert main(make) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("0 of 3 files made")
    assert main(["check", "tabletop", "--split", "train"]) == 0

    recipe = (store.folder / "recipe.json").read_bytes()
    (store.folder / "recipe.json").write_text("{")
    capsys.readouterr()
    assert main(["check", "tabletop", "--split", "train"]) == 1
    assert "recipe.json: damaged JSON" in capsys.readouterr().err
    (store.folder / "recipe.json").write_bytes(recipe)

    path = store.path(1)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    capsys.readouterr()
    assert main(["check", "tabletop", "--split", "train"]) == 1
    assert path.name in capsys.readouterr().err

    (empty / "mine.txt").parent.mkdir(exist_ok=True)
    (empty / "worlds" / "mine.txt").write_text("kept")
    assert main(["clean"]) == 0
    out = capsys.readouterr().out
    assert "tabletop/" in out
    assert " MB deleted" in out
    assert "mine.txt" in out
    assert not store.folder.exists()
    assert (empty / "worlds" / "mine.txt").read_text() == "kept"
    assert main(["clean"]) == 0
    assert "0.0 MB deleted" in capsys.readouterr().out


def test_check_of_all_splits(cache, capsys):
    assert main(["check", "tabletop", "--scale", "tiny"]) == 0
    assert [line[-20:] for line in capsys.readouterr().out.splitlines()] == [
        " 3 of 3 files are good"[-20:],
        " 1 of 1 files are good"[-20:],
        " 1 of 1 files are good"[-20:],
    ]


def test_what_does_not_fit_into_memory_is_a_line(monkeypatch, capsys):
    def no_room(*_, **__):
        raise MemoryError

    monkeypatch.setattr("data_tools.views.open", no_room)
    assert main(["show", "bop:x"]) == 1
    assert capsys.readouterr().err == "error: not enough memory\n"


def test_show(cache, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["show", "tabletop", "--count", "3", "--first", "8"]) == 0
    assert capsys.readouterr().out == "tabletop_train.png\n"
    sheet = cv2.imread(str(tmp_path / "tabletop_train.png"))
    assert sheet.shape[1] == 1800
    output = str(tmp_path / "sheet.png")
    chosen = ["--split", "easy", "--first", "8", "--count", "50"]
    assert main(["show", "tabletop", *chosen, "--output", output]) == 0
    assert cv2.imread(output).shape[1] == 1200, "there are two more"


def test_export_and_back(cache, tmp_path, capsys):
    folder = tmp_path / "bop"
    assert main(["export", str(folder), "--count", "3"]) == 0
    for split, part in (("train", "train"), ("easy", "test"), ("occluded", "test_occluded")):
        written = data_tools.open(f"bop:{folder}", split=part)
        world = data_tools.open("tabletop", split=split)
        assert len(written) == 3
        for view, ours in zip(written, world, strict=False):
            assert (view.scene_id, view.image_id) == (ours.scene_id, ours.image_id)
            for name in ("rgb", "depth", "K"):
                assert np.array_equal(getattr(view, name), getattr(ours, name)), name
            assert np.allclose(view.T_world_cam, ours.T_world_cam, rtol=0, atol=1e-12)
            assert len(view.objects) == len(ours.objects)
            for item, mine in zip(view.objects, ours.objects, strict=True):
                for name in ("object_id", "R", "box", "mask", "full_mask", "visible_fraction"):
                    assert np.array_equal(getattr(item, name), getattr(mine, name)), name
                for name in ("t", "size", "symmetries"):
                    given, expected = getattr(item, name), getattr(mine, name)
                    assert np.allclose(given, expected, rtol=0, atol=1e-12), name
        for object_id in world.models().ids:
            info, expected = written.models().info(object_id), world.models().info(object_id)
            assert info.diameter == pytest.approx(expected.diameter, abs=1e-12)
            mesh, ours = written.models().mesh(object_id), world.models().mesh(object_id)
            assert np.allclose(mesh.vertices, ours.vertices, atol=1e-7)
    targets = json.loads((folder / "test_targets_bop19.json").read_text())
    seen = [o for v in list(world.world.open(split="easy"))[:3] for o in v.objects]
    assert len(targets) == sum(o.visible_fraction >= 0.1 for o in seen)
    capsys.readouterr()
    assert main(["export", str(folder)]) == 1
    assert capsys.readouterr().err.startswith("error: path: expected a new or an empty folder")
    assert main(["show", f"bop:{folder}", "--split", "test", "--output", f"{tmp_path}/a.png"]) == 0
    picture = next((folder / "test").rglob("rgb/*.png"))
    before = picture.read_bytes()
    assert main(["show", f"bop:{folder}", "--split", "test", "--output", str(picture)]) == 1
    assert "error: --output: expected a file that is none of" in capsys.readouterr().err
    assert picture.read_bytes() == before


BAD = [
    (["make", "tables"], "world: expected one of 'headset', 'tabletop', 'categories'"),
    (["make", "tabletop", "--split", "test"], "split: expected one of 'train', 'easy', 'occluded'"),
    (["make", "tabletop", "--shard", "3/2"], "--shard: expected i/n"),
    (["make", "tabletop", "--shard", "0/2"], "--shard: expected i/n"),
    (["make", "tabletop", "--shard", "half"], "--shard: expected i/n"),
    (["make", "tabletop", "--shard", "1/2/3"], "--shard: expected i/n"),
    (["make", "tabletop", "--shard", "١/٢"], "--shard: expected i/n"),
    (["make", "tabletop", "--shard", "1/" + "9" * 5000], "--shard: expected i/n"),
    (["make", "tabletop", "--processes", "0"], "processes"),
    (["check", "tabletop", "--split", "x"], "split"),
    (["show", "tables"], "source"),
    (["show", "tabletop", "--count", "0"], "--count"),
    (["show", "tabletop", "--first", "40"], "--first"),
    (["show", "tabletop", "--output", "a.jpg"], "--output: expected a name that ends in .png"),
    (["show", "bop:nowhere"], "path"),
    (["show", "bop:nowhere", "--scale", "tiny"], "--scale"),
    (["export", "/no/such/folder/x"], "path: expected a folder in one that exists"),
    (["export", "x", "--count", "0"], "--count"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_input_is_one_line(cache, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: {message}")
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_cache_that_is_none(monkeypatch, capsys):
    monkeypatch.setenv("POSECORE_CACHE", "here")
    assert main(["clean"]) == 1
    assert capsys.readouterr().err.startswith("error: POSECORE_CACHE: expected an absolute path")


@pytest.mark.parametrize(
    "arguments", [[], ["draw"], ["make"], ["make", "tabletop", "--scale", "x"]]
)
def test_what_argparse_refuses(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_as_a_module(cache):
    command = [sys.executable, "-W", "error", "-m", "data_tools", "make", "tables"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: world")


def test_warnings_are_notes(monkeypatch, capsys):
    def warn(options):
        warnings.warn("the depth looks odd", UserWarning, stacklevel=1)

    monkeypatch.setattr("data_tools.main._show", warn)
    assert main(["show", "bop:x"]) == 0
    assert capsys.readouterr().err == "note: the depth looks odd\n"
