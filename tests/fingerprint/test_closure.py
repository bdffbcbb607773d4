"""Which definitions a function reaches, found by reading files, and how a change of one is seen."""

# ruff: noqa: E501 - tables of code, a line each

import functools
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from book.tools.dependencies import code_of
from posecore.fingerprint import HOME, changes, closure, digest, of_source

BOMB = "raise SystemExit('this file was run')\n"
FILES = {
    "house/__init__.py": "from house.kitchen import cook\nfrom typing import TYPE_CHECKING\n"
    "if TYPE_CHECKING:\n    from house.attic import box\ndef __getattr__(name): return 1\n",
    "house/kitchen.py": "import math\nfrom house import tools\nfrom house.tools import knife as k\n"
    "SALT = 1\nTABLE = {}\nTABLE['a'] = 5\ndef cook(x):\n    return k(x) + SALT + math.pi\n"
    "def boil(x):\n    return tools.pot.heat(x)\ndef unused(): return 2\n",
    "house/tools/__init__.py": "from .knives import knife\nfrom house.tools import pot\n",
    "house/tools/knives.py": "EDGE: float = 3\ndef knife(x):\n    return x * EDGE\ndef fork(x):\n    return x\n",
    "house/tools/pot.py": "def heat(x):\n    from house.tools.knives import fork as f\n    return f(x)\n",
    "house/attic.py": BOMB + "def box(): return old()\ndef old(): return 1\n",
    "house/rooms.py": "from house.kitchen import *\nclass Room:\n    size: int = 1\n"
    "    def walk(self): return cook(1)\n    def stay(self): return 0\n"
    "class Hall(Room):\n    pass\ndef enter(): return Hall().walk()\n",
    "house/doors.py": "import house\ndef open_box(): return house.box()\ndef cooked(): return house.cook(2)\n",
    "house/circle.py": "from house import ring\ndef a(): return ring.b()\n",
    "house/ring.py": "from house import circle\ndef b(): return circle.a()\n",
    "house/loose.py": "import atexit\nLIST = []\natexit.register(print)\nif len(LIST):\n    A = 1\nelse:\n"
    "    A = 2\nfor i in range(3):\n    B = i\ndef f(): return A\ndef g(): return LIST\n",
    "house/whole.py": "from house.tools import knives\ndef pick(name): return getattr(knives, name)\n",
    "house/bad.py": "def f(:\n",
    "lone.py": "import house.kitchen as kitchen\ndef f(): return kitchen.boil(1)\n",
}  # fmt: skip


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def names(root: str, **options: object) -> set[str]:
    return {name for name, _ in closure(root, packages=("house",), **options).definitions}


@pytest.mark.parametrize(
    ("root", "expected"),
    [
        ("house.kitchen:cook", "cook knife EDGE SALT"),
        ("house.kitchen:boil", "boil heat fork"),
        ("house.kitchen:TABLE", "TABLE"),
        ("house.rooms:Room", "Room Room.walk Room.stay cook knife EDGE SALT"),
        ("house.rooms:enter", "enter Hall Room Room.walk Room.stay cook knife EDGE SALT"),
        ("house.doors:cooked", "cooked cook knife EDGE SALT"),
        ("house.doors:open_box", "open_box box old __getattr__"),
        ("house.circle:a", "a b"),
        ("house.loose:f", "f A LIST <module>"),
        ("house.loose:g", "g LIST <module>"),
        ("house.whole:pick", "pick knife fork EDGE"),
        ("lone:f", "f boil heat fork"),
        ("house.tools", "knife heat fork EDGE"),
    ],
)
def test_the_definitions_that_are_found(house: Path, root: str, expected: str) -> None:
    assert names(root) == set(expected.split())


def test_nothing_is_imported(house: Path) -> None:
    closure("house.doors:open_box", packages=("house",))
    assert not any(name.split(".")[0] == "house" for name in sys.modules)


