"""Which files a measurement depends on, found without running any of them."""

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore import fingerprint
from posecore.fingerprint import code_hash, imported_modules

BOMB = "raise SystemExit('this file was run')\n"
FILES = {
    "house/__init__.py": BOMB,
    "house/alone.py": "x = 1\n",
    "house/absolute.py": "import house.alone\nimport numpy, os.path\n",
    "house/lazy.py": "def f():\n    from house.absolute import f\n",
    "house/room/__init__.py": "from . import bed\n",
    "house/room/bed.py": "from ..alone import x\nfrom .chair import *\n",
    "house/room/chair.py": "if 0:\n    from .. import lazy\n",
    "house/text.py": "import importlib\nm = importlib.import_module('house.5_number')\n",
    "house/5_number.py": "from importlib import import_module\nimport_module('house.' + 'alone')\n",
    "house/circle_a.py": "from house import circle_b\n",
    "house/circle_b.py": "from house import circle_a\n",
    "house/bad.py": "from house import\n",
    "house/windows.py": "x = 1\r\ny = 2\r\n",
    "plain/inside.py": "from house.alone import x\nimport other_house\n",
    "other_house.py": BOMB,
    "top.py": "from plain.inside import a\nfrom house import alone, nothing\n",
}
ROOM = "house house.room house.room.bed house.room.chair house.alone house.lazy house.absolute"


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(text.encode())
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(fingerprint, "PACKAGES", ("house", "plain"))
    return tmp_path


@pytest.mark.parametrize(
    ("module", "names"),
    [
        ("house.alone", "house house.alone"),
        ("house.absolute", "house house.absolute house.alone"),
        ("house.lazy", "house house.lazy house.absolute house.alone"),
        (
            "house.room",
            ROOM,
        ),
        (
            "house.room.chair",
            ROOM,
        ),
        ("house.text", "house house.text house.5_number"),
        ("house.circle_a", "house house.circle_a house.circle_b"),
        ("plain.inside", "plain.inside house house.alone"),
        ("top", "top plain.inside house house.alone"),
    ],
)
def test_the_modules_that_are_found(house: Path, module: str, names: str) -> None:
    found = imported_modules(module)
    assert set(found) == set(names.split())
    assert all(path.is_relative_to(house) for path in found.values())


def test_nothing_is_imported(house: Path) -> None:
    before = set(sys.modules)
    code_hash("house.room")
    assert not {name for name in set(sys.modules) - before if name.startswith(("house", "plain"))}


def test_every_byte_of_every_file_counts_and_no_other(house: Path) -> None:
    first = code_hash("house.lazy")
    assert first == code_hash("house.lazy") and len(first) == 16
    for name in ("house/lazy.py", "house/absolute.py", "house/alone.py", "house/__init__.py"):
        text = (house / name).read_bytes()
        (house / name).write_bytes(text + b"# a comment\n")
        assert code_hash("house.lazy") != first, name
        (house / name).write_bytes(text)
        assert code_hash("house.lazy") == first
    for name in ("house/room/bed.py", "other_house.py", "house/circle_a.py"):
        (house / name).write_bytes(b"changed = 1\n")
    assert code_hash("house.lazy") == first


def test_a_compiled_module_counts_by_its_bytes(house: Path) -> None:
    file = house / ("house/compiled" + EXTENSION_SUFFIXES[0])
    file.write_bytes(b"\x7fELF\0")
    assert imported_modules("house.compiled")["house.compiled"] == file
    first = code_hash("house.compiled")
    file.write_bytes(b"\x7fELF\1")
    assert code_hash("house.compiled") != first


def test_line_ends_do_not_count(house: Path) -> None:
    first = code_hash("house.windows")
    (house / "house/windows.py").write_bytes(b"x = 1\ny = 2\n")
    assert code_hash("house.windows") == first


