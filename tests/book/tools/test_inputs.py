"""What a page shows that does not stand on it, and that it is stale once that has changed."""

import json
from pathlib import Path

import pytest
import safetensors.torch
import torch
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from book.tools.contents import Page, find_page
from book.tools.inputs import inputs, stale_inputs
from book.tools.measuring import claims, train
from tests.book.tools.small_book import edit, forget

DRAWINGS = '''
from folio.ch01_poses.drawing.colours import BLUE
from posecore.figures import Picture


def curve(width):
    """A curve."""
    return Picture(figsize=(width, 1), color=BLUE)


def spiral():
    return curve(3)


def other():
    return BLUE
'''
CODE = """
from folio.ch01_poses import drawing, experiments
from book.tools.checkpoints import load_or_train
from posecore.poses import inverse
drawing.spiral()
"""


@pytest.fixture
def book(folio: Path) -> Path:
    """With drawings, claims and a network."""
    folder = folio / "ch01_poses" / "drawing"
    folder.mkdir()
    names = "from folio.ch01_poses.drawing.curves import curve, other, spiral\n"
    (folder / "__init__.py").write_text(names)
    (folder / "curves.py").write_text(DRAWINGS)
    (folder / "colours.py").write_text('BLUE = "blue"\nRED = "red"\n')
    claims("1", folio)
    train("1", folio)
    return folio


def page(code: str = CODE) -> NotebookNode:
    return new_notebook(cells=[new_markdown_cell("# Title"), new_code_cell(code)])


def executed(book: Path, name: str = "1", code: str = CODE) -> NotebookNode:
    """A page with what it keeps of its execution."""
    nb = page(code)
    nb.metadata["posecore"] = {"inputs": inputs(nb, find_page(name, book), book)}
    return nb


def changed(nb: NotebookNode, book: Path, name: str = "1") -> tuple[str, ...]:
    forget()
    return stale_inputs(nb, find_page(name, book), book)


def test_what_is_kept_are_the_definitions_of_the_book_alone(book: Path) -> None:
    found = inputs(page(), find_page("1", book), book)
    assert found == json.loads(json.dumps(found))
    names = {word.partition(":")[0] for word in found["definitions"].split()}
    assert {"spiral", "curve", "BLUE"} <= names
    assert not {"other", "RED", "Picture", "inverse", "load_or_train"} & names
    assert list(found["weights"]) == ["bigger", "net"] and len(found["claims"]) == 16


DRAWN = ("ch01_poses/drawing/curves.py", "ch01_poses/drawing/colours.py")


@pytest.mark.parametrize(
    ("name", "old", "new", "found"),
    [
        (DRAWN[0], "return curve(3)", "return curve(4)", ("curves.spiral",)),
        (DRAWN[0], "(width, 1)", "(width, 2)", ("curves.curve",)),
        (DRAWN[1], '"blue"', '"navy"', ("colours.BLUE",)),
        (DRAWN[1], '"red"', '"pink"', ()),
        (DRAWN[0], "    return BLUE", "    return BLUE + BLUE", ()),  # the page does not call it
        (DRAWN[0], '"""A curve."""', '"""A curve, again."""', ()),
        (DRAWN[0], "def curve(width)", "def curve(width: float)", ()),
        ("ch01_poses/experiments.py", "import torch", "import math, torch", ()),
    ],
)
def test_a_drawing_that_the_page_calls_makes_it_stale(
    name: str, old: str, new: str, found: tuple[str, ...], book: Path
) -> None:
    nb = executed(book, code="from folio.ch01_poses import drawing\ndrawing.spiral()")
    assert changed(nb, book) == ()
    edit(book / name, (old, new))
    assert changed(nb, book) == found


def test_a_page_that_has_all_drawings_depends_on_all(book: Path) -> None:
    nb = executed(book, code="from folio.ch01_poses.drawing import curves\nshow(curves)")
    edit(book / DRAWN[0], ("    return BLUE", "    return BLUE + BLUE"))
    assert changed(nb, book) == ("curves.other",)


def test_numbers_and_claims_count_and_when_they_were_confirmed_does_not(book: Path) -> None:
    chapter, index, other = (executed(book, name, "1") for name in ("1", "index", "2"))
    path = book / "ch01_poses" / "claims.json"
    whole = path.read_text()

    def told() -> tuple[tuple[str, ...], ...]:
        pages = (chapter, "1"), (index, "index"), (other, "2")
        return tuple(changed(nb, book, name) for nb, name in pages)

    ledger = json.loads(whole)
    ledger["measurements"]["table"] |= {"confirmed": "tiny", "seconds": {}, "definitions": "a:1"}
    path.write_text(json.dumps(ledger))
    assert told() == ((), (), ())
    for part in (
        lambda ledger: ledger["measurements"]["table"]["values"]["0"].update({"method=a": 9.0}),
        lambda ledger: ledger["measurements"]["table"].update(machine="another"),
        lambda ledger: ledger["claims"]["one"].update(statement="another"),
    ):
        ledger = json.loads(whole)
        part(ledger)
        path.write_text(json.dumps(ledger))
        assert told() == (("claims",), ("claims",), ())
    path.unlink()
    assert told() == (("claims",), ("claims",), ())


def test_weights_count_by_their_tensors(book: Path) -> None:
    nb = executed(book)
    folder = book / "ch01_poses" / "weights"
    state = safetensors.torch.load((folder / "net.safetensors").read_bytes())
    (folder / "net.safetensors").write_bytes(safetensors.torch.save(state, {"note": "the same"}))
    (folder / "net.json").write_text("{}")
    assert changed(nb, book) == ()
    state["bias"] = state["bias"] + 1e-6
    (folder / "net.safetensors").write_bytes(safetensors.torch.save(state))
    (folder / "bigger.safetensors").unlink()
    (folder / "new.safetensors").write_bytes(safetensors.torch.save({"w": torch.ones(1)}))
    assert changed(nb, book) == tuple(f"weights/{name}" for name in ("bigger", "net", "new"))
    (folder / "net.safetensors").write_bytes(b"half a net")
    with pytest.raises(ValueError, match=r"net\.safetensors: damaged: "):
        changed(nb, book)


def test_a_page_that_was_never_executed_is_not_stale(book: Path) -> None:
    assert changed(page(), book) == ()


@pytest.mark.parametrize("kept", ["16 digits of old", {}, {"definitions": "a:1", "claims": "0"}])
def test_a_page_of_before_does_not_say_what_it_was_made_from(kept: object, book: Path) -> None:
    nb = page()
    nb.metadata["posecore"] = {"inputs": kept}
    assert changed(nb, book) == ("what it was made from is not kept",)


def test_a_page_that_is_no_python_is_named(book: Path) -> None:
    with pytest.raises(ValueError, match=r"^01_poses: source: expected Python, got "):
        inputs(page("%matplotlib inline"), Page("01_poses"), book)
