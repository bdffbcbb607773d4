import json
import re

import nbformat
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output, new_raw_cell

from book.tools.notebooks import (
    HEADER,
    cells_differ,
    code_digest,
    is_executed,
    notebook_bytes,
    outputs_digest,
    read_notebook,
    read_source,
    source_bytes,
    strip,
    with_outputs,
    write_notebook,
    write_source,
)

SOURCE = (
    HEADER
    + """
# %% [markdown]
# # A page

# %%
import math


# %% tags=["solution"]
def area(r):
    return math.pi * r**2


# %%
area(1)
"""
)


def result(text, count):
    return new_output("execute_result", {"text/plain": text}, execution_count=count)


def page():
    return new_notebook(
        cells=[
            new_markdown_cell("# A page"),
            new_code_cell("import math", execution_count=1),
            new_code_cell("math.pi", execution_count=2, outputs=[result("3.14", 2)]),
        ]
    )


def cells(*pairs):
    make = {"m": new_markdown_cell, "c": new_code_cell, "r": new_raw_cell}
    return new_notebook(cells=[make[kind](text) for kind, text in pairs])


WORDS = st.text("ab #%[](){}'\"\\:=,.!?\n\t-_*é✓0", max_size=40)
CELLS = st.lists(st.tuples(st.sampled_from("mc"), WORDS), max_size=5)


@given(CELLS)
def test_what_a_source_can_hold_comes_back_and_the_rest_is_refused(made):
    nb = cells(*made)
    try:
        data = source_bytes(nb)
    except ValueError as error:
        assert str(error).startswith("notebook: expected cells that percent format can hold")
        return
    again = _read(data)
    assert cells_differ(nb, again) == ""
    assert source_bytes(again) == data
    assert notebook_bytes(again) == notebook_bytes(strip(nb))
    assert code_digest(again) == code_digest(nb)


def _read(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.py")
        path.write_bytes(data)
        return read_source(path)


@given(st.lists(st.tuples(st.sampled_from("mcr"), st.text("ab", max_size=2)), max_size=8))
def test_cells_have_names_of_their_own_that_depend_on_content_alone(made):
    names = [cell["id"] for cell in json.loads(notebook_bytes(cells(*made)))["cells"]]
    assert len(set(names)) == len(names)
    assert names == [cell["id"] for cell in json.loads(notebook_bytes(cells(*made)))["cells"]]
    first = json.loads(notebook_bytes(cells(("m", "in front"), *made)))["cells"]
    assert [cell["id"] for cell in first[1:]] == names
    nbformat.validate(nbformat.reads(notebook_bytes(cells(*made)).decode(), as_version=4))


def test_ordinary_pages_are_not_refused(tmp_path):
    path = tmp_path / "a.py"
    path.write_text(SOURCE, encoding="utf-8")
    nb = read_source(path)
    assert [cell.cell_type for cell in nb.cells] == ["markdown", "code", "code", "code"]
    assert nb.cells[2].metadata.tags == ["solution"]
    write_source(nb, path)
    assert path.read_text(encoding="utf-8") == SOURCE


@pytest.mark.parametrize("text", ["a = 1\n\n# %%\nb = 2", "# %% [markdown]\n# c"])
def test_cells_that_would_fall_apart_are_refused(text, tmp_path):
    path = tmp_path / "a.py"
    path.write_text("as it was")
    with pytest.raises(ValueError, match="notebook: expected cells that percent format can hold"):
        write_source(cells(("c", text)), path)
    assert path.read_text() == "as it was"


def test_nothing_of_tools_and_machines_is_stored():
    nb = page()
    nb.metadata = {
        "kernelspec": {"display_name": "my kernel", "language": "python", "name": "mine"},
        "language_info": {"name": "python", "version": "3.11.4"},
        "widgets": {"application/vnd.jupyter.widget-state+json": {}},
        "jupytext": {"text_representation": {"jupytext_version": "1.19.6"}},
    }
    nb.cells[1].metadata = {"execution": {"iopub.status.busy": "2026"}, "editable": True}
    text = notebook_bytes(nb).decode() + source_bytes(nb).decode()
    for trace in ("mine", "3.11.4", "widget", "1.19.6", "2026", "editable", "extension: .py"):
        assert trace not in text
    assert text.endswith("\n")
    assert notebook_bytes(nb) == notebook_bytes(nbformat.reads(notebook_bytes(nb).decode(), 4))


def test_the_header_needs_no_settings_from_elsewhere():
    assert re.fullmatch(r"(# .*\n)+", HEADER)
    assert "formats: ipynb,py:percent" in HEADER
    assert source_bytes(page()).decode().startswith(HEADER + "\n# %% [markdown]\n")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b'{"cells": [',
        b"\xff\xfe",
        b"[]",
        b'{"cells": [], "metadata": {}, "nbformat": 3, "nbformat_minor": 0}',
        b'{"cells": [{"cell_type": "code"}], "metadata": {}, "nbformat": 4, "nbformat_minor": 5}',
        b'{"worksheets": [], "metadata": {}, "nbformat": 3, "nbformat_minor": 0}',
    ],
)
def test_damaged_notebooks_are_named(data, tmp_path):
    path = tmp_path / "01_a.ipynb"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"^01_a\.ipynb"):
        read_notebook(path)


@pytest.mark.parametrize("data", [b"\xff", b"# ---\n# jupyter:\n#   : [\n# ---\n"])
def test_damaged_sources_are_named(data, tmp_path):
    path = tmp_path / "01_a.py"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"^01_a\.py"):
        read_source(path)


