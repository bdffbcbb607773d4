"""The students' notebooks: nothing of a solution is left in them, and nothing of theirs is lost."""

import copy
import json
import re
import shutil
from pathlib import Path

import nbformat
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jupyter_server.services.contents.largefilemanager import LargeFileManager
from jupytext.sync_contentsmanager import build_sync_jupytext_contents_manager_class
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from book.tools.contents import BOOK, Page, pages
from book.tools.exercises import BEGIN, END, generate, generated, start, student_version
from book.tools.notebooks import is_executed, read_notebook, read_source, source_bytes

STUB = '''def add(a, b):
    """The sum."""
    ...  # your code here


assert add'''
SOLVED = f'''def add(a, b):
    """The sum."""
    {BEGIN}
    total = a + b

    return total
    {END}


assert add'''
WITH_EXERCISES = [page for page in pages() if page.exercises]
each_page = pytest.mark.parametrize("page", WITH_EXERCISES, ids=lambda page: page.name)


def code(source, *tags, **more):
    return new_code_cell(source, metadata={"tags": list(tags)}, **more)


def text(source, *tags):
    return new_markdown_cell(source, metadata={"tags": list(tags)})


def sources(nb):
    return [cell.source for cell in nb.cells]


def marked(*lines):
    return [code("\n".join(lines))]


# student_version --------------------------------------------------------------------------------


def test_solutions_become_stubs() -> None:
    nb = new_notebook(
        cells=[
            text("# Exercises"),
            text("**Solution.** Add.", "solution"),
            code("import numpy", "hide-input"),
            code(SOLVED, outputs=[new_output("stream", text="secret")], execution_count=3),
            code("add(1, 2)", "solution"),
            code("answer"),
        ],
        metadata={"posecore": {"code": "digest"}},
    )
    before = copy.deepcopy(nb)
    student = student_version(nb)
    assert nb == before
    assert sources(student) == ["# Exercises", "import numpy", STUB, "answer"]
    assert [cell.metadata.get("tags", []) for cell in student.cells] == [[], ["hide-input"], [], []]
    assert not is_executed(student)
    nbformat.validate(student)


def test_several_solutions_in_one_cell_keep_their_indentation() -> None:
    inner = ["if x:", "    z = 3", "        ", f"    {BEGIN}", "    z = 4", f"    {END}"]
    student = student_version(new_notebook(cells=marked("x = 1", BEGIN, "y = 2", END, *inner)))
    assert sources(student) == [
        "x = 1\n...  # your code here\nif x:\n    z = 3\n\n    ...  # your code here"
    ]


