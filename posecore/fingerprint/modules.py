"""Modules as files: what each defines at its top level, and what it imports from where."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.machinery import ModuleSpec
from pathlib import Path

__all__ = ["HOME", "PACKAGES", "Module", "find_module", "origins"]

PACKAGES = ("posecore", "data_tools", "book")
"""The packages of this project; what others change, a pinned environment keeps still."""
HOME = Path(__file__).resolve().parents[2]
"""The folder they stand in. A notebook's kernel runs elsewhere, and may find another `book`."""

NEVER = {"TYPE_CHECKING", "typing.TYPE_CHECKING", "__name__ == '__main__'"}
"""Conditions that are false where a module is imported."""
Origin = tuple[str, str | None]
"""Where a name comes from: a module, and a name in it; None for the module itself."""


@dataclass(eq=False)
class Module:
    """A module's file, taken apart.

    Attributes:
        name: such as "posecore.metrics.add".
        path: of the file.
        definitions: by name, the statements at the top level that give it its value.
        imports: by name, where it comes from.
        doors: the same of imports under `if TYPE_CHECKING`, which a `__getattr__` makes true.
        others: by name, where else it may come from, under another condition.
        stars: modules of which everything is imported.
        whole: modules that are imported as such.
        loose: statements that give no name a value, such as a call.
        forms: what walks have read in it, and in which modules they looked meanwhile, for the next.
    """

    name: str
    path: Path
    definitions: dict[str, list[ast.stmt]] = field(default_factory=dict)
    imports: dict[str, Origin] = field(default_factory=dict)
    doors: dict[str, Origin] = field(default_factory=dict)
    stars: list[str] = field(default_factory=list)
    others: dict[str, list[Origin]] = field(default_factory=dict)
    whole: list[str] = field(default_factory=list)
    loose: list[ast.stmt] = field(default_factory=list)
    forms: dict[tuple, tuple[dict[str, Module | None], list]] = field(default_factory=dict)

    @property
    def package(self) -> str:
        """What its relative imports start from."""
        return self.name if self.path.stem == "__init__" else self.name.rpartition(".")[0]


def find_module(name: str, sources: Mapping[str, bytes] | None = None) -> Module | None:
    """The module of this name, or None where there is no file of Python.

    Args:
        name: such as "posecore.metrics".
        sources: by name, what counts in place of a file's content.

    Raises:
        ValueError: if it is no Python.
    """
    path, data = _find_file(name), (sources or {}).get(name)
    if data is not None:  # also where the file is gone
        return _parsed(name, path or Path(f"{name.rpartition('.')[2]}.py"), data)
    return None if path is None else _parsed(name, path, path.read_bytes())


@lru_cache(maxsize=1024)
def _parsed(name: str, path: Path, data: bytes) -> Module:
    try:
        tree = ast.parse(data)
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"{path}: no Python: {error}") from error
    module = Module(name, path)
    for statement in tree.body:
        _enter(module, statement)
    return module


def _find_file(name: str) -> Path | None:
    top, *rest = name.split(".")
    for root in _roots(top):
        place = root.joinpath(*rest)
        for path in (place / "__init__.py", place.with_suffix(".py") if rest else None):
            if path is not None and path.is_file():
                return path
    if not rest:  # a single module, as a script's neighbour
        spec = _spec(top)
        if spec is not None and spec.origin and spec.origin.endswith(".py"):
            return Path(spec.origin)
    return None


def _roots(top: str) -> list[Path]:
    """The folders of a package; of this project's own only the one beside this file."""
    if top in PACKAGES and (HOME / top).is_dir():
        return [HOME / top]
    spec = _spec(top)
    return [Path(p) for p in (spec.submodule_search_locations or [])] if spec is not None else []


def _spec(top: str) -> ModuleSpec | None:
    if top == "__main__":  # a script or a notebook, which has no file of its own to read again
        return None
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):  # a module put together by hand
        return None


# Statements at the top level ----------------------------------------------------------------------


def _enter(module: Module, statement: ast.stmt) -> None:
    if isinstance(statement, ast.Import | ast.ImportFrom):
        _enter_import(module, statement, module.imports)
    elif isinstance(statement, ast.If) and ast.unparse(statement.test) in NEVER:
        for inner in ast.walk(ast.Module(statement.body, [])):
            if isinstance(inner, ast.Import | ast.ImportFrom):
                _enter_import(module, inner, module.doors)
        for inner in statement.orelse:
            _enter(module, inner)
    elif not _says_nothing(statement):
        # Also inside `if`, `try`, `for` and `with`, which then belong to every name they define.
        for inner in ast.walk(statement):
            if isinstance(inner, ast.Import | ast.ImportFrom) and not isinstance(
                statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
            ):
                _enter_import(module, inner, module.imports)
        names = _defined(statement) - {"__all__"}
        parts = {n for n in names & module.imports.keys() if not _binds(statement, n)}
        for name in names - parts:
            module.definitions.setdefault(name, []).append(statement)
        # Also what acts on something besides: a loop that fills a table, a draw from a generator.
        if (not names and not _assigns_all(statement)) or _acts(module, statement, names):
            module.loose.append(statement)


