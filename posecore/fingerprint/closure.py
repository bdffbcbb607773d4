"""The definitions that a piece of code reaches, with a hash of what each of them computes."""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from posecore.arrays import fail
from posecore.fingerprint.modules import PACKAGES, Module, find_module
from posecore.fingerprint.plain import Found, Plain, plain_form

__all__ = ["Closure", "changes", "closure", "digest", "of_source"]

LOOSE = "<module>"
"""The name under which statements of a module count that define nothing."""
LINKS = "<links>"
"""The name under which it counts which of several definitions of one name is meant where."""


@dataclass
class Closure:
    """Definitions that a piece of code reaches.

    Attributes:
        places: (module, name) -> the hashes of what stands there; of a class one for each method
            and one for the rest, by their names.
        lines: (file, first line, last line) of each.
        scaled: scale -> the numbers chosen by it (`choose`, or a dict by scale) in plain form.
    """

    places: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)
    lines: set[tuple[Path, int, int]] = field(default_factory=set)
    scaled: dict[str, list[str]] = field(default_factory=dict)

    @property
    def definitions(self) -> frozenset[tuple[str, str]]:
        """(name, hash) of each, whatever module it stands in; names may occur twice."""
        return frozenset(pair for hashes in self.places.values() for pair in hashes.items())

    @property
    def text(self) -> str:
        """The definitions on one line, `name:hash` in alphabetical order, to be kept."""
        return " ".join(f"{name}:{code}" for name, code in sorted(self.definitions))

    def numbers(self, scale: str) -> str:
        """A hash of the numbers that are chosen by scale, as they are at this one."""
        return _hash("\n".join(sorted(self.scaled.get(scale, []))))

    def merge(self, other: Closure) -> Closure:
        """Both together."""
        scaled = {k: [*self.scaled.get(k, [])] for k in self.scaled | other.scaled}
        for name, values in other.scaled.items():
            scaled[name] += values
        return Closure(self.places | other.places, self.lines | other.lines, scaled)


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
    return _Walk(tops, refusals, tuple(without), sources).run(starts)


def of_source(source: str, packages: Iterable[str] = ("book",)) -> Closure:
    """The definitions of some packages that the source of a script or a page reaches.

    Raises:
        ValueError: if it is no Python.
    """
    walk = _Walk(set(packages), refusals=False)
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
    return _hash(closure.text, 16)


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


def _hash(text: str, digits: int = 8) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:digits]


# The walk -----------------------------------------------------------------------------------------


