"""Which options a dataset is opened with."""

import argparse

import pytest

import data_tools
from posecore.methods import sources
from posecore.methods.sources import new_parser, open_source


@pytest.fixture
def opened(monkeypatch):
    calls = []
    monkeypatch.setattr(data_tools, "open", lambda *a, **k: calls.append((*a, k)), raising=False)
    return calls


def test_worlds_have_scales_and_bars_and_folders_have_not(opened):
    open_source("tabletop", "easy", "tiny", show=False)
    open_source("bop:here", None, "tiny", targets="t.json")
    assert opened == [
        ("tabletop", {"split": "easy", "scale": "tiny", "progress": False}),
        ("bop:here", {"split": None, "targets": "t.json"}),
    ]


@pytest.mark.parametrize(("show", "terminal"), [(True, True), (True, False), (False, True)])
def test_a_bar_is_for_terminals(opened, monkeypatch, show, terminal):
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    open_source("tabletop", "easy", "tiny", show)
    assert opened[0][-1]["progress"] is (show and terminal)


def test_what_is_no_source_is_refused():
    with pytest.raises(ValueError, match="^--data: "):
        open_source("nonsense", None, "tiny")


def test_a_folder_needs_its_kind(tmp_path, monkeypatch):
    (tmp_path / "photos").mkdir()
    (tmp_path / "tabletop").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="^--data: expected bop:photos .*or pictures:photos"):
        open_source("photos", None, "tiny")
    monkeypatch.setattr(data_tools, "open", lambda *_, **__: "the world", raising=False)
    assert open_source("tabletop", None, "tiny") == "the world"


def test_cameras_of_pictures(tmp_path):
    with pytest.raises(ValueError, match="^--data: expected a folder of pictures"):
        open_source("pictures:nowhere", None, None, camera=None)
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(ValueError, match="^--camera: expected a JSON file"):
        open_source(f"pictures:{tmp_path}", None, None, camera="nowhere.json")


def test_odd_units_are_told_of_once(monkeypatch, capsys, three):
    monkeypatch.setattr(data_tools, "open", lambda *_, **__: three, raising=False)
    monkeypatch.setattr(sources.units, "of_dataset", lambda _: iter(["700 m away"]))
    assert open_source("linemod:here", None, None) is three
    assert capsys.readouterr() == ("", "note: linemod:here: 700 m away\n")
    open_source("linemod:here", None, None, show=False)
    open_source("tabletop", "easy", "tiny")
    assert capsys.readouterr().err == ""


def test_commands_that_read_a_dataset_share_options(capsys):
    called = []
    parser = argparse.ArgumentParser()
    methods = parser.add_subparsers()
    own = new_parser(methods, "mine", called.append, summary="a word", description="A sentence.")
    own.add_argument("--more")
    options = parser.parse_args(["mine", "--data", "tabletop", "--more", "x"])
    assert (options.data, options.device, options.more) == ("tabletop", "auto", "x")
    options.command(options)
    assert called == [options]
    with pytest.raises(SystemExit):
        parser.parse_args(["mine"])
    assert "--data" in capsys.readouterr().err
