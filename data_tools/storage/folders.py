"""Folders that appear when everything is in them."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from data_tools.storage.locks import claim
from posecore.arrays import fail
from posecore.files import require_path

__all__ = ["new_folder"]


@contextlib.contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Fill a folder that appears as a whole, at the end of the block.

    Until then its name ends in `.unfinished`; after an error nothing is left of it, and what a kill
    left is taken away by the next call.

    Args:
        path: the folder, new or empty; the folder around it exists.

    Yields:
        The unfinished folder, empty.

    Raises:
        ValueError: if `path` is no such folder, or another process is writing it.
        OSError: if it cannot be written.
    """
    # "." and a link have no name to put another folder beside.
    path = Path(os.path.realpath(require_path("path", path)))
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        fail("path", "a new or an empty folder", str(path))
    if not path.parent.is_dir():
        fail("path", "a folder in one that exists", str(path))
    unfinished = path.with_name(path.name + ".unfinished")
    with claim(unfinished) as claimed:
        if not claimed.mine:
            fail("path", "one that no other process writes", f"{path}, which one does")
        if unfinished.exists():
            if not claimed.left:
                fail("path", f"no {unfinished.name} beside it that something else left", unfinished)
            shutil.rmtree(unfinished)  # of a try that was killed
        try:
            unfinished.mkdir()
            yield unfinished
            if path.exists():
                _fill(path, unfinished)
            else:
                unfinished.rename(path)
        except BaseException as error:
            shutil.rmtree(unfinished, ignore_errors=True)
            if isinstance(error, OSError) and error.filename is None:
                error.filename = str(unfinished)  # a full disk does not say which one it is
            raise


def _fill(path: Path, source: Path) -> None:
    """Move all into an empty folder: it may be one that somebody stands in."""
    moved = []
    try:
        for part in sorted(source.iterdir()):
            moved.append(path / part.name)
            part.rename(moved[-1])
        source.rmdir()
    except BaseException:
        for part in moved:
            if part.is_dir():
                shutil.rmtree(part, ignore_errors=True)
            else:
                part.unlink(missing_ok=True)
        raise
