import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from book.tools import budget, confirming, contents, exercises, measuring, site
from book.tools.contents import BOOK, Page
from book.tools.notebooks import HEADER, is_executed, read_notebook, write_notebook
from tests.book.tools.small_book import edit, forget

pytestmark = pytest.mark.slow  # a kernel, and other processes

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


def work_in(book, make, monkeypatch):
    """Let `make.py` work on another book than the one it lies in."""
    monkeypatch.setattr(make, "BOOK", book)
    monkeypatch.setattr(make, "pages", lambda _: contents.pages(book))


@pytest.fixture
def book(make, tmp_path, monkeypatch):
    """A book in which `make.py` works."""
    for part in ("site", "solutions"):
        (tmp_path / part).mkdir()
    (tmp_path / "site" / "contents.toml").write_text(CONTENTS)
    for name, text in (("index", "\n# %% [markdown]\n# # The book\n"), ("01_a", CHAPTER),
                       ("solutions/solutions_01_a", SOLUTION)):  # fmt: skip
        (tmp_path / f"{name}.py").write_text(HEADER + text)
    work_in(tmp_path, make, monkeypatch)
    return tmp_path


def test_the_road_of_a_contributor(make, book, capsys):
    assert make.main(["check"]) == 1
    out, err = capsys.readouterr()
    assert "01_a.ipynb: in site/contents.toml, but missing" in out
    assert err == "make.py check: 4 problems\n"
    assert make.main(["pair"]) == 0
    assert capsys.readouterr().out == "index: in step\n01_a: in step\n"
    assert make.main(["execute"]) == 0
    assert capsys.readouterr().out.startswith("index: executed in ")
    assert read_notebook(book / "01_a.ipynb").cells[2].outputs[0].text == "1\n"
    assert make.main(["check"]) == 0
    *lengths, last = capsys.readouterr().out.splitlines()
    assert last == "fit to be committed, and nothing is stale"
    assert [line.partition(":")[0] for line in lengths] == ["index", "01_a"]
    assert make.main(["check", "--strict"]) == 0
    capsys.readouterr()
    assert make.main(["strip", "1"]) == 0
    source, notebook = (book / f"01_a.{suffix}" for suffix in ("py", "ipynb"))
    assert source.stat().st_mtime_ns >= notebook.stat().st_mtime_ns  # as JupyterLab expects
    assert not is_executed(read_notebook(book / "01_a.ipynb"))
    assert make.main(["check", "index"]) == 0
    assert make.main(["check", "01_a"]) == 1
    assert "01_a: never executed" in capsys.readouterr().out


def test_a_page_that_is_too_long_is_told_of_and_fit(make, book, capsys, monkeypatch):
    monkeypatch.setattr(budget, "MOST_WORDS", 2)
    (book / "01_a.py").write_text(f"{HEADER}\n# %% [markdown]\n# # One, two and three\n{CHAPTER}")
    for command in ("pair", "execute"):
        assert make.main([command]) == 0
    capsys.readouterr()
    assert make.main(["check", "1", "--strict"]) == 0
    line, last = capsys.readouterr().out.splitlines()
    assert line.startswith("01_a: words 5 of 2, cells 4 of 150, ") and line.endswith("over: words")
    assert last == "fit to be committed, and nothing is stale"


def test_start_copies_exercises_and_goes_on_where_there_are_copies(make, book, capsys, monkeypatch):
    make.main(["pair"])
    real = exercises.start
    monkeypatch.setattr(exercises, "start", lambda page: real(page, book / "my_work", book))
    assert make.main(["start", "1"]) == 0
    path = book / "my_work" / "my_01_a.ipynb"
    assert capsys.readouterr().out.endswith(f"01_a: open {path}\n") and path.is_file()
    path.write_text("a student's work")
    assert make.main(["start", "1"]) == 1
    assert "is there already" in capsys.readouterr().err
    assert make.main(["start"]) == 0  # all that have exercises
    assert "is there already" in capsys.readouterr().out
    assert path.read_text() == "a student's work"
    assert make.main(["start", "index"]) == 1