def edit(house: Path, file: str, old: str, new: str) -> None:
    text = (house / file).read_text()
    assert old in text
    (house / file).write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("file", "old", "new", "changed"),
    [
        ("house/kitchen.py", "SALT = 1", "SALT = 2", ["kitchen.SALT"]),
        ("house/tools/knives.py", "x * EDGE", "x + EDGE", ["knives.knife"]),
        ("house/tools/knives.py", "EDGE: float = 3", "EDGE: int = 3  # sharp", []),
        ("house/kitchen.py", "return 2", "return 3", []),  # unused
        ("house/tools/knives.py", "    return x\n", "    return -x\n", []),  # the fork
        ("house/kitchen.py", "def cook(x):", "def cook(x: int) -> int:\n    'Hot.'", []),
        ("house/kitchen.py", "    return k(x)", "    if x < 0: raise ValueError\n    return k(x)", []),
        ("house/kitchen.py", "import knife as k", "import knife as blade, knife as k", []),
        ("house/tools/__init__.py", "import knife", "import fork as knife", ["cook", "knives", "knife", "EDGE"]),
    ],
)  # fmt: skip
def test_a_change_is_seen_where_it_matters(
    house: Path, file: str, old: str, new: str, changed: list[str]
) -> None:
    before = closure("house.kitchen:cook", packages=("house",))
    edit(house, file, old, new)
    after = closure("house.kitchen:cook", packages=("house",))
    if file.endswith("__init__.py"):  # another function under the same name
        found = changes(before.text, after)
        assert "knives.fork" in found and "kitchen.cook" in found and "EDGE" in found
    else:
        assert changes(before.text, after) == changed
        assert (digest(before) == digest(after)) == (not changed)


def test_a_plain_move_changes_nothing(house: Path) -> None:
    before = closure("house.kitchen:cook", packages=("house",))
    (house / "house/tools/steel.py").write_text((house / "house/tools/knives.py").read_text())
    (house / "house/tools/knives.py").unlink()
    edit(house, "house/tools/__init__.py", "from .knives", "from house.tools.steel")
    edit(
        house, "house/kitchen.py", "from house.tools import knife as k", "import house.tools.steel"
    )
    edit(house, "house/kitchen.py", "return k(x)", "return house.tools.steel.knife(x)")
    after = closure("house.kitchen:cook", packages=("house",))
    assert changes(before.text, after) == [] and before.text == after.text


def test_what_is_gone_and_what_is_new_have_names(house: Path) -> None:
    before = closure("house.kitchen:cook", packages=("house",))
    edit(house, "house/kitchen.py", "+ SALT", "+ PEPPER")
    edit(house, "house/kitchen.py", "SALT = 1", "PEPPER = 1")
    after = closure("house.kitchen:cook", packages=("house",))
    assert changes(before.text, after) == ["SALT", "kitchen.PEPPER", "kitchen.cook"]


def test_two_definitions_of_one_name_are_two(house: Path) -> None:
    (house / "house/more.py").write_text(
        "from house.tools.knives import knife as other\ndef knife(x): return other(x)\n"
    )
    found = closure("house.more:knife", packages=("house",))
    assert [name for name, _ in found.definitions].count("knife") == 2
    edit(house, "house/tools/knives.py", "x * EDGE", "x / EDGE")
    assert changes(found.text, closure("house.more:knife", packages=("house",))) == ["knives.knife"]


def test_methods_are_named(house: Path) -> None:
    before = closure("house.rooms:enter", packages=("house",))
    edit(house, "house/rooms.py", "return 0", "return 1")
    edit(house, "house/rooms.py", "size: int = 1", "size: int = 2")
    after = closure("house.rooms:enter", packages=("house",))
    assert changes(before.text, after) == ["rooms.Room", "rooms.Room.stay"]


def test_modules_that_do_not_count(house: Path) -> None:
    assert names("house.kitchen:cook", without=("house.tools",)) == {"cook", "SALT"}
    assert names("house.kitchen:cook", without=("house.to",)) == names("house.kitchen:cook")
    assert names("house.kitchen:cook", without=("house.tools.knives",)) == {"cook", "SALT"}


