import json
import re

import pytest
from nbformat.v4 import new_output

from book.tools.budget import LARGEST_NOTEBOOK
from book.tools.checking import problems, stale
from book.tools.contents import Page, find_page, pages
from book.tools.exercises import generate
from book.tools.inputs import inputs
from book.tools.measuring import claims, train
from book.tools.notebooks import (
    HEADER,
    code_digest,
    outputs_digest,
    read_notebook,
    write_notebook,
)
from book.tools.pairs import pair
from tests.book.tools.small_book import edit as edit_text
from tests.book.tools.small_book import forget

CONTENTS = """
[[page]]
name = "index"

[[page]]
name = "01_a"
exercises = true
"""
INDEX = """
# %% [markdown]
# # The book
"""
CHAPTER = """
# %% [markdown]
# # A chapter

# %%
x = 1

# %%
# NBVAL_CHECK_OUTPUT
print(x)

# %%
assert x == 1
"""
DRAWING = '''
COLOUR = "red"


def curve():
    """A curve."""
    return COLOUR


def other():
    return 2
'''
SOLUTION = '''
# %% [markdown]
# # Exercise

# %%
def double(x):
    """Twice as much."""
    ### BEGIN SOLUTION
    return 2 * x
    ### END SOLUTION
'''


def execute_by_hand(path, outputs=(), scale="book"):
    """What `make.py execute` leaves behind, without a run."""
    nb = read_notebook(path)
    code = [cell for cell in nb.cells if cell.cell_type == "code"]
    for count, cell in enumerate(code, 1):
        cell.execution_count = count
    if code:
        code[1].outputs = list(outputs) or [new_output("stream", name="stdout", text="1\n")]
    nb.metadata["posecore"] = {
        "code": code_digest(nb),
        "inputs": inputs(nb, find_page(path.stem, path.parent), path.parent),
        "outputs": outputs_digest(nb),
        "scale": scale,
    }
    write_notebook(nb, path)


@pytest.fixture
def book(tmp_path, monkeypatch):
    """A book that is fit to be committed."""
    monkeypatch.syspath_prepend(tmp_path)
    book = tmp_path / "folio"
    for part in ("site", "solutions", "exercises", "ch01_a", "ch00_index", "my_work"):
        (book / part).mkdir(parents=True)
    (book / "site" / "contents.toml").write_text(CONTENTS)
    for name in ("__init__", "ch01_a/__init__", "make", "conftest"):
        (book / f"{name}.py").write_text("")
    (book / "ch01_a" / "drawing.py").write_text(DRAWING)
    for name, text in (("index", INDEX), ("01_a", CHAPTER), ("solutions/solutions_01_a", SOLUTION)):
        (book / f"{name}.py").write_text(HEADER + text, encoding="utf-8")
        pair(book / f"{name}.py")
    for name in ("index", "01_a"):
        execute_by_hand(book / f"{name}.ipynb")
    generate(Page("01_a", True), book)
    (book / "my_work" / "my_01_a.ipynb").write_text("a student's, whatever it holds")
    yield book
    forget()


