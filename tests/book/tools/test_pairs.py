import json
import os

import pytest
from nbformat.v4 import new_output

from book.tools.contents import BOOK
from book.tools.notebooks import (
    HEADER,
    code_digest,
    is_executed,
    notebook_bytes,
    read_notebook,
    strip,
    write_notebook,
)
from book.tools.pairs import pair, set_aside

SOURCE = (
    HEADER
    + """
# %% [markdown]
# # A page

# %%
import math

# %%
math.pi
"""
)


@pytest.fixture
def pages(tmp_path):
    """An executed pair in a folder, both sides equally old."""
    source = tmp_path / "01_a.py"
    source.write_text(SOURCE, encoding="utf-8")
    pair(source)
    target = source.with_suffix(".ipynb")
    nb = read_notebook(target)
    for count, cell in enumerate([c for c in nb.cells if c.cell_type == "code"], 1):
        cell.execution_count = count
    cell.outputs = [new_output("execute_result", {"text/plain": "3.14"}, execution_count=count)]
    nb.metadata["posecore"] = {"code": code_digest(nb)}
    write_notebook(nb, target)
    for path in (source, target):
        os.utime(path, (1e9, 1e9))
    return source, target


def touch(path, seconds):
    os.utime(path, (1e9 + seconds, 1e9 + seconds))


def test_pair_makes_the_notebook(tmp_path):
    source = tmp_path / "01_a.py"
    source.write_text("# %% [markdown]\n# # No header yet\n\n# %%\n1 + 1\n", encoding="utf-8")
    pair(source)
    assert source.read_text(encoding="utf-8").startswith(HEADER)
    assert read_notebook(tmp_path / "01_a.ipynb").cells[1].source == "1 + 1"


def test_pair_changes_nothing_that_is_in_step(pages):
    before = [(path.read_bytes(), path.stat().st_mtime_ns) for path in pages]
    for side in pages:
        pair(side)
    assert [(path.read_bytes(), path.stat().st_mtime_ns) for path in pages] == before


def test_pair_keeps_outputs_when_only_text_changed(pages):
    source, target = pages
    source.write_text(SOURCE.replace("# # A page", "# # A better page"), encoding="utf-8")
    touch(source, 1)
    pair(source)
    assert source.stat().st_mtime_ns >= target.stat().st_mtime_ns
    nb = read_notebook(target)
    assert nb.cells[0].source == "# A better page"
    assert nb.cells[2].outputs and nb.metadata.posecore.code == code_digest(nb)


def test_pair_drops_all_outputs_when_code_changed(pages):
    source, target = pages
    source.write_text(SOURCE.replace("import math", "import math  # more"), encoding="utf-8")
    pair(source)
    assert not is_executed(read_notebook(target))


@pytest.mark.parametrize("part", ["solutions", "exercises"])
def test_pair_stores_no_outputs_of_solutions_and_exercises(part, pages):
    folder = pages[0].parent / part
    folder.mkdir()
    for path in pages:
        (folder / path.name).write_bytes(path.read_bytes())
    pair(folder / "01_a.py")
    assert not is_executed(read_notebook(folder / "01_a.ipynb"))


def test_pair_does_not_write_over_edits_of_the_notebook(pages):
    source, target = pages
    nb = read_notebook(target)
    nb.cells[0].source = "# Edited where jupytext was not there"
    write_notebook(nb, target)
    touch(target, 1)
    before = [path.read_bytes() for path in pages]
    with pytest.raises(ValueError, match=r"01_a\.ipynb was saved after 01_a\.py and differs"):
        pair(source)
    assert [path.read_bytes() for path in pages] == before
    touch(source, 2)  # "to keep the source save it once more"
    pair(source)
    assert read_notebook(target).cells[0].source == "# A page"


def test_pair_makes_a_deleted_source_from_the_notebook(pages):
    source, target = pages
    before = target.read_bytes()
    source.unlink()
    pair(source)
    assert source.read_text(encoding="utf-8") == SOURCE
    assert target.read_bytes() == before


def test_pair_does_not_lose_a_pasted_picture(pages):
    source, target = pages
    raw = json.loads(target.read_bytes())
    raw["cells"][0]["attachments"] = {"a.png": {"image/png": "AAAA"}}
    target.write_text(json.dumps(raw))
    touch(target, -1)
    with pytest.raises(ValueError, match="cell 1 holds a pasted picture"):
        pair(source)
    source.unlink()
    with pytest.raises(ValueError, match="pasted pictures"):
        pair(source)
    assert "AAAA" in target.read_text()


def kept(book):
    return [read_notebook(path) for path in sorted((book / "_build" / "replaced").glob("*"))]


def test_pair_keeps_what_gives_way_to_the_source(pages, capsys):
    """Edited in the notebook by a tool without jupytext, then in the source by an editor."""
    source, target = pages
    nb = read_notebook(target)
    nb.cells[0].source = "# Hours of work"
    write_notebook(nb, target)
    touch(target, 1)
    source.write_text(SOURCE.replace("math.pi", "math.tau"), encoding="utf-8")
    touch(source, 2)
    pair(source)
    assert read_notebook(target).cells[2].source == "math.tau"
    (old,) = kept(source.parent)
    assert old.cells[0].source == "# Hours of work" and not is_executed(old)
    line = capsys.readouterr().out
    assert line.startswith(f"01_a.ipynb: what it said before is kept as {source.parent}")
    assert line.endswith("(cell 1, line 1 is '# Hours of work' and '# A page')\n")
    pair(source)  # nothing gives way now
    assert capsys.readouterr().out == "" and len(kept(source.parent)) == 1


@pytest.mark.parametrize("part", ["", "solutions", "exercises"])
def test_every_text_is_kept_once_and_for_good(part, pages):
    book = pages[0].parent
    target = book / part / "01_a.ipynb"
    target.parent.mkdir(exist_ok=True)
    new = notebook_bytes(strip(read_notebook(pages[1])))
    for text in ("one", "two", "one"):
        nb = read_notebook(pages[1])
        nb.cells[0].source = text
        write_notebook(nb, target)
        set_aside(target, new)
    assert sorted(nb.cells[0].source for nb in kept(book)) == ["one", "two"]
    target.write_bytes(b"half a noteb")
    set_aside(target, new)
    assert b"half a noteb" in [path.read_bytes() for path in book.glob("_build/replaced/*")]
    assert [path.name for path in book.glob("_build/replaced/*") if part in path.name]


def test_outputs_alone_are_not_kept(pages):
    book, new = pages[0].parent, notebook_bytes(strip(read_notebook(pages[1])))
    set_aside(pages[1], new)
    set_aside(book / "none.ipynb", new)
    assert not (book / "_build").exists()


def test_what_is_kept_is_no_page_and_no_test(pages):
    assert "book/_build/" in (BOOK.parent / ".gitignore").read_text().splitlines()
