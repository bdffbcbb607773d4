import importlib
import re
import sys

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from data_tools.storage import code_version
from posecore import loaded

FILES = ("__init__.py", "meshes.py", "deep/__init__.py", "deep/noise.py")
MESHES = '''"""Meshes."""

from made_up_package.deep.noise import noise

SIDES = 4


def mesh():
    """One."""
    return noise() * SIDES


def another():
    return 1
'''


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of four files, and a module beside it."""
    for name in FILES:
        path = tmp_path / "made_up_package" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"{path.parent.name}_{path.stem} = 1\n")
    (tmp_path / "made_up_package" / "meshes.py").write_text(MESHES)
    (tmp_path / "made_up_package" / "deep" / "noise.py").write_text("def noise():\n    return 3\n")
    (tmp_path / "made_up_module.py").write_text("y = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(loaded, "PACKAGES", ("made_up_package", "made_up_module"))
    monkeypatch.setattr(loaded, "SOURCES", {})
    yield tmp_path / "made_up_package"
    for name in [name for name in sys.modules if name.startswith("made_up")]:
        del sys.modules[name]


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", FILES)
def test_every_module_of_a_package_counts(package, name):
    before = code_version("made_up_package")
    assert code_version("made_up_package") == before
    (package / name).write_bytes((package / name).read_bytes() + b"added = 2\n")
    after = code_version("made_up_package")
    assert after != before
    (package / name).write_bytes((package / name).read_bytes().replace(b"\n", b"\r\n"))
    assert code_version("made_up_package") == after, "line ends do not count"


def test_names_count_and_their_order_does_not(package):
    both = code_version("made_up_package", "made_up_module")
    assert both == code_version("made_up_module", "made_up_package", "made_up_module")
    assert both != code_version("made_up_package")
    assert re.fullmatch("[0-9a-f]{16}", both)


def test_where_a_definition_stands_does_not_count(package):
    before = code_version("made_up_package.meshes:mesh")
    (package / "deep" / "noise.py").rename(package / "deep" / "sounds.py")
    edit(package / "meshes.py", "deep.noise", "deep.sounds")
    assert code_version("made_up_package.meshes:mesh") == before


@pytest.mark.parametrize(
    ("name", "old", "new", "counts"),
    [
        ("meshes.py", "SIDES = 4", "SIDES = 5", True),
        ("meshes.py", "noise() * SIDES", "SIDES", True),
        ("deep/noise.py", "return 3", "return 4", True),
        ("meshes.py", "    return 1", "    return 2", False),  # another function
        ("meshes.py", '"""One."""', '"""A mesh."""', False),
        ("meshes.py", "SIDES = 4", "SIDES = 4  # as many as a table has", False),
        ("meshes.py", "def mesh():", "def mesh() -> int:", False),
        ("meshes.py", '"""One."""', 'if SIDES < 0:\n        raise ValueError("few")', False),
        ("deep/__init__.py", "= 1", "= 2", False),
    ],
)
def test_what_a_function_computes_counts_and_nothing_else(package, name, old, new, counts):
    before = code_version("made_up_package.meshes:mesh")
    edit(package / name, old, new)
    assert (code_version("made_up_package.meshes:mesh") != before) == counts


def test_a_function_and_its_name_are_one(package):
    meshes = importlib.import_module("made_up_package.meshes")
    assert code_version(meshes.mesh) == code_version("made_up_package.meshes:mesh")
    assert code_version(meshes.mesh) != code_version(meshes.another)


def test_code_that_is_no_longer_what_was_loaded(package):
    """What it makes must not be taken for what the new source makes."""
    importlib.import_module("made_up_package.meshes")
    before = code_version("made_up_package", "made_up_module")
    edit(package.parent / "made_up_module.py", "y = 1", "y = 2")
    after = code_version("made_up_package", "made_up_module")
    assert after != before, "what is not loaded may change"
    edit(package / "meshes.py", "SIDES = 4", "SIDES = 5")
    for roots in (["made_up_package"], ["made_up_package.meshes:mesh", "made_up_module"]):
        with pytest.raises(RuntimeError, match="^SIDES: the source has changed; start Python or"):
            code_version(*roots)
    assert code_version("made_up_package.meshes:another"), "what is not reached may change"
    edit(package / "meshes.py", "SIDES = 5", "SIDES = 4  # again")
    assert code_version("made_up_package", "made_up_module") == after
    (package / "deep" / "noise.py").unlink()
    with pytest.raises(RuntimeError, match="the source has changed"):
        code_version("made_up_package.meshes:mesh")


def test_what_was_loaded_first_is_remembered(package):
    importlib.import_module("made_up_package.meshes")
    edit(package / "meshes.py", "SIDES = 4", "SIDES = 5")
    importlib.import_module("made_up_module")  # what is loaded later changes nothing
    with pytest.raises(RuntimeError, match="SIDES"):
        code_version("made_up_package.meshes:mesh")


def test_other_files_do_not_count(package):
    before = code_version("made_up_package.meshes")
    (package / "deep" / "sounds.py").write_bytes(b"x = 2\n")
    (package / "meshes.txt").write_bytes(b"x = 2\n")
    assert code_version("made_up_package.meshes") == before


MODULES = ["posecore.poses", "data_tools.storage", "posecore.arrays"]


@hypothesis_settings(max_examples=8)  # each looks at all that they reach
@given(modules=st.lists(st.sampled_from(MODULES), min_size=1, max_size=4))
def test_any_order_of_any_modules(modules):
    assert code_version(*modules) == code_version(*reversed(modules), *modules)


@pytest.mark.parametrize(
    "bad",
    [*("no_such_module", "posecore.no", "", "..", "sys", "math", "a/b"), "posecore.poses:none", 7]
    + [len, None],
)
def test_what_is_no_definition_is_refused(bad):
    with pytest.raises(ValueError, match="roots: expected a "):
        code_version("posecore.poses", bad)


def test_nothing_is_no_version():
    with pytest.raises(ValueError, match="roots: expected at least one"):
        code_version()