def change(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def change_code(book, old, new):
    """In source and notebook, which is executed again."""
    change(book / "01_a.py", old, new)
    pair(book / "01_a.py")
    execute_by_hand(book / "01_a.ipynb")


def edit(path, function):
    """Edit a notebook as another tool would."""
    nb = json.loads(path.read_text(encoding="utf-8"))
    function(nb)
    path.write_text(json.dumps(nb, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def test_a_fit_book_has_no_problems_and_nothing_stale(book):
    for only in (None, [Page("01_a", True)]):
        assert problems(book, only) == [] == stale(book, only)


@pytest.mark.slow
def test_the_book_is_fit():
    assert problems() == []


@pytest.mark.slow
def test_what_is_stale_of_the_book_is_said():
    """To be measured, confirmed or executed; what is stale fails `make.py check --strict` alone."""
    names = {page.name for page in pages()}
    for line in stale():
        assert ": stale: " in line and line.partition(",")[0] in names


def wrong_output(nb):
    nb["cells"][2]["outputs"][0]["text"] = ["2\n"]


def never_executed(nb):
    for cell in nb["cells"]:
        if cell["cell_type"] == "code":
            cell.update(execution_count=None, outputs=[])
    del nb["metadata"]["posecore"]


def without_count(nb):
    nb["cells"][1]["execution_count"] = None
    _sign(nb)


def out_of_order(nb):
    nb["cells"][1]["execution_count"] = 9
    _sign(nb)


def _sign(nb):
    """As if the outputs were those of a run."""
    import nbformat

    nb["metadata"]["posecore"]["outputs"] = outputs_digest(nbformat.from_dict(nb))


@pytest.mark.parametrize(
    "function, message",
    [
        (wrong_output, "outputs that make.py execute did not store"),
        (never_executed, "never executed"),
        (without_count, "not all executed once in their order"),
        (out_of_order, "not all executed once in their order"),
        (lambda nb: nb["cells"][1].update(source=["x = 7"]), "source and notebook differ: cell 2"),
        (lambda nb: nb["cells"].pop(), "4 cells in one and 3 in the other"),
        (lambda nb: nb["cells"][1]["metadata"].update(tags=["a"]), "differ: cell 2 has tags"),
        (lambda nb: nb["metadata"]["posecore"].update(scale="tiny"), "executed at scale tiny"),
        (lambda nb: nb["metadata"].update(widgets={}), "the notebook is not as make.py writes it"),
        (lambda nb: nb["cells"][0].update(id="mine"), "the notebook is not as make.py writes it"),
    ],
)
def test_a_notebook_that_others_changed(function, message, book):
    edit(book / "01_a.ipynb", function)
    assert any(line.startswith("01_a: ") and message in line for line in problems(book))


def test_outputs_of_other_code(book):
    for suffix, old in ((".py", "x = 1"), (".ipynb", "x = 1")):
        change(book / f"01_a{suffix}", f"{old}\n" if suffix == ".py" else f'"{old}"',
               "x = 2\n" if suffix == ".py" else '"x = 2"')  # fmt: skip
    found = problems(book)
    assert "01_a: outputs of other code; run make.py execute" in found
    assert not any("differ" in line for line in found)


# What is stale ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "old, new, found",
    [
        ("return COLOUR", "return COLOUR * 2", ["01_a, the page: stale: drawing.curve"]),
        ('"red"', '"blue"', ["01_a, the page: stale: drawing.COLOUR"]),
        ("return 2", "return 3", []),  # a drawing that the page does not call
        ('"""A curve."""', '"""A red curve."""', []),
        ("return COLOUR", "return COLOUR  # again", []),
    ],
)
def test_a_drawing_that_is_shown_makes_the_page_stale(old, new, found, book):
    """Which is told of, and no reason not to commit."""
    change_code(book, "x = 1", "from folio.ch01_a import drawing\n\nx = drawing.curve()")
    assert problems(book) == [] == stale(book)
    change(book / "ch01_a" / "drawing.py", old, new)
    assert stale(book) == stale(book, [Page("01_a", True)]) == found
    assert problems(book) == [] == stale(book, [Page("index")])


def test_results_that_are_stale_are_named_with_what_has_changed(folio):
    claims("1", folio)
    train("1", folio)
    assert stale(folio) == []
    measured = folio / "ch01_poses" / "measured.py"
    edit_text(measured, ("2 * seed", "4 * seed"), ("book=2", "book=5"), ("start {", "begun {"))
    edit_text(folio / "ch01_poses" / "helper.py", ("0.125", "0.25"))
    edit_text(folio / "ch01_poses" / "experiments.py", ("Linear(3, 2)", "Linear(3, 3)"))
    forget()
    assert stale(folio) == [
        "01_poses, table: stale: helper.OFFSET, measured.SIZE, measured.table",
        "01_poses, weights/net.safetensors: stale: experiments.net",
    ]
    edit_text(measured, ("def note(text):", "def note(text):\n    time.time()"))
    assert stale(folio)[0].endswith("measured.SIZE, measured.note and 1 more")
    assert stale(folio, [Page("02_worlds")]) == []


@pytest.mark.parametrize("inputs", ["16 digits", {}])
def test_a_page_of_before_is_stale(inputs, book):
    edit(book / "01_a.ipynb", lambda nb: nb["metadata"]["posecore"].update(inputs=inputs))
    assert stale(book) == ["01_a, the page: stale: what it was made from is not kept"]


@pytest.mark.parametrize(
    "name, text, found",
    [
        ("claims.json", '{"claims": {"c": {}}}', "ch01_a: {path}: damaged ledger: "),
        ("claims.json", "{", "ch01_a: {path}: damaged ledger: "),
        ("weights/net.safetensors", "half", "ch01_a/weights: net.safetensors is damaged: "),
        ("weights/net.json", "{", "ch01_a/weights: net.json is damaged: "),
    ],
)
def test_results_that_cannot_be_read_are_problems(name, text, found, book):
    path = book / "ch01_a" / name
    path.parent.mkdir(exist_ok=True)
    if path.suffix == ".json" and path.stem == "net":
        path.with_suffix(".safetensors").write_bytes(b"")
    path.write_text(text)
    lines = problems(book, [Page("01_a", True)])
    assert lines[0].startswith(found.format(path=path)), lines
    assert lines == problems(book) and not problems(book, [Page("index")])
    assert all(": stale: " in line for line in stale(book))  # and it raises no error


# What should not be stored ------------------------------------------------------------------------


MARKS = ["raises-exception", "skip-execution", "nbval-skip", "nbval-raises-exception"]
COMMENTS = ["NBVAL_SKIP", "NBVAL_RAISES_EXCEPTION", "NBVAL_IGNORE_OUTPUT"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "old, new",
    [("# %%\nassert", f'# %% tags=["{mark}"]\nassert') for mark in MARKS]
    + [("assert", f"# {comment}\nassert") for comment in COMMENTS],
)
@pytest.mark.parametrize("name", ["01_a", "solutions/solutions_01_a"])
def test_marks_that_switch_tests_off(old, new, name, book):
    if name == "01_a":
        change_code(book, old, new)
    else:
        change(book / f"{name}.py", old.replace("assert", "def"), new.replace("assert", "def"))
        pair(book / f"{name}.py")
        generate(Page("01_a", True), book)
    (line, *_) = problems(book)
    assert re.fullmatch(rf"{name}: cell \d is marked [\w-]+, which switches its test off", line)


def test_prose_about_marks_is_no_mark(book):
    change_code(book, "assert", "# not a case for nbval_skip or raises-exception\nassert")
    assert problems(book) == []


PICTURE = {"image/png": "iVBORw0KGgo=", "text/plain": "words"}


def shown(data, **metadata):
    return new_output("display_data", data, metadata=metadata)


def printed(text, name="stdout"):
    return new_output("stream", name=name, text=text)


@pytest.mark.slow
@pytest.mark.parametrize(
    "output, message",
    [
        (printed("UserWarning: careful", "stderr"), "prints a warning: UserWarning: careful"),
        (printed("/home/ann/book.py"), "shows a folder of the machine"),
        (printed("in /tmp/ipykernel_1/2.py:2"), "shows a folder of the machine"),
        (printed("C:\\Users\\ann"), "shows a folder of the machine"),
        (shown({"text/html": "<p>/Users/ann</p>"}), "shows a folder of the machine"),
        (printed(__file__), "shows a folder of the machine"),
        (printed("<Line2D at 0x7f00aa11bb>"), "shows an address in memory"),
        (shown(PICTURE), "shows a picture without alt text"),
        (shown(PICTURE, **{"image/png": {"alt": " "}}), "shows a picture without alt text"),
        (shown({"image/svg+xml": "<svg/>"}), "shows a picture without alt text"),
        (shown({"image/jpeg": "/9j/4A=="}), "shows a picture without alt text"),
        (shown({"text/html": "<img src='data:x'>"}), "picture without alt text in its HTML"),
        (shown({"text/html": "<img alt='' src='x'>"}), "picture without alt text in its HTML"),
        (shown({"application/vnd.jupyter.widget-view+json": {}}), "holds a widget"),
        (new_output("error", ename="KeyError", evalue="x", traceback=[]), "an error: KeyError"),
    ],
)
def test_outputs_that_should_not_be_stored(output, message, book):
    change_code(book, "# NBVAL_CHECK_OUTPUT\n", "")
    execute_by_hand(book / "01_a.ipynb", [output])
    (line,) = problems(book)
    assert line.startswith("01_a: cell 3 ") and message in line


@pytest.mark.parametrize(
    "output",
    [
        printed("1/2 m/s, https://home/tmp/x, half-way/home/, and/or; 50%\n"),
        shown({"text/html": f"<img alt='a' src='data:{'A' * 9}/home/{'b' * 9}/tmp/AA=='>"}),
        shown(PICTURE, **{"image/png": {"alt": "words"}}),
        shown({"image/jpeg": "/9j/4A=="}, **{"image/jpeg": {"alt": "words"}}),
    ],
)
def test_outputs_that_may_be_stored(output, book):
    change_code(book, "# NBVAL_CHECK_OUTPUT\n", "")
    execute_by_hand(book / "01_a.ipynb", [output])
    assert problems(book) == []


def test_nbval_is_not_asked_to_compare_pictures(book):
    output = shown(PICTURE, **{"image/png": {"alt": "words"}})
    execute_by_hand(book / "01_a.ipynb", [output])
    assert problems(book) == ["01_a: cell 3 asks nbval to compare a picture, which it does not do"]


def test_nbval_is_not_asked_to_compare_with_nothing(book):
    change(
        book / "solutions" / "solutions_01_a.py", "def double", "# NBVAL_CHECK_OUTPUT\ndef double"
    )
    pair(book / "solutions" / "solutions_01_a.py")
    generate(Page("01_a", True), book)
    message = "cell 2 asks nbval to compare with outputs that are not stored"
    assert problems(book) == [f"solutions/solutions_01_a: {message}"]


@pytest.mark.parametrize("code", ["%matplotlib inline", "!ls", "%%bash\nls", "x ="])
def test_code_is_plain_python(code, book):
    change(book / "01_a.py", "assert x == 1", code)
    pair(book / "01_a.py")
    found = problems(book)
    assert [line for line in found if line.startswith("01_a: cell 4 is not plain Python")]
    assert stale(book) == []


def test_cells_are_short(book):
    head = 'def f():\n    """Many.\n\n    Words.\n    """\n    # and a comment\n\n'
    change_code(book, "assert x == 1\n", head + "    x = 1\n" * 14)
    assert problems(book) == []
    change_code(book, "def f", "x = 2\n\n\ndef f")
    assert problems(book) == ["01_a: cell 4 has more than 15 lines of code"]


def test_pages_are_not_too_large(book):
    execute_by_hand(book / "01_a.ipynb", [printed("x" * LARGEST_NOTEBOOK)])
    assert problems(book) == ["01_a: 1.50 MB; at most 1.5 MB"]


def test_solutions_store_no_outputs(book):
    path = book / "solutions" / "solutions_01_a.ipynb"
    nb = read_notebook(path)
    nb.cells[1].execution_count = 1
    write_notebook(nb, path)
    assert problems(book) == ["solutions/solutions_01_a: has stored outputs; run make.py pair"]


def ran(nb):
    nb["cells"][1]["execution_count"] = 1


def says_something_else(nb):
    nb["cells"][1]["source"][1] = nb["cells"][1]["source"][1].replace("Twice", "Three times")


def paired(nb):
    nb["metadata"]["jupytext"]["formats"] = "ipynb,py:percent"


@pytest.mark.parametrize("function", [ran, says_something_else, paired])
def test_exercises_are_those_that_the_solutions_generate(function, book):
    edit(book / "exercises" / "exercises_01_a.ipynb", function)
    message = "exercises/exercises_01_a.ipynb: not what its solutions generate; run make.py pair"
    assert problems(book) == [message]


def test_solutions_that_generate_nothing(book):
    change(book / "solutions" / "solutions_01_a.py", "### END SOLUTION", "### END")
    pair(book / "solutions" / "solutions_01_a.py")
    assert any(
        "solutions/solutions_01_a.py" in line and "END SOLUTION" in line for line in problems(book)
    )


@pytest.mark.parametrize(
    "name",
    [
        *(
            "02_b.ipynb",
            "02_b.py",
            "notes.ipynb",
            "solutions/solutions_index.ipynb",
            "deep/er/a.ipynb",
        ),
        "exercises/exercises_01_a.py",  # a notebook alone is generated
        *("solutions/01_a.ipynb", "exercises/01_a.ipynb"),  # as they were called before
    ],
)
def test_files_that_the_contents_lack(name, book):
    (book / name).parent.mkdir(parents=True, exist_ok=True)
    (book / name).write_text("")
    assert problems(book) == [f"{name}: not in site/contents.toml"]


@pytest.mark.parametrize("name", ["ch02_b", "ch01_b", "ch00_idex"])
def test_packages_of_no_page(name, book):
    (book / name).mkdir()
    assert problems(book) == [f"{name}: belongs to no page of site/contents.toml"]


@pytest.mark.parametrize("name", ["01_a.py", "index.ipynb", "exercises/exercises_01_a.ipynb"])
def test_files_that_are_missing(name, book):
    (book / name).unlink()
    assert problems(book) == [f"{name}: in site/contents.toml, but missing"]
    of_the_page = [Page("index")] if "index" in name else [Page("01_a", True)]
    assert problems(book, of_the_page) == problems(book)


@pytest.mark.parametrize("name", ["01_a.ipynb", "solutions/solutions_01_a.ipynb", "01_a.py"])
def test_damaged_files_are_named_and_the_rest_is_looked_at(name, book):
    (book / name).write_bytes(b"\xff")
    never = book / "index.ipynb"
    edit(never, lambda nb: nb["metadata"].pop("posecore"))
    found = problems(book)
    assert any(
        re.match(rf"{name[:-3].partition('.')[0]}.*{name.rsplit('/')[-1]}", f) for f in found
    )
    assert "index: never executed; run make.py execute" in found


def test_a_source_of_another_form(book):
    change(book / "01_a.py", HEADER, "")
    assert "01_a: the source is not as make.py writes it; run make.py pair" in problems(book)


def test_blank_lines_are_the_formatters_if_both_sides_know(book):
    change(book / "01_a.py", "# # A chapter\n\n", "# # A chapter\n\n\n")
    assert problems(book) == ["01_a: source and notebook differ in blank lines; run make.py pair"]
    before = (book / "01_a.py").read_bytes()
    pair(book / "01_a.py")
    assert problems(book) == []
    assert (book / "01_a.py").read_bytes() == before
