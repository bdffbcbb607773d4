"""Cells that are no Python: the error is shown, and the notebook runs on.

"Run all" stops at a cell with a syntax error, as at any other error; a student who has mistyped one
function would see nothing of the exercises that follow. So the first cell of a notebook says

    forgive_syntax()

and from then on a cell that cannot be read shows where, and what it would have defined is `Broken`:
the check says so, and the library's version stands in.
"""

from __future__ import annotations
import __future__

import ast
import keyword
import re
import sys
import traceback
import warnings
from typing import Any, NoReturn

__all__ = ["Broken", "broken", "forgive_syntax"]

# Two names and a bracket are no Python unless the first is a keyword: it is `def`, mistyped.
DEFINITION = re.compile(r"^ {0,3}(?:async +)?(\w+)[ \t]+(\w+)[ \t]*(\(?)", re.MULTILINE)
FUTURE = sum({getattr(__future__, name).compiler_flag for name in __future__.all_feature_names})


class Broken:
    """Stands for a function whose cell is no Python.

    Attributes:
        words: where, and what is wrong there, on one line.
    """

    words: str

    def __init__(self, error: SyntaxError) -> None:
        line = f" in `{error.text.strip()}`" if error.text and error.text.strip() else ""
        self.words = f"line {error.lineno} of its cell is no Python: {error.msg}{line}"

    def __call__(self, *arguments: Any, **named: Any) -> NoReturn:
        """Fail: there is nothing to be called.

        Raises:
            NameError: always.
        """
        raise NameError(self.words)


def forgive_syntax() -> None:
    """Let cells with a syntax error show it and be passed over; without IPython, do nothing.

    Cells that are Python, magic commands included, run as they are.
    """
    shell = _shell()
    if shell is not None and _passed_over not in shell.input_transformers_post:
        shell.input_transformers_post.append(_passed_over)


def broken(source: str) -> dict[str, Broken]:
    """Show the syntax error of a cell on the error stream; nothing is raised.

    Args:
        source: of the cell, its magic commands already made Python.

    Returns:
        What the cell would have defined, by name; empty, and nothing is shown, for a right cell.
    """
    error = _error(source)
    if error is None:
        return {}
    names = []
    for word, name, bracket in DEFINITION.findall(source):
        mistyped = bracket and not keyword.iskeyword(word) and word != "print"
        if word in ("def", "class") or mistyped:
            names.append(name)
    print("".join(traceback.format_exception_only(error)).rstrip(), file=sys.stderr)
    print("Nothing in this cell was run. The page goes on.", file=sys.stderr)
    return dict.fromkeys(names, Broken(error))


def _shell() -> Any:
    """The IPython in which this runs, or None."""
    ipython = sys.modules.get("IPython")  # not imported for the sake of this: it takes long
    return None if ipython is None else ipython.get_ipython()


def _passed_over(lines: list[str]) -> list[str]:
    """The lines of a cell, or, where they are no Python, one that says so."""
    source = "".join(lines)
    if _error(source) is None:
        return lines
    place = f'__import__({__name__!r}, fromlist=["broken"])'
    return [f"globals().update({place}.broken({source!r}))\n"]


def _error(source: str) -> SyntaxError | None:
    """What is wrong with a cell, which may await and has the features that others imported."""
    shell = _shell()
    flags = 0 if shell is None else shell.compile.flags & FUTURE
    flags |= ast.PyCF_ALLOW_TOP_LEVEL_AWAIT
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they come when it is run
            compile(source, "this cell", "exec", flags, dont_inherit=True)
    except SyntaxError as error:
        return error
    return None
