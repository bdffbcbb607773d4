"""When a row of a ledger is stale, and that it names what has changed."""

import json
from pathlib import Path

import pytest

from book.tools.ledger import Measurement, measure, read_ledger, record, stale
from tests.book.tools.small_book import (
    CLAIM,
    HELPER,
    MEASURED,
    SPECKS,
    edit,
    forget,
    of,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "claims.json"


def measured(function: str, path: Path, **more: object) -> Measurement:
    """Measure a function of the small book into a ledger, with one claim."""
    from folio.ch01_poses import measured

    measurement = of(getattr(measured, function), **more)
    measure("m", measurement, path)
    record([CLAIM], path)
    return measurement


def changed(path: Path) -> tuple[str, ...]:
    """What another process says of the ledger's only row."""
    forget()
    (row,) = read_ledger(path)
    return row.stale


# Definitions ------------------------------------------------------------------------------------

HARMLESS = [
    ("helper.py", "return OFFSET", "return OFFSET  # that is all"),
    ("helper.py", "OFFSET = 0.125", "# an eighth\nOFFSET: float = 0.125"),
    ("helper.py", '"""What is added."""', '"""What is\n\n    added.\n    """'),
    ("helper.py", "def shift():", "def shift() -> float:"),
    (
        "helper.py",
        "    return OFFSET",
        "    if not OFFSET:\n        raise ValueError\n    return OFFSET",
    ),
    ("helper.py", "    return 3", "    return 4"),  # nobody calls it
    ("helper.py", "def unrelated", "def another():\n    return 1\n\n\ndef unrelated"),
    ("measured.py", "def table(seed):", "def table(seed: int) -> dict:"),
    ("experiments.py", "import torch", "import torch\nprint"),  # what is measured stands elsewhere
]


@pytest.mark.parametrize(("name", "old", "new"), HARMLESS)
def test_what_computes_nothing_changes_nothing(
    name: str, old: str, new: str, folio: Path, path: Path
) -> None:
    measured("table", path)
    assert changed(path) == ()
    edit(folio / "ch01_poses" / name, (old, new))
    assert changed(path) == ()


HARMFUL = [
    ("helper.py", "0.125", "0.126", ("helper.OFFSET",)),
    ("helper.py", "return OFFSET", "return 2 * OFFSET", ("helper.shift",)),
    ("helper.py", "return OFFSET", "return unrelated()", ("OFFSET", "helper.shift", "helper.unre")),
    ("measured.py", "2 * seed / 3", "3 * seed / 3", ("measured.table",)),
    ("measured.py", "book=2", "book=4", ("measured.SIZE",)),
    ("measured.py", "tiny=1", "tiny=4", ("measured.SIZE",)),
]


@pytest.mark.parametrize(("name", "old", "new", "names"), HARMFUL)
def test_a_changed_definition_is_named(
    name: str, old: str, new: str, names: tuple[str, ...], folio: Path, path: Path
) -> None:
    measured("table", path)
    edit(folio / "ch01_poses" / name, (old, new))
    found = changed(path)
    assert len(found) == len(names)
    assert all(word.startswith(start) for word, start in zip(found, names, strict=True))
    edit(folio / "ch01_poses" / name, (new, old))
    assert changed(path) == ()


def test_a_better_message_changes_nothing(folio: Path, path: Path) -> None:
    helper = folio / "ch01_poses" / "helper.py"
    helper.write_text(
        HELPER.replace("    return OFFSET", '    require_it("offset")\n    return OFFSET')
        + "\n\ndef require_it(name):\n    if not name:\n        raise ValueError('short')\n"
    )
    measured("table", path)
    edit(helper, ("'short'", "'long, and it names what came'"), ("if not name", "if name is None"))
    assert changed(path) == ()


def test_a_plain_move_changes_nothing(folio: Path, path: Path) -> None:
    measured("table", path)
    chapter = folio / "ch01_poses"
    (chapter / "moved.py").write_text(HELPER)
    (chapter / "helper.py").write_text("from folio.ch01_poses.moved import OFFSET, shift\n")
    assert changed(path) == ()
    edit(chapter / "measured.py", ("ch01_poses.helper", "ch01_poses.moved"))
    (chapter / "helper.py").unlink()
    assert changed(path) == ()
    edit(chapter / "moved.py", ("0.125", "0.5"))
    assert changed(path) == ("moved.OFFSET",)


def test_the_measured_function_moved_is_not_measured_again(folio: Path, path: Path) -> None:
    """Its row cannot find it, until whoever declares it says where it is."""
    measured("table", path)
    before = json.loads(path.read_bytes())
    (folio / "ch01_poses" / "measured.py").rename(folio / "ch01_poses" / "elsewhere.py")
    assert changed(path) == ("folio.ch01_poses.measured:table is gone",)
    from folio.ch01_poses import elsewhere

    measure("m", of(elsewhere.table), path)
    assert elsewhere.calls == [] and changed(path) == ()
    before["measurements"]["m"]["module"] = "folio.ch01_poses.elsewhere"
    assert json.loads(path.read_bytes()) == before


def test_a_function_that_is_gone_or_can_no_longer_be_read(folio: Path, path: Path) -> None:
    measured("table", path)
    file = folio / "ch01_poses" / "measured.py"
    edit(file, ("def table", "def tables"))
    assert changed(path) == ("folio.ch01_poses.measured:table is gone",)
    file.write_text("no python (")
    (line,) = changed(path)
    assert line.startswith(f"{file}: no Python: ")
    file.unlink()
    assert changed(path) == ("folio.ch01_poses.measured:table is gone",)
    file.write_text(MEASURED)
    helper = folio / "ch01_poses" / "helper.py"
    helper.write_text("no python either (")
    (line,) = changed(path)
    assert line.startswith(f"{helper}: no Python: ")
    helper.write_text(HELPER)
    assert changed(path) == ()


@pytest.mark.parametrize("name", ["data", "definitions", "numbers"])
def test_an_older_entry_does_not_say_what_it_was_made_from(
    name: str, folio: Path, path: Path
) -> None:
    measured("table", path)
    ledger = json.loads(path.read_bytes())
    del ledger["measurements"]["m"][name]
    path.write_text(json.dumps(ledger))
    assert changed(path) == ("how it was measured is not kept",)
    assert stale(ledger["measurements"]["m"], "trained") == ("how it was trained is not kept",)


# Datasets ---------------------------------------------------------------------------------------

SEEN = {"data": ("specks/train",)}


@pytest.mark.slow
def test_what_makes_or_reads_a_dataset_counts_for_those_who_declare_it(
    folio: Path, path: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.json"
    measured("seen", path, **SEEN)
    measured("table", other)
    specks = folio / "ch01_poses" / "specks.py"
    for old, new, names in (
        ("FAINTEST = 7", "FAINTEST = 8", ("specks.FAINTEST",)),
        ("integers(200)", "integers(100)", ("specks.record",)),
        ("scene_id=0", "scene_id=1", ("specks.views",)),
        (
            '"book": Size(4, 3, {"train": 4,',
            '"book": Size(4, 3, {"train": 5,',
            ("specks: train co",),
        ),
        ('"book": Size(4, 3,', '"book": Size(4, 9,', ("specks: train height",)),
        ('"tiny": Size(4, 3, {"train": 3,', '"tiny": Size(4, 3, {"train": 5,', ()),
        ('"train": 4, "test": 2', '"train": 4, "test": 3', ()),  # another split
        ("shade = int", "# one of 200\n    shade = int", ()),
    ):
        edit(specks, (old, new))
        found = changed(path)
        assert len(found) == len(names), (new, found)
        assert all(word.startswith(start) for word, start in zip(found, names, strict=True))
        assert changed(other) == ()
        specks.write_text(SPECKS)
    assert changed(path) == ()


@pytest.mark.slow
def test_a_dataset_that_is_gone(folio: Path, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from data_tools.readers import READERS

    measured("seen", path, **SEEN)
    edit(folio / "ch01_poses" / "specks.py", ('"train"', '"learning"'))
    (line,) = changed(path)
    assert line.startswith("folio.ch01_poses.measured:seen: split: expected one of 'learning', 't")
    monkeypatch.delitem(READERS, "specks")
    (line,) = changed(path)
    assert line.startswith("folio.ch01_poses.measured:seen: source: expected KIND")
