"""What nbval passes over, seen in nbval itself, and that `checking` refuses each of it."""

import os
import re
import shutil
import subprocess
import sys
import tomllib

import nbformat
import nbval.plugin
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output

from book.tools.checking import problems
from book.tools.contents import BOOK, ROOT, Page, notebooks, pages
from book.tools.inputs import inputs
from book.tools.notebooks import (
    HEADER,
    code_digest,
    outputs_digest,
    write_notebook,
    write_source,
)

pytestmark = pytest.mark.slow  # kernels

PIXEL = (
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mNkYAAAAAYAAjCB0C8AAAAASUVORK5CYII="
)
SHOW = f"get_ipython().display_pub.publish({{'image/png': {PIXEL!r}}})"


def printed(text):
    return [new_output("stream", name="stdout", text=text)]


def picture(data):
    return [new_output("display_data", {"image/png": data})]


def cell(code, outputs=(), count=1, **metadata):
    return new_code_cell(code, outputs=list(outputs), execution_count=count, metadata=metadata)


CHECK = "# NBVAL_CHECK_OUTPUT\n"
# Each trap: the cell, what becomes of it in nbval, and what `problems` says about its notebook.
TRAPS = {
    "compared to nothing": (
        cell(CHECK + "print('new')", count=None),
        "PASSED",
        "cells were not all executed once in their order",
    ),
    "wrong output, not asked to compare": (
        cell("print('new')", printed("old\n")),
        "PASSED",
        "outputs that make.py execute did not store",
    ),
    "wrong picture, asked to compare": (
        cell(CHECK + SHOW, picture("another")),
        "PASSED",
        "asks nbval to compare a picture",
    ),
    "raises-exception without one": (
        cell("x = 1", tags=["raises-exception"]),
        "PASSED",
        "is marked raises-exception",
    ),
    "raises-exception hides any error": (
        cell("assert False", tags=["raises-exception"]),
        "PASSED",
        "is marked raises-exception",
    ),
    "raises in a comment": (
        cell("# NBVAL_RAISES_EXCEPTION\nassert False"),
        "PASSED",
        "is marked nbval-raises-exception",
    ),
    "skipped by a tag": (
        cell("assert False", tags=["nbval-skip"]),
        "SKIPPED",
        "is marked nbval-skip",
    ),
    "skipped by a comment": (cell("# NBVAL_SKIP\n1 / 0"), "SKIPPED", "is marked nbval-skip"),
    "not even Python, but skipped": (
        cell("%%script false\n1 +"),
        "FAILED",  # and only as `false` fails
        "is not plain Python",
    ),
    # The control: what nbval does see, because it is asked to.
    "wrong output, asked to compare": (cell(CHECK + "print(1)", printed("2\n")), "FAILED", None),
    "right output, asked to compare": (cell(CHECK + "print(1)", printed("1\n")), "PASSED", None),
    "an assertion that fails": (cell("assert 1 == 2, 'one is not two'"), "FAILED", None),
}
SEES = """\
import os, sys
import matplotlib
import posecore

assert os.environ["POSECORE_SCALE"] == "tiny"
assert not {{"POSECORE_DATA", "POSECORE_RETRAIN"}} & set(os.environ)
assert os.path.basename(os.getcwd()) == "pages"
assert os.path.samefile(sys.executable, {python!r})
assert os.path.samefile(os.path.dirname(posecore.__file__), {library!r})
assert matplotlib.get_backend().endswith("backend_inline")
assert matplotlib.rcParams["lines.linewidth"] == 1.5
assert "startup" not in globals()
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Notebooks in a folder with the conftest.py of the book."""
    pages = tmp_path_factory.mktemp("project") / "pages"
    (pages / "site").mkdir(parents=True)
    (pages / "my_work").mkdir()
    (pages / "_build" / "replaced").mkdir(parents=True)
    shutil.copyfile(BOOK / "conftest.py", pages / "conftest.py")
    seen = SEES.format(python=sys.executable, library=str(ROOT / "posecore"))
    books = {
        "01_traps": [trap for trap, _, _ in TRAPS.values()],
        "01_drift": [cell("x = 1")],
        "01_sees": [cell(seen)],
        "01_slow": [cell("import time"), cell("time.sleep(60)"), cell("x = 1")],
        "my_work/01_traps": [cell("assert False, 'a student tries'")],
        "_build/replaced/01_traps": [cell("assert False, 'somebody tried'")],
    }
    for name, cells in books.items():
        nb = new_notebook(cells=cells)
        write_notebook(nb, pages / f"{name}.ipynb")
        if "/" not in name:
            write_source(nb, pages / f"{name}.py")
    # A pair that drifted: the notebook is content, its source is not.
    (pages / "01_drift.py").write_text(HEADER + "\n# %%\nassert False\n")
    table = "".join(f'[[page]]\nname = "{name}"\n' for name in books if "/" not in name)
    (pages / "site" / "contents.toml").write_text(table)
    return pages


