import importlib
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.storage import code_version, versions

FILES = ("__init__.py", "meshes.py", "deep/__init__.py", "deep/noise.py")


@pytest.fixture
def package(tmp_path, monkeypatch):
    for name in FILES:
        (tmp_path / "made_up_package" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "made_up_package" / name).write_bytes(b"x = 1\n")
    (tmp_path / "made_up_module.py").write_bytes(b"y = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "made_up_package"


@pytest.mark.parametrize("name", FILES)
def test_every_file_of_a_package_counts(package, name):
    before = code_version("made_up_package")
    assert code_version("made_up_package") == before
    (package / name).write_bytes(b"x = 2\n")
    after = code_version("made_up_package")
    assert after != before
    (package / name).write_bytes(b"x = 2\r\n")
    assert code_version("made_up_package") == after, "line ends do not count"


def test_names_count_and_their_order_does_not(package):
    both = code_version("made_up_package", "made_up_module")
    assert both == code_version("made_up_module", "made_up_package", "made_up_module")
    assert both != code_version("made_up_package")
    (package / "deep" / "noise.py").rename(package / "deep" / "sounds.py")
    assert both != code_version("made_up_package", "made_up_module")
    assert len(both) == 16


def test_code_that_is_no_longer_what_was_loaded(package, monkeypatch):
    """What it makes must not be taken for what the new source makes."""
    monkeypatch.setattr(versions, "_LOADED", {})
    importlib.import_module("made_up_package.meshes")
    before = code_version("made_up_package", "made_up_module")
    (package.parent / "made_up_module.py").write_bytes(b"y = 2\n")
    after = code_version("made_up_package", "made_up_module")
    assert after != before, "what is not loaded may change"
    (package / "meshes.py").write_bytes(b"x = 2\n")
    for names in (["made_up_package"], ["made_up_module", "made_up_package"]):
        with pytest.raises(RuntimeError, match="made_up_package: its source has changed"):
            code_version(*names)
    (package / "meshes.py").write_bytes(b"x = 1\n")
    assert code_version("made_up_package", "made_up_module") == after
    for name in ("made_up_package", "made_up_package.meshes"):
        monkeypatch.delitem(sys.modules, name)


def test_other_files_do_not_count(package):
    before = code_version("made_up_package.meshes")
    (package / "deep" / "noise.py").write_bytes(b"x = 2\n")
    (package / "meshes.txt").write_bytes(b"x = 2\n")
    assert code_version("made_up_package.meshes") == before


@given(
    modules=st.lists(
        st.sampled_from(["posecore.poses", "data_tools.storage", "posecore.arrays"]), min_size=1
    )
)
def test_any_order_of_any_modules(modules):
    assert code_version(*modules) == code_version(*reversed(modules), *modules)


@pytest.mark.parametrize(
    "bad", ["no_such_module", "posecore.no", "", "..", "sys", "math", "a/b", 7]
)
def test_what_is_no_module_is_refused(bad):
    with pytest.raises(ValueError, match="modules: expected names of modules"):
        code_version("posecore.poses", bad)


def test_nothing_is_no_version():
    with pytest.raises(ValueError, match="modules: expected at least one"):
        code_version()
