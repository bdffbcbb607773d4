"""What a page shows that does not stand on it: its drawings, the ledger, and shipped weights.

A page is stale once one of these has changed since it was executed. The library below is not among
them: its tests hold it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nbformat import NotebookNode

from book.tools.contents import Page, pages
from book.tools.ledger import read_file
from posecore import weights
from posecore.fingerprint import Closure, changes, of_source

__all__ = ["inputs", "stale_inputs"]


def inputs(nb: NotebookNode, page: Page, book: Path) -> dict[str, Any]:
    """The inputs of a page, as are stored with its outputs.

    Args:
        nb: the page.
        page: which it is.
        book: the folder of the book.

    Returns:
        "definitions" of the book that its code reaches; "claims", a hash of the claims and numbers
        that it can show (of its chapter, for the index of all); and "weights", digests by name.

    Raises:
        ValueError: if a cell is no Python, or a file is damaged.
    """
    return _inputs(_closure(nb, page, book), page, book)


def _inputs(code: Closure, page: Page, book: Path) -> dict[str, Any]:
    shown = pages(book) if page.name == "index" else [page]
    return {
        "definitions": code.text,
        "claims": _claims(book / one.package / "claims.json" for one in shown),
        "weights": _weights(book / page.package / "weights"),
    }


def stale_inputs(nb: NotebookNode, page: Page, book: Path) -> tuple[str, ...]:
    """What has changed since a page was executed; nothing if it is fresh or was never executed.

    Args:
        nb, page, book: as for `inputs`; the notebook keeps those of its execution.
    """
    kept = nb.metadata.get("posecore", {}).get("inputs")
    if kept is None:
        return ()
    if not isinstance(kept, dict) or not kept.keys() >= {"claims", "definitions", "weights"}:
        return ("what it was made from is not kept",)
    code = _closure(nb, page, book)
    now = _inputs(code, page, book)
    found = changes(kept["definitions"], code)
    found += ["claims"] if kept["claims"] != now["claims"] else []
    both = sorted(kept["weights"].keys() | now["weights"].keys())
    found += [f"weights/{n}" for n in both if kept["weights"].get(n) != now["weights"].get(n)]
    return tuple(found)


def _closure(nb: NotebookNode, page: Page, book: Path) -> Closure:
    code = "\n".join(cell.source for cell in nb.cells if cell.cell_type == "code")
    try:
        return of_source(code, (book.resolve().name,))
    except ValueError as error:
        raise ValueError(f"{page.name}: {error}") from error


def _claims(files: Iterable[Path]) -> str:
    """A hash of what a table of claims shows."""
    shown = []
    for path in files:
        ledger = read_file(path)
        made = {
            name: [entry["values"], entry["scale"], entry["version"], entry["machine"]]
            for name, entry in ledger["measurements"].items()
        }
        shown.append([path.parent.name, ledger["claims"], made])
    return hashlib.sha256(json.dumps(shown, sort_keys=True).encode()).hexdigest()[:16]


def _weights(folder: Path) -> dict[str, str]:
    found = {}
    for path in sorted(folder.glob("*.safetensors")):
        try:
            found[path.stem] = weights.digest(weights.parse(path.read_bytes()))
        except ValueError as error:
            raise ValueError(f"{path}: damaged: {error}") from error
    return found
