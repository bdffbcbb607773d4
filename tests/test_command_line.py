"""From the first import to the end of Python: whenever Ctrl-C comes, one line and status 130."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import data_tools.main
import posecore.methods.main
from posecore.command_line import Interrupts, carry_out

ROOT = Path(__file__).parents[1]

COMMAND = """
import atexit, signal
def stop():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("as some libraries do")
def at(moment):
    if moment == {moment!r}:
        stop()
at("import")
def parse():
    at("parse")
    return 3
def run(options):
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    atexit.register(at, "end")
    return options
"""

FINDER = """
import importlib.abc, runpy, signal, sys
class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {library!r}:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                raise ImportError("as some libraries do")
sys.meta_path.insert(0, Finder())
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


def python(*words, cwd=None):
    done = subprocess.run(
        [sys.executable, *words],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        capture_output=True,
        text=True,
        timeout=120,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("moment", ["import", "parse", "end"])
def test_an_interrupt_before_and_after_the_command(tmp_path, moment):
    (tmp_path / "command.py").write_text(COMMAND.format(moment=moment))
    start = ["-c", "from posecore.command_line import start; start('command')"]
    assert python(*start, cwd=tmp_path) == (130, "", "interrupted\n")


def test_the_status_is_what_the_command_returns(tmp_path):
    (tmp_path / "command.py").write_text(COMMAND.format(moment="never"))
    start = ["-c", "from posecore.command_line import start; start('command')"]
    assert python(*start, cwd=tmp_path) == (3, "", "")


def test_who_ignores_interrupts_goes_on(tmp_path):
    """As what a shell starts in the background."""
    module = COMMAND.format(moment="import").replace("    assert signal", "    0 and signal")
    (tmp_path / "command.py").write_text(module)
    ignore = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    start = f"{ignore}from posecore.command_line import start; start('command')"
    assert python("-c", start, cwd=tmp_path) == (3, "", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("library", "words"),
    [
        ("torch", ["posecore", "evaluate", "est.csv", "gt.csv"]),
        ("data_tools.bop", ["posecore", "evaluate", "est.csv", "gt.csv"]),
        ("posecore.methods.vector_field", ["posecore", "train", "vector_field"]),
        ("numpy", ["data_tools", "make", "tabletop"]),
        ("torch", ["book.make", "check"]),
    ],
)
def test_an_interrupt_while_libraries_are_imported(tmp_path, library, words):
    code = FINDER.format(library=library)
    assert python("-c", code, *words, cwd=tmp_path) == (130, "", "interrupted\n")


SWALLOWED = """
import signal, time
from posecore.command_line import Interrupts
def parse():
    return signal.{name}
def run(number):
    with Interrupts() as interrupts:
        try:
            try:
                signal.raise_signal(number)
            except BaseException:
                pass  # as the initialisation of some compiled modules does
            end = time.monotonic() + 20
            while time.monotonic() < end:
                time.sleep(0.01)
        except KeyboardInterrupt:
            assert interrupts.came
            end = time.monotonic() + 0.6  # nothing disturbs a clean-up
            while time.monotonic() < end:
                time.sleep(0.01)
            print("stopped", end="")
            return 130
    return 0
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this needs Unix")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_that_is_swallowed_comes_again(tmp_path, name):
    (tmp_path / "command.py").write_text(SWALLOWED.format(name=name))
    start = ["-c", "from posecore.command_line import start; start('command')"]
    assert python(*start, cwd=tmp_path) == (130, "stopped", "")


def test_an_error_made_of_an_interrupt_is_no_reason_to_disturb_its_clean_up():
    with Interrupts() as interrupts:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        try:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt:
                raise ImportError("as some libraries do")  # noqa: B904
        except ImportError:
            interrupts._looks(signal.SIGALRM, None)
        with pytest.raises(KeyboardInterrupt):
            interrupts._looks(signal.SIGALRM, None)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_after_an_interrupt_nothing_is_left_to_the_end_of_python(tmp_path):
    """There the threads of libraries that were interrupted half-way have ended in crashes."""
    text = "import atexit\ndef parse(): pass\n"
    text += "def run(_):\n    atexit.register(print, 'ended')\n    print('out')\n"
    text += "    raise SystemExit(130)\n"
    (tmp_path / "command.py").write_text(text)
    start = ["-c", "from posecore.command_line import start; start('command')"]
    assert python(*start, cwd=tmp_path) == (130, "out\n", "")


@pytest.mark.parametrize(
    ("main", "words", "name"),
    [
        (data_tools.main.main, ["export", ""], "path"),
        (data_tools.main.main, ["show", "tabletop", "--output", ""], "--output"),
        (posecore.methods.main.main, ["evaluate", "", "gt.csv"], "estimates"),
        (posecore.methods.main.main, ["evaluate", "e.csv", "gt.csv", "--json", ""], "--json"),
        (
            posecore.methods.main.main,
            ["train", "vector_field", "--data", "tabletop", "--out", ""],
            "--out",
        ),
    ],
)
def test_nothing_is_no_name(tmp_path, monkeypatch, capsys, main, words, name):
    monkeypatch.chdir(tmp_path)
    assert main(words) in (1, 2)
    assert capsys.readouterr().err == f"error: {name}: expected a text that is not empty, got ''\n"
    assert list(tmp_path.iterdir()) == []


def test_python_is_not_taken_down_after_the_last_exit_function(tmp_path):
    """Meanwhile Ctrl-C would end the process without a word."""
    text = "import atexit\nclass Late:\n    def __del__(self): print('late')\nlate = Late()\n"
    text += "def parse(): pass\ndef run(_):\n    atexit.register(print, 'ended')\n    return 3\n"
    (tmp_path / "command.py").write_text(text)
    start = ["-c", "from posecore.command_line import start; start('command')"]
    assert python(*start, cwd=tmp_path) == (3, "ended\n", "")


PRINTS = """
from posecore.command_line import carry_out
def parse():
    if {help}:
        print("help")
        raise SystemExit(0)
def run(options):
    def command():
        print("much" * 9000 if {much} else "a line")
        {then}
    return carry_out(command, name="tool", failed=2)
"""
FULL = Path("/dev/full")


def printing(folder, module, stdout):
    (folder / "command.py").write_text(module)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.Popen(
        [sys.executable, "-c", "from posecore.command_line import start; start('command')"],
        cwd=folder,
        env=kept | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
    )


def to_a_full_disk(folder, module):
    with FULL.open("w") as full, printing(folder, module, full) as process:
        errors = process.stderr.read()
    return process.returncode, errors


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
@pytest.mark.parametrize("much", [False, True])
@pytest.mark.parametrize(
    ("then", "line"),
    [
        ("pass", ""),
        # Where both went wrong both are said.
        ("raise ValueError('x: expected y')", "tool: x: expected y\n"),
        ("raise KeyboardInterrupt", "interrupted\n"),
    ],
)
def test_a_full_disk_behind_the_output_is_said(tmp_path, much, then, line):
    status, errors = to_a_full_disk(tmp_path, PRINTS.format(help=False, much=much, then=then))
    said = "tool: [Errno 28] No space left on device"
    if much:  # print itself fails, so that what follows is never reached
        assert errors.startswith(said) and errors.count("\n") == 1
        assert status == 2
    else:
        assert errors == f"{said}: 'standard output'\n{line}"
        assert status == (130 if "Interrupt" in then else 2)


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_a_full_disk_behind_a_help_text_is_said(tmp_path):
    status, errors = to_a_full_disk(tmp_path, PRINTS.format(help=True, much=False, then="pass"))
    assert status == 1
    assert errors == "error: [Errno 28] No space left on device: 'standard output'\n"


@pytest.mark.skipif(os.name == "nt", reason="this needs Unix")
def test_nobody_reads_to_the_end(tmp_path):
    module = PRINTS.format(help=False, much=True, then="pass")
    with printing(tmp_path, module, subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 141


def test_a_fault_of_the_program_goes_through():
    def broken():
        raise KeyError("mistake")

    with pytest.raises(KeyError, match="mistake"):
        carry_out(broken)