@pytest.mark.parametrize("read, name", [(read_source, "a.py"), (read_notebook, "a.ipynb")])
def test_missing_files_are_named(read, name, tmp_path):
    with pytest.raises(ValueError, match=f"^{name}"):
        read(tmp_path / name)


def tagged():
    nb = cells(("c", "a"))
    nb.cells[0].metadata["tags"] = ["solution"]
    return nb


def attached():
    nb = cells(("m", "a"))
    nb.cells[0]["attachments"] = {"a.png": {"image/png": "AAAA"}}
    return nb


@pytest.mark.parametrize(
    "a, b, word",
    [
        (cells(("c", "a")), cells(("m", "a")), "cell 1 is code in one and markdown"),
        (cells(("c", "a\nb")), cells(("c", "a\nc")), "cell 1, line 2 is 'b' and 'c'"),
        (cells(("c", "a")), cells(("c", "a\nb")), "line 2 is missing and 'b'"),
        (cells(("c", "a")), cells(("c", " a")), "line 1 is 'a' and ' a'"),
        (cells(("c", "a")), cells(("c", "a"), ("c", "")), "1 cells in one and 2"),
        (cells(("c", "a")), tagged(), "cell 1 has tags"),
        (cells(("m", "a")), attached(), "cell 1 has pasted pictures"),
        (cells(("m", "x" * 99)), cells(("m", "y")), r"\.\.\.'"),
    ],
)
def test_the_first_difference_is_told(a, b, word):
    assert re.search(word, cells_differ(a, b))
    assert cells_differ(b, a)
    assert cells_differ(a, a) == cells_differ(b, b) == ""


def test_outputs_and_ends_of_cells_are_no_difference():
    assert cells_differ(page(), strip(page())) == ""
    assert cells_differ(cells(("c", "a")), cells(("c", "a\n\n"))) == ""


def test_digests_see_what_they_should():
    nb, other = page(), page()
    other.cells[0].source = "# Another title"
    other.cells[2].outputs = []
    assert code_digest(nb) == code_digest(other)
    assert outputs_digest(nb) != outputs_digest(other)
    for one, two in (
        ([("c", "a\nb")], [("c", "a"), ("c", "b")]),
        ([("c", "ab")], [("c", "a"), ("c", "b")]),
        ([("c", "a"), ("c", "b")], [("c", "b"), ("c", "a")]),
        ([("c", "a")], [("c", "a ; b")]),
        ([("c", "a")], [("m", "a")]),
    ):
        assert code_digest(cells(*one)) != code_digest(cells(*two))
    counted = page()
    counted.cells[1].execution_count = 7
    assert outputs_digest(counted) != outputs_digest(nb)
    stored = nbformat.reads(notebook_bytes(nb).decode(), as_version=4)
    assert (code_digest(stored), outputs_digest(stored)) == (code_digest(nb), outputs_digest(nb))


def test_strip_leaves_the_given_notebook_alone():
    nb = page()
    nb.metadata["posecore"] = {"scale": "book"}
    bare = strip(nb)
    assert not is_executed(bare) and "posecore" not in bare.metadata
    assert is_executed(nb) and nb.cells[2].outputs and nb.metadata.posecore
    assert cells_differ(nb, bare) == ""


def test_outputs_go_to_the_same_code_only():
    text = page()
    text.cells.insert(1, new_markdown_cell("more text"))
    moved = with_outputs(text, page())
    assert moved.cells[3].outputs[0].data["text/plain"] == "3.14"
    text.cells[2].source += "  # changed"
    assert not is_executed(with_outputs(text, page()))


def browser_of_before(raw):
    raw["nbformat_minor"] = 4  # before cells had names
    for cell in raw["cells"]:
        del cell["id"]


def names_in_an_older_format(raw):
    raw["nbformat_minor"] = 4


def no_names(raw):
    for cell in raw["cells"]:
        del cell["id"]


def one_name_twice(raw):
    for cell in raw["cells"]:
        cell["id"] = "a"


def a_format_to_come(raw):
    raw["nbformat_minor"] = 9


@pytest.mark.parametrize(
    "change",
    [browser_of_before, names_in_an_older_format, no_names, one_name_twice, a_format_to_come],
)
def test_notebooks_of_other_tools_are_read(change, tmp_path):
    raw = json.loads(notebook_bytes(page()))
    change(raw)
    path = tmp_path / "a.ipynb"
    path.write_text(json.dumps(raw))
    assert notebook_bytes(read_notebook(path)) == notebook_bytes(page())


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_files_as_windows_writes_them(mark, end, tmp_path):
    for data, name in ((source_bytes(page()), "a.py"), (notebook_bytes(page()), "a.ipynb")):
        (tmp_path / name).write_bytes(mark + data.replace(b"\n", end))
    assert cells_differ(read_source(tmp_path / "a.py"), page()) == ""
    assert notebook_bytes(read_notebook(tmp_path / "a.ipynb")) == notebook_bytes(page())


@pytest.mark.parametrize("write, name", [(write_source, "a.py"), (write_notebook, "a.ipynb")])
def test_a_full_disk_leaves_the_old_file(write, name, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    (tmp_path / name).write_text("as it was")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write(page(), tmp_path / name)
    assert (tmp_path / name).read_text() == "as it was"
    assert [path.name for path in tmp_path.iterdir()] == [name]
