"""What makes a book unfit to be committed, and what is stale in it. Nothing is run here.

Several things that a test run of notebooks passes over are refused: outputs of other code or from
elsewhere, marks that switch tests off, pairs that drifted apart, pages missing from the contents.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from nbformat import NotebookNode

from book.tools.budget import LARGEST_NOTEBOOK, LONGEST_CELL, lines_of_code
from book.tools.checkpoints import read_about, wrong_weights
from book.tools.contents import BOOK, PARTS, ROOT, Page, notebooks, notebooks_of, pages
from book.tools.execution import WIDGET_VIEW
from book.tools.exercises import generated
from book.tools.inputs import stale_inputs
from book.tools.ledger import require_ledger
from book.tools.measuring import shown, stale_results
from book.tools.notebooks import (
    cells_differ,
    code_digest,
    is_executed,
    notebook_bytes,
    outputs_digest,
    read_notebook,
    read_source,
    source_bytes,
)
from posecore import weights

__all__ = ["problems", "stale"]

NOT_PAGES = {"__init__.py", "make.py", "conftest.py"}
NOT_OURS = {"my_work", "_build", ".ipynb_checkpoints"}
# Tags and comments by which a test or a run passes over a cell; nbval writes them with "_" too.
SWITCHES_OFF = {
    *("raises-exception", "nbval-raises-exception", "skip-execution", "nbval-skip"),
    *("nbval-ignore-output", "pytest-validate-ignore-output"),
}
COMPARED = "nbval-check-output"
ADDRESS = re.compile(r" at 0x[0-9a-f]{6,}")
# Not inside base64, where any letters may follow each other.
FOLDER = re.compile(
    r"(?<![\w+/=.])(?:/(?:home|Users|root|tmp|var|usr|opt|mnt|private)/|[A-Za-z]:\\Users\\)"
)
IMAGE = re.compile(r"<img\b[^>]*>")
ALT = re.compile(r"""\balt=(?:"[^"]*\w|'[^']*\w)""")


def problems(book: Path = BOOK, only: Sequence[Page] | None = None) -> list[str]:
    """Everything that makes a book unfit, a line each; empty if it is fit.

    Args:
        book: the folder of the book.
        only: look at these pages alone; by default at all, and at the table of contents.
    """
    found = [] if only is not None else list(_contents(book))
    for page in pages(book) if only is None else only:
        found += _missing(page, book)
        found += _page(page, book)
        found += _results(page, book)
    return found


def stale(book: Path = BOOK, only: Sequence[Page] | None = None) -> list[str]:
    """What is older than the code it was made from, a line each.

    Files that cannot be read are passed over: `problems` tells of them.

    Args:
        book, only: as for `problems`.
    """
    found = []
    for page in pages(book) if only is None else only:
        path = book / f"{page.name}.ipynb"
        results: list[tuple[str, tuple[str, ...]]] = []
        with suppress(ValueError):
            results += stale_results(page, book)
        with suppress(ValueError):
            if path.is_file():
                results.append(("the page", stale_inputs(read_notebook(path), page, book)))
        found += [f"{page.name}, {name}: stale: {shown(why)}" for name, why in results if why]
    return found


def _results(page: Page, book: Path) -> Iterator[str]:
    """Ledgers and notes on weights that cannot be read, and networks that are not as trained."""
    folder = book / page.package
    ledger = folder / "claims.json"
    try:
        require_ledger(ledger)
    except ValueError as error:
        yield f"{page.package}: {error}"
    for path in sorted((folder / "weights").glob("*.json")):
        if not path.with_suffix(".safetensors").exists():
            yield f"{page.package}/weights: {path.stem}.safetensors is missing beside {path.name}"
    for path in sorted((folder / "weights").glob("*.safetensors")):
        try:
            about = read_about(path)
        except ValueError as error:
            yield f"{page.package}/weights: {error}"
            continue
        try:
            state = weights.parse(path.read_bytes())
        except ValueError as error:
            yield f"{page.package}/weights: {path.name} is damaged: {error}"
            continue
        if about and (wrong := wrong_weights(path.name, state, about)):
            yield f"{page.package}/weights: {wrong}"


def _missing(page: Page, book: Path) -> Iterator[str]:
    for path in notebooks_of(page, book):
        for side in _files(path):
            if not side.exists():
                yield f"{side.relative_to(book).as_posix()}: in site/contents.toml, but missing"


def _files(notebook: Path) -> tuple[Path, ...]:
    """A notebook, and its source if it has one."""
    is_generated = notebook.parent.name == "exercises"
    return (notebook,) if is_generated else (notebook, notebook.with_suffix(".py"))


def _contents(book: Path) -> Iterator[str]:
    """Where the files are not those of the table of contents."""
    listed = {file for path in notebooks(book) for file in _files(path)}
    present = {
        path
        for path in book.rglob("*.ipynb")
        if not NOT_OURS.intersection(path.relative_to(book).parts)
    }
    for folder in (book, *(book / part for part in PARTS)):
        present |= {path for path in folder.glob("*.py") if path.name not in NOT_PAGES}
    for path in sorted(present - listed):
        yield f"{path.relative_to(book).as_posix()}: not in site/contents.toml"
    packages = {page.package for page in pages(book)}
    for path in sorted(book.glob("ch[0-9][0-9]_*")):
        if path.name not in packages:
            yield f"{path.name}: belongs to no page of site/contents.toml"


def _page(page: Page, book: Path) -> Iterator[str]:
    source = book / f"{page.name}.py"
    yield from _named(source, book, _executed_page(source))
    if page.exercises:
        path = book / f"{page.part('solutions')}.py"
        yield from _named(path, book, _bare_notebook(path))
        try:
            path, data = generated(page, book)
            if path.is_file() and path.read_bytes() != data:
                name = path.relative_to(book).as_posix()
                yield f"{name}: not what its solutions generate; run make.py pair"
        except ValueError as error:
            yield str(error)


def _named(source: Path, book: Path, found: Iterator[str]) -> Iterator[str]:
    name = source.with_suffix("").relative_to(book).as_posix()
    if not (source.exists() and source.with_suffix(".ipynb").exists()):
        return  # the contents tell of it
    try:
        for problem in found:
            yield f"{name}: {problem}"
    except ValueError as error:  # a file that cannot be read
        yield f"{name}: {error}"


def _executed_page(source: Path) -> Iterator[str]:
    yield from _pair(source)
    target = source.with_suffix(".ipynb")
    nb = read_notebook(target)
    yield from _outputs_belong(nb)
    for number, cell in _code_cells(nb):
        if lines_of_code(cell.source) > LONGEST_CELL:
            yield f"cell {number} has more than {LONGEST_CELL} lines of code"
        for output in cell.outputs:
            for problem in _output(output):
                yield f"cell {number} {problem}"
        if COMPARED in _marks(cell) and any(_pictures(output) for output in cell.outputs):
            yield f"cell {number} asks nbval to compare a picture, which it does not do"
    size = target.stat().st_size
    if size > LARGEST_NOTEBOOK:
        yield f"{size / 1e6:.2f} MB; at most {LARGEST_NOTEBOOK / 1e6} MB"


def _bare_notebook(source: Path) -> Iterator[str]:
    """A solution."""
    yield from _pair(source)
    nb = read_notebook(source.with_suffix(".ipynb"))
    if is_executed(nb):
        yield "has stored outputs; run make.py pair"
    for number, cell in _code_cells(nb):
        if COMPARED in _marks(cell):
            yield f"cell {number} asks nbval to compare with outputs that are not stored"


def _pair(source: Path) -> Iterator[str]:
    """Where the sides of a pair differ, or are not as we write them."""
    target = source.with_suffix(".ipynb")
    nb, described = read_notebook(target), read_source(source)
    difference = cells_differ(described, nb)
    if difference:
        yield f"source and notebook differ: {difference}; run make.py pair"
    if source.read_bytes() != source_bytes(described):
        yield "the source is not as make.py writes it; run make.py pair"
    elif not difference and source.read_bytes() != source_bytes(nb):
        yield "source and notebook differ in blank lines; run make.py pair"
    if target.read_bytes() != notebook_bytes(nb):
        yield "the notebook is not as make.py writes it; run make.py pair"
    for number, cell in _code_cells(nb):
        for mark in sorted(SWITCHES_OFF.intersection(_marks(cell))):
            yield f"cell {number} is marked {mark}, which switches its test off"
        try:
            ast.parse(cell.source)
        except SyntaxError as error:
            yield f"cell {number} is not plain Python ({error.msg})"


def _outputs_belong(nb: NotebookNode) -> Iterator[str]:
    """Whether the outputs are those of this code, stored by `make.py execute`."""
    note = nb.metadata.get("posecore", {})
    if not note:
        yield "never executed; run make.py execute"
        return
    if note.get("code") != code_digest(nb):
        yield "outputs of other code; run make.py execute"
    elif note.get("outputs") != outputs_digest(nb):
        yield "outputs that make.py execute did not store; run it"
    if note.get("scale") != "book":
        yield f"executed at scale {note.get('scale')}, not book; run make.py execute"
    counts = [cell.execution_count for _, cell in _code_cells(nb)]
    if counts != list(range(1, len(counts) + 1)):
        yield "cells were not all executed once in their order; run make.py execute"


def _output(output: NotebookNode) -> Iterator[str]:
    """What a stored output should not hold."""
    if output.output_type == "error":
        yield f"ends in an error: {output.ename}"
        return
    data = output.get("data", {})
    texts = [output.get("text", ""), *(v for k, v in data.items() if isinstance(v, str))]
    if output.get("name") == "stderr":
        yield f"prints a warning: {' '.join(output.text.split())[:100]}"
    elif any(FOLDER.search(text) or any(p in text for p in _places()) for text in texts):
        yield "shows a folder of the machine it ran on"
    if any(ADDRESS.search(text) for text in texts):
        yield "shows an address in memory, another one in every run"
    if WIDGET_VIEW in data:
        yield "holds a widget, which nobody sees without a kernel"
    for kind in _pictures(output):
        if not output.metadata.get(kind, {}).get("alt", "").strip():
            yield "shows a picture without alt text"
    for tag in IMAGE.findall(data.get("text/html", "")):
        if not ALT.search(tag):
            yield "shows a picture without alt text in its HTML"


def _places() -> list[str]:
    """Folders of this machine under which no reader has anything."""
    return [str(place) for place in (ROOT, sys.prefix, Path.home()) if len(Path(place).parts) > 2]


def _pictures(output: NotebookNode) -> list[str]:
    return [kind for kind in output.get("data", {}) if kind.startswith("image/")]


def _code_cells(nb: NotebookNode) -> list[tuple[int, NotebookNode]]:
    """Code cells with their numbers among all cells."""
    return [(n, cell) for n, cell in enumerate(nb.cells, 1) if cell.cell_type == "code"]


def _marks(cell: NotebookNode) -> set[str]:
    """Tags and comments, in one spelling."""
    comments = [line.strip() for line in cell.source.split("\n") if line.strip().startswith("#")]
    marks = [*cell.metadata.get("tags", []), *(line.lstrip("#").strip() for line in comments)]
    return {mark.lower().replace("_", "-") for mark in marks}
