"""`make.py new`: what it writes passes the checks as it is, and nothing is written half."""

import os
import re
import shutil
import signal
import subprocess
import sys
from itertools import pairwise

import pytest

from book.tools import new as module
from book.tools.checking import problems
from book.tools.contents import ROOT, find_page, pages
from book.tools.new import ENDING, LONGEST_NAME, SKELETON, new

METHODS = '"""Methods."""\n\n__all__ = ["METHODS"]\n\nMETHODS = ("vector_field",)\n"""Names."""\n'
CONTENTS = """# The pages.

[[page]]
name = "index"

[[page]]
name = "02_worlds"
exercises = true

[[page]]
name = "05_rotations"
"""
LONG = "z" * LONGEST_NAME
# In the project itself the linter finds what imports are the project's own.
PACKAGES = ["book", "data_tools", "posecore", "tests"]
OURS = ["--config", f"lint.isort.known-first-party={PACKAGES}"]


@pytest.fixture
def root(tmp_path):
    """As much of a project as it needs to find."""
    for path, text in (
        ("book/site/contents.toml", CONTENTS),
        ("posecore/methods/__init__.py", METHODS),
        ("posecore/methods/training.py", '"""What is shared."""\n'),
        ("posecore/methods/vector_field/__init__.py", ""),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    shutil.copyfile(ROOT / "pyproject.toml", tmp_path / "pyproject.toml")
    return tmp_path


def everything(root):
    return {path: path.is_file() and path.read_bytes() for path in root.rglob("*")}


def lint(root):
    for words in (["check", *OURS], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *words, "--no-cache", root]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("number", "name", "place"),
    [("3", "a", 2), ("1", "head_pose", 1), ("06", "clouds", 3), ("99", LONG, 3)],
)
def test_a_page_takes_its_place_and_a_method_its_name(root, number, name, place):
    written = new(number, name, root=root)
    page = f"{number.zfill(2)}_{name}"
    found = pages(root / "book")
    assert found[place].name == page and found[place].exercises
    text = (root / "book" / "site" / "contents.toml").read_text()
    entry = f'[[page]]\nname = "{page}"\nexercises = true\n'
    assert text in {CONTENTS.replace(old, new) for old, new in (
        ('[[page]]\nname = "02', f'{entry}\n[[page]]\nname = "02'),
        ('[[page]]\nname = "05', f'{entry}\n[[page]]\nname = "05'),
        ('05_rotations"\n', f'05_rotations"\n\n{entry}'),
    )}  # fmt: skip
    changed = (root / "posecore" / "methods" / "__init__.py").read_text()
    assert changed == METHODS.replace('"vector_field",', f'"vector_field", "{name}"')
    assert all(path.is_file() for path in written)
    templates = [path for path in SKELETON.rglob("*") if path.is_file()]
    # Two sources have notebooks, one of them a student's, too; and two files are changed.
    assert len(written) == len(templates) + 5
    assert all(path.name.endswith(".py" + ENDING) for path in templates)


@pytest.mark.parametrize("names", [["a"], ["clouds", "infrared"], [LONG]])
def test_what_is_written_is_as_the_linter_wants_it(root, names):
    new("3", *names, root=root)
    lint(root)


def test_many_methods_stand_in_lines_of_their_own(root):
    path = root / "posecore" / "methods" / "__init__.py"
    path.write_text(METHODS.replace('("vector_field",)', f'("vector_field", "{"y" * 70}")'))
    new("3", "clouds", root=root)
    assert '    "vector_field",\n' in path.read_text()
    lint(root)


def test_all_that_is_left_to_do_is_to_run_it(root):
    new("3", "clouds", "infrared", root)
    page = find_page("3", root / "book")
    assert problems(root / "book", [page]) == ["03_clouds: never executed; run make.py execute"]
    for name in ("03_clouds", "solutions/solutions_03_clouds"):
        source = root / "book" / f"{name}.py"
        assert source.stat().st_mtime_ns >= source.with_suffix(".ipynb").stat().st_mtime_ns
    written = "\n".join(p.read_text() for p in root.rglob("*.py") if "methods/v" not in str(p))
    assert not [word for word in ("NN_", "NN ", "TITLE", "METHOD ", "METHOD.") if word in written]
    assert "posecore.methods.infrared.network" in written and "# # Clouds\n" in written


def test_a_page_has_what_readers_look_for(root):
    """The time it takes, a way through it, symbols, questions, and the audit where it ends."""
    new("3", "clouds", root=root)
    page = (root / "book" / "03_clouds.py").read_text()
    places = [page.index(f"# {words}") for words in (
        "## What you will build", "- **Time:** ", "- **Short path:** ", "| symbol | ", "## 1. ",
        "## 2. ", "## 3. ", "## Exercises", "## Summary", "## Appendix: reading the paper closely",
    )]  # fmt: skip
    assert places == sorted(places)
    for begin, end in pairwise(places[4:8]):  # a question ends each section, its answer hidden
        section = page[begin:end].rstrip("# \n")
        question = r"# <details><summary>[^<]+\?</summary>\n#\n(# .+\n)+#\n# </details>$"
        assert re.search(question, section)
    student = (root / "book" / "exercises" / "exercises_03_clouds.ipynb").read_text()
    assert "forgive_syntax()" in student and "answer.inputs" in student