FUNCTION, BODY = "def add(a, b):", "    return a + b"
IN, OUT = f"    {BEGIN}", f"    {END}"
REFUSED = [
    ([], "notebook: expected an exercise"),
    ([text("# Exercises"), code("add(1, 2)")], "notebook: expected an exercise"),
    ([code("add(1, 2)", "solution")], "notebook: expected an exercise"),
    (marked(FUNCTION, IN, BODY), f"cell 1 ('def add(a, b):'): expected {END} after {BEGIN}, got"),
    (marked(FUNCTION, BODY, OUT), f"expected {BEGIN} before {END}, got {END} alone"),
    (marked(FUNCTION, OUT, BODY, IN), f"expected {BEGIN} before {END}"),
    (marked(FUNCTION, IN, IN, BODY, OUT, OUT), f"expected {END} before the next {BEGIN}, got nes"),
    (marked(FUNCTION, IN, BODY, IN, BODY, OUT), f"expected {END} before the next {BEGIN}, got nes"),
    (marked(FUNCTION, IN, BODY, OUT, OUT), f"expected {BEGIN} before {END}"),
    (marked(FUNCTION, IN, BODY, END), f"expected {END} as far to the right as its {BEGIN}, got an"),
    (marked(FUNCTION, BEGIN, BODY, OUT), f"expected {END} as far to the right as its {BEGIN}"),
    (marked(FUNCTION, BEGIN, BODY, END), "expected what is left without the solution to be Python"),
    (marked(FUNCTION, IN, OUT), "expected a solution between the marks, got nothing"),
    (marked(FUNCTION, IN, "", "    ", OUT), "expected a solution between the marks, got nothing"),
    (marked(FUNCTION, IN, BODY, OUT, IN, OUT), "expected a solution between the marks, got noth"),
    (marked(FUNCTION, IN, BODY, "    # END SOLUTION"), "alone on a line, got '# END SOLUTION'"),
    (marked(FUNCTION, "    ###BEGIN SOLUTION", BODY, OUT), "line, got '###BEGIN SOLUTION'"),
    (marked(FUNCTION, "    ### Begin Solution", BODY, OUT), "line, got '### Begin Solution'"),
    (marked(FUNCTION, "    ### BEGIN_SOLUTION", BODY, OUT), "line, got '### BEGIN_SOLUTION'"),
    (marked(FUNCTION, f"{IN} here", BODY, OUT), "alone on a line, got '### BEGIN SOLUTION here'"),
    (marked(FUNCTION, f"{BODY}  {BEGIN}"), "alone on a line, got 'return a + b  ### BEGIN"),
    ([text(f"{BEGIN}\nadd\n{END}"), code(SOLVED)], "cell 1 ('### BEGIN SOLUTION'): expected marks"),
    ([code(SOLVED), code(SOLVED, "solution")], "cell 2 ('def add(a, b):'): expected marks"),
    ([code(SOLVED), text("Add.", "Solution")], "cell 2 ('Add.'): expected the tag 'solution', got"),
    ([code(SOLVED), text("Add.", "solutions")], "expected the tag 'solution', got 'solutions'"),
    ([code(SOLVED), code("add", "a-solution")], "expected the tag 'solution', got 'a-solution'"),
]


