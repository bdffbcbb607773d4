"""The version of the code that makes a world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from posecore.arrays import fail
from posecore.fingerprint import closure_as_loaded, digest

__all__ = ["code_version"]

FINDING = ("posecore.fingerprint", "posecore.loaded")  # finds definitions, and changes none


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
        RuntimeError: if a definition has been edited since it was loaded: what this process makes
            would be taken for what the new source makes.
    """
    if not roots:
        fail("roots", "at least one", "none")
    return digest(closure_as_loaded(*roots, without=FINDING))
