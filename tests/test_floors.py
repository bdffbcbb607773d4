"""Who may import whom: a storey, and in `posecore` a floor, from what is under it; no circles."""

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("posecore", "data_tools", "book")

FLOORS = {
    "arrays": 0, "rotations": 0, "scale": 0, "files": 0, "weights": 0, "fingerprint": 0,
    "loaded": 0, "command_line": 0, "randomness": 0, "lazy": 0,
    "poses": 1, "cameras": 1, "clouds": 1, "symmetry": 1, "distortion": 1, "opengl": 1,
    "splat": 1,
    "metrics": 2, "registration": 2, "models": 2,
    "nets": 3,
    "training": 4, "figures": 4, "refinement": 4,
}  # fmt: skip
"""The rooms of `posecore` below its methods; some of them are still to come."""
METHODS = ("methods", "__main__")
FOR_DATA_TOOLS = {room for room, floor in FLOORS.items() if floor <= 2} | {"figures"}

BELOW = {
    "posecore": ("posecore",),
    "data_tools": ("posecore", "data_tools"),
    "posecore.methods": ("posecore", "data_tools", "posecore.methods"),
    "book": ("posecore", "data_tools", "posecore.methods", "book"),
}
"""The storeys, and which of them each may import."""


def module_name(path: Path) -> str:
    """`posecore.arrays` for `posecore/arrays.py`; of a package its name."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {
    module_name(path): path.read_text(encoding="utf-8")
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if "my_work" not in path.parts  # a student's own
}
# Pages and exercises have names with digits first: nobody can import them.
MODULES = {
    name: text for name, text in SOURCES.items() if all(map(str.isidentifier, name.split(".")))
}


def storey(module: str) -> str:
    """The storey of a module."""
    package, room = [*module.split("."), ""][:2]
    return "posecore.methods" if package == "posecore" and room in METHODS else package


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """What import statements name, by full names: modules, and what is taken out of modules."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def offences(module: str, source: str) -> list[str]:
    """The imports of a module that the rule forbids, wherever in it they stand."""
    own, found = storey(module), []
    for name in sorted(set(imported(ast.walk(ast.parse(source))))):
        package, room = [*name.split("."), ""][:2]
        other = storey(name)
        if package not in PACKAGES:
            continue
        if other not in BELOW[own]:
            found.append(f"{module} imports {name} of a storey above")
        elif own == "data_tools" and other == "posecore" and room not in FOR_DATA_TOOLS:
            found.append(f"{module} imports {name}, which is not for data_tools")
        elif own == other == "posecore" and floor(name) > floor(module):
            found.append(f"{module} imports {name} of a floor above")
        elif module.startswith("book.tools") and re.match(r"book\.ch\d", name):
            found.append(f"{module} imports {name}, a chapter")
    return found


def floor(module: str) -> int:
    """The floor of a module of `posecore`, or of what is taken out of one."""
    if module == "posecore":
        return 0  # the package itself, which holds nothing
    room = module.split(".")[1]
    assert room in FLOORS, f"{module}: a new room, which has to be entered in FLOORS"
    return FLOORS[room]


def test_imports_go_down():
    assert [one for module in sorted(SOURCES) for one in offences(module, SOURCES[module])] == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("posecore.arrays", "from posecore import cameras"),
        ("posecore.arrays", "import posecore.cameras"),
        ("posecore.rotations.so3", "from posecore.poses import apply"),
        ("posecore.metrics.boxes", "from posecore.nets.resnet import ResNet"),
        ("posecore.nets.resnet", "from posecore import training"),
        ("posecore", "from posecore.arrays import fail, to_numbers\nfrom posecore import nets"),
        ("posecore.training.feed", "from data_tools.batches import Batches"),
        ("posecore.training.feed", "import data_tools"),
        ("posecore.figures.images", "from book.tools import site"),
        ("posecore.nets.resnet", "from posecore.methods import METHODS"),
        ("posecore.nets.resnet", "from posecore.__main__ import main"),
        ("data_tools.views", "from posecore.nets.resnet import ResNet"),
        ("data_tools.views", "import posecore.training"),
        ("data_tools.views", "from posecore.methods.sources import open_source"),
        ("data_tools.__main__", "import book"),
        ("posecore.methods.main", "from book.tools import claims"),
        ("posecore.__main__", "import book.ch01_poses_and_cameras"),
        ("book.tools.measuring", "from book.ch01_poses_and_cameras import checks"),
        ("book.tools.measuring", "import book.ch01_poses_and_cameras.checks"),
        ("book.tools", "from book import ch01_poses_and_cameras"),
    ],
)
@pytest.mark.parametrize(
    "place",
    [
        "{}",
        "def function():\n    {}",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    {}",
        "class Some:\n    def method(self):\n        with self:\n            {}",
    ],
)
def test_the_rule_sees_what_is_planted(module, line, place):
    indent = re.search(r" *(?=\{)", place).group()
    source = place.format(line.replace("\n", "\n" + indent))
    (found,) = offences(module, source)
    assert found.startswith(f"{module} imports ")


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("posecore.metrics.boxes", "from posecore import cameras, poses"),
        ("posecore.metrics.boxes", "from posecore.registration import icp"),
        ("posecore.arrays", "import numpy.linalg, booklet"),
        ("data_tools.__main__", "from posecore.figures import style"),
        ("posecore.methods.main", "from data_tools.views import Dataset"),
        ("posecore.__main__", "from posecore.methods.main import main"),
        ("book.ch08_vector_fields.checks", "from posecore.methods.vector_field import voting"),
        ("book.ch08_vector_fields.checks", "from book.tools import checks"),
        ("book.tools.site", "from book.tools.contents import chapters"),
    ],
)
def test_the_rule_allows_what_goes_down(module, line):
    assert offences(module, line) == []