@pytest.mark.parametrize(
    ("number", "words", "message"),
    [
        ("5", ["clouds"], "page: expected a number and a name that are free, got those of 05_r"),
        ("03", ["rotations"], "page: expected a number and a name that are free"),
        ("003", ["clouds"], "number: expected one or two digits, got '003'"),
        ("x", ["clouds"], "number: expected one or two digits, got 'x'"),
        ("3", ["Clouds"], "name: expected at most 30 small letters, digits and _, got 'Clouds'"),
        ("3", ["to-pose"], "name: expected"),
        ("3", ["../clouds"], "name: expected"),
        ("3", [""], "name: expected"),
        ("3", [LONG + "z"], "name: expected at most 30"),
        ("3", ["clouds", "3d"], "method: expected at most 30 small letters"),
        ("3", ["clouds", "vector_field"], "method: expected a name that is free"),
        ("3", ["clouds", "training"], "method: expected a name that is free"),
        ("3", ["clouds", "class"], "method: expected a name that is no word of Python's"),
    ],
)
def test_names_that_cannot_be(root, number, words, message):
    before = everything(root)
    with pytest.raises(ValueError) as caught:
        new(number, *words, root=root)
    assert str(caught.value).startswith(message)
    assert everything(root) == before


@pytest.mark.parametrize(
    "name",
    [
        "book/03_clouds.ipynb",
        "book/solutions/solutions_03_clouds.py",
        "tests/methods/clouds/test_losses.py",
    ],
)
def test_a_file_that_is_there_stays_and_stays_alone(root, name):
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text("somebody's work")
    before = everything(root)
    with pytest.raises(ValueError, match=f"name: expected files that are not .*, got {name}"):
        new("3", "clouds", root=root)
    assert everything(root) == before


@pytest.mark.parametrize("count", [0, 1, 12, 23])
def test_where_the_disk_is_full_nothing_is_left(root, monkeypatch, count):
    real, calls = module.write_bytes, []

    def full(path, data):
        calls.append(path)
        if len(calls) == count + 1:
            raise OSError(28, "No space left on device")
        real(path, data)

    before = everything(root)
    monkeypatch.setattr(module, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        new("3", "clouds", root=root)
    assert everything(root) == before


def killed(root, monkeypatch, count, half):
    """Begin a chapter in a process that is killed before, or in the middle of, one of its files."""
    real, calls = module.write_bytes, []

    def until(path, data):
        calls.append(path)
        if len(calls) == count + 1:
            if half:
                (path.parent / f".{path.name}.0123456789abcdef.tmp").write_bytes(data[:9])
            os.kill(os.getpid(), signal.SIGKILL)
        real(path, data)

    child = os.fork()
    if child == 0:
        module.write_bytes = until
        new("3", "clouds", root=root)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this test forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("name", ["clouds", "others"])
@pytest.mark.parametrize(("count", "half"), [(0, True), (1, False), (12, True), (24, True)])
def test_after_a_kill_the_next_one_begins_anew(
    root, tmp_path_factory, monkeypatch, name, count, half
):
    whole = tmp_path_factory.mktemp("whole") / "root"
    shutil.copytree(root, whole)
    expected = {path.relative_to(whole) for path in new("3", name, root=whole)}
    killed(root, monkeypatch, count, half)
    assert {path.relative_to(root) for path in new("3", name, root=root)} == expected
    found, wanted = everything(root), everything(whole)
    assert {p.relative_to(root): data for p, data in found.items()} == {
        p.relative_to(whole): data for p, data in wanted.items()
    }


def test_one_that_was_killed_at_its_very_end_is_done(root, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(module.Path, "unlink", lambda *_, **__: None)
        files = new("3", "clouds", root=root)
    before = everything(root)
    assert (root / module.UNFINISHED).exists()
    assert new("3", "clouds", root=root) == files
    assert set(before) - set(everything(root)) == {
        root / module.UNFINISHED,
        root / "book/.new.unfinished.lock.tmp",
    }


def test_what_somebody_has_worked_on_since_a_kill_stays(root, monkeypatch):
    killed(root, monkeypatch, 12, False)
    page = next((root / "book").rglob("*.py"))
    page.write_text("my work")
    with pytest.raises(ValueError, match="expected"):
        new("3", "clouds", root=root)
    assert page.read_text() == "my work"


def test_two_at_once(root):
    with module.claim(root / module.UNFINISHED):
        with pytest.raises(ValueError, match="root: expected a project in which no other process"):
            new("3", "clouds", root=root)


@pytest.mark.slow
def test_its_own_tests_pass_in_a_project_of_its_own(tmp_path, monkeypatch, capsys):
    """Beside floors and the command line; the page itself runs as every page does."""
    ignored = shutil.ignore_patterns("__pycache__", "_build", "my_work", "real", ".*")
    for part in ("book", "posecore", "data_tools", "tests"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=ignored)
    shutil.copyfile(ROOT / "pyproject.toml", tmp_path / "pyproject.toml")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "OMP_NUM_THREADS": "1"}

    def run(*words):
        done = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    with monkeypatch.context() as patch:
        patch.setattr(sys, "path", list(sys.path))  # a script, it changes the first one
        from book import make

        patch.setattr(make, "BOOK", tmp_path / "book")
        assert make.main(["new", "97", "rehearsal"]) == 0
    assert "make.py claims 97" in capsys.readouterr().out
    run("-m", "ruff", "check", "--no-cache", ".")
    chapter, method = "tests/book/ch97_rehearsal", "tests/methods/rehearsal"
    with_it = ["tests/test_floors.py", "tests/methods/test_main.py", "-k", "rehearsal or circle"]
    run("-m", "pytest", "-n0", "-q", "-p", "no:cacheprovider", chapter, method, *with_it)
