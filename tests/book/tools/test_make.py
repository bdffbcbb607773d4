import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from book.tools import contents, exercises, ledgers, site
from book.tools.contents import BOOK, Page
from book.tools.notebooks import HEADER, is_executed, read_notebook, write_notebook

CONTENTS = '[[page]]\nname = "index"\n\n[[page]]\nname = "01_a"\nexercises = true\n'
CHAPTER = "\n# %% [markdown]\n# # A\n\n# %%\nx = 1\n\n# %%\nprint(x)\n"
SOLUTION = "\n# %%\n### BEGIN SOLUTION\nanswer = 42\n### END SOLUTION\n"
COMMANDS = ["pair", "execute", "strip", "start", "train", "claims", "site", "check"]


@pytest.fixture(scope="module")
def make():
    path, before = BOOK / "make.py", list(sys.path)
    spec = importlib.util.spec_from_file_location("book_make", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path[:] = before
    return module


@pytest.fixture
def book(make, tmp_path, monkeypatch):
    """A book in which `make.py` works."""
    for part in ("site", "solutions"):
        (tmp_path / part).mkdir()
    (tmp_path / "site" / "contents.toml").write_text(CONTENTS)
    for name, text in (("index", "\n# %% [markdown]\n# # The book\n"), ("01_a", CHAPTER),
                       ("solutions/01_a", SOLUTION)):  # fmt: skip
        (tmp_path / f"{name}.py").write_text(HEADER + text)
    monkeypatch.setattr(make, "BOOK", tmp_path)
    monkeypatch.setattr(make, "pages", lambda book: contents.pages(tmp_path))
    return tmp_path


def test_the_road_of_a_contributor(make, book, capsys):
    assert make.main(["check"]) == 1
    out, err = capsys.readouterr()
    assert "01_a.ipynb: in site/contents.toml, but missing" in out
    assert err == "make.py check: 5 problems\n"
    assert make.main(["pair"]) == 0
    assert capsys.readouterr().out == "index: in step\n01_a: in step\n"
    assert make.main(["execute"]) == 0
    assert capsys.readouterr().out.startswith("index: executed in ")
    assert read_notebook(book / "01_a.ipynb").cells[2].outputs[0].text == "1\n"
    assert make.main(["check"]) == 0
    assert capsys.readouterr().out == "fit to be committed\n"
    assert make.main(["strip", "1"]) == 0
    source, notebook = (book / f"01_a.{suffix}" for suffix in ("py", "ipynb"))
    assert source.stat().st_mtime_ns >= notebook.stat().st_mtime_ns  # as JupyterLab expects
    assert not is_executed(read_notebook(book / "01_a.ipynb"))
    assert make.main(["check", "index"]) == 0
    assert make.main(["check", "01_a"]) == 1
    assert "01_a: never executed" in capsys.readouterr().out


def test_start_copies_exercises_and_goes_on_where_there_are_copies(make, book, capsys, monkeypatch):
    make.main(["pair"])
    real = exercises.start
    monkeypatch.setattr(exercises, "start", lambda page: real(page, book / "my_work", book))
    assert make.main(["start", "1"]) == 0
    path = book / "my_work" / "01_a.ipynb"
    assert capsys.readouterr().out.endswith(f"01_a: open {path}\n") and path.is_file()
    path.write_text("a student's work")
    assert make.main(["start", "1"]) == 1
    assert "is there already" in capsys.readouterr().err
    assert make.main(["start"]) == 0  # all that have exercises
    assert "is there already" in capsys.readouterr().out
    assert path.read_text() == "a student's work"
    assert make.main(["start", "index"]) == 1


def test_training_claims_and_site_are_those_of_making(make, book, capsys, monkeypatch):
    called = []
    monkeypatch.setattr(
        ledgers, "train", lambda page, book, scale: called.append(("train", page, book))
    )
    monkeypatch.setattr(
        ledgers, "claims", lambda page, book, scale: called.append(("claims", page, book))
    )
    monkeypatch.setattr(site, "build", lambda: book / "html")
    assert make.main(["train", "1"]) == make.main(["claims"]) == make.main(["site"]) == 0
    assert called == [("train", "01_a", book), ("claims", "index", book), ("claims", "01_a", book)]
    assert capsys.readouterr().out == f"open {book / 'html' / 'index.html'}\n"


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "site"])
def test_an_unknown_page_is_one_line_on_stderr(command, make, book, capsys):
    assert make.main([command, "7"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert (
        err
        == f"make.py {command}: page: expected one of index, 01_a (site/contents.toml), got '7'\n"
    )


def test_a_file_that_cannot_be_written_is_one_line_on_stderr(make, book, capsys, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("book.tools.pairs.write_bytes", full)
    assert make.main(["pair"]) == 1
    assert capsys.readouterr().err == "make.py pair: [Errno 28] No space left on device\n"
    assert not (book / "index.ipynb").exists()


@pytest.mark.parametrize("words", [[], ["bake"], ["site", "1"], ["execute", "--scale", "huge"]])
def test_words_that_mean_nothing(words, make, capsys):
    with pytest.raises(SystemExit) as caught:
        make.main(words)
    assert caught.value.code == 2 and "usage: make.py" in capsys.readouterr().err


def test_help_explains_the_workflow_from_any_folder(tmp_path):
    words = [sys.executable, BOOK / "make.py", "--help"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    for command in COMMANDS:
        assert f"\n    {command} " in done.stdout
    for word in ("make.py pair NN", "make.py execute NN", "make.py check", "pytest book -k NN"):
        assert word in done.stdout


def test_it_works_on_the_book_that_it_lies_in(tmp_path):
    book = tmp_path / "project" / "book"
    shutil.copytree(BOOK / "making", book / "making")
    shutil.copyfile(BOOK / "make.py", book / "make.py")
    shutil.copytree(BOOK.parent / "posecore", book.parent / "posecore")
    (book / "site").mkdir()
    (book / "site" / "contents.toml").write_text('[[page]]\nname = "index"\n')
    (book / "index.py").write_text(HEADER + CHAPTER)
    words = [sys.executable, book / "make.py", "pair"]
    environment = {"PATH": "", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "index: in step\n"), done.stderr
    assert (book / "index.ipynb").is_file()
    assert Page("index") in contents.pages(book)


def test_strip_does_not_hide_edits_of_the_notebook(make, book, capsys):
    """It touches the source, which would then be the newer one of two that differ."""
    make.main(["pair"])
    nb = read_notebook(book / "01_a.ipynb")
    nb.cells[0].source = "# Hours of work"
    write_notebook(nb, book / "01_a.ipynb")
    os.utime(book / "01_a.py", (1e9, 1e9))
    assert make.main(["strip", "1"]) == 1
    assert "01_a.ipynb was saved after 01_a.py and differs" in capsys.readouterr().err
    assert make.main(["pair", "1"]) == 1
    assert read_notebook(book / "01_a.ipynb").cells[0].source == "# Hours of work"


def test_an_exercise_solved_where_it_lies_is_kept(make, book, capsys):
    make.main(["pair"])
    path = book / "exercises" / "01_a.ipynb"
    nb = read_notebook(path)
    nb.cells[0].source = "answer = 6 * 7"
    write_notebook(nb, path)
    assert make.main(["pair", "1"]) == 0
    assert "what it said before is kept" in capsys.readouterr().out
    (kept,) = (book / "_build" / "replaced").iterdir()
    assert read_notebook(kept).cells[0].source == "answer = 6 * 7"
    assert "your code here" in read_notebook(path).cells[0].source


@pytest.mark.parametrize(
    "error, status, words",
    [
        (ModuleNotFoundError("No module named 'nbclient'"), 1, "nbclient'; pip install -r"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
)
def test_what_is_missing_or_stopped_is_one_line(
    error, status, words, make, book, capsys, monkeypatch
):
    def ends(*arguments, **more):
        raise error

    monkeypatch.setattr(ledgers, "claims", ends)
    assert make.main(["claims", "1"]) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("make.py claims: ") and words in line


@pytest.mark.parametrize("command", ["train", "claims"])
def test_trying_at_another_scale(command, make, book, monkeypatch):
    called = []
    monkeypatch.setattr(ledgers, command, lambda page, book, scale: called.append(scale))
    assert make.main([command, "1", "--scale", "tiny"]) == 0
    assert called == ["tiny"]
