import shutil

import pytest

from data_tools.checking.command import source_of
from data_tools.main import main
from tests.data_tools.checking import mistakes

pytestmark = pytest.mark.slow


def test_sources(tmp_path):
    assert source_of(str(tmp_path)) == f"bop:{tmp_path}"
    assert source_of("linemod:here") == "linemod:here"
    assert source_of("headset") == "headset"


def test_a_folder_that_is_fine(exported, capsys):
    assert main(["check", str(exported / "plain")]) == 0
    out, err = capsys.readouterr()
    first, *_, last = out.splitlines()
    assert first == f"bop:{exported}/plain, test" and err == ""
    assert last == "  fine: models, poses, camera and images fit together"


def test_several_splits(copy, tmp_path, capsys):
    folder = copy()
    shutil.copytree(folder / "test", folder / "train")
    for path in (folder / "train").glob("*/scene_gt*.json"):
        path.unlink()
    mistakes.poses(folder, lambda R, t: (R, t / 1000))
    assert main(["check", f"bop:{folder}", "--pictures", str(tmp_path / "drawn")]) == 1
    out, err = capsys.readouterr()
    assert f"bop:{folder}, test\n" in out and "OFF: scaled translations" in out
    assert f"bop:{folder}, train: " in err and "scene_gt.json: no such file" in err
    assert len(list((tmp_path / "drawn" / "test").iterdir())) == 6
    assert main(["check", f"bop:{folder}", "--split", "train"]) == 1
    assert capsys.readouterr().err.startswith("error: ")


def test_one_split_writes_where_it_is_told(copy, tmp_path, capsys):
    mistakes.models(folder := copy(), 1000)
    words = ["check", str(folder), "--count", "3"]
    assert main([*words, "--pictures", str(tmp_path / "drawn")]) == 1
    assert str(tmp_path / "drawn" / "check_000002_000000.png") in capsys.readouterr().out
    assert main(words) == 1
    assert "--pictures FOLDER draws masks" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "source: expected one of headset, tabletop, categories, a folder or KIND:"),
        (["."], "path: expected a folder with splits"),
        (["bop:nowhere"], "path: expected the folder of a BOP dataset"),
        (["bop:x", "--scale", "tiny"], "--scale: expected a world to go with it"),
        (["headset", "--pictures", "x"], "--pictures: expected a dataset to go with it"),
    ],
)
def test_what_is_refused(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["check", *words]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(f"error: {message}") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())
