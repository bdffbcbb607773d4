"""How much room the made worlds take, and how to get it back."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

from data_tools.storage.store import WORLDS
from posecore.scale import cache_folder

__all__ = ["cache_size", "clean"]

# What a Store writes, as NAME/KEY/FILE, and nothing else.
FILE = r"(recipe\.json|\d{6,}\.shard)"
OURS = re.compile(rf"[a-z0-9][a-z0-9_-]*/[0-9a-f]{{16}}/({FILE}|\.{FILE}\.[0-9a-f]{{16}}\.tmp)")


def cache_size(folder: str | Path | None = None) -> dict[str, int]:
    """How many bytes each world takes.

    Args:
        folder: where the worlds lie, as for `Store`; None for `worlds` in `cache_folder()`.

    Returns:
        Bytes by "NAME/KEY", in alphabetical order. Files that no store has written do not count.
    """
    sizes: dict[str, int] = {}
    for file, is_ours in _files(_root(folder)):
        if is_ours:
            world = file.parent.relative_to(_root(folder)).as_posix()
            with contextlib.suppress(FileNotFoundError):  # just now renamed or deleted
                sizes[world] = sizes.get(world, 0) + file.stat().st_size
    return dict(sorted(sizes.items()))


def clean(folder: str | Path | None = None) -> tuple[dict[str, int], list[Path]]:
    """Delete all made worlds, and nothing else: neither links nor files that no store has written.

    Args:
        folder: where the worlds lie, as for `Store`; None for `worlds` in `cache_folder()`.

    Returns:
        What it was, as `cache_size` says it; and the files that were left alone.

    Raises:
        OSError: if a file cannot be deleted.
    """
    root, sizes = _root(folder), cache_size(folder)
    left = []
    for file, is_ours in list(_files(root)):
        if is_ours:
            file.unlink(missing_ok=True)
        else:
            left.append(file)
    for world in sizes:
        for emptied in (root / world, (root / world).parent, root):
            with contextlib.suppress(OSError):  # it is not empty
                emptied.rmdir()
    return sizes, left


def _root(folder: str | Path | None) -> Path:
    return cache_folder() / WORLDS if folder is None else Path(folder)


def _files(root: Path) -> Iterator[tuple[Path, bool]]:
    """All files and links under a folder, and whether a store has written them."""
    for path in sorted(root.rglob("*")):
        is_link = path.is_symlink()
        if is_link or not path.is_dir():
            name = path.relative_to(root).as_posix()
            yield path, path.is_file() and not is_link and OURS.fullmatch(name) is not None
