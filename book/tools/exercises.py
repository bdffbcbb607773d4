"""The students' notebooks: made from the solutions, and handed out.

A solution notebook is the source. Code between the marks becomes one line, `...  # your code here`:

    def add(a, b):
        ### BEGIN SOLUTION
        return a + b
        ### END SOLUTION

and cells tagged `solution` are left out.
"""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import nbformat
from nbformat import NotebookNode

from book.tools.contents import BOOK, Page
from book.tools.notebooks import read_notebook, read_source, strip
from book.tools.pairs import set_aside
from posecore.arrays import fail
from posecore.files import write_bytes

__all__ = ["generate", "generated", "start", "student_version"]

BEGIN, END = "### BEGIN SOLUTION", "### END SOLUTION"
PLACE = "...  # your code here"
TAG = "solution"
ALMOST_A_MARK = re.compile(r"#\W*(begin|end)[\W_]*solution", re.IGNORECASE)


def student_version(nb: NotebookNode) -> NotebookNode:
    """The notebook without its solutions and outputs; the given one stays as it is.

    Raises:
        ValueError: if it has no exercise, or if a mark or tag is so placed or spelled that a
            solution could slip through; the message names the cell.
    """
    student = strip(nb)
    kept, exercises = [], 0
    for number, cell in enumerate(student.cells, 1):
        first_line = cell.source.strip().split("\n")[0]
        place = f"cell {number} ({first_line[:60]!r})"
        marked = bool(ALMOST_A_MARK.search(cell.source))
        tags = cell.metadata.get("tags", [])
        if wrong := [tag for tag in tags if TAG in tag.lower() and tag != TAG]:
            fail(place, f"the tag {TAG!r}", repr(wrong[0]))
        if marked and (cell.cell_type != "code" or TAG in tags):
            fail(place, "marks of a solution in code that students get", "marks elsewhere")
        if marked:
            cell.source = _without_solution(cell.source, place)
            exercises += 1
        if TAG not in tags:
            kept.append(cell)
    if not exercises:
        fail("notebook", f"an exercise, code between {BEGIN} and {END}", "none")
    student.cells = kept
    return student


def _without_solution(source: str, place: str) -> str:
    kept: list[str] = []
    mark, solution = None, 0  # the open mark's line, and how many lines came after it
    for line in source.split("\n"):
        text = line.strip()
        if ALMOST_A_MARK.search(line) and text not in (BEGIN, END):
            fail(place, f"{BEGIN} or {END} alone on a line", repr(text))
        if text == BEGIN:
            if mark is not None:
                fail(place, f"{END} before the next {BEGIN}", "nested marks")
            mark, solution = line, 0
            kept.append(line.replace(BEGIN, PLACE))
        elif text == END:
            if mark is None:
                fail(place, f"{BEGIN} before {END}", f"{END} alone")
            if line.rstrip() != mark.rstrip().replace(BEGIN, END):
                fail(place, f"{END} as far to the right as its {BEGIN}", "another indentation")
            if not solution:
                fail(place, "a solution between the marks", "nothing")
            mark = None
        elif mark is None:
            kept.append(line)
        elif text:
            solution += 1
    if mark is not None:
        fail(place, f"{END} after {BEGIN}", "none")
    stub = "\n".join(line.rstrip() for line in kept)
    try:
        ast.parse(stub)
    except SyntaxError as error:
        fail(place, "what is left without the solution to be Python", str(error))
    return stub


def generated(page: Page, book: Path = BOOK) -> tuple[Path, bytes]:
    """The file `exercises/exercises_NAME.ipynb`, and what it has to be, to the byte.

    Raises:
        ValueError: if the page has no exercises, or the solutions are not as `student_version`
            wants them; the message names the file.
    """
    _require_exercises(page)
    solutions = book / f"{page.part('solutions')}.py"
    try:
        nb = student_version(read_source(solutions))
    except ValueError as error:
        raise ValueError(f"solutions/{solutions.name}: {error}") from error
    return book / f"{page.part('exercises')}.ipynb", _alone(nb)


def generate(page: Page, book: Path = BOOK) -> None:
    """Write `exercises/exercises_NAME.ipynb` from `solutions/solutions_NAME.py`, where it differs.

    A notebook that says something else is set aside: somebody may have solved it where it lies.

    Raises:
        ValueError: as `generated`; nothing is written then.
    """
    path, data = generated(page, book)
    path.parent.mkdir(exist_ok=True)
    set_aside(path, data)
    if not path.is_file() or path.read_bytes() != data:
        write_bytes(path, data)


def start(page: Page, destination: Path = BOOK / "my_work", book: Path = BOOK) -> Path:
    """Copy the student's notebook of a page into a folder of the student's own.

    The copy is on its own: no `.py` file is paired with it, whatever jupytext does elsewhere.

    Args:
        page: with exercises.
        destination: the folder; it is made if it is not there.
        book: the folder of the book.

    Returns:
        The path of the copy.

    Raises:
        FileExistsError: if there is a file of this name already, with the student's work perhaps,
            or one of the name that it had before; it is left as it is.
        ValueError: if the page has no exercises, or its notebook is not there.
    """
    _require_exercises(page)
    source = book / f"{page.part('exercises')}.ipynb"
    path = Path(destination) / f"my_{page.name}.ipynb"
    if not source.is_file():
        fail("page", "exercises that were generated", f"no file {source}")
    for there in (path, path.with_name(f"{page.name}.ipynb")):  # the second as it was called before
        if os.path.lexists(there):
            raise FileExistsError(
                f"{there} is there already and stays as it is. To begin again, rename it first."
            )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, _alone(strip(read_notebook(source))))
    return path


def _alone(nb: NotebookNode) -> bytes:
    """The bytes of a notebook that no `.py` is paired with."""
    nb = nbformat.from_dict(nb)
    # Without this, a folder's general setting would have jupytext write a .py beside it.
    nb.metadata["jupytext"] = {"formats": "ipynb"}
    return nbformat.writes(nb).encode() + b"\n"


def _require_exercises(page: Page) -> None:
    if not page.exercises:
        fail("page", "a page with exercises", page.name)
