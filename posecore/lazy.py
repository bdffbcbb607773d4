"""Packages whose modules are imported when they are first named, as `posecore.metrics`.

`import posecore` so costs nothing, and `posecore.metrics.add` works after it (PEP 562).
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

__all__ = ["submodule", "submodules"]


def submodule(package: str, name: str) -> ModuleType:
    """A module of a package, for the package's `__getattr__`.

    Args:
        package: its full name.
        name: of the module, without the package.

    Raises:
        AttributeError: if the package has no such module, as of any other missing attribute.
    """
    if name not in submodules(package):
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    return importlib.import_module(f"{package}.{name}")


def submodules(package: str) -> list[str]:
    """The names of the modules in a package, in alphabetical order; not those for itself alone."""
    import pkgutil  # what nobody asks costs nothing

    found = pkgutil.iter_modules(sys.modules[package].__path__)
    return sorted(info.name for info in found if not info.name.startswith("_"))
