"""The walk from definition to definition, along what each of them refers to."""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from posecore.fingerprint.modules import Module, find_module
from posecore.fingerprint.plain import Found, Plain, plain_form

__all__ = ["LINKS", "LOOSE", "Closure", "Walk", "short_hash"]

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
        return short_hash("\n".join(sorted(self.scaled.get(scale, []))))


def short_hash(text: str, digits: int = 8) -> str:
    """The first hexadecimal digits of a text's hash."""
    return hashlib.sha256(text.encode()).hexdigest()[:digits]


class Walk:
    """Follows references from definition to definition.

    Args:
        tops: the packages whose definitions count.
        refusals, without, sources: as for `posecore.fingerprint.closure`.
    """

    def __init__(
        self,
        tops: set[str],
        refusals: bool,
        without: tuple[str, ...] = (),
        sources: Mapping[str, bytes] | None = None,
    ) -> None:
        self.tops, self.refusals, self.without = tops, refusals, without
        # A file is read once in a walk, and again in the next, as it may have been edited.
        self.module = functools.cache(functools.partial(find_module, sources=sources or {}))
        self.looked: dict[str, Module | None] = {}

    def find(self, name: str) -> Module | None:
        """The module of this name; that somebody looked into it is noted."""
        found = self.looked[name] = self.module(name)
        return found

    def run(self, starts: Iterable[tuple[str, str]]) -> Closure:
        """All that is reached from some definitions, each (module, name)."""
        result, todo, seen = Closure(), list(starts), set()
        imported: set[str] = set()
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
            read[place] = self._forms(module, place[1], place in guarded)
            if read[place] and place[1] != LOOSE:
                todo += self._imported_with(place[0], imported)  # importing the module runs it
            for _, plain in read[place]:
                todo += plain.guarded - guarded
                guarded |= plain.guarded
                todo += plain.origins - seen
            for node in _statements(module, place[1]):
                result.lines.add((module.path, _first_line(node), node.end_lineno or 0))
        order: dict[tuple[str, str], list] = {}  # by name and hash, to what it refers
        for place in sorted(read):
            for name, plain in read[place]:
                result.places.setdefault(place, {})[name] = short_hash(plain.text)
                order.setdefault((name, short_hash(plain.text)), []).append(plain.order)
                for scale, values in plain.scaled.items():
                    result.scaled.setdefault(scale, []).extend(values)
        if links := _links(result, order):
            result.places["", LINKS] = {LINKS: links}
        return result

    def _forms(self, module: Module, name: str, answered: bool) -> list[tuple[str, Plain]]:
        """The plain forms of a definition, by name; of a class each method by itself.

        Many closures meet the same definitions: what an earlier walk read counts as long as each
        module into which it looked is the one of today.
        """
        key = (name, answered, frozenset(self.tops), self.without, self.refusals)
        looked, forms = module.forms.get(key, ({}, None))
        if forms is not None and all(self.module(n) is found for n, found in looked.items()):
            return forms
        self.looked = {}
        resolve = functools.partial(self.resolve, module)
        forms = [
            (piece, plain_form(nodes, module.package, resolve, self.refusals, answered))
            for piece, nodes in _pieces(module, name).items()
        ]
        module.forms[key] = self.looked, forms
        return forms

    def _imported_with(self, name: str, before: set[str]) -> list[tuple[str, str]]:
        """The loose statements of a module, of its packages, and of what these import.

        Args:
            name: of the module.
            before: the modules that were imported before and are left out; these join them.
        """
        todo, found = [name], []
        while todo:
            one = todo.pop()
            if one in before or not self._ours(one):
                continue
            before.add(one)
            found.append((one, LOOSE))
            todo += [one.rpartition(".")[0]] if "." in one else []
            module = self.find(one)
            if module is not None:
                others = [origin for some in module.others.values() for origin in some]
                for base, name in (*module.imports.values(), *others):
                    todo += [base, *([f"{base}.{name}"] if name else [])]
                todo += [*module.stars, *module.whole]
        return found

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

    def _all_of(self, base: str) -> tuple[tuple[str, str], ...]:
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
    own = {place: short_hash(str(sorted(hashes.items()))) for place, hashes in found.places.items()}
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
    return short_hash("\n".join(sorted(lines))) if lines else ""


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
