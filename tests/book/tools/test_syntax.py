"""Cells that are no Python: shown, passed over, and nothing else is touched."""

import subprocess
import sys

import pytest
from IPython.core.interactiveshell import InteractiveShell
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat.v4 import new_code_cell, new_notebook
from traitlets.config import Config

from book.tools.checks import DONE, NOT_RIGHT, Exercise, use
from book.tools.execution import environment
from book.tools.syntax import Broken, broken, forgive_syntax

OPEN = "def double(x):\n    return (2 * x\n"
TOLD = """\
  File "this cell", line 2
    return (2 * x
           ^
SyntaxError: '(' was never closed
Nothing in this cell was run. The page goes on.
"""
WORDS = "line 2 of its cell is no Python: '(' was never closed in `return (2 * x`"


@pytest.fixture
def shell(tmp_path, monkeypatch):
    """IPython as in a notebook, with nothing kept on this machine."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    config = Config()
    config.HistoryManager.enabled = False
    InteractiveShell.clear_instance()
    yield InteractiveShell.instance(config=config)
    InteractiveShell.clear_instance()


def run(shell, source):
    return shell.run_cell(source, store_history=True)


def test_a_cell_that_is_no_python_is_shown_and_passed_over(shell, capsys):
    assert isinstance(run(shell, OPEN).error_before_exec, SyntaxError)  # as IPython has it
    capsys.readouterr()
    forgive_syntax()
    assert run(shell, OPEN).success
    assert capsys.readouterr() == ("", TOLD)
    assert isinstance(shell.user_ns["double"], Broken)
    assert set(shell.user_ns) == set(shell.user_ns_hidden) | {"double"} | {
        name for name in shell.user_ns if name.startswith("_")
    }
    result = run(shell, "double(3)").error_in_exec
    assert isinstance(result, NameError) and str(result) == WORDS
    assert run(shell, "def double(x):\n    return 2 * x\ndouble(3)").result == 6


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("def f(x:\n    pass", ["f"]),
        ("def f(x)\n    return x\n\n\ndef g(x):\n    return x\n", ["f", "g"]),
        ("async def f(x)\n    return x", ["f"]),
        ("class A\n    def method(self):\n        pass", ["A"]),
        ("dfe f(x):\n    return x", ["f"]),
        ("x = 1\n def f(x):\n    return x", ["f"]),
        ("def f(x):\n\treturn x\n        return x", ["f"]),
        ("return 3", []),  # found by the compiler, not by the parser
        ("assert f(3) ==", []),  # f may be right
        ("assert not f(3) ==", []),
        ("print f(3)", []),
        ("y = f(3", []),
    ],
)
def test_what_a_broken_cell_would_have_defined(shell, source, names, capsys):
    shell.user_ns["f"] = f = "as it was"
    forgive_syntax()
    assert run(shell, source).success
    assert "Error: " in capsys.readouterr().err
    assert [
        name for name in ("f", "g", "A") if isinstance(shell.user_ns.get(name), Broken)
    ] == names
    assert "f" in names or shell.user_ns["f"] is f


@pytest.mark.parametrize(
    "source",
    [
        "x = 3\nx",
        "",
        "\n",
        "# nothing",
        "import asyncio\nawait asyncio.sleep(0)\n7",
        "%time x = 3",
        "%%capture\nx = 3",
        "x = !echo 3",
        "len?",
        "'''\nsome words (\n'''",
        "'\\d'  # a warning of its own",
        "    x = 3\n    x",
    ],
)
@pytest.mark.filterwarnings("ignore::SyntaxWarning", "ignore::DeprecationWarning")
def test_cells_that_are_python_are_left_as_they_are(shell, source):
    before = shell.transform_cell(source)
    forgive_syntax()
    assert shell.transform_cell(source) == before
    assert run(shell, source).success


def test_features_of_other_cells_count(shell, capsys):
    forgive_syntax()
    run(shell, "from __future__ import barry_as_FLUFL")
    assert run(shell, "1 <> 2").result is True
    assert capsys.readouterr().err == ""
    assert run(shell, "1 != 2").success and "SyntaxError" in capsys.readouterr().err


def test_it_is_installed_once(shell, capsys):
    before = len(shell.input_transformers_post)
    forgive_syntax()
    forgive_syntax()
    assert len(shell.input_transformers_post) == before + 1
    run(shell, OPEN)
    assert capsys.readouterr().err == TOLD


def test_without_ipython_it_does_nothing():
    code = (
        "import sys; from book.tools.syntax import forgive_syntax; forgive_syntax();"
        "assert 'IPython' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    forgive_syntax()  # also where it is imported, but does not run
    assert broken("x = 3") == {}


def test_its_check_says_where_and_spends_no_hint(capsys):
    def double(x):
        return 2 * x

    check = Exercise(double, lambda rng: iter([("three", 3.0)]), hints=("Add.", "x + x"))
    answer = check(broken(OPEN)["double"])
    assert (answer.status, answer.line) == (NOT_RIGHT, f"double: not right yet: {WORDS}.")
    assert use(answer, double) is double
    assert check(lambda x: x).line.endswith("Hint 1 of 2: Add.")
    assert check(double).status == DONE


@pytest.mark.slow
def test_run_all_goes_on(tmp_path):
    """In a kernel, which says of each cell whether it failed: there nbclient and Jupyter stop."""
    first = "from book.tools.syntax import forgive_syntax\n"
    rest = [OPEN, "print('goes on', type(double).__name__)", "1 / 0"]
    for begin, last in ((first, 1), (first + "forgive_syntax()", 3)):
        nb = new_notebook(cells=[new_code_cell(source) for source in (begin, *rest)])
        with environment("tiny", tmp_path / "profile"):
            with pytest.raises(CellExecutionError):  # other errors stop it as they always did
                NotebookClient(nb, timeout=60, kernel_name="python3").execute()
        kinds = [[output.output_type for output in cell.outputs] for cell in nb.cells]
        assert [n for n, kind in enumerate(kinds) if "error" in kind] == [last]
    assert nb.cells[1].outputs[0].text == TOLD and nb.cells[1].outputs[0].name == "stderr"
    assert nb.cells[2].outputs[0].text == "goes on Broken\n"
