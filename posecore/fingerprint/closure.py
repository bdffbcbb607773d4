"""The definitions that a piece of code reaches, with a hash of what each of them computes."""

from __future__ import annotations

import ast
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from posecore import loaded
from posecore.arrays import fail
from posecore.fingerprint.modules import PACKAGES, Module, find_module
from posecore.fingerprint.plain import plain_form
from posecore.fingerprint.walk import LINKS, LOOSE, Closure, Walk, short_hash

__all__ = ["Closure", "changes", "closure", "closure_as_loaded", "digest", "of_source"]


def closure(
    *roots: Callable[..., Any] | str,
    packages: Iterable[str] = PACKAGES,
    without: Iterable[str] = (),
    refusals: bool = False,
    sources: Mapping[str, bytes] | None = None,
) -> Closure:
    """The definitions that functions and modules reach: functions, classes, assignments.

    A function counts without comments, docstrings, annotations and lines that only refuse, and by
    its name, not its module, so that a plain move or a better message changes nothing. A class
    counts whole; what only its refusing lines call does not count. Names that are put together
    while running are not seen: a test that watches what runs has to find them.

    Args:
        roots: functions or classes of modules with a file (`functools.partial` and decorators are
            seen through), or names: "package.module" for all that the module defines,
            "package.module:name" for one definition.
        packages: whose definitions count, besides those of the roots' own packages.
        without: packages and modules in these that do not count after all.
        refusals: whether lines that only refuse count, for tests that watch what runs.
        sources: of modules, in place of what is in their files.

    Raises:
        ValueError: naming a root that has no file, or a file that is no Python.
    """
    starts = [start for root in roots for start in _starts(root)]
    tops = {*packages, *(module.partition(".")[0] for module, _ in starts)}
    return Walk(tops, refusals, tuple(without), sources).run(starts)


def closure_as_loaded(
    *roots: Callable[..., Any] | str,
    packages: Iterable[str] = PACKAGES,
    without: Iterable[str] = (),
) -> Closure:
    """The closure of what this process runs: refused where a file says something else by now.

    Args:
        roots, packages, without: as for `closure`.

    Raises:
        ValueError: as `closure`.
        RuntimeError: if a definition has been edited since it was loaded: what runs here would be
            taken for what the file says.
    """
    now = closure(*roots, packages=packages, without=without)
    if edited := loaded.edited():
        before = closure(*roots, packages=packages, without=without, sources=edited)
        if names := {name for name, _ in before.definitions ^ now.definitions}:
            words = ", ".join(sorted(names - {LINKS} or names)[:3])
            raise RuntimeError(f"{words}: the source has changed; start Python or the kernel anew")
    return now


def of_source(source: str, packages: Iterable[str] = ("book",)) -> Closure:
    """The definitions of some packages that the source of a script or a page reaches.

    Raises:
        ValueError: if it is no Python.
    """
    walk = Walk(set(packages), refusals=False)
    try:
        body = ast.parse(source).body
    except SyntaxError as error:
        raise ValueError(f"source: expected Python, got {error}") from error
    module = Module("__main__", Path("__main__.py"))
    # A page imports where it needs something: every import counts from its first line on.
    found = plain_form(body, "", functools.partial(walk.resolve, module), refusals=True)
    return walk.run(sorted(found.origins))


def digest(closure: Closure) -> str:
    """16 hexadecimal digits of the definitions."""
    return short_hash(closure.text, 16)


def changes(kept: str, now: Closure) -> list[str]:
    """The names of definitions that are other than in a text that was kept, or gone, or new.

    Args:
        kept: `Closure.text` of before.
        now: the closure of today.

    Returns:
        "module.name" by the last part of the module's name, just the name where it is gone; in
        alphabetical order. Definitions that only moved are not among them.
    """
    before = {tuple(word.rsplit(":", 1)) for word in kept.split()}
    after = set(now.definitions)
    where = {
        name: module.rpartition(".")[2]
        for (module, _), hashes in now.places.items()
        for name, code in hashes.items()
        if (name, code) not in before
    }
    names = {name for name, _ in before ^ after}
    named = names - {LINKS} or names  # which is meant where changes with what they are
    return sorted(f"{where[name]}.{name}" if where.get(name) else name for name in named)


def _starts(root: Callable[..., Any] | str) -> list[tuple[str, str]]:
    """Where a walk begins."""
    if isinstance(root, str):
        base, _, name = root.partition(":")
        module = find_module(base)
        if module is None or (name and name not in module.definitions):
            fail("roots", "a module with a file, or module:name", repr(root))
        if name:
            return [(base, name)]
        return [(one.name, n) for one in _with_parts(module) for n in (*one.definitions, LOOSE)]
    plain = root
    while isinstance(plain, functools.partial):
        plain = plain.func
    plain = inspect.unwrap(plain)
    name, top = getattr(plain, "__module__", ""), getattr(plain, "__qualname__", "").split(".")[0]
    module = find_module(name) if name else None
    if module is None or top not in module.definitions:
        fail("roots", "a function from a module that can be imported", f"{top or root!r} of {name}")
    return [(name, top)]


def _with_parts(module: Module) -> list[Module]:
    """A module, and if it is a package all modules in it."""
    found = [module]
    if module.path.stem == "__init__":
        folder = module.path.parent
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join([module.name, *(parts[:-1] if parts[-1] == "__init__" else parts)])
            if name != module.name and (part := find_module(name)) is not None:
                found.append(part)
    return found
