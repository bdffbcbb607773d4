"""The door of the command line: which commands and methods there are, and how it ends."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from data_tools.storage import MakingError
from posecore import methods
from posecore.methods import METHODS, evaluating
from posecore.methods.main import main

ROOT = Path(__file__).parents[2]


def test_every_package_is_a_method_and_has_both_commands():
    (folder,) = map(Path, methods.__path__)
    packages = {path.parent.name for path in folder.glob("*/__init__.py")}
    assert set(METHODS) == packages and len(set(METHODS)) == len(METHODS)
    for method in METHODS:
        command = importlib.import_module(f"posecore.methods.{method}.command")
        assert callable(command.add_train) and callable(command.add_estimate)


@pytest.mark.parametrize("words", [["--help"], ["train", "--help"], ["estimate", "--help"]])
def test_help_names_what_there_is(capsys, words):
    with pytest.raises(SystemExit, match="0"):
        main(words)
    shown = capsys.readouterr().out
    for name in METHODS if len(words) > 1 else ("evaluate", "train", "estimate"):
        assert f"    {name}" in shown


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("train", ["--data", "--split", "--out", "--objects", "--scale", "--seed", "--device"]),
        ("estimate", ["--run", "--data", "--split", "--targets", "--output", "--device"]),
    ],
)
def test_every_method_has_the_shared_options(capsys, method, command, options):
    with pytest.raises(SystemExit, match="0"):
        main([command, method, "--help"])
    shown = capsys.readouterr().out
    for option in options:
        assert f"  {option}" in shown


@pytest.mark.parametrize(
    "words", [[], ["guess"], ["train"], ["estimate", "nothing"], ["evaluate", "one.csv"]]
)
def test_what_is_no_command_ends_with_2(capsys, words):
    with pytest.raises(SystemExit, match="2"):
        main(words)
    out, err = capsys.readouterr()
    assert out == "" and "usage: python -m posecore" in err


@pytest.mark.parametrize("error", [ValueError, OSError, FileNotFoundError, MakingError])
def test_errors_become_a_line_and_a_status(capsys, monkeypatch, error):
    def broken(*_, **__):
        raise error("est.csv: broken")

    monkeypatch.setattr(evaluating, "read_results", broken)
    assert main(["evaluate", "est.csv", "gt.csv"]) == 2
    assert capsys.readouterr() == ("", "error: est.csv: broken\n")


def test_mistakes_of_ours_are_not_hidden(monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr(evaluating, "read_results", broken)
    with pytest.raises(ZeroDivisionError):
        main(["evaluate", "est.csv", "gt.csv"])


@pytest.mark.slow
def test_evaluate_waits_for_no_method(tmp_path):
    """And `python -m posecore` is the same door."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "posecore", "evaluate", "est.csv", "gt.csv"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert "error: " in done.stderr and "est.csv" in done.stderr
    imported = {line.split("|")[-1].strip() for line in done.stderr.splitlines()}
    assert "posecore.methods.evaluating" in imported
    assert not [name for name in imported if name.startswith("posecore.methods.vector_field")]
