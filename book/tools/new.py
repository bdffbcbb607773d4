"""A chapter begun: a page, its exercise, figure and claim, a method with its recipe, and the tests.

What is written lies in `skeleton/`, laid out as the project is. There, and in the names of files,
NN_NAME is the page, NN its number, TITLE its title and METHOD the method. It is real and small, so
that a chapter grows out of it by edits, each of which the checks hold.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
import keyword
import re
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from book.tools import exercises, pairs
from book.tools.contents import ROOT, Page, pages
from data_tools.storage.locks import claim
from posecore.arrays import fail
from posecore.files import write_bytes

__all__ = ["LONGEST_NAME", "new"]

SKELETON = Path(__file__).parent / "skeleton"
ENDING = ".in"  # so that nobody takes a template for Python
LONGEST_NAME = 30
"""Letters of a name: with more, lines of the templates would be too long."""
UNFINISHED = "book/new.unfinished"
"""What is being written, and what was there before: whoever comes after a kill brings it to an end.
"""
RANDOM = "[0-9a-f]" * 16  # in the names of copies that `write_bytes` has not finished
METHODS = re.compile(r"^METHODS = (\([^)]*\))$", re.MULTILINE)


def new(number: str, name: str, method: str | None = None, root: Path = ROOT) -> list[Path]:
    """Write the skeleton of a chapter, or, if anything is in its way, nothing.

    Args:
        number: of the chapter, one or two digits.
        name: small letters, digits and _, as in `NN_name`.
        method: the package in `posecore/methods`; by default it has the chapter's name.
        root: the folder of the project.

    Returns:
        The files that were written or changed.

    Raises:
        ValueError: if a number or a name is malformed or taken, a file is there already, or another
            process is at it.
        OSError: if a file cannot be written; those that were are taken back.
    """
    method = name if method is None else method
    if not re.fullmatch(r"\d{1,2}", number):
        fail("number", "one or two digits", repr(number))
    for what, word in (("name", name), ("method", method)):
        if not re.fullmatch("[a-z][a-z0-9_]*", word) or len(word) > LONGEST_NAME:
            fail(what, f"at most {LONGEST_NAME} small letters, digits and _", repr(word))
    page = Page(f"{number.zfill(2)}_{name}", exercises=True)
    journal = root / UNFINISHED
    with claim(journal) as claimed:
        if not claimed.mine:
            fail("root", "a project in which no other process begins a chapter", root)
        before = _resume(journal, root)
        if page.name in {path.stem for path in before}:
            return before
        _require_free(page, method, root)
        title = name.replace("_", " ").capitalize()
        words = {"NN_NAME": page.name, r"\bNN\b": page.name[:2], r"\bMETHOD\b": method}
        files = _made(words | {r"\bTITLE\b": title}, page, root)
        for path in files:
            if path.exists():
                fail("name", "files that are not there yet", path.relative_to(root).as_posix())
        contents, methods = root / "book/site/contents.toml", root / "posecore/methods/__init__.py"
        files[contents] = _with_page(contents.read_text(encoding="utf-8"), page, root).encode()
        files[methods] = _with_method(methods.read_text(encoding="utf-8"), method).encode()
        _write(files, journal, root)
        return list(files)


def _require_free(page: Page, method: str, root: Path) -> None:
    number, _, name = page.name.partition("_")
    for other in pages(root / "book"):
        if number == other.name[:2] or name == other.name.partition("_")[2]:
            fail("page", "a number and a name that are free", f"those of {other.name}")
    if keyword.iskeyword(method):
        fail("method", "a name that is no word of Python's", repr(method))
    folder = root / "posecore" / "methods"
    if (folder / method).exists() or (folder / f"{method}.py").exists():
        fail("method", "a name that is free in posecore/methods", repr(method))


def _made(words: Mapping[str, str], page: Page, root: Path) -> dict[Path, bytes]:
    """The new files; of a source and its notebook the source comes last, as JupyterLab expects."""
    with tempfile.TemporaryDirectory() as folder:
        book = Path(folder) / "book"
        for template in sorted(SKELETON.rglob(f"*{ENDING}")):
            place = template.relative_to(SKELETON).as_posix().removesuffix(ENDING)
            path = Path(folder) / _filled(place, words)
            path.parent.mkdir(parents=True, exist_ok=True)
            text = _filled(template.read_text(encoding="utf-8"), words)
            path.write_text(text, encoding="utf-8", newline="\n")
        for source in (book / f"{page.name}.py", book / f"{page.part('solutions')}.py"):
            pairs.pair(source)
        exercises.generate(page, book)
        made = sorted(path for path in Path(folder).rglob("*") if path.is_file())
        return {root / path.relative_to(folder): path.read_bytes() for path in made}


def _filled(text: str, words: Mapping[str, str]) -> str:
    for word, value in words.items():
        text = re.sub(word, value, text)
    return text


def _with_page(text: str, page: Page, root: Path) -> str:
    """The table of contents with a page, before the first one of a higher number."""
    entry = f'[[page]]\nname = "{page.name}"\nexercises = true\n'
    names = [other.name for other in pages(root / "book")]
    behind = [name for name in names if name[:2].isdigit() and name > page.name]
    if not behind:
        return f"{text.rstrip()}\n\n{entry}"
    head, mark, tail = text.partition(f'[[page]]\nname = "{behind[0]}"')
    if not mark:
        fail("site/contents.toml", f"the name of {behind[0]} under its [[page]]", "another form")
    return f"{head}{entry}\n{mark}{tail}"


def _with_method(text: str, method: str) -> str:
    """`posecore/methods/__init__.py` with one more name in METHODS, as ruff formats it."""
    found = METHODS.search(text)
    if found is None:
        fail("posecore/methods/__init__.py", "METHODS = (names)", "none")
    names = [f'"{name}"' for name in (*ast.literal_eval(found[1]), method)]
    line = f"METHODS = ({', '.join(names)})"
    if len(line) > 100:
        line = "\n".join(["METHODS = (", *(f"    {name}," for name in names), ")"])
    return text[: found.start()] + line + text[found.end() :]


def _write(files: Mapping[Path, bytes], journal: Path, root: Path) -> None:
    """Write all of the files, or leave everything as it was: after a kill the next call does so."""
    note = {
        "folders": [_name(path, root) for path in _folders(files) if not path.exists()],
        "files": {
            _name(path, root): {
                "old": path.read_bytes().decode() if path.exists() else None,
                "new": hashlib.sha256(data).hexdigest(),
            }
            for path, data in files.items()
        },
    }
    write_bytes(journal, json.dumps(note).encode())
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, data)
    except BaseException:
        _take_back(note, root)
        raise
    finally:
        journal.unlink()


def _resume(journal: Path, root: Path) -> list[Path]:
    """Bring to an end what was killed: the files that are all there; none where it took them back.

    Where somebody has worked on one of them since, all stay as they are.
    """
    for copy in journal.parent.glob(f".{journal.name}.{RANDOM}.tmp"):
        copy.unlink()
    if not journal.exists():
        return []
    note = json.loads(journal.read_bytes())
    states = [_state(root / name, change) for name, change in note["files"].items()]
    if "old" in states and "changed" not in states:
        _take_back(note, root)
    journal.unlink()
    return [root / name for name in note["files"]] if set(states) == {"new"} else []


def _take_back(note: Mapping[str, Any], root: Path) -> None:
    for name, change in note["files"].items():
        path = root / name
        for copy in path.parent.glob(f".{path.name}.{RANDOM}.tmp"):
            copy.unlink()
        if change["old"] is None:
            path.unlink(missing_ok=True)
        elif _state(path, change) != "old":
            write_bytes(path, change["old"].encode())
    for name in note["folders"]:
        with contextlib.suppress(OSError):  # it was not made, or somebody has put something there
            (root / name).rmdir()


def _state(path: Path, change: Mapping[str, Any]) -> str:
    """Whether a file is the "old" one, which may be none, the "new" one, or "changed" since."""
    data = path.read_bytes() if path.exists() else None
    if data == (None if change["old"] is None else change["old"].encode()):
        return "old"
    return "new" if hashlib.sha256(data or b"").hexdigest() == change["new"] else "changed"


def _name(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _folders(files: Iterable[Path]) -> list[Path]:
    """The folders of files and those that hold them, the innermost first."""
    found = {folder for path in files for folder in path.parents}
    return sorted(found, key=lambda folder: len(folder.parts), reverse=True)