def _enter_import(
    module: Module, statement: ast.Import | ast.ImportFrom, imports: dict[str, Origin]
) -> None:
    if isinstance(statement, ast.Import):
        module.whole += [alias.name for alias in statement.names]
    for name, origin in origins(statement, module.package).items():
        if imports.get(name, origin) != origin:  # under another condition, perhaps
            module.others.setdefault(name, []).append(imports[name])
        imports[name] = origin
    if isinstance(statement, ast.ImportFrom) and statement.names[0].name == "*":
        module.stars.append(imports.pop("*")[0])


def origins(statement: ast.Import | ast.ImportFrom, package: str) -> dict[str, Origin]:
    """What the names that an import gives stand for.

    Args:
        statement: the import.
        package: that a relative one starts from.
    """
    if isinstance(statement, ast.Import):
        return {
            alias.asname or alias.name.partition(".")[0]: (
                alias.name if alias.asname else alias.name.partition(".")[0],
                None,
            )
            for alias in statement.names
        }
    above = package.split(".")[: len(package.split(".")) + 1 - statement.level]
    base = ".".join([*(above if statement.level else []), *filter(None, [statement.module])])
    return {alias.asname or alias.name: (base, alias.name) for alias in statement.names}


def _binds(statement: ast.stmt, name: str) -> bool:
    """Whether a statement gives the name itself a value, and not a part of it."""
    return any(
        (isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and n.name == name)
        or (
            isinstance(n, ast.Name)
            and isinstance(n.ctx, ast.Store)
            and n.id == name
            and not (isinstance(statement, ast.AugAssign) and n is statement.target)
        )
        for n in ast.walk(statement)
    )


def _acts(module: Module, statement: ast.stmt, names: set[str]) -> bool:
    """Whether a statement does something besides giving names values: order counts then."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return False
    if any(name in module.imports and not _binds(statement, name) for name in names):
        return True  # a part of what is imported is changed
    if any(isinstance(n, ast.Expr | ast.NamedExpr | ast.With) for n in ast.walk(statement)):
        return True
    bases: set[str] = set()
    for call in (node for node in ast.walk(statement) if isinstance(node, ast.Call)):
        if isinstance(call.func, ast.Attribute):
            bases |= _bases(call.func)
        elif getattr(call.func, "id", "") == "next":
            bases |= {one.id for one in call.args if isinstance(one, ast.Name)}
    kinds = ast.FunctionDef | ast.ClassDef
    values = bases & module.definitions.keys() - names
    return any(not isinstance(module.definitions[name][0], kinds) for name in values)


def _says_nothing(statement: ast.stmt) -> bool:
    is_text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    return is_text or isinstance(statement, ast.Pass | ast.Raise | ast.Assert)


def _assigns_all(statement: ast.stmt) -> bool:
    return _defined(statement) == {"__all__"} or (
        isinstance(statement, ast.AnnAssign) and statement.value is None
    )


def _defined(statement: ast.stmt) -> set[str]:
    """Names to which a statement at the top level gives a value, or changes it."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.Assign):
        return {name for target in statement.targets for name in _bases(target)}
    if isinstance(statement, ast.AnnAssign | ast.AugAssign):
        return _bases(statement.target) if statement.value is not None else set()
    found: set[str] = set()
    for _, value in ast.iter_fields(statement):
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, ast.stmt | ast.excepthandler | ast.match_case):
                found |= _defined(inner)  # type: ignore[arg-type]
    if isinstance(statement, ast.For | ast.AsyncFor):
        found |= _bases(statement.target)
    return found


def _bases(target: ast.expr) -> set[str]:
    """The names that an assignment changes: `x`, of `x[0]` and `x.y` also x."""
    if isinstance(target, ast.Name):
        return {target.id}
    if isinstance(target, ast.Tuple | ast.List):
        return {name for element in target.elts for name in _bases(element)}
    if isinstance(target, ast.Subscript | ast.Attribute | ast.Starred):
        return _bases(target.value)
    return set()
