"""Two small books: one that measures, and one with every kind of content, with its site."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from book.tools.checks import DONE, NOT_DONE, NOT_RIGHT, Answer
from book.tools.claims import Claim, LedgerTable, Row
from book.tools.contents import BOOK
from book.tools.execution import WIDGET_VIEW
from book.tools.keys import Key
from book.tools.site import build
from book.tools.source import show_source
from data_tools.readers import READERS
from data_tools.storage.locks import file_lock
from posecore import figures
from posecore.metrics import add
from tests.book.tools.small_book import forget, write_folio

CONTENTS = """
[[page]]
name = "index"
[[page]]
name = "01_first"
exercises = true
[[page]]
name = "02_second"
"""

CURVES = "accuracy of two methods over the threshold"
GRID = "four pictures [of] *noise* & <more>, 100 % \\"
WIDE = "four pictures in a row"
VIEWER = "two spheres of points, a box around the first"
FIRST = """\
# Poses, first of all

A pose says where an object is, and how it is turned: three numbers for the place, three for the
turn. Umeyama's solution ([Umeyama, 1991](https://doi.org/10.1109/34.88573)) finds both at once,
ICP ([Besl and McKay, 1992](https://doi.org/10.1109/34.121791/)) without knowing which points
belong together; the second chapter [goes on](02_second.ipynb), from
[a heading in it](02_second.ipynb#A-heading-with-Capitals) or [one here](#A-formula). Its figures
are drawn by [code of their own](ch01_first/drawing.py), its metrics by
[the library](../library/metrics.py). `[no link](https://doi.org/10.1/none)` is code.

## A formula

A point of the object lands in the image at
$\\mathbf{u} = \\pi(K (R\\,\\mathbf{x} + \\boldsymbol{t}))$, and the **average distance** is
the mean over all points of the model:

$$
e_{\\mathrm{ADD}} = \\frac{1}{M} \\sum_{i=1}^{M} \\left\\lVert (R\\,\\mathbf{x}_i + \\mathbf{t})
- (\\hat{R}\\,\\mathbf{x}_i + \\hat{\\mathbf{t}}) \\right\\rVert_2 \\qquad
R = \\begin{bmatrix} r_{11} & r_{12} & r_{13} \\\\ r_{21} & r_{22} & r_{23} \\\\
r_{31} & r_{32} & r_{33} \\end{bmatrix}
$$
"""
TABLE = """\
## What it is good for

| metric | asks | unit | misleads when | and the reader then has to look at |
|---|---|---|---|---|
| ADD | how far do points move? | mm | the object is symmetric | symmetric_averages |
| 2D projection | how far do pixels move? | px | the object is far away | depth |

| | asks |
|---|---|
| ADD | how far? |

> A metric is a question. Ask the right one.[^note]

1. First the points,
2. then the pose.

[^note]: A footnote of the page's own.
"""


def _output(thing):
    if hasattr(thing, "_repr_mimebundle_"):
        data, metadata = thing._repr_mimebundle_()
    else:
        data, metadata = {"text/plain": repr(thing)}, {}
        for kind in ("html", "markdown"):
            if hasattr(thing, f"_repr_{kind}_"):
                data[f"text/{kind}"] = getattr(thing, f"_repr_{kind}_")()
    return new_output("execute_result", data, metadata=metadata, execution_count=1)


def _cell(code, *things):
    outputs = [thing if isinstance(thing, dict) else _output(thing) for thing in things]
    return new_code_cell(code, outputs=outputs, execution_count=1)


def _rows():
    six, quaternion = Key("6D"), Key("quaternion")
    claim = Claim(
        id="a",
        statement="6D beats quaternions <by far>",
        source="Table IV",
        measurement="table_iv",
        favoured=six,
        other=quaternion,
        better="lower",
        unit="degrees",
        paper=(0.55, 2.5),
    )
    values = {seed: {six: 0.5 + seed / 50, quaternion: 2.4 - seed / 40} for seed in range(3)}
    conditions = {"scale": "book", "version": "0.1.0", "machine": "Linux, x86_64, 2 cores"}
    return Row(claim, values, conditions), Row(claim, values, conditions, ("shading",))


def _slider():
    """A widget, as JupyterLab saves it."""
    view = {"version_major": 2, "version_minor": 0, "model_id": "box"}
    return new_output("display_data", {WIDGET_VIEW: view, "text/plain": "IntSlider(value=0)"})


def _curves():
    errors = np.abs(np.random.default_rng(1).normal(0, 0.03, 200))
    return figures.accuracy_curves({"ours": errors, "theirs": errors * 2}, alt=CURVES)


def _grid():
    images = np.random.default_rng(0).integers(0, 256, (4, 60, 80, 3), dtype=np.uint8)
    return figures.picture_grid(images, titles=list("abcd"), alt=GRID)


def _wide():
    """A picture as wide as a page of paper, of which a phone shows less than half."""
    image = np.random.default_rng(0).integers(0, 256, (40, 120, 3), dtype=np.uint8)
    return figures.picture_grid([image] * 4, columns=4, alt=WIDE)


def _viewer():
    points = np.random.default_rng(0).normal(size=(600, 3))
    points /= 10 * np.linalg.norm(points, axis=1, keepdims=True)
    clouds = {"model": points, "estimate": points + [0.02, 0, 0.01]}
    box = (np.eye(3), np.zeros(3), np.full(3, 0.2))
    return figures.Viewer(clouds, axes=(np.eye(3), np.zeros(3)), boxes=box, alt=VIEWER)


def _cells():
    """The cells of every notebook."""
    long_line = "x = nearest_rotation(reference @ " + "rotation_about_x(angle) @ " * 6 + "I)"
    back = "\n\nBack to [the chapter](../01_first.ipynb)."
    return {
        "index": [
            new_markdown_cell("# The small book\n\nTwo chapters, [one](01_first.ipynb) and two."),
            new_markdown_cell("## Words\n\n**Pose**: a place and a turn; a zymurgical word."),
        ],
        "01_first": [
            new_markdown_cell(FIRST),
            _cell("figures.accuracy_curves({'ours': errors, 'theirs': errors * 2})", _curves()),
            new_markdown_cell("*Smaller thresholds ask for more: a caption.*"),
            _cell("figures.picture_grid(images)", _grid()),
            new_markdown_cell("Turn it:"),
            _cell("figures.Viewer({'model': points})", _viewer()),
            new_markdown_cell(TABLE),
            _cell(long_line, new_output("stream", name="stdout", text="9 " * 200)),
            _cell("show_source(add)", show_source(add, docstrings=False)),
            _cell("ledger_table(read_ledger(path))", LedgerTable(_rows())),
            _cell("slider", _slider()),
        ],
        "02_second": [
            new_markdown_cell("# Second\n\nNothing to compute."),
            new_markdown_cell(
                "## A heading with Capitals\n\nSee [before](01_first.ipynb#What-it-is-good-for)."
            ),
            _cell("figures.picture_grid(rows)", _wide()),
        ],
        "exercises/exercises_01_first": [
            new_markdown_cell("# Exercises: poses" + back),
            _cell("answer", Answer(DONE, "Exercise 1: done, 12 of 12 inputs agree.", None)),
            _cell("answer", Answer(NOT_DONE, "Exercise 2: not done yet.", None)),
            _cell("answer", Answer(NOT_RIGHT, "Exercise 3: not right yet: 0, not <1>.", None)),
        ],
        "solutions/solutions_01_first": [
            new_markdown_cell("# Exercises: poses" + back),
            _cell("def centroid(points):\n    return points.mean(-2)"),
        ],
    }


METADATA = {
    "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"},
    "language_info": {"name": "python", "pygments_lexer": "ipython3"},
}


def write_notebook(path, cells):
    path.write_text(json.dumps(new_notebook(cells=cells, metadata=METADATA)), encoding="utf-8")


def write_book(folder):
    """A project with a small book; returns the folder of the book."""
    book = folder / "project" / "book"
    for part in ("site", "ch01_first", "exercises", "solutions", "../library"):
        (book / part).mkdir(parents=True)
    (book / "site" / "contents.toml").write_text(CONTENTS)
    (book / "ch01_first" / "drawing.py").write_text("print('figures')\n")
    (book / "../library" / "metrics.py").write_text("print('metrics')\n")
    for name, cells in _cells().items():
        write_notebook(book / f"{name}.ipynb", cells)
    return book


@pytest.fixture
def folio(tmp_path, monkeypatch):
    """A book named folio that can be imported, and its world; at book scale, a cache of its own."""
    book = write_folio(tmp_path)
    monkeypatch.delenv("POSECORE_SCALE", raising=False)
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(READERS, "specks", "folio.ch01_poses.specks:WORLD.open")
    # An edit within one second that leaves the size as it was would run the old bytecode.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)
    yield book
    forget()


@pytest.fixture(scope="session")
def hostile(tmp_path_factory):
    """The environment of a user whose settings would change what a notebook shows."""
    home = tmp_path_factory.mktemp("home")
    startup = home / "ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True)
    for path in (startup / "00.py", home / "startup.py"):
        path.write_text("startup = 1")
    (home / "matplotlibrc").write_text("lines.linewidth: 77")
    kernel = home / "data" / "kernels" / "python3"
    kernel.mkdir(parents=True)
    wrong = {"argv": ["false"], "display_name": "wrong", "language": "python"}
    kernel.joinpath("kernel.json").write_text(json.dumps(wrong))
    return {
        "HOME": str(home),
        "IPYTHONDIR": str(home / "ipython"),
        "PYTHONSTARTUP": str(home / "startup.py"),
        "MATPLOTLIBRC": str(home / "matplotlibrc"),
        "MPLBACKEND": "svg",
        "JUPYTER_PATH": str(home / "data"),
        "PYTHONOPTIMIZE": "1",
        "PYTHONWARNINGS": "error",
        "POSECORE_DATA": str(home),
        "POSECORE_RETRAIN": "1",
        "POSECORE_SCALE": "paper",
        "COLUMNS": "200",
    }


@pytest.fixture(scope="session")
def small_site(shared_cache):
    """The small book, and the folder of its site, built once for all processes of a run."""
    folder = shared_cache / "small site"
    with file_lock(folder):
        if not (folder / "html").exists():
            build(folder / "html", write_book(folder))
    return SimpleNamespace(book=folder / "project" / "book", folder=folder / "html")


@pytest.fixture(scope="session")
def real_site(shared_cache):
    """The book, and the folder of its site, which is built once for all processes of a run."""
    folder = shared_cache / "site" / "html"
    folder.parent.mkdir(exist_ok=True)
    with file_lock(folder):
        if not folder.exists():
            build(folder)
    return SimpleNamespace(book=BOOK, folder=folder)


@pytest.fixture(scope="session", params=["small", "real"])
def site(request):
    """Either of the two."""
    return request.getfixturevalue(f"{request.param}_site")
