"""The teacher's rehearsal: what students do to a notebook, and what it tells them then.

Every notebook of exercises and of solutions runs here, and only here: pages run under nbval.
"""

import ast
import doctest
import functools
import importlib

import nbformat
import pytest
import torch
from matplotlib.figure import Figure
from nbclient import NotebookClient

from book.tools.checks import DONE, NOT_DONE, NOT_RIGHT, Answer, Exercise
from book.tools.contents import BOOK, find_page, pages
from book.tools.execution import environment
from book.tools.exercises import start
from book.tools.notebooks import read_notebook
from tests.book.exercises import ExerciseTests

pytestmark = pytest.mark.slow  # whole notebooks

WITH_EXERCISES = [page for page in pages() if page.exercises]
each_page = pytest.mark.parametrize("page", WITH_EXERCISES, ids=lambda page: page.name)
CHAPTER = find_page("01")


@pytest.fixture(scope="module", autouse=True)
def defaults():
    """What a page sets for itself, no other test may meet."""
    before = torch.get_default_dtype(), torch.get_num_threads()
    yield
    torch.set_default_dtype(before[0])
    torch.set_num_threads(before[1])


@functools.cache
def played(path):
    """What a notebook's cells leave behind, run in this process: their names, and all answers."""
    space, answers = {"__name__": "__main__"}, {}
    for cell in read_notebook(path).cells:
        if cell.cell_type != "code":
            continue
        body, shown = ast.parse(cell.source).body, None
        if body and isinstance(body[-1], ast.Expr) and not cell.source.rstrip().endswith(";"):
            shown = ast.Expression(body.pop().value)
        exec(compile(ast.Module(body, []), "<cell>", "exec"), space)
        if shown is not None:
            show(eval(compile(shown, "<cell>", "eval"), space))
        answer = space.pop("answer", None)
        if isinstance(answer, Answer):
            answers[answer.line.partition(":")[0]] = answer
    return space, answers


def show(thing):
    """What a notebook does with the last line of a cell; of a figure no file is made."""
    if isinstance(thing, Figure):
        thing.draw_without_rendering()
        return
    for name in ("_repr_mimebundle_", "_repr_html_", "_repr_markdown_"):
        if hasattr(thing, name):
            assert getattr(thing, name)()
    assert repr(thing)


def checks(page):
    return importlib.import_module(f"book.{page.package}.checks")


def exercises(page):
    found = vars(checks(page)).items()
    return {name.removeprefix("check_"): e for name, e in found if isinstance(e, Exercise)}


@each_page
def test_every_stub_is_not_done_yet_and_the_library_stands_in(page):
    space, answers = played(BOOK / "exercises" / f"exercises_{page.name}.ipynb")
    assert list(answers) == list(exercises(page))  # every check, in the order of the page
    for name, answer in answers.items():
        assert answer.status == NOT_DONE
        assert answer.line == f"{name}: not done yet (it returns nothing)."
        assert space[f"{name}_here"] is not space[name]


@each_page
def test_every_solution_is_done_and_used(page):
    space, answers = played(BOOK / "solutions" / f"solutions_{page.name}.ipynb")
    assert list(answers) == list(exercises(page))
    for name, answer in answers.items():
        assert answer.status == DONE, answer.line
        assert space[f"{name}_here"] is space[name]


@each_page
def test_the_examples_in_the_stubs_are_what_the_solutions_give(page):
    space, answers = played(BOOK / "solutions" / f"solutions_{page.name}.ipynb")
    for name in answers:
        words = space[name].__doc__ or ""
        test = doctest.DocTestParser().get_doctest(words, dict(space), name, None, None)
        assert test.examples, f"{name} has no example"
        assert doctest.DocTestRunner().run(test).failed == 0


@each_page
def test_every_chapter_proves_its_exercises(page):
    """The mutation rule, which `tests/book/exercises.py` asks of each exercise."""
    module = importlib.import_module(f"tests.book.{page.package}.test_checks")
    proofs = [c for c in vars(module).values() if isinstance(c, type) and c is not ExerciseTests]
    # By name, as others in this process may have imported the chapter afresh.
    proven = [c.checks.__name__ for c in proofs if issubclass(c, ExerciseTests)]
    assert proven == [checks(page).__name__]


