"""Where results may be written to, and where they are printed."""

import os

import pytest

from posecore.methods.outputs import check_outputs, say_beside


@pytest.fixture
def folder(tmp_path):
    for name in ("est.csv", "old.json", "data/scene_gt.json", "data/rgb/000001.png",
                 "data/run.json", "data/old.csv", "data/plots/curve.png"):  # fmt: skip
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    (tmp_path / "link.json").symlink_to("est.csv")
    return tmp_path


@pytest.mark.parametrize(
    "name", ["new.json", "old.json", "data/old.csv", "data/new.csv", "data/plots/curve.png"]
)
def test_what_may_be_written(folder, name):
    check_outputs({"--json": str(folder / name)}, [str(folder / "est.csv"), str(folder / "data")])


@pytest.mark.parametrize(
    "name",
    ["est.csv", "link.json", "data/../est.csv", "data/scene_gt.json", "data/rgb/000001.png",
     "data/run.json"],
)  # fmt: skip
def test_what_is_read_is_not_written(folder, name):
    inputs = [str(folder / "est.csv"), str(folder / "data"), None]
    with pytest.raises(ValueError, match="^--json: expected a file that the command does not read"):
        check_outputs({"--json": str(folder / name)}, inputs)


def test_two_outputs_are_two_files(folder):
    both = {"--curve": str(folder / "a.png"), "--json": str(folder / "data" / ".." / "a.png")}
    with pytest.raises(ValueError, match="^--json: expected another file than --curve"):
        check_outputs(both, [])
    check_outputs(dict.fromkeys(both, os.devnull), [])


def test_folders_are_no_files(folder):
    with pytest.raises(ValueError, match="^--json: expected a file, got the folder"):
        check_outputs({"--json": str(folder / "data")}, [])
    with pytest.raises(ValueError, match="^--json: expected a file in a folder that exists"):
        check_outputs({"--json": str(folder / "no" / "a")}, [])


def test_results_are_printed_beside_a_file(folder, capsys):
    say_beside("table", [str(folder / "new.json"), None])
    assert capsys.readouterr() == ("table\n", "")