def test_one_file_cannot_look_like_two(monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = []
    for files in ({"a": b"", "b": b"z"}, {"a": b"b\nz"}, {"a": b"b", "b": b"z"}):
        found = {name: Bytes(data) for name, data in files.items()}
        monkeypatch.setattr(fingerprint, "imported_modules", lambda module, f=found: f)
        hashes.append(code_hash("a"))
    assert len(set(hashes)) == 3


@given(st.binary(max_size=20), st.binary(max_size=20))
def test_two_texts_have_one_hash_only_if_they_are_the_same(a: bytes, b: bytes) -> None:
    with pytest.MonkeyPatch.context() as patch:
        hashes = []
        for data in (a, b):
            patch.setattr(fingerprint, "imported_modules", lambda module, d=data: {"m": Bytes(d)})
            hashes.append(code_hash("m"))
    same = a.replace(b"\r\n", b"\n") == b.replace(b"\r\n", b"\n")
    assert (hashes[0] == hashes[1]) == same


class Bytes:
    """Stands in for a path."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def read_bytes(self) -> bytes:
        return self.data


def test_the_hash_does_not_depend_on_the_folder_or_the_machine(house: Path, tmp_path: Path) -> None:
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); from posecore import fingerprint as f;"
        "f.PACKAGES = ('house', 'plain'); print(f.code_hash('house.room'))"
    )
    moved = tmp_path / "moved"
    (moved / "house/room").mkdir(parents=True)
    for name in FILES:
        if name.startswith("house/"):
            (moved / name).write_bytes((house / name).read_bytes())
    result = subprocess.run(
        [sys.executable, "-c", program, str(moved)], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == code_hash("house.room")


def test_relative_names_and_parts_of_a_chapter_are_imports(house: Path) -> None:
    (house / "house/loads.py").write_text(
        "from importlib import import_module\n"
        "from book.tools import parts\nfrom book.tools.parts import checks\n"
        "import_module('.alone', __package__)\nimport_module('....far', __package__)\n"
        "import_module()\nimport_module(name)\nchecks(name)\n"
        "a, b = checks('05_x'), parts.drawing('05_x')\n"
    )
    for part in ("checks", "drawing"):
        (house / "book" / part).mkdir(parents=True)
        (house / "book" / part / "05_x.py").write_text("import house.circle_a\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fingerprint, "PACKAGES", ("house", "book"))
        patch.setattr(fingerprint, "HOME", house)
        found = set(imported_modules("house.loads"))
    circle = {"house", "house.circle_a", "house.circle_b"}
    assert found == circle | {
        "house.loads",
        "house.alone",
        "book.checks.05_x",
        "book.drawing.05_x",
    }


def test_the_book_is_found_beside_the_library_wherever_a_kernel_runs(tmp_path: Path) -> None:
    """As in an installed environment: the library can be imported, the folder `book` cannot."""
    decoy = tmp_path / "book" / "drawing"
    decoy.mkdir(parents=True)
    (decoy / "index.py").write_text("a decoy")
    # A folder in a folder, both without __init__.py, as `book/experiments` is.
    assert (fingerprint.HOME / "book/drawing/index.py").is_file()
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import posecore.fingerprint as f;"
        "sys.path.remove(sys.argv[1]); sys.path.insert(0, '');"
        "print(f.code_hash('book.drawing.index'), f.imported_modules('book.drawing.index'))"
    )
    answers = set()
    for folder in (tmp_path, fingerprint.HOME / "book"):
        result = subprocess.run(
            [sys.executable, "-P", "-c", program, str(fingerprint.HOME)],
            cwd=folder,
            env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
            capture_output=True,
            text=True,
            check=True,
        )
        answers.add(result.stdout)
    assert answers == {
        f"{code_hash('book.drawing.index')} {imported_modules('book.drawing.index')}\n"
    }


def test_the_library_itself() -> None:
    found = imported_modules("posecore.metrics.boxes")
    assert {"posecore", "posecore.metrics", "posecore.arrays", "posecore.poses"} <= set(found)
    assert not any(name.startswith("data_tools") for name in found)
    assert "posecore.rotations.validity" in found  # through posecore.poses


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: code_hash("house.nothing"), "module: expected the name of a module"),
        (lambda: code_hash("no_such_house"), "module: expected the name of a module"),
        (lambda: code_hash("house.alone.x"), "module: expected the name of a module"),
        (lambda: code_hash("no_such.house"), "module: expected the name of a module"),
        (lambda: code_hash("__main__"), "module: expected the name of a module"),
        (lambda: code_hash("house.bad"), "bad.py: no Python: "),
    ],
)
def test_what_is_refused(house: Path, call: Callable[[], str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
