"""The version of the code that makes a world."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from posecore.arrays import fail
from posecore.files import hash_files

__all__ = ["code_version"]

_LOADED: dict[str, str] = {}  # hashes of loaded modules, as they were when first asked for


def code_version(*modules: str) -> str:
    """A hash of the source of modules, to be the version of the worlds that they make.

    A comment changes it too: a world made once too often costs minutes, an old one taken for new
    costs the trust in every number. Line ends do not count, as Git may change them. What the
    modules import does not count unless it is named as well.

    Args:
        modules: names such as "data_tools.worlds"; of a package all modules in it.

    Returns:
        16 hexadecimal digits, the same for every order of the names.

    Raises:
        ValueError: if there are none, or one is no module with a source.
        RuntimeError: if one was loaded and has been changed since the first call: what this process
            makes would be taken for what the new source makes.
    """
    if not modules:
        fail("modules", "at least one name", "none")
    sources = {module: _sources(module) for module in sorted(set(modules), key=str)}
    for module in sources.keys() & sys.modules.keys():
        version = hash_files(sources[module])
        if _LOADED.setdefault(module, version) != version:
            raise RuntimeError(f"{module}: its source has changed; start Python or the kernel anew")
    return hash_files(source for files in sources.values() for source in files)


def _sources(module: str) -> list[tuple[str, Path]]:
    """The files of a module, named alike on every machine."""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError, AttributeError, TypeError):
        spec = None
    origin = Path(spec.origin) if spec is not None and spec.origin else None
    if origin is None or origin.suffix != ".py" or not origin.is_file():
        fail("modules", "names of modules with a source", repr(module))
    if origin.name != "__init__.py":
        return [(module, origin)]
    files = sorted(
        (p.relative_to(origin.parent).as_posix(), p) for p in origin.parent.rglob("*.py")
    )
    return [(f"{module}/{name}", path) for name, path in files]