@pytest.mark.parametrize(("cells", "message"), REFUSED)
def test_what_could_let_a_solution_slip_is_refused(cells: list, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        student_version(new_notebook(cells=cells))


LINES = st.lists(st.sampled_from([IN, OUT, "    secret = 1", "    shown = 1", "    # END"]))


@given(LINES)
def test_a_solution_is_removed_or_refused(lines: list[str]) -> None:
    """Against a reading of its own: what stands between two marks is gone, all else is there."""
    inside, balanced, expected, secret = False, True, [FUNCTION], 0
    for line in lines:
        if line in (IN, OUT):
            balanced &= inside == (line == OUT) and (line == IN or secret > 0)
            inside, secret = line == IN, 0
            expected += ["    ...  # your code here"] if line == IN else []
        elif inside:
            secret += 1
        else:
            expected.append(line)
    nb = new_notebook(cells=marked(FUNCTION, *lines, "    return"))
    if balanced and not inside and IN in lines:
        assert sources(student_version(nb)) == ["\n".join([*expected, "    return"])]
    else:
        with pytest.raises(ValueError, match="expected"):
            student_version(nb)


# generate ---------------------------------------------------------------------------------------


@pytest.fixture
def book(tmp_path: Path) -> Path:
    """A book with one page of exercises, in step."""
    (tmp_path / "solutions").mkdir()
    solutions = new_notebook(cells=[text("# Exercises"), code(SOLVED), text("So.", "solution")])
    (tmp_path / "solutions" / "solutions_01_a.py").write_bytes(source_bytes(solutions))
    generate(PAGE, tmp_path)
    return tmp_path


PAGE = Page("01_a", exercises=True)


def test_a_notebook_alone_is_generated(book: Path) -> None:
    path, data = generated(PAGE, book)
    assert path == book / "exercises" / "exercises_01_a.ipynb"
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == data
    nb = nbformat.read(path, as_version=4)
    nbformat.validate(nb)
    assert sources(nb) == ["# Exercises", STUB]
    assert nb.metadata["jupytext"] == {"formats": "ipynb"}
    assert nb.metadata["kernelspec"]["name"] == "python3"


def test_the_same_solutions_give_the_same_bytes(book: Path) -> None:
    path, data = generated(PAGE, book)
    before = path.stat().st_mtime_ns
    generate(PAGE, book)
    assert path.stat().st_mtime_ns == before  # it is not written again
    path.unlink()
    generate(PAGE, book)
    assert path.read_bytes() == data


def test_an_edited_exercise_is_generated_again_and_kept_aside(
    book: Path, capsys: pytest.CaptureFixture
) -> None:
    path, data = generated(PAGE, book)
    nb = nbformat.read(path, as_version=4)
    nb.cells[1].source = "add = sum"
    nbformat.write(nb, path)
    generate(PAGE, book)
    assert path.read_bytes() == data
    (kept,) = (book / "_build" / "replaced").iterdir()
    assert sources(read_notebook(kept)) == ["# Exercises", "add = sum"]
    assert "what it said before is kept" in capsys.readouterr().out


def test_a_bad_solution_changes_nothing(book: Path) -> None:
    path, data = generated(PAGE, book)
    solutions = book / "solutions" / "solutions_01_a.py"
    solutions.write_text(solutions.read_text().replace(END, "### END"))
    with pytest.raises(
        ValueError, match=r"^solutions/solutions_01_a\.py: cell 2 \('def add.*expected ### E"
    ):
        generate(PAGE, book)
    assert path.read_bytes() == data


@pytest.mark.parametrize("page", [Page("01_a"), Page("index")])
def test_pages_without_exercises(book: Path, page: Page) -> None:
    with pytest.raises(ValueError, match=f"page: expected a page with exercises, got {page.name}"):
        generate(page, book)
    with pytest.raises(ValueError, match="page: expected"):
        start(page, book / "my_work", book)
    assert not (book / "my_work").exists()


def test_a_page_whose_solutions_are_missing(book: Path) -> None:
    with pytest.raises(ValueError, match=r"^solutions/solutions_02_b\.py: .*cannot be read"):
        generate(Page("02_b", exercises=True), book)
    assert not (book / "exercises" / "exercises_02_b.ipynb").exists()


@each_page
def test_the_books_exercises_are_those_that_its_solutions_generate(page: Page) -> None:
    path, data = generated(page)
    assert path.read_bytes() == data, f"{path.name}: run make.py pair"
    assert not path.with_suffix(".py").exists()


@each_page
def test_the_first_cell_forgives_what_is_mistyped_in_the_others(page: Page) -> None:
    nb = nbformat.reads(generated(page)[1].decode(), as_version=4)
    first = next(cell.source for cell in nb.cells if cell.cell_type == "code")
    assert "from book.tools.syntax import forgive_syntax\n" in first
    assert re.search(r"^forgive_syntax\(\)", first, re.MULTILINE)


@each_page
def test_no_trace_of_a_solution(page: Page) -> None:
    secret, public, inside = set(), set(), False
    for cell in read_source(BOOK / "solutions" / f"solutions_{page.name}.py").cells:
        for line in map(str.strip, cell.source.split("\n")):
            inside = line == BEGIN or (inside and line != END)
            hidden = inside or "solution" in cell.metadata.get("tags", [])
            (secret if hidden or "SOLUTION" in line else public).add(line)
    secret -= public
    assert len(secret) > 10
    student = generated(page)[0].read_text(encoding="utf-8")
    assert not [s for s in secret if s in student or json.dumps(s)[1:-1] in student]
    assert "SOLUTION" not in student


@each_page
def test_solutions_store_no_outputs(page: Page) -> None:
    nb = nbformat.read(BOOK / "solutions" / f"solutions_{page.name}.ipynb", as_version=4)
    cells = [cell for cell in nb.cells if cell.cell_type == "code"]
    assert cells and not any(cell.outputs or cell.execution_count for cell in cells)


# start ------------------------------------------------------------------------------------------


def test_start(book: Path) -> None:
    path = start(PAGE, book / "my" / "work", book)
    assert path == book / "my" / "work" / "my_01_a.ipynb"
    nb = nbformat.read(path, as_version=4)
    nbformat.validate(nb)
    assert sources(nb) == ["# Exercises", STUB]
    assert nb.metadata["jupytext"] == {"formats": "ipynb"}
    assert nb.metadata["kernelspec"]["name"] == "python3"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_start_leaves_a_students_file_alone(book: Path) -> None:
    path = start(PAGE, book / "my_work", book)
    path.write_text("my work, half a notebook")
    before = path.stat().st_mtime_ns
    with pytest.raises(FileExistsError, match=re.escape(f"{path} is there already and stays")):
        start(PAGE, book / "my_work", book)
    assert path.read_text() == "my work, half a notebook"
    assert path.stat().st_mtime_ns == before
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_start_leaves_a_file_alone_that_has_its_name_of_before(book: Path) -> None:
    """Copies were called as their page; a student who solved one should not be handed another."""
    (book / "my_work").mkdir()
    path = book / "my_work" / "01_a.ipynb"
    path.write_text("my work")
    with pytest.raises(FileExistsError, match=re.escape(f"{path} is there already and stays")):
        start(PAGE, book / "my_work", book)
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    path.rename(path.with_name("old.ipynb"))
    assert start(PAGE, book / "my_work", book).name == "my_01_a.ipynb"


def test_start_leaves_a_link_alone(book: Path) -> None:
    (book / "my_work").mkdir()
    path = book / "my_work" / "my_01_a.ipynb"
    path.symlink_to(book / "elsewhere.ipynb")  # on a disk that is not there today, say
    with pytest.raises(FileExistsError):
        start(PAGE, book / "my_work", book)
    assert path.is_symlink() and not (book / "elsewhere.ipynb").exists()


def test_start_is_all_or_nothing(book: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        start(PAGE, book / "my_work", book)
    assert not list((book / "my_work").iterdir())


def test_start_before_the_exercises_were_generated(book: Path) -> None:
    (book / "exercises" / "exercises_01_a.ipynb").unlink()
    with pytest.raises(ValueError, match="page: expected exercises that were generated, got no fi"):
        start(PAGE, book / "my_work", book)
    assert not (book / "my_work").exists()


def test_start_hands_out_no_outputs(book: Path) -> None:
    path = book / "exercises" / "exercises_01_a.ipynb"  # somebody ran the book's own copy
    nb = nbformat.read(path, as_version=4)
    nb.cells[1].outputs = [new_output("stream", text="mine")]
    nb.cells[1].execution_count = 1
    nbformat.write(nb, path)
    assert not is_executed(read_notebook(start(PAGE, book / "my_work", book)))


@pytest.mark.parametrize("folder", ["my_work", "exercises"])
def test_jupytext_pairs_a_students_notebook_with_nothing(folder: str, book: Path) -> None:
    """Opened, edited and saved in JupyterLab, under the book's own settings."""
    shutil.copy(BOOK / "jupytext.toml", book)
    path = start(PAGE, book / "my_work", book) if folder == "my_work" else generated(PAGE, book)[0]
    for root, name in ((book, f"{folder}/{path.name}"), (path.parent, path.name)):
        manager = build_sync_jupytext_contents_manager_class(LargeFileManager)()
        manager.root_dir = str(root)
        model = manager.get(name)
        model["content"]["cells"][1]["source"] += f"\n# {root.name}"
        manager.save(model, name)
        files = [file for file in path.parent.iterdir() if file.is_file()]
        assert files == [path]
        nb = nbformat.read(path, as_version=4)
        assert nb.cells[1].source.endswith(f"\n# {root.name}")
        assert nb.metadata["jupytext"]["formats"] == "ipynb"
