"""The sources of this project's modules as they were when this process loaded them.

What runs is what was loaded; a fingerprint reads files. Where the two differ, a result must not be
taken for one of today's files. Imported before all else, by each package of the project.
"""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

__all__ = ["edited"]

PACKAGES = ("posecore", "data_tools", "book")
SOURCES: dict[str, tuple[Path, bytes]] = {}


class _Noting:
    """Finds no module, but notes the source of those that are about to be loaded."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        top = name.partition(".")[0]
        if top in PACKAGES:
            spec = PathFinder.find_spec(name, path)
            _note(name, None if spec is None else spec.origin)
            if top in sys.modules and top not in SOURCES:  # loaded before, or by another finder
                _note(top, sys.modules[top].__file__)
        return None


def _note(name: str, file: str | None) -> None:
    if file is not None and file.endswith(".py"):
        SOURCES[name] = Path(file), Path(file).read_bytes()


def edited() -> dict[str, bytes]:
    """By the name of a module, the source that was loaded and is no longer in its file."""
    found = {}
    for name, (path, data) in SOURCES.items():
        try:
            same = path.read_bytes() == data
        except OSError:  # it is gone
            same = False
        if not same:
            found[name] = data
    return found


if not any(finder is _Noting for finder in sys.meta_path):
    sys.meta_path.insert(0, _Noting)  # type: ignore[arg-type]
