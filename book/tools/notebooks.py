"""Notebooks and their sources: read, compare, written so that the same content is the same bytes.

A page is a pair: `NN_name.py`, the source in jupytext's percent format, which one edits and
reviews, and `NN_name.ipynb`, which one opens and runs. The header of the source names the pair, so
JupyterLab keeps both in step wherever its server was started. Everything that tools write of
themselves (versions, names of kernels, time stamps, colours of cells) stays out of both files.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from pathlib import Path

import jupytext
import nbformat
from nbformat import NotebookNode

from posecore.arrays import fail
from posecore.files import write_bytes

__all__ = [
    "HEADER",
    "cells_differ",
    "code_digest",
    "is_executed",
    "notebook_bytes",
    "outputs_digest",
    "read_notebook",
    "read_source",
    "source_bytes",
    "strip",
    "with_outputs",
    "write_notebook",
    "write_source",
]

FORMAT = "py:percent"
JUPYTEXT = {
    "cell_metadata_filter": "tags,-all",
    "formats": "ipynb,py:percent",
    "notebook_metadata_filter": "jupytext,-jupytext.text_representation,-kernelspec",
}
KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
LANGUAGE = {"name": "python", "pygments_lexer": "ipython3"}
HEADER = "\n".join(
    ["# ---", "# jupyter:", "#   jupytext:", *(f"#     {k}: {v}" for k, v in JUPYTEXT.items())]
    + ["# ---", ""]
)
"""What every source begins with."""


def read_source(path: Path) -> NotebookNode:
    """The notebook that a source describes, without outputs.

    Raises:
        ValueError: if the file is missing, no UTF-8, or cannot be read as a notebook.
    """
    path = Path(path)
    try:
        nb = jupytext.reads(_text(path), fmt=FORMAT)
    except ValueError:
        raise
    except Exception as error:  # the header is YAML, the rest jupytext's own
        raise ValueError(f"{path.name} cannot be read as a notebook: {error}") from error
    return _plain(nb)


def read_notebook(path: Path) -> NotebookNode:
    """A notebook with its outputs, whatever tool wrote it.

    Raises:
        ValueError: if the file is missing or damaged, or holds notes of another format than 4.
    """
    path = Path(path)
    try:
        with warnings.catch_warnings():
            # Names of cells that are missing or not their own: `_plain` gives every cell a new one.
            warnings.simplefilter("ignore")
            nb = nbformat.reads(_text(path), as_version=nbformat.NO_CONVERT)
            # Some tools write what belongs to a newer minor version than they say.
            nbformat.validate(nb, relax_add_props=True)
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{path.name} is damaged: {reason}") from error
    if nb.nbformat != 4:
        raise ValueError(f"{path.name}: expected format 4, got {nb.nbformat}")
    return _plain(nb)


def write_source(nb: NotebookNode, path: Path) -> None:
    """Write a notebook's source, whole or not at all.

    Raises:
        ValueError: if percent format cannot hold the cells; the file is then as it was.
    """
    write_bytes(Path(path), source_bytes(nb))


def write_notebook(nb: NotebookNode, path: Path) -> None:
    """Write a notebook, whole or not at all."""
    write_bytes(Path(path), notebook_bytes(nb))


def source_bytes(nb: NotebookNode) -> bytes:
    """The source of a notebook.

    Raises:
        ValueError: if percent format cannot hold the cells, such as one with a line `# %%`.
    """
    plain = strip(nb)
    plain.metadata = nbformat.from_dict({"jupytext": JUPYTEXT})
    text = jupytext.writes(plain, fmt=FORMAT)
    text = text.rstrip("\n") + "\n"
    difference = cells_differ(nb, _plain(jupytext.reads(text, fmt=FORMAT)))
    if difference:
        fail("notebook", "cells that percent format can hold", difference)
    return text.encode()


def notebook_bytes(nb: NotebookNode) -> bytes:
    """The bytes of a notebook file."""
    return (nbformat.writes(_plain(nb), version=4) + "\n").encode()


def strip(nb: NotebookNode) -> NotebookNode:
    """The same cells without outputs."""
    bare = _plain(nb)
    bare.metadata.pop("posecore", None)
    for cell in _code(bare):
        cell.outputs, cell.execution_count = [], None
    return bare


def is_executed(nb: NotebookNode) -> bool:
    """Whether there is anything that a run left behind."""
    return "posecore" in nb.metadata or any(
        cell.outputs or cell.execution_count is not None for cell in _code(nb)
    )


def cells_differ(a: NotebookNode, b: NotebookNode) -> str:
    """What differs first in the cells of two notebooks (kind, tags, text); empty if nothing.

    Outputs are not compared, nor white space at the end of a cell, which no tool keeps.
    """
    for number, (one, other) in enumerate(zip(a.cells, b.cells, strict=False), 1):
        if one.cell_type != other.cell_type:
            return f"cell {number} is {one.cell_type} in one and {other.cell_type} in the other"
        if _tags(one) != _tags(other):
            return f"cell {number} has tags {_tags(one)} in one and {_tags(other)} in the other"
        if bool(one.get("attachments")) != bool(other.get("attachments")):
            return f"cell {number} has pasted pictures in one of them"
        lines, others = (cell.source.rstrip().split("\n") for cell in (one, other))
        for line in range(max(len(lines), len(others))):
            text, its = (part[line] if line < len(part) else None for part in (lines, others))
            if text != its:
                return f"cell {number}, line {line + 1} is {_shown(text)} and {_shown(its)}"
    if len(a.cells) != len(b.cells):
        return f"{len(a.cells)} cells in one and {len(b.cells)} in the other"
    return ""


def code_digest(nb: NotebookNode) -> str:
    """A hash of all code cells in their order; text and outputs do not count."""
    return _digest([cell.source.rstrip() for cell in _code(nb)])


def outputs_digest(nb: NotebookNode) -> str:
    """A hash of all outputs, to tell those of `make.py execute` from others."""
    runs = [[cell.outputs, cell.execution_count] for cell in _code(nb)]
    return _digest([json.dumps(run, sort_keys=True) for run in runs])


def with_outputs(nb: NotebookNode, executed: NotebookNode) -> NotebookNode:
    """The cells of `nb` with the outputs of `executed`, if those belong to the same code.

    JupyterLab keeps old outputs beside code that was edited, so where `make.py execute` noted the
    code that it ran, that counts too.
    """
    result = strip(nb)
    digest, note = code_digest(nb), executed.metadata.get("posecore", {})
    if digest == code_digest(executed) == note.get("code", digest):
        for cell, run in zip(_code(result), _code(executed), strict=True):
            cell.outputs, cell.execution_count = run.outputs, run.execution_count
        if note:
            result.metadata["posecore"] = note
    return result


def _plain(nb: NotebookNode) -> NotebookNode:
    """A copy with nothing but cells, tags, outputs and our own note, always in the same form."""
    metadata = {"jupytext": JUPYTEXT, "kernelspec": KERNEL, "language_info": LANGUAGE}
    if "posecore" in nb.metadata:
        metadata["posecore"] = nb.metadata["posecore"]
    cells, seen = [], {}
    for cell in nb.cells:
        bare = _bare(cell)
        # Named after its content, a cell keeps its name when others are put in before it.
        key = _digest([bare.cell_type, bare.source])[:8]
        seen[key] = seen.get(key, 0) + 1
        bare["id"] = key if seen[key] == 1 else f"{key}-{seen[key]}"
        cells.append(bare)
    plain = {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return nbformat.from_dict(plain)


def _bare(cell: NotebookNode) -> NotebookNode:
    bare = {"cell_type": cell.cell_type, "metadata": {}, "source": cell.source.rstrip()}
    if _tags(cell):
        bare["metadata"]["tags"] = _tags(cell)
    # Blank lines in the source where jupytext would set others than the formatter of the code.
    # Without this note JupyterLab would set its own, and not open the page where the notebook is
    # the newer file.
    if "lines_to_next_cell" in cell.metadata:
        bare["metadata"]["lines_to_next_cell"] = cell.metadata["lines_to_next_cell"]
    if cell.cell_type == "code":
        bare["outputs"] = cell.get("outputs", [])
        bare["execution_count"] = cell.get("execution_count")
    elif cell.get("attachments"):
        bare["attachments"] = cell.attachments
    return nbformat.from_dict({"id": "none", **bare})


def _tags(cell: NotebookNode) -> list[str]:
    return list(cell.metadata.get("tags", []))


def _code(nb: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in nb.cells if cell.cell_type == "code"]


def _digest(texts: list[str]) -> str:
    digest = hashlib.sha256()
    for text in texts:
        data = text.encode()
        digest.update(b"%d\n" % len(data) + data)
    return digest.hexdigest()[:16]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors put a mark in front
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from error


def _shown(line: str | None) -> str:
    if line is None:
        return "missing"
    return repr(line if len(line) <= 60 else line[:57] + "...")