class _Walk:
    """Follows references from definition to definition."""

    def __init__(
        self,
        tops: set[str],
        refusals: bool,
        without: tuple[str, ...] = (),
        sources: Mapping[str, bytes] | None = None,
    ) -> None:
        self.tops, self.refusals, self.without = tops, refusals, without
        # A file is read once in a walk, and again in the next, as it may have been edited.
        self.find = functools.cache(functools.partial(find_module, sources=sources or {}))
        self.imported_with = functools.cache(self._imported_with)

    def run(self, starts: Iterable[tuple[str, str]]) -> Closure:
        result, todo, seen = Closure(), list(starts), set()
        # Where an error may be answered by something else.
        guarded: set[tuple[str, str]] = set()
        answered: set[tuple[str, str]] = set()
        # What each place says, as it is read last: it is read again once it turns out that somebody
        # answers its errors, and which of two comes first is chance.
        read: dict[tuple[str, str], list[tuple[str, Plain]]] = {}
        while todo:
            place = todo.pop()
            if place in seen and (place in answered or place not in guarded):
                continue
            seen.add(place)
            if place in guarded:
                answered.add(place)
            module = self.find(place[0])
            if module is None:
                continue
            pieces = _pieces(module, place[1])
            if pieces and place[1] != LOOSE:
                todo += self.imported_with(place[0])  # importing the module runs it
            read[place] = []
            for name, nodes in pieces.items():
                resolve = functools.partial(self.resolve, module)
                plain = plain_form(nodes, module.package, resolve, self.refusals, place in guarded)
                read[place].append((name, plain))
                todo += plain.guarded - guarded
                guarded |= plain.guarded
                todo += plain.origins - seen
            for node in _statements(module, place[1]):
                result.lines.add((module.path, _first_line(node), node.end_lineno or 0))
        order: dict[tuple[str, str], list] = {}  # by name and hash, to what it refers
        for place in sorted(read):
            for name, plain in read[place]:
                result.places.setdefault(place, {})[name] = _hash(plain.text)
                order.setdefault((name, _hash(plain.text)), []).append(plain.order)
                for scale, values in plain.scaled.items():
                    result.scaled.setdefault(scale, []).extend(values)
        if links := _links(result, order):
            result.places["", LINKS] = {LINKS: links}
        return result

    def _imported_with(self, name: str) -> list[tuple[str, str]]:
        """The loose statements of a module, of its packages, and of what these import."""
        todo, seen = [name], set()
        while todo:
            one = todo.pop()
            if one in seen or not self._ours(one):
                continue
            seen.add(one)
            todo += [one.rpartition(".")[0]] if "." in one else []
            module = self.find(one)
            if module is not None:
                others = [origin for some in module.others.values() for origin in some]
                for base, name in (*module.imports.values(), *others):
                    todo += [base, *([f"{base}.{name}"] if name else [])]
                todo += [*module.stars, *module.whole]
        return [(one, LOOSE) for one in seen]

    def resolve(
        self, module: Module, chain: list[str], local: dict[str, tuple[str, str | None]]
    ) -> Found | None:
        """What a chain of names stands for in a module; None where it is none of its names."""
        first = chain[0]
        if first in local:
            base, name = local[first]
            return self._imported(base, name, chain)
        found = None
        if first in module.imports:
            found = self._imported(*module.imports[first], chain)
            more = [self._imported(*o, chain).origins for o in module.others.get(first, ())]
            found = Found(found.name, (*found.origins, *(o for m in more for o in m)), found.used)
        if first in module.definitions:
            own = ((module.name, first), *(found.origins if found else ()))
            return Found(first, own, 1)
        if found is not None and not module.stars:
            return found
        stars = [self._attribute(b, first) for b in reversed(module.stars) if self._ours(b)]
        stars = [star for star in stars if star is not None]
        if stars:
            every = [*stars, *([found] if found else [])]
            return Found(stars[0].name, tuple(o for f in every for o in f.origins), 1)
        if found is not None:
            return found
        if first in module.doors:
            return self._imported(*module.doors[first], chain)
        return None

    def _imported(self, base: str, name: str | None, chain: list[str]) -> Found:
        """The chain after an import: into modules as far as they are ours."""
        used = 1
        if not self._ours(base):
            return Found(".".join(filter(None, [base, name])), (), used)
        if name is not None:
            found = self._attribute(base, name)
            if found is not None:
                return Found(found.name, found.origins, used)
            base = f"{base}.{name}"
        while used < len(chain):
            found = self._attribute(base, chain[used])
            if found is not None:
                return Found(found.name, found.origins, used + 1)
            if self.find(f"{base}.{chain[used]}") is None:
                break
            base, used = f"{base}.{chain[used]}", used + 1
        # A module by itself: whoever has it can reach all that is in it.
        module = self.find(base)
        # What is not found, too, may be given by any of it: by `globals()`, or a `__getattr__`.
        return Found(base.rpartition(".")[2], self._all_of(base) if module else (), used)

    def _all_of(self, base: str, depth: int = 0) -> tuple[tuple[str, str], ...]:
        """All that is in a module, also what it imports of ours."""
        module = self.find(base)
        if module is None:
            return ()
        found = [*((base, name) for name in module.definitions), (base, LOOSE)]
        for there, what in module.imports.values():
            if self._ours(there):
                one = self._attribute(there, what) if what is not None else None
                found += one.origins if one is not None else ()
        return tuple(dict.fromkeys(found))

    def _attribute(self, base: str, name: str, depth: int = 0) -> Found | None:
        """What `base.name` is: a definition, there or where it is imported from."""
        module = self.find(base)
        if module is None or depth > 20:
            return None
        if name in module.definitions:
            return Found(name, ((base, name),), 1)
        origin = module.imports.get(name)
        doors: tuple[tuple[str, str], ...] = ()
        if origin is None and name in module.doors:
            origin = module.doors[name]
            doors = ((base, "__getattr__"),) if "__getattr__" in module.definitions else ()
        if origin is None:
            for star in module.stars:
                if self._ours(star) and (found := self._attribute(star, name, depth + 1)):
                    return found
            return None
        there, what = origin
        if not self._ours(there):
            return Found(".".join(filter(None, [there, what])), doors, 1)
        found = self._attribute(there, what, depth + 1) if what is not None else None
        return None if found is None else Found(found.name, found.origins + doors, 1)

    def _ours(self, module: str) -> bool:
        is_without = any(f"{module}.".startswith(f"{name}.") for name in self.without)
        return module.partition(".")[0] in self.tops and not is_without


