"""The hash of the code that a measurement depends on, found by reading files, not by importing."""

from __future__ import annotations

import ast
import contextlib
import importlib.util
from collections.abc import Iterator
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from posecore.arrays import fail
from posecore.files import hash_files

__all__ = ["PACKAGES", "code_hash", "imported_modules"]

PACKAGES = ("posecore", "data_tools", "book")
"""The packages of this project; what others change, a pinned environment keeps still."""

HOME = Path(__file__).resolve().parents[1]
"""The folder they stand in. A notebook's kernel runs elsewhere, and may find another `book`."""

LOADERS = ("checks", "drawing")
"""Functions of `book.tools.parts`: `checks("01_name")` runs `book/checks/01_name.py`."""


def code_hash(module: str) -> str:
    """A hash of a module and of all modules of this project that it imports, however indirectly.

    It is taken over the names and bytes of the files, so a comment changes it too: an alarm too
    many costs a measurement, one too few a wrong number. Line ends do not count, as Git may change
    them. Imports count wherever they stand, also `import_module("a literal name")` and the parts of
    a chapter, `checks("a literal name")` and `drawing("a literal name")`; a name that is put
    together while running is not seen.

    Raises:
        ValueError: if there is no such module, or one of the files is no Python.
    """
    return hash_files(sorted(imported_modules(module).items()))


def imported_modules(module: str) -> dict[str, Path]:
    """The files of a module and of all modules of this project that it imports, by name."""
    files: dict[str, Path] = {}
    todo, seen = [module], set()
    specs: dict[str, ModuleSpec | None] = {}
    while todo:
        name = todo.pop()
        if name in seen:
            continue
        seen.add(name)
        spec = _find(name, specs)
        if spec is None:
            if name == module:
                fail("module", "the name of a module that can be imported", repr(module))
            continue  # `from package import function`
        if spec.origin is None or not Path(spec.origin).is_file():
            continue  # a folder without __init__.py
        files[name] = Path(spec.origin)
        if files[name].suffix == ".py":
            package = (
                name if spec.submodule_search_locations is not None else name.rpartition(".")[0]
            )
            todo += [n for n in _imports(files[name], package) if n.partition(".")[0] in PACKAGES]
        if "." in name:
            todo.append(name.rpartition(".")[0])  # its package runs first
    return files


def _find(name: str, specs: dict[str, ModuleSpec | None]) -> ModuleSpec | None:
    """The spec of a module, found from its package's folder: find_spec would run the package."""
    if name not in specs:
        specs[name] = None
        package = name.rpartition(".")[0]
        if package:
            folder = getattr(_find(package, specs), "submodule_search_locations", None)
            # Asked for by its last name: by its whole name a folder in a folder, both without
            # __init__.py, would want the outer one to have been imported.
            last = name.rpartition(".")[2]
            specs[name] = PathFinder.find_spec(last, list(folder)) if folder is not None else None
        elif name != "__main__":  # a script or a notebook; other programs call themselves so too
            if name in PACKAGES:
                specs[name] = PathFinder.find_spec(name, [str(HOME)])
            with contextlib.suppress(ImportError, ValueError):  # a module put together by hand
                specs[name] = specs[name] or importlib.util.find_spec(name)
    return specs[name]


def _imports(path: Path, package: str) -> Iterator[str]:
    """Every name that a file may import; some are functions and not modules."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"{path}: no Python: {error}") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) + 1 - node.level]
            base = ".".join((above if node.level else []) + ([node.module] if node.module else []))
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call):
            yield from _loads(node, package)


def _loads(call: ast.Call, package: str) -> Iterator[str]:
    """The module that a call loads by a literal name."""
    function = ast.unparse(call.func).rpartition(".")[2]
    first = call.args[0] if call.args else None
    if not (isinstance(first, ast.Constant) and isinstance(first.value, str)):
        return
    if function == "import_module":
        # Relative ones are taken to be meant from here, as `import_module(".name", __package__)`.
        with contextlib.suppress(ImportError):
            yield importlib.util.resolve_name(first.value, package)
    elif function in LOADERS:
        yield f"book.{function}.{first.value}"