def test_sources_in_place_of_files(house: Path) -> None:
    text = FILES["house/kitchen.py"].replace("SALT = 1", "SALT = 9").encode()
    found = closure("house.kitchen:cook", packages=("house",), sources={"house.kitchen": text})
    kept = closure("house.kitchen:cook", packages=("house",))
    assert changes(kept.text, found) == ["kitchen.SALT"]


def test_numbers_chosen_by_scale(house: Path) -> None:
    (house / "house/sizes.py").write_text(
        "def choose(**x): return x\ndef n(): return choose(tiny=1, book=2, paper=3)\n"
        "def other(): return choose(tiny=1, book=9)\n"
    )
    before = closure("house.sizes:n", packages=("house",))
    edit(house, "house/sizes.py", "tiny=1, book=2", "tiny=7, book=2")
    same = closure("house.sizes:n", packages=("house",))
    edit(house, "house/sizes.py", "book=2", "book=3")
    other = closure("house.sizes:n", packages=("house",))
    assert before.numbers("book") == same.numbers("book") != other.numbers("book")
    assert before.numbers("tiny") != same.numbers("tiny")
    assert before.text != same.text


def test_the_source_of_a_page(house: Path) -> None:
    page = "from house import kitchen as k\nimport numpy\n\nx = k.cook(numpy.ones(3))\n"
    found = of_source(page, ("house",))
    assert {name for name, _ in found.definitions} == {"cook", "knife", "EDGE", "SALT"}
    later = "x = 1\nfrom house.kitchen import boil\nboil(x)\ndef f():\n    return boil(2)\n"
    assert {n for n, _ in of_source(later, ("house",)).definitions} == {"boil", "heat", "fork"}
    assert of_source("x = 1", ("house",)).text == ""
    with pytest.raises(ValueError, match="source: expected Python"):
        of_source("x = = 1")


def add(a: int, b: int) -> int:
    return a + b


def test_functions_are_seen_through() -> None:
    wrapped = functools.lru_cache(functools.wraps(add)(lambda a, b: add(a, b)))
    for function in (add, functools.partial(functools.partial(add, 1), 2), wrapped):
        assert ("add", closure(add).places[(__name__, "add")]["add"]) in closure(
            function
        ).definitions


def test_the_library_itself() -> None:
    from posecore.metrics import add as distance

    modules = {module for module, _ in closure(distance).places}
    assert {"posecore.metrics.model_errors", "posecore.poses", "posecore.arrays"} <= modules
    assert not any(module.startswith(("data_tools", "book")) for module in modules)


@pytest.mark.slow
def test_every_process_finds_the_same(tmp_path: Path) -> None:
    """Whatever order its sets have, and in whatever folder, where another `book` may lie."""
    decoy = tmp_path / "book" / "tools"
    decoy.mkdir(parents=True)
    (decoy / "keys.py").write_text("def Key(): return 'a decoy'\n")
    (decoy.parent / "__init__.py").write_text("")
    function, data = "book.ch08_vector_fields.comparison:compare_systems", ("tabletop/easy",)
    program = (
        "import sys; from posecore.fingerprint import closure;"
        "print(closure('book.tools.keys:Key').text); sys.path.remove('');"
        "from book.tools.dependencies import code_of;"
        f"c = code_of({function!r}, {data}); print(c.text); print(c.numbers('book'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": str(HOME)},  # here: any other
        capture_output=True,
        text=True,
        check=True,
    )
    code = code_of(function, data)
    answer = [closure("book.tools.keys:Key").text, code.text, code.numbers("book")]
    assert done.stdout.splitlines() == answer


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: closure("house.nothing"), "roots: expected a module with a file"),
        (lambda: closure("no_such_house:f"), "roots: expected a module with a file"),
        (lambda: closure("house.kitchen:nothing"), "roots: expected a module with a file"),
        (lambda: closure("house.bad"), "bad.py: no Python"),
        (lambda: closure(len), "roots: expected a function from a module"),
        (lambda: closure(7), "roots: expected a function from a module"),
        (lambda: closure(eval("lambda: 1", {"__name__": "__main__"})), "roots: expected a function"),
    ],
)  # fmt: skip
def test_what_is_refused(house: Path, call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