def run_pytest(project, *words, before=(), **variables):
    """Exit status, what became of each cell by its name, and all that was printed."""
    command = [
        *(*before, sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml"),
        *("--rootdir", project.parent, "-p", "no:cacheprovider", "-n0", "-v", "--color=no", *words),
    ]
    done = subprocess.run(
        [str(word) for word in command],
        cwd=project.parent,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=120,
    )
    lines = re.findall(r"^(\S+)::ipynb::Cell (\d+) ([A-Z]+)", done.stdout, re.MULTILINE)
    cells = {(name, int(number)): outcome for name, number, outcome in lines}
    return done.returncode, cells, done.stdout + done.stderr


@pytest.fixture(scope="module")
def outcome(project, hostile):
    """One run over all of it, without network; a cell may take 4 s, so that the slow one ends."""
    # Two switches would stop pytest itself.
    kept = {k: v for k, v in hostile.items() if k not in ("PYTHONOPTIMIZE", "PYTHONWARNINGS")}
    return run_pytest(project, "pages", "--nbval-cell-timeout=4", before=_without_network(), **kept)


@pytest.mark.parametrize("number, name", list(enumerate(TRAPS)))
def test_what_nbval_makes_of_a_trap(number, name, outcome):
    assert outcome[1]["pages/01_traps", number] == TRAPS[name][1]


@pytest.mark.parametrize("number, name", [(n, k) for n, k in enumerate(TRAPS) if TRAPS[k][2]])
def test_what_nbval_passes_over_is_refused(number, name, tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "contents.toml").write_text('[[page]]\nname = "01_trap"\n')
    nb = new_notebook(cells=[nbformat.from_dict(TRAPS[name][0])])
    other = new_notebook(cells=[cell(nb.cells[0].source, printed("new\n"))])
    stored = other if name == "wrong output, not asked to compare" else nb
    is_python = name != "not even Python, but skipped"
    kept = inputs(nb, Page("01_trap"), tmp_path) if is_python else {}
    nb.metadata["posecore"] = {
        "code": code_digest(nb),
        "inputs": kept,
        "outputs": outputs_digest(stored),
        "scale": "book",
    }
    write_notebook(nb, tmp_path / "01_trap.ipynb")
    write_source(nb, tmp_path / "01_trap.py")
    assert any(TRAPS[name][2] in line for line in problems(tmp_path))


def test_an_assertion_that_fails_turns_pytest_red(outcome):
    status, _, text = outcome
    assert status == 1
    assert "AssertionError" in text and "one is not two" in text


def test_a_pair_that_drifted_passes_in_nbval_and_is_refused(outcome, project):
    assert outcome[1]["pages/01_drift", 0] == "PASSED"
    assert any(
        line.startswith("01_drift: source and notebook differ: cell 1, line 1 is 'assert False'")
        for line in problems(project)
    )


def test_a_cell_that_hangs_is_stopped_and_red(outcome):
    _, cells, text = outcome
    assert cells["pages/01_slow", 0] == "PASSED"
    assert cells["pages/01_slow", 1] == "FAILED"
    assert "Timeout of 4 seconds exceeded" in text


def test_what_students_and_tools_leave_is_not_collected(outcome):
    assert {name for name, _ in outcome[1]} == {
        f"pages/01_{name}" for name in ("traps", "drift", "slow", "sees")
    }


def test_cells_get_a_stated_time_and_not_2000_s(request):
    class Defaults(dict):
        def getgroup(self, *names):
            return self

        def addoption(self, name, **settings):
            self[name] = settings.get("default")

        _addoption = addoption

    defaults = Defaults()
    nbval.plugin.pytest_addoption(defaults)
    assert defaults["--nbval-cell-timeout"] == 2000
    assert request.config.getoption("--nbval-cell-timeout") == 120
    assert request.config.getoption("--nbval-kernel-startup-timeout") == 120
    assert request.config.getoption("--nbval-lax") and request.config.getoption(
        "--nbval-current-env"
    )


def test_plain_pytest_runs_library_and_book():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert options["testpaths"] == ["tests", "book"]


def _without_network():
    """The words before a command that leave it loopback alone; none where that cannot be had."""
    words = ["unshare", "-rn", "sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
    try:
        subprocess.run([*words, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return []
    return words


def test_a_notebook_without_network_sees_the_same_world_whoever_runs_it(outcome):
    assert outcome[1]["pages/01_sees", 0] == "PASSED", outcome[2]


def test_the_collected_notebooks_are_the_pages_of_the_contents(monkeypatch):
    class Collected:
        def pytest_collection_finish(self, session):
            self.files = {item.path for item in session.items}

    monkeypatch.chdir(ROOT)
    collected = Collected()
    pytest.main(["--collect-only", "-n0", "-qp", "no:cacheprovider", "book"], [collected])
    listed = {BOOK / f"{page.name}.ipynb" for page in pages()}
    assert collected.files == listed
    # All others are run by test_rehearsal.py, which does so for each page that says it has them.
    others = {*BOOK.glob("exercises/*.ipynb"), *BOOK.glob("solutions/*.ipynb")}
    assert set(notebooks()) - listed == others
