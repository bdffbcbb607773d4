"""The version of the code that makes a world."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from posecore import loaded
from posecore.arrays import fail
from posecore.fingerprint import PACKAGES, closure, digest

__all__ = ["code_version", "remember_sources"]

FINDING = ("posecore.fingerprint", "posecore.loaded")  # finds definitions, and changes none
_LOADED: dict[str, tuple[Path, bytes]] = {}  # sources of loaded modules, as they were at first


def code_version(*roots: Callable[..., Any] | str) -> str:
    """A hash of the definitions that functions or modules reach, to be the version of a world.

    Comments, docstrings and lines that only refuse do not count, nor where a definition stands; see
    `posecore.fingerprint.closure`.

    Args:
        roots: functions, or names of modules; of a package all modules in it count.

    Returns:
        16 hexadecimal digits, the same for every order of the roots.

    Raises:
        ValueError: if there is none, or one is no function or module with a source.
        RuntimeError: if a definition was loaded and has been changed since `remember_sources`: what
            this process makes would be taken for what the new source makes.
    """
    if not roots:
        fail("roots", "at least one", "none")
    now = closure(*roots, without=FINDING)
    edited = {name: data for name, (path, data) in _LOADED.items() if _bytes(path) != data}
    edited |= loaded.edited()
    if edited:
        before = closure(*roots, without=FINDING, sources=edited)
        if before.definitions != now.definitions:
            names = sorted({name for name, _ in before.definitions ^ now.definitions})
            raise RuntimeError(
                f"{', '.join(names[:3])}: the source has changed; start Python or the kernel anew"
            )
    return digest(now)


def remember_sources(packages: tuple[str, ...] = PACKAGES) -> None:
    """Keep the sources of the modules that are loaded by now: those that this process will run."""
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if name not in _LOADED and file and name.partition(".")[0] in packages:
            _LOADED[name] = (Path(file), _bytes(Path(file)))


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # it is gone
        return b""
