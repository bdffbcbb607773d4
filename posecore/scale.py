"""The one switch between quick tests, the book and the papers' own sizes, and where caches lie.

Three environment variables are read here and nowhere else; empty counts as not set:

- `POSECORE_SCALE`: `tiny` (tests), `book` (the default) or `paper`;
- `POSECORE_CACHE`: the folder of worlds and resume files, by default in the user's cache folder;
- `POSECORE_RETRAIN`: `1` trains again where a checkpoint could be loaded.

A scale changes numbers, never code paths: write `steps = choose(tiny=20, book=2000, paper=100_000)`
and not `if scale() == "tiny"`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TypeVar

from posecore.arrays import fail

__all__ = ["SCALES", "cache_folder", "choose", "retrain", "scale"]

SCALES = ("tiny", "book", "paper")

T = TypeVar("T")


def scale() -> str:
    """The scale in force: `"tiny"`, `"book"` or `"paper"`.

    Raises:
        ValueError: if `POSECORE_SCALE` is something else.
    """
    name = os.environ.get("POSECORE_SCALE") or "book"
    if name not in SCALES:
        fail("POSECORE_SCALE", "one of " + ", ".join(SCALES), repr(name))
    return name


def choose(*, tiny: T, book: T, paper: T) -> T:
    """The value for the scale in force.

    Raises:
        ValueError: if `POSECORE_SCALE` is no scale.
    """
    return {"tiny": tiny, "book": book, "paper": paper}[scale()]


def retrain() -> bool:
    """Whether a reader asked for training where a checkpoint could be loaded.

    Raises:
        ValueError: if `POSECORE_RETRAIN` is neither 0 nor 1.
    """
    answer = os.environ.get("POSECORE_RETRAIN") or "0"
    if answer not in ("0", "1"):
        fail("POSECORE_RETRAIN", "0 or 1", repr(answer))
    return answer == "1"


def cache_folder() -> Path:
    """The folder that caches share. It is not made here: whoever writes to it makes it.

    Raises:
        ValueError: if `POSECORE_CACHE` is not absolute, names somebody who is no user, or is
            something other than a folder.
    """
    given = os.environ.get("POSECORE_CACHE")
    if not given:
        return _user_cache() / "posecore"
    try:
        folder = Path(given).expanduser()
    except RuntimeError:
        fail("POSECORE_CACHE", "the home of a user, or an absolute path", repr(given))
    # A relative one would be a different folder for every notebook.
    if not folder.is_absolute():
        fail("POSECORE_CACHE", "an absolute path", repr(given))
    try:
        wrong = folder.exists() and not folder.is_dir()
    except (OSError, ValueError) as error:  # a name that is too long, or no name
        fail("POSECORE_CACHE", "a path that can be a folder's", f"{given!r:.80}: {error!s:.40}")
    if wrong:
        fail("POSECORE_CACHE", "a folder", f"the file {given!r}")
    return folder


def _user_cache() -> Path:
    """Where the three systems want caches: XDG base directories, Library/Caches, LOCALAPPDATA."""
    if sys.platform == "darwin":
        return _home() / "Library" / "Caches"
    variable = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    folder = Path(os.environ.get(variable, ""))
    if folder.is_absolute():  # the XDG specification says to ignore relative ones
        return folder
    return _home() / ("AppData/Local" if sys.platform == "win32" else ".cache")


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user without a name, as in some containers
        fail("POSECORE_CACHE", "an absolute path, as this user has no home", "none")
