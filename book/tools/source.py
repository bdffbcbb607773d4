"""The library's own source on the page, so that a finished class is shown and not typed again."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posecore.arrays import fail

__all__ = ["Source", "show_source"]


@dataclass(frozen=True)
class Source:
    """A piece of a file, which a notebook shows as highlighted code under its file and line."""

    file: str
    line: int
    code: str

    def __repr__(self) -> str:
        return f"{self.file}, line {self.line}\n\n{self.code}"

    def _repr_markdown_(self) -> str:
        longest = max(map(len, re.findall("`+", self.code)), default=0)
        fence = "`" * max(3, longest + 1)
        return f"`{self.file}`, line {self.line}\n\n{fence}python\n{self.code}\n{fence}\n"


def show_source(thing: Any, *, docstrings: bool = True, hide: Sequence[str] = ()) -> Source:
    """The source of a class, a function or a method, from the file that it was imported from.

    Args:
        thing: the class or function; decorators that keep `__wrapped__` are seen through.
        docstrings: whether docstrings are shown.
        hide: names of methods whose body is shown as `...`.

    Raises:
        ValueError: if `thing` is neither class nor function, if it has no file (built in, or typed
            in a notebook), or if `hide` names no method of it.
    """
    if isinstance(hide, str):
        fail("hide", "a sequence of names of methods", repr(hide))
    if not (inspect.isclass(thing) or inspect.isroutine(thing)):
        fail("thing", "a class or a function", f"an instance of {type(thing).__name__}")
    thing = inspect.unwrap(thing)
    name = getattr(thing, "__qualname__", repr(thing))
    try:
        path = Path(inspect.getsourcefile(thing) or "")
        lines, line = inspect.getsourcelines(thing)
    except (OSError, TypeError):
        fail("thing", "something with Python source", name)
    if not path.is_file():
        fail("thing", "something from a file", f"{name}, typed in a notebook or a shell")
    indent = lines[0][: len(lines[0]) - len(lines[0].lstrip())]
    # Not textwrap.dedent: a string over several lines may reach further left than the code.
    lines = [text.rstrip("\r\n").removeprefix(indent) for text in lines]
    return Source(_short(path, thing.__module__), line, _cut(lines, docstrings, hide))


def _short(path: Path, module: str) -> str:
    """The path from the top package on, the same on every machine."""
    parts = len(module.split(".")) + (path.name == "__init__.py")
    return "/".join(path.parts[-parts:])


def _cut(lines: list[str], docstrings: bool, hide: Sequence[str]) -> str:
    top = ast.parse("\n".join(lines)).body[0]
    methods = [
        node
        for node in getattr(top, "body", [])
        if isinstance(top, ast.ClassDef)
        and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    if missing := set(hide) - {node.name for node in methods}:
        fail("hide", "names of methods", ", ".join(map(repr, sorted(missing))))
    hidden = [node for node in methods if node.name in hide]
    cuts = [(node.body[0], node.body[-1], True) for node in hidden]
    if not docstrings:
        inside_hidden = {inner for node in hidden for inner in ast.walk(node)}
        for node in ast.walk(top):
            if node not in inside_hidden and (text := _docstring(node)) is not None:
                cuts.append((text, text, len(node.body) == 1))  # type: ignore[attr-defined]
    # From the bottom up, so that the line numbers above a cut stay right.
    for first, last, ellipsis in sorted(cuts, key=lambda cut: -cut[0].lineno):
        _replace(lines, first, last, "..." if ellipsis else None)
    return "\n".join(lines)


def _docstring(node: ast.AST) -> ast.Expr | None:
    if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        return None
    first = node.body[0]
    return first if ast.get_docstring(node) is not None and isinstance(first, ast.Expr) else None


def _replace(lines: list[str], first: ast.stmt, last: ast.stmt, text: str | None) -> None:
    start, end = first.lineno - 1, last.end_lineno or last.lineno
    # The column counts bytes.
    before = lines[start].encode()[: first.col_offset].decode()
    after = lines[end - 1].encode()[last.end_col_offset :].decode().lstrip(" ;")
    if text is not None:
        lines[start:end] = [before + text]
    elif before.strip() or (after and not after.startswith("#")):
        lines[start:end] = [before + after]  # more than the docstring stands on its lines
    else:
        if end < len(lines) and not lines[end].strip():
            end += 1
        del lines[start:end]