def _links(found: Closure, order: dict) -> str:
    """A hash of which of several definitions of one name each reference means."""
    own = {place: _hash(str(sorted(hashes.items()))) for place, hashes in found.places.items()}
    several: dict[str, set[str]] = {}
    for (_, name), code in own.items():
        several.setdefault(name, set()).add(code)
    lines = []
    for (name, code), orders in order.items():
        for one in orders:
            meant = [
                sorted(own[o] for o in origins if o in own and len(several[o[1]]) > 1)
                for origins in one
            ]
            if any(meant):
                lines.append(f"{name}:{code}>{[m for m in meant if m]}")
    return _hash("\n".join(sorted(lines))) if lines else ""


def _statements(module: Module, name: str) -> list[ast.stmt]:
    return module.loose if name == LOOSE else module.definitions.get(name, [])


def _pieces(module: Module, name: str) -> dict[str, list[ast.AST]]:
    """The statements of a definition, by name; of a class each method by itself."""
    pieces: dict[str, list[ast.AST]] = {}
    for statement in _statements(module, name):
        if not isinstance(statement, ast.ClassDef):
            pieces.setdefault(name, []).append(statement)
            continue
        rest = []
        for inner in statement.body:
            if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
                pieces.setdefault(f"{name}.{inner.name}", []).append(inner)
            else:
                rest.append(inner)
        bare = ast.ClassDef(
            name, statement.bases, statement.keywords, rest, statement.decorator_list
        )
        pieces.setdefault(name, []).append(ast.copy_location(bare, statement))
    return pieces


def _first_line(node: ast.stmt) -> int:
    return min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])


def _starts(root: Callable[..., Any] | str) -> list[tuple[str, str]]:
    """Where a walk begins."""
    if isinstance(root, str):
        base, _, name = root.partition(":")
        module = find_module(base)
        if module is None or (name and name not in module.definitions):
            fail("roots", "a module with a file, or module:name", repr(root))
        if name:
            return [(base, name)]
        return [(one, n) for one in _with_parts(module) for n in (*_module(one).definitions, LOOSE)]
    plain = root
    while isinstance(plain, functools.partial):
        plain = plain.func
    plain = inspect.unwrap(plain)
    name, top = getattr(plain, "__module__", ""), getattr(plain, "__qualname__", "").split(".")[0]
    module = find_module(name) if name else None
    if module is None or top not in module.definitions:
        fail("roots", "a function from a module that can be imported", f"{top or root!r} of {name}")
    return [(name, top)]


def _module(name: str) -> Module:
    module = find_module(name)
    assert module is not None
    return module


def _with_parts(module: Module) -> list[str]:
    """A module, and if it is a package all modules in it."""
    names = [module.name]
    if module.path.stem == "__init__":
        folder = module.path.parent
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            if parts:
                names.append(".".join([module.name, *parts]))
    return names