def test_each_command_is_that_of_the_tools(make, book, capsys, monkeypatch):
    called = []

    def note(word, answer=()):
        return lambda page, book, **more: called.append((word, page, book)) or list(answer)

    monkeypatch.setattr(measuring, "train", note("train"))
    monkeypatch.setattr(measuring, "claims", note("claims"))
    monkeypatch.setattr(measuring, "status", note("status", ["a: stale: b", "c: stale: d"]))
    monkeypatch.setattr(confirming, "confirm", note("confirm", ["a: confirmed"]))
    monkeypatch.setattr(site, "build", lambda: book / "html")
    assert make.main(["train", "1"]) == make.main(["claims"]) == make.main(["site"]) == 0
    assert called == [("train", "01_a", book), ("claims", "index", book), ("claims", "01_a", book)]
    *advice, last = capsys.readouterr().out.splitlines()
    assert last == f"open {book / 'html' / 'index.html'}"
    assert advice == ["and `make.py claims --confirm` keeps what this code gives at tiny"] * 2
    called.clear()
    assert make.main(["claims", "1", "--confirm"]) == make.main(["claims", "1", "--status"]) == 0
    assert called == [("confirm", "01_a", book), ("status", Page("01_a", True), book)]
    assert capsys.readouterr().out == "a: confirmed\na: stale: b\nc: stale: d\n"
    for option in ("--confirm", "--status"):  # at a scale of their own
        assert make.main(["claims", "1", option, "--scale", "paper"]) == 1
        assert f"--scale: expected none, as {option} has its own" in capsys.readouterr().err
    assert make.main(["claims", "1", "--same-numbers"]) == 1
    assert "--same-numbers: expected --confirm" in capsys.readouterr().err


def fit(book, make):
    """The folio with pages of its own, executed, measured and trained."""
    drawing = book / "ch01_poses" / "drawing.py"
    drawing.write_text("def curve():\n    return 1\n\n\ndef other():\n    return 2\n")
    (book / "site" / "contents.toml").write_text('[[page]]\nname = "01_poses"\n')
    code = "from folio.ch01_poses.drawing import curve\n\ncurve()"
    (book / "01_poses.py").write_text(HEADER + f"\n# %% [markdown]\n# # A\n\n# %%\n{code}\n")
    for command in ("pair", "claims", "train", "execute"):
        assert make.main([command]) == 0, command


def test_what_is_stale_is_said_and_fails_where_it_is_asked_to(
    make, folio, tmp_path, capsys, monkeypatch
):
    work_in(folio, make, monkeypatch)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def said(*words):
        forget()
        capsys.readouterr()
        status = make.main(list(words))
        out, err = capsys.readouterr()
        return status, [line for line in out.splitlines() if ": words " not in line], err

    fit(folio, make)
    whole = ["fit to be committed, and nothing is stale"]
    assert said("check") == said("check", "--strict") == (0, whole, "")
    assert said("claims", "--status") == (0, ["01_poses: nothing is stale"], "")

    drawing = folio / "ch01_poses" / "drawing.py"
    edit(drawing, ("return 2", "return 3"))  # which the page does not call
    edit(folio / "ch01_poses" / "helper.py", ("return OFFSET", "return OFFSET  # an eighth"))
    assert said("check", "--strict") == (0, whole, "")
    edit(drawing, ("return 1", "return 4"))
    page = ["01_poses, the page: stale: drawing.curve"]
    assert said("check") == (0, page, "")
    assert said("check", "1", "--strict") == (1, page, "make.py check: 1 stale\n")

    edit(folio / "ch01_poses" / "measured.py", ("2 * seed", "4 * seed"))
    edit(folio / "ch01_poses" / "experiments.py", ("Linear(3, 2)", "Linear(3, 3)"))
    results = [
        "01_poses, table: stale: measured.table",
        "01_poses, weights/net.safetensors: stale: experiments.net",
    ]
    assert said("check") == (0, results + page, "")
    assert said("check", "--strict") == (1, results + page, "make.py check: 3 stale\n")
    lines = [f"{line}; made anew in 1 min" for line in results]
    assert said("claims", "--status") == (0, lines, "")

    (folio / "01_poses.ipynb").unlink()
    missing = ["01_poses.ipynb: in site/contents.toml, but missing"]
    assert said("check") == (1, missing + results, "make.py check: 1 problem, 2 stale\n")
    with pytest.raises(SystemExit):
        make.main(["claims", "--status", "--confirm"])


