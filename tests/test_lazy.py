"""Modules that are imported when they are first named."""

import subprocess
import sys

import pytest

import posecore
from posecore.lazy import submodule, submodules

PROGRAM = """
import sys
import posecore
heavy = {"numpy", "torch", "scipy", "matplotlib", "pkgutil"} & set(sys.modules)
assert not heavy, heavy
from pathlib import Path
ours = [name for name in sys.modules if name.startswith("posecore")]
assert set(ours) == {"posecore", "posecore.loaded", "posecore.lazy"}, ours
assert callable(posecore.metrics.add) and callable(posecore.rotations.hat)
assert posecore.nets.resnet.ResNet and posecore.methods.vector_field.voting.vote
assert posecore.cameras is sys.modules["posecore.cameras"]
"""


def test_the_package_alone_loads_nothing_and_offers_everything():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_modules_are_listed():
    assert {"arrays", "metrics", "nets", "methods"} <= set(dir(posecore))
    assert dir(posecore) == submodules("posecore") == sorted(dir(posecore))
    assert not any(name.startswith("_") for name in dir(posecore))
    assert {"resnet", "pointnet2"} <= set(dir(posecore.nets))
    assert {"METHODS", "vector_field", "sources"} <= set(dir(posecore.methods))


@pytest.mark.parametrize("name", ["nothing", "__main__", "__wrapped__"])
def test_what_is_not_there_is_missed_as_anywhere(name):
    with pytest.raises(AttributeError, match=f"module 'posecore' has no attribute '{name}'"):
        getattr(posecore, name)
    with pytest.raises(AttributeError):
        submodule("posecore", name)
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        from posecore import nothing  # noqa: F401