@pytest.fixture
def work(tmp_path):
    """Chapter 1, started by a student into a folder of the student's own."""
    with environment("tiny", tmp_path / "profile"):
        yield start(CHAPTER, tmp_path / "my_work")


def write(path, **functions):
    """Put the student's text in the place of whole functions; None deletes the cell's text."""
    nb = nbformat.read(path, as_version=4)
    for name, text in functions.items():
        (cell,) = [cell for cell in nb.cells if cell.source.startswith(f"def {name}(")]
        cell.source = text or ""
    nbformat.write(nb, path)


def run(path):
    """Run a notebook as JupyterLab would, from top to bottom, and keep what it shows."""
    nb = nbformat.read(path, as_version=4)
    client = NotebookClient(
        nb, timeout=60, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}
    )
    try:
        client.execute()
    finally:
        nbformat.write(nb, path)


def answers_shown(path):
    lines = {}
    for cell in nbformat.read(path, as_version=4).cells:
        for output in cell.get("outputs", []):
            if output.output_type == "execute_result" and 'role="status"' in str(output.data):
                line = output.data["text/plain"]
                lines[line.partition(":")[0]] = line
    return lines


RIGHT = """
def rotation_angle(R_1, R_2):
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R_1.T @ R_2).magnitude()
"""
WRONG = """
def best_rotation(source, target):
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, Vt = np.linalg.svd(q.T @ p)
    return U @ Vt
"""
MISTYPED = """
def project_points(R, t, K, points):
    X = (points @ R.T + t
    return X @ K.T
"""
RAISES = """
def balanced_error(errors, true_angles, bin_width):
    return errors @ np.eye(7)
"""
ENDLESS = """
def add_symmetric(R_est, t_est, R_gt, t_gt, points, symmetries):
    while True:
        pass
"""


def test_the_rehearsal(work):
    """One is no Python, one right, one wrong, one never ends, one raises, one is left."""
    write(
        work,
        project_points=MISTYPED,
        rotation_angle=RIGHT,
        best_rotation=WRONG,
        add_symmetric=ENDLESS,
        balanced_error=RAISES,
    )
    run(work)
    nb = nbformat.read(work, as_version=4)
    counts = [cell.execution_count for cell in nb.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))  # to its end

    lines = answers_shown(work)
    assert list(lines) == list(exercises(CHAPTER))
    for name, status in {
        "project_points": NOT_RIGHT,
        "rotation_angle": DONE,
        "best_rotation": NOT_RIGHT,
        "add_symmetric": NOT_RIGHT,
        "balanced_error": NOT_RIGHT,
        "forgiven_pose": NOT_DONE,
    }.items():
        assert lines[name].startswith(f"{name}: {status}")
        hinted = status == NOT_RIGHT and name != "project_points"
        assert ("Hint 1 of 2" in lines[name]) == hinted
    assert lines["project_points"] == (
        "project_points: not right yet: line 2 of its cell is no Python: '(' was never closed "
        "in `X = (points @ R.T + t`."
    )
    (mistyped,) = [cell for cell in nb.cells if cell.source == MISTYPED]
    assert "SyntaxError: '(' was never closed" in mistyped.outputs[0].text
    assert lines["rotation_angle"] == "rotation_angle: done, 23 inputs agree."
    assert "On a planar cloud (answer.inputs: source = array (6, 3)" in lines["best_rotation"]
    assert "not finished after 5 s; perhaps a loop never ends" in lines["add_symmetric"]
    assert "it raised ValueError: matmul" in lines["balanced_error"]
    assert "at `return errors @ np.eye(7)`" in lines["balanced_error"]
    # The student's folder holds the notebook and nothing else.
    assert [file.name for file in work.parent.iterdir()] == [work.name]


def test_a_function_that_was_deleted(work):
    """The page stops at its check, and Python says which name is missing."""
    write(work, rotation_angle=None)
    with pytest.raises(NameError, match=r"^name 'rotation_angle' is not defined$"):
        played(work)
    assert start(CHAPTER, work.parent / "again").exists()  # the way back
