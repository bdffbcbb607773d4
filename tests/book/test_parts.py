"""The parts of a page: found from anywhere, imported once, readable, reloadable."""

import importlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore.book import parts
from posecore.book.checks import Exercise

CHAPTER = "01_poses_and_cameras"
PROJECT = Path(__file__).resolve().parents[2]


def test_a_chapters_checks() -> None:
    module = parts.checks(CHAPTER)
    assert module.__name__ == f"book.checks.{CHAPTER}"
    found = {name: thing for name, thing in vars(module).items() if isinstance(thing, Exercise)}
    assert found and all(name.startswith("check_") for name in found)
    assert parts.checks(CHAPTER) is module is sys.modules[module.__name__]
    assert Path(module.__file__) == PROJECT / "book" / "checks" / f"{CHAPTER}.py"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A checkout of its own, with one drawing; nothing of the real book is imported."""
    (tmp_path / "book" / "drawing").mkdir(parents=True)
    (tmp_path / "book" / "drawing" / "07_own.py").write_text("def draw():\n    return 1\n")
    monkeypatch.setattr(parts, "ROOT", tmp_path)
    away = [path for path in sys.path if Path(path or ".").resolve() != PROJECT]
    monkeypatch.setattr(sys, "path", away)
    known = {name: sys.modules.pop(name) for name in list(sys.modules) if _of_the_book(name)}
    yield tmp_path
    for name in list(sys.modules):
        if _of_the_book(name):
            del sys.modules[name]
    sys.modules.update(known)


def _of_the_book(name: str) -> bool:
    return name == "book" or name.startswith("book.")


def test_a_drawing_is_found_once_and_can_be_read(root: Path) -> None:
    before = list(sys.path)
    module = parts.drawing("07_own")
    assert module.draw() == 1
    assert inspect.getsource(module.draw) == "def draw():\n    return 1\n"
    assert parts.drawing("07_own") is module
    assert sys.path == before + [str(root)]  # at the end, and once


def test_reload_reads_an_edited_file(root: Path) -> None:
    module = parts.drawing("07_own")
    file = root / "book" / "drawing" / "07_own.py"
    file.write_text("def draw():\n    return 'two'  # longer\n")
    assert importlib.reload(module) is module
    assert module.draw() == "two"
    assert "'two'" in inspect.getsource(module.draw)
    assert parts.drawing("07_own").draw() == "two"


def test_a_file_that_came_later_is_found(root: Path) -> None:
    parts.drawing("07_own")
    (root / "book" / "drawing" / "08_later.py").write_text("VALUE = 8\n")
    importlib.invalidate_caches()
    assert parts.drawing("08_later").VALUE == 8


def test_an_error_in_the_file_comes_through(root: Path) -> None:
    (root / "book" / "drawing" / "09_broken.py").write_text("1 / 0\n")
    for _ in range(2):  # the second time too: half a module is not kept
        with pytest.raises(ZeroDivisionError):
            parts.drawing("09_broken")


def test_another_package_of_this_name_is_refused(root: Path) -> None:
    other = root / "other"
    for folder in (other / "book", other / "book" / "drawing"):
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("")
    (other / "book" / "drawing" / "07_own.py").write_text("")
    sys.path.insert(0, str(other))
    with pytest.raises(ValueError, match=r"name: expected a module of .*another package"):
        parts.drawing("07_own")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("08_missing", "name: expected one of '07_own', got '08_missing'"),
        ("07_own.py", "name: expected one of '07_own', got '07_own.py'"),
        ("../drawing/07_own", "name: expected one of '07_own', got '../drawing/07_own'"),
        ("", "name: expected one of '07_own', got ''"),
        (7, "name: expected one of '07_own', got 7"),
        (None, "name: expected one of '07_own', got None"),
    ],
)
def test_what_is_not_there_is_refused(root: Path, name: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        parts.drawing(name)
    assert str(caught.value) == message


def test_a_library_without_the_book_says_so(root: Path) -> None:
    with pytest.raises(ValueError, match="posecore: expected to lie beside the book.*checks"):
        parts.checks("07_own")


@given(st.text(max_size=12) | st.integers() | st.none())
def test_anything_but_a_file_there_is_refused(name: Any) -> None:
    for find in (parts.drawing, parts.checks):
        with pytest.raises(ValueError, match="name: expected one of"):
            find(name)
