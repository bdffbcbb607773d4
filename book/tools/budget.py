"""How long a page is, beside what a reader can take at one sitting: told, and no fault."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from nbformat import NotebookNode

from book.tools.contents import BOOK, Page
from book.tools.notebooks import read_notebook

__all__ = [
    "LARGEST_NOTEBOOK",
    "LONGEST_CELL",
    "MOST_CELLS",
    "MOST_WORDS",
    "budget",
    "count_words",
    "lines_of_code",
]

MOST_WORDS = 7000
"""Of the text of a page, about; an appendix, for those who want more, does not count."""
MOST_CELLS = 150
"""Of a page before its appendix."""
LARGEST_NOTEBOOK = 1_500_000
"""Bytes of an executed page."""
LONGEST_CELL = 15
"""Lines of code in one cell of a page, without blank ones, comments and docstrings."""

APPENDIX = re.compile(r"^#+ Appendix\b", re.MULTILINE)
# No words: blocks of code, formulas, HTML, and where links and pictures lead.
WORDLESS = re.compile(
    r"^```.*?^```|\$\$.*?\$\$|\$[^$\n]+\$|<[/!a-zA-Z][^>]*>|(?<=\])\([^)\s]*\)",
    re.MULTILINE | re.DOTALL,
)
WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*")
FIGURE = re.compile(r"<(?:figure|img)\b")


def budget(page: Page, book: Path = BOOK) -> str:
    """What a page holds and what it may, in one line; empty where it cannot be read.

    Args:
        page: its notebook is read.
        book: the folder of the book.
    """
    path = book / f"{page.name}.ipynb"
    try:
        nb = read_notebook(path)
    except ValueError:  # of which the checks tell
        return ""
    lesson, appendix = _split(nb)
    code = [cell for cell in nb.cells if cell.cell_type == "code"]
    longest = max((lines_of_code(cell.source) for cell in code), default=0)
    parts, over = [], []
    for what, amount, most, unit in (
        ("words", _words(lesson), MOST_WORDS, ""),
        ("cells", len(lesson), MOST_CELLS, ""),
        ("a cell", longest, LONGEST_CELL, " lines"),
        ("size", path.stat().st_size / 1e6, LARGEST_NOTEBOOK / 1e6, " MB"),
    ):
        parts.append(f"{what} {round(amount, 2):g} of {most:g}{unit}")
        over += [what] if amount > most else []
    parts.append(f"{sum(map(_figures, code))} figures")
    if appendix:
        parts.append(f"appendix {_words(appendix)} words")
    return f"{page.name}: {', '.join(parts)}" + (f"; over: {', '.join(over)}" if over else "")


def count_words(text: str) -> int:
    """The words of a piece of Markdown, without code in blocks, formulas, HTML and addresses."""
    return len(WORD.findall(WORDLESS.sub(" ", text)))


def lines_of_code(source: str) -> int:
    """Lines of a cell, without blank ones, comments and docstrings; 0 where it is no Python."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return 0
    lines = {n for n, line in enumerate(source.split("\n"), 1) if line.strip()}
    lines -= {n for n, line in enumerate(source.split("\n"), 1) if line.strip().startswith("#")}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node):
            lines -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


def _split(nb: NotebookNode) -> tuple[list[NotebookNode], list[NotebookNode]]:
    """The cells before the appendix and of it; a cell in which it begins is divided."""
    for number, cell in enumerate(nb.cells):
        found = APPENDIX.search(cell.source) if cell.cell_type == "markdown" else None
        if found:
            before, behind = (
                NotebookNode(cell_type="markdown", source=text)
                for text in (cell.source[: found.start()], cell.source[found.start() :])
            )
            lesson = nb.cells[:number] + ([before] if before.source.strip() else [])
            return lesson, [behind, *nb.cells[number + 1 :]]
    return nb.cells, []


def _words(cells: list[NotebookNode]) -> int:
    return sum(count_words(cell.source) for cell in cells if cell.cell_type == "markdown")


def _figures(cell: NotebookNode) -> int:
    """Pictures of a cell's outputs, and figures within HTML."""
    shown = [output.get("data", {}) for output in cell.outputs]
    pictures = sum(kind.startswith("image/") for data in shown for kind in data)
    return pictures + sum(len(FIGURE.findall(data.get("text/html", ""))) for data in shown)