def test_confirmed_it_is_fresh_again(make, folio, capsys, monkeypatch):
    work_in(folio, make, monkeypatch)
    (folio / "site" / "contents.toml").write_text('[[page]]\nname = "01_poses"\n')
    assert make.main(["claims"]) == make.main(["train"]) == make.main(["claims", "--confirm"]) == 0
    edit(folio / "ch01_poses" / "measured.py", ("2 * seed", "seed * 2"))
    forget()
    capsys.readouterr()
    assert make.main(["claims", "--status"]) == 0
    assert "table: stale: measured.table" in capsys.readouterr().out
    assert make.main(["claims", "--confirm"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "01_poses, table: confirmed at tiny (measured.table)",
        *(
            f"01_poses, {name}: fresh"
            for name in ("other", "net.safetensors", "bigger.safetensors")
        ),
    ]
    assert make.main(["claims", "--status"]) == 0
    assert capsys.readouterr().out == "01_poses: nothing is stale\n"


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


def test_help_explains_the_workflow(make, capsys):
    with pytest.raises(SystemExit, match="0"):
        make.main(["--help"])
    shown = capsys.readouterr().out
    for command in COMMANDS:
        assert f"\n    {command} " in shown
    words = ("make.py pair NN", "make.py execute NN", "make.py check", "pytest book tests/book -k")
    for word in words:
        assert word in shown


def test_it_works_on_the_book_that_it_lies_in(tmp_path):
    book = tmp_path / "project" / "book"
    shutil.copytree(BOOK / "tools", book / "tools")
    (book / "__init__.py").write_text("")
    shutil.copyfile(BOOK / "make.py", book / "make.py")
    for package in ("posecore", "data_tools"):
        shutil.copytree(BOOK.parent / package, book.parent / package)
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
    path = book / "exercises" / "exercises_01_a.ipynb"
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

    monkeypatch.setattr(measuring, "claims", ends)
    assert make.main(["claims", "1"]) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("make.py claims: ") and words in line


@pytest.mark.parametrize("command", ["train", "claims"])
def test_trying_at_another_scale(command, make, book, monkeypatch):
    called = []
    monkeypatch.setattr(measuring, command, lambda page, book, scale: called.append(scale))
    assert make.main([command, "1", "--scale", "tiny"]) == 0
    assert called == ["tiny"]


def run(*words, **more):
    command = [sys.executable, str(BOOK / "make.py"), *words]
    return subprocess.run(command, text=True, stderr=subprocess.PIPE, timeout=120, **more)


def test_help_from_any_folder_and_without_docstrings(tmp_path):
    plain = {**os.environ, "PYTHONOPTIMIZE": "2"}
    done = run("--help", stdout=subprocess.PIPE, cwd=tmp_path, env=plain)
    assert done.returncode == 0 and not done.stderr
    assert all(f"    {name} " in done.stdout for name in COMMANDS)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a full device")
def test_output_that_cannot_be_written_is_said():
    with open("/dev/full", "w") as full:
        env = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
        done = run("claims", "--status", "index", stdout=full, env=env)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "make.py claims: [Errno 28] No space left on device: 'standard output'"
    ]


def test_a_reader_who_has_seen_enough():
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as closed:
        done = run("claims", "--status", "index", stdout=closed)
    assert done.returncode == 141 and done.stderr == ""  # as a shell has it
