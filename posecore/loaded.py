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
        if name.partition(".")[0] in PACKAGES:
            spec = PathFinder.find_spec(name, path)
            if spec is not None and (spec.origin or "").endswith(".py"):
                file = Path(spec.origin or "")
                SOURCES[name] = file, file.read_bytes()
        return None


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
