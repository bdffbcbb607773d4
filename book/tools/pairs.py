"""Both sides of a pair brought in step, without losing what was written on either."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import nbformat

from book.tools.contents import PARTS
from book.tools.notebooks import (
    cells_differ,
    notebook_bytes,
    read_notebook,
    read_source,
    source_bytes,
    strip,
    with_outputs,
)
from posecore.files import write_bytes

__all__ = ["pair", "refuse_lost_edits", "set_aside"]


def pair(path: Path) -> None:
    """Write both sides of a pair anew from the source.

    Outputs stay if the code is the same; solutions and exercises keep none.

    Args:
        path: either side; the other may be missing.

    Raises:
        ValueError: if the notebook was saved after the source and says something else, so that
            edits would be lost.
    """
    source, target = Path(path).with_suffix(".py"), Path(path).with_suffix(".ipynb")
    if not source.exists() and target.exists():
        old = read_notebook(target)
        nb = with_outputs(old, old)
    else:
        nb = read_source(source)
        if target.exists():
            refuse_lost_edits(source, target)
            nb = with_outputs(nb, read_notebook(target))
    if source.parent.name in PARTS:
        nb = strip(nb)
    # Both are made before either is written, as the cells may be such that a source cannot hold.
    files = {target: notebook_bytes(nb), source: source_bytes(nb)}
    changed = [path for path, data in files.items() if not _holds(path, data)]
    set_aside(target, files[target])
    for path in changed:
        write_bytes(path, files[path])
    if changed:
        os.utime(source)  # JupyterLab expects a source to be no older than its notebook


def refuse_lost_edits(source: Path, target: Path) -> None:
    """Refuse to write over a notebook that was edited where its source did not follow.

    Raises:
        ValueError: if the cells differ and the notebook is the newer file, or if it holds pasted
            pictures.
    """
    old = read_notebook(target)
    for number, cell in enumerate(old.cells, 1):
        if cell.get("attachments"):
            raise ValueError(
                f"{target.name}, cell {number} holds a pasted picture, which {source.name} cannot "
                "hold; draw it in code instead"
            )
    difference = cells_differ(read_source(source), old)
    if difference and target.stat().st_mtime_ns > source.stat().st_mtime_ns:
        raise ValueError(
            f"{target.name} was saved after {source.name} and differs ({difference}); to keep the "
            f"source save it once more, to keep the notebook delete {source.name}, then pair again"
        )


def set_aside(target: Path, new: bytes) -> None:
    """Keep what a notebook says that another is about to replace, and say where.

    Times of files cannot tell whether somebody edited the notebook too before its source, so the
    old text goes to `_build/replaced`, without outputs. Nothing is done if the cells are the same.

    Args:
        target: the notebook, in the folder of a book or one of its parts.
        new: the bytes that will stand there.
    """
    if not target.exists() or _holds(target, new):
        return
    try:
        old = strip(read_notebook(target))
        data = notebook_bytes(old)
        difference = cells_differ(old, nbformat.reads(new.decode(), as_version=4))
    except ValueError as error:
        difference, data = str(error), target.read_bytes()
    if difference:
        book = target.parent.parent if target.parent.name in PARTS else target.parent
        digest = hashlib.sha256(data).hexdigest()[:8]
        place = "-".join([*target.parent.relative_to(book).parts, target.stem, digest])
        path = book / "_build" / "replaced" / f"{place}.ipynb"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
        print(f"{target.name}: what it said before is kept as {path} ({difference})")


def _holds(path: Path, data: bytes) -> bool:
    return path.exists() and path.read_bytes() == data
