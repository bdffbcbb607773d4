"""The door of the command line: which commands and methods there are, and how it ends."""

import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from data_tools.storage import MakingError
from posecore import methods
from posecore.methods import METHODS, evaluating
from posecore.methods.main import main

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def in_the_foreground():
    """Where tests run in the background, interrupts are ignored, and by what is started as well."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


COMMANDS = ("train", "estimate", "clouds")


def command_of(method):
    return importlib.import_module(f"posecore.methods.{method}.command")


def methods_of(command):
    """The methods that have it: all can be trained, and then give poses or clouds."""
    return [method for method in METHODS if hasattr(command_of(method), f"add_{command}")]


def test_every_package_is_a_method_that_trains_and_gives_something():
    (folder,) = map(Path, methods.__path__)
    packages = {path.parent.name for path in folder.glob("*/__init__.py")}
    assert set(METHODS) == packages and len(set(METHODS)) == len(METHODS)
    assert methods_of("train") == list(METHODS)
    assert set(methods_of("estimate")) | set(methods_of("clouds")) == set(METHODS)
    for command in COMMANDS:
        for method in methods_of(command):
            assert callable(getattr(command_of(method), f"add_{command}"))


def test_help_names_the_commands(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    shown = capsys.readouterr().out
    for name in ("evaluate", *COMMANDS):
        assert f"    {name}" in shown


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_the_methods_that_have_a_command(capsys, command):
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    shown = capsys.readouterr().out
    assert {name for name in METHODS if f"    {name}" in shown} == set(methods_of(command))


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("train", ["--data", "--split", "--out", "--objects", "--scale", "--seed", "--device"]),
        ("estimate", ["--run", "--data", "--split", "--targets", "--output", "--device"]),
        ("clouds", ["--run", "--data", "--split", "--output", "--device"]),
    ],
)
def test_every_method_has_the_shared_options(capsys, command, options):
    for method in methods_of(command):
        with pytest.raises(SystemExit, match="0"):
            main([command, method, "--help"])
        shown = capsys.readouterr().out
        for option in options:
            assert f"  {option}" in shown


@pytest.mark.parametrize(
    "words",
    [
        [], ["guess"], ["train"], ["estimate", "nothing"], ["evaluate", "one.csv"], ["clouds"],
        ["estimate", "infrared"], ["clouds", "vector_field"],
    ],
)  # fmt: skip
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
    packages = tuple(f"posecore.methods.{method}" for method in METHODS)
    assert not [name for name in imported if name.startswith(packages)]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ImportError, RuntimeError, ValueError])
@pytest.mark.parametrize("command", ["evaluate", "estimate"])
def test_an_interrupt_is_one_line(capsys, monkeypatch, error, command):
    """Also where a library makes another error of it."""

    def interrupted(*_, **__):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise error("made of an interrupt") from None

    words = ["evaluate", "est.csv", "gt.csv"]
    if command == "estimate":
        words = ["estimate", "vector_field", "--run", "r", "--data", "d", "--output", "o.csv"]
        module = importlib.import_module("posecore.methods.vector_field.command")
        monkeypatch.setattr(module, "estimate", interrupted)
    monkeypatch.setattr(evaluating, "read_results", interrupted)
    assert main(words) == 130
    assert capsys.readouterr() == ("", "interrupted\n")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(
    ("error", "more"),
    [
        (MemoryError(), ""),
        (RuntimeError("could not create a primitive"), ": could not create a primitive"),
        (RuntimeError("can't start new\nthread"), ": can't start new thread"),
    ],
)
def test_not_enough_memory_is_one_line(capsys, monkeypatch, error, more):
    def broken(*_, **__):
        raise error

    monkeypatch.setattr(evaluating, "read_results", broken)
    assert main(["evaluate", "est.csv", "gt.csv"]) == 2
    assert capsys.readouterr() == ("", f"error: not enough memory{more}\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "own"),
    [
        (["-m", "posecore", "evaluate"], ""),
        (["book/make.py", "check"], ""),
        (["-m", "posecore", "evaluate"], "active"),
    ],
)
def test_threads_sleep_where_they_wait(command, own):
    """The one of another process may be stopped there; spinning took four times the time of one."""
    shown = {"OMP_DISPLAY_ENV": "true"} | ({"OMP_WAIT_POLICY": own} if own else {})
    kept = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    done = subprocess.run(
        [sys.executable, "-c", LOADS, *command],
        env=kept | shown,
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "libgomp" not in done.stderr or done.returncode == 0, done.stderr
    if "OMP_WAIT_POLICY" not in done.stderr:
        pytest.skip("an OpenMP that does not show its settings")
    assert f"OMP_WAIT_POLICY = '{own.upper() or 'PASSIVE'}'" in done.stderr


LOADS = """
import runpy, sys
first, *words = sys.argv[1:]
sys.argv = [*words, "--help"]
try:
    if first == "-m":
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)
    else:
        sys.argv = [first, *words, "--help"]
        runpy.run_path(first, run_name="__main__")
except SystemExit:
    pass
import torch
"""
