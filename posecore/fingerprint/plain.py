"""Code in a plain form, that only what it computes changes, and the names that it refers to."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache

from posecore.fingerprint.modules import origins

__all__ = ["Found", "Plain", "plain_form"]

REFUSES = re.compile(r"_?(fail|refuse|require)(_\w+)?$")
"""Functions that do nothing but refuse: `fail`, `require_choice`."""
SCALES = {"tiny", "book", "paper"}
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass(frozen=True)
class Found:
    """What a chain of names stands for.

    Attributes:
        name: that is written into the plain form, without the module of our own definitions.
        origins: (module, name) of what it refers to of this project.
        used: how many names of the chain that took.
    """

    name: str
    origins: tuple[tuple[str, str], ...]
    used: int


Resolve = Callable[[list[str], dict[str, tuple[str, str | None]]], Found | None]
"""From a chain, ["np", "linalg", "norm"], and local imports, to what it stands for."""


@dataclass
class Plain:
    """A piece of code.

    Attributes:
        text: its plain form.
        origins: (module, name) of the definitions that it refers to.
        scaled: by scale, the plain forms of the numbers that are chosen by it.
        order: the definitions that each reference may mean, one after the other.
        guarded: those that are referred to where an error is answered by something else.
    """

    text: str
    origins: set[tuple[str, str]] = field(default_factory=set)
    scaled: dict[str, list[str]] = field(default_factory=dict)
    order: list[tuple[tuple[str, str], ...]] = field(default_factory=list)
    guarded: set[tuple[str, str]] = field(default_factory=set)


def plain_form(
    nodes: list[ast.AST], package: str, resolve: Resolve, refusals: bool, answered: bool = False
) -> Plain:
    """The plain form of statements.

    Not in it are comments, docstrings, annotations of arguments, results and variables (those of
    a class's own body count: dataclasses read them), imports, and, unless they are asked for, lines
    that only refuse. A name is written as that of the definition it stands for.

    Args:
        nodes: the statements, or parts of a class.
        package: that relative imports start from.
        resolve: finds what names stand for.
        refusals: whether lines that only refuse count.
        answered: whether somebody answers an error of this code by something else: then lines that
            only refuse count, too, but for their words.
    """
    writer = _Writer(package, resolve, refusals, answered and not refusals)
    text = writer.block(nodes, in_class=False) if nodes else ""
    return Plain(text, writer.origins, writer.scaled, writer.order, writer.guarded)


class _Writer:
    def __init__(self, package: str, resolve: Resolve, refusals: bool, answered: bool) -> None:
        self.package, self.resolve, self.refusals = package, resolve, refusals
        self.origins: set[tuple[str, str]] = set()
        self.order: list[tuple[tuple[str, str], ...]] = []
        self.answered, self.inside = answered, answered
        self.guarded: set[tuple[str, str]] = set()
        self.outside: dict[ast.AST, set[str]] = {}
        self.scaled: dict[str, list[str]] = {}
        self.local: set[str] = set()
        self.imports: dict[str, tuple[str, str | None]] = {}

    # Statements

    def block(self, statements: list, in_class: bool) -> str:
        return "[" + "".join(t for s in statements if (t := self.statement(s, in_class))) + "]"

    def statement(self, node: ast.AST, in_class: bool = False) -> str:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return ""  # a docstring, or a text in its place
        if isinstance(node, ast.Import | ast.ImportFrom):
            self.imports |= origins(node, self.package)
            return ""
        if isinstance(node, ast.AnnAssign):
            if in_class:
                kind = f"{ast.unparse(node.target)}: {ast.unparse(node.annotation)}"
                return f"{kind} = {self.write(node.value)};"
            if node.value is None:
                return ""
            node = ast.copy_location(ast.Assign([node.target], node.value), node)
        if self.answered and (said := _said(node)):
            return said  # which error, but not in which words
        if not self.refusals and not self.answered and _refuses(node):
            return ""
        if isinstance(node, ast.ClassDef):
            head = [node.decorator_list, node.bases, node.keywords]
            return f"class {node.name}{self.write(head)}{self.block(node.body, True)};"
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            return self.function(node)
        if _answers(node):
            kept, self.inside = self.inside, True
            text = self.write(node) + ";"
            self.inside = kept
            return text
        counts = self.refusals or self.answered
        if isinstance(node, ast.Try) and not counts and not _handles(node):
            inside = [*node.body, *node.orelse, *node.finalbody]
            return "".join(self.statement(s) for s in inside)
        return self.write(node) + (";" if isinstance(node, ast.stmt) else "")

    def function(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> str:
        outside = self.write(getattr(node, "decorator_list", []))
        defaults = self.write([node.args.defaults, node.args.kw_defaults])
        local, imports = self.local, self.imports
        self.local, self.imports = (local | _bound(node)) - _globals(node), dict(imports)
        body = node.body if isinstance(node.body, list) else [ast.Return(node.body)]
        names = ",".join(_arguments(node.args))
        # Imports first: a function may use them above where they stand, in a function inside it.
        for inner in _imports(node):
            self.imports |= origins(inner, self.package)
            self.local -= set(origins(inner, self.package))
        text = f"{outside}{type(node).__name__} {getattr(node, 'name', '')}({names}){defaults}"
        text += self.block(body, False)
        self.local, self.imports = local, imports
        return text + ";"

    # Anything

    def write(self, node: object) -> str:
        if isinstance(node, list):
            if node and all(isinstance(item, ast.stmt) for item in node):
                return self.block(node, False)
            return "[" + ",".join(self.write(item) for item in node) + "]"
        if not isinstance(node, ast.AST):
            return repr(node)
        if node in self.outside:  # what a comprehension goes over first is none of its own scope
            local, self.local = self.local, self.outside.pop(node)
            text = self.write(node)
            self.local = local
            return text
        if isinstance(node, ast.Name | ast.Attribute) and (text := self.chain(node)):
            return text
        if isinstance(node, ast.Constant):
            return f"{type(node.value).__name__} {node.value!r}"
        if isinstance(node, ast.JoinedStr):
            return f"f({self.write(_merged(node.values))})"
        if isinstance(node, ast.stmt) and isinstance(
            node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.AnnAssign
        ):
            return self.statement(node)
        if isinstance(node, ast.Lambda):
            return self.function(node)
        local = self.local
        if isinstance(node, COMPREHENSIONS):
            self.outside[node.generators[0].iter] = local
            self.local = local.union(*(_stored(g.target) for g in node.generators))
        parts = {
            name: self.write(value)
            for name, value in sorted(ast.iter_fields(node))
            # Absent in older versions of Python, or empty, or not part of what is computed.
            if value not in (None, []) and name not in ("ctx", "kind", "type_comment", "lineno")
        }
        self.local = local
        self.choose(node)
        return f"{type(node).__name__}({','.join(f'{k}={v}' for k, v in parts.items())})"

    def chain(self, node: ast.Name | ast.Attribute) -> str:
        names, inner = [], node
        while isinstance(inner, ast.Attribute):
            names.append(inner.attr)
            inner = inner.value
        if not isinstance(inner, ast.Name) or inner.id in self.local:
            return f"Name {node.id}" if isinstance(node, ast.Name) else ""
        names.append(inner.id)
        names.reverse()
        found = self.resolve(names, self.imports)
        if found is None:
            return ".".join(names)
        self.origins |= set(found.origins)
        self.order.append(found.origins)
        if self.inside:
            self.guarded |= set(found.origins)
        return ".".join([found.name, *names[found.used :]])

    def choose(self, node: ast.AST) -> None:
        """Note the numbers of a scale, in `choose(tiny=..., book=...)` and {"tiny": ...}."""
        if isinstance(node, ast.Call):
            pairs = [(keyword.arg, keyword.value) for keyword in node.keywords]
        elif isinstance(node, ast.Dict):
            keys = [key.value if isinstance(key, ast.Constant) else None for key in node.keys]
            pairs = list(zip(keys, node.values, strict=True))
        else:
            return
        if {"tiny", "book"} <= {name for name, _ in pairs if isinstance(name, str)}:
            for name, value in pairs:
                if name in SCALES:
                    self.scaled.setdefault(name, []).append(self.write(value))


def _merged(values: list[ast.expr]) -> list[ast.expr]:
    """Neighbouring texts of an f-string as one, as some versions of Python part them."""
    merged: list[ast.expr] = []
    for value in values:
        last = merged[-1] if merged else None
        if isinstance(value, ast.Constant) and isinstance(last, ast.Constant):
            merged[-1] = ast.Constant(last.value + value.value)
        elif not (isinstance(value, ast.Constant) and value.value == ""):
            merged.append(value)
    return merged


# Lines that only refuse ---------------------------------------------------------------------------


def _refuses(node: ast.AST) -> bool:
    """Whether all that a statement can do is to raise an error."""
    if isinstance(node, ast.Raise | ast.Assert):
        only = True
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        called = node.value.func
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        only = bool(REFUSES.match(name))
    elif isinstance(node, ast.If | ast.For):
        only = all(_refuses(inner) for inner in [*node.body, *node.orelse])
    elif isinstance(node, ast.Try):
        inside = [*node.body, *node.orelse, *node.finalbody]
        only = all(_refuses(inner) for inner in inside) and not _handles(node)
    else:
        only = False
    return only and not _does_more(node)  # last, as it looks at all that is inside


SIGNALS = {"StopIteration", "StopAsyncIteration", "IndexError", "KeyError", "AttributeError"}
"""Errors by which Python's own protocols say something."""


def _does_more(node: ast.AST) -> bool:
    """Whether a line that refuses gives a name a value besides, or says something by its error."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.NamedExpr | ast.Yield | ast.YieldFrom | ast.Await):
            return True
        if isinstance(inner, ast.Raise) and inner.exc is not None:
            error = inner.exc.func if isinstance(inner.exc, ast.Call) else inner.exc
            name = error.attr if isinstance(error, ast.Attribute) else getattr(error, "id", "")
            if name in SIGNALS:
                return True
    return False


def _answers(node: ast.AST) -> bool:
    """Whether something else is done where an error comes out of a statement."""
    if isinstance(node, ast.With):
        return any("suppress" in ast.unparse(item.context_expr) for item in node.items)
    return isinstance(node, ast.Try) and _handles(node)


def _said(node: ast.AST) -> str:
    """A line that refuses, without its words."""
    if isinstance(node, ast.Raise):
        error = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
        return f"raise {ast.unparse(error) if error else ''};"
    return "refuse;" if isinstance(node, ast.Expr) and _refuses(node) else ""


def _handles(node: ast.Try) -> bool:
    """Whether an error is answered otherwise than by another one."""
    return any(not all(_refuses(inner) for inner in handler.body) for handler in node.handlers)


# Names of a scope ---------------------------------------------------------------------------------


def _arguments(arguments: ast.arguments) -> list[str]:
    """The names of arguments, each with the mark of its kind."""
    names = [a.arg for a in arguments.posonlyargs] + ["/"] * bool(arguments.posonlyargs)
    names += [a.arg for a in arguments.args]
    names += (
        [f"*{arguments.vararg.arg}"] if arguments.vararg else ["*"] * bool(arguments.kwonlyargs)
    )
    names += [a.arg for a in arguments.kwonlyargs]
    return names + ([f"**{arguments.kwarg.arg}"] if arguments.kwarg else [])


# What a function's own text says is looked for once: many closures meet the same functions.


@lru_cache(maxsize=8192)
def _imports(function: ast.AST) -> tuple[ast.Import | ast.ImportFrom, ...]:
    return tuple(n for n in ast.walk(function) if isinstance(n, ast.Import | ast.ImportFrom))


@lru_cache(maxsize=8192)
def _bound(function: ast.AST) -> set[str]:
    """The names that a function gives values itself, its arguments among them."""
    names = {a.strip("*") for a in _arguments(function.args)}  # type: ignore[attr-defined]
    body = function.body if isinstance(function.body, list) else [function.body]  # type: ignore
    return names | {name for statement in body for name in _stored(statement)}


def _stored(node: ast.AST) -> set[str]:
    names: set[str] = set()
    for inner in _inside(node):
        if isinstance(inner, ast.Name) and not isinstance(inner.ctx, ast.Load):
            names.add(inner.id)
        elif isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(inner.name)
        elif isinstance(inner, ast.ExceptHandler) and inner.name:
            names.add(inner.name)
        elif isinstance(inner, ast.MatchAs | ast.MatchStar) and inner.name:
            names.add(inner.name)
    return names


def _inside(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all in it that belongs to the same scope."""
    yield node
    if isinstance(node, COMPREHENSIONS):  # a scope of its own, but for `:=`
        yield from (n.target for n in ast.walk(node) if isinstance(n, ast.NamedExpr))
    elif not isinstance(node, (*SCOPES, ast.ClassDef)):
        for child in ast.iter_child_nodes(node):
            yield from _inside(child)


@lru_cache(maxsize=8192)
def _globals(function: ast.AST) -> set[str]:
    return {n for inner in ast.walk(function) if isinstance(inner, ast.Global) for n in inner.names}