def test_the_projector_needs_nothing_but_arrays():
    """So that it can be taken out and used alone."""
    rooms = {
        name.split(".")[1]
        for module in MODULES
        if module.startswith("posecore.splat")
        for name in imported(ast.walk(ast.parse(SOURCES[module])))
        if name.startswith("posecore.")
    }
    assert rooms == {"splat", "arrays"}


def test_every_room_has_a_floor():
    for module in SOURCES:
        if storey(module) == "posecore":
            assert floor(module) >= 0


def test_a_new_room_has_to_be_entered():
    with pytest.raises(AssertionError, match="cellar: a new room"):
        offences("posecore.arrays", "from posecore import cellar")
    with pytest.raises(AssertionError, match="a relative import"):
        offences("posecore.arrays", "from .files import write_bytes")


# Circles ------------------------------------------------------------------------------------------


def outside_functions(node: ast.AST) -> Iterator[ast.AST]:
    """The parts of a module without the bodies of functions, where an import may come late."""
    yield node
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        for child in ast.iter_child_nodes(node):
            yield from outside_functions(child)


def needs(module: str, sources: Mapping[str, str]) -> set[str]:
    """The modules that a module imports, for its annotations too (`if TYPE_CHECKING`).

    Not the packages that hold them: a package may offer what its own modules have.
    """
    found = set()
    for name in imported(outside_functions(ast.parse(sources[module]))):
        while name not in sources and "." in name:  # what is taken out of a module is none
            name = name.rpartition(".")[0]
        found |= {name} & sources.keys()
    return found


def circle(sources: Mapping[str, str]) -> list[str] | None:
    """Modules of which each imports the next, and the last one the first; None for none."""
    done: set[str] = set()

    def look(module: str, way: list[str]) -> list[str] | None:
        if module in way:
            return way[way.index(module) :]
        if module in done:
            return None
        for other in sorted(needs(module, sources)):
            if found := look(other, [*way, module]):
                return found
        done.add(module)
        return None

    return next((found for module in sorted(sources) if (found := look(module, []))), None)


def test_no_modules_import_each_other():
    assert circle(MODULES) is None


HARMLESS = {
    "a": "from a.one import x",  # a package that offers what its modules have
    "a.one": "import a.two\nfrom a.two import y\nfrom a import three",
    "a.two": "import numpy\ndef later():\n    from a.one import x",
    "a.three": "class Some:\n    def method(self):\n        import a.two",
}


@pytest.mark.parametrize(
    ("planted", "expected"),
    [
        ({}, None),
        ({"a.two": "from a.one import x"}, ["a.one", "a.two"]),
        ({"a.two": "from a import one"}, ["a.one", "a.two"]),
        ({"a.two": "import a.one as first"}, ["a.one", "a.two"]),
        ({"a.two": "from a import x"}, ["a", "a.one", "a.two"]),
        ({"a.two": "import a.two"}, ["a.two"]),
        ({"a.two": "if TYPE_CHECKING:\n    from a.one import x"}, ["a.one", "a.two"]),
        ({"a.three": "try:\n    from a.one import x\nfinally:\n    pass"}, ["a.one", "a.three"]),
        ({"a.three": "class Some:\n    from a.one import x"}, ["a.one", "a.three"]),
        ({"b": "import c", "c": "import d", "d": "import b"}, ["b", "c", "d"]),
    ],
)  # fmt: skip
def test_circles_are_seen(planted, expected):
    assert circle(HARMLESS | planted) == expected
