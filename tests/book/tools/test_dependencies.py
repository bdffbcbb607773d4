"""What a result depends on: definitions, numbers chosen by scale, and datasets."""

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

from book.tools.dependencies import (
    code_of,
    dependencies,
    open_world,
    reasons,
    records_digest,
)
from tests.book.tools.small_book import edit, forget


def modules() -> tuple[ModuleType, ModuleType]:
    """As they are imported now."""
    from folio.ch01_poses import measured, specks

    return measured, specks


TABLE, SEEN = (f"folio.ch01_poses.measured:{name}" for name in ("table", "seen"))


def test_a_function_and_its_name_depend_on_the_same(folio: Path) -> None:
    measured, _ = modules()
    found = dependencies(measured.table, (), "book")
    assert found == dependencies(TABLE, (), "book") == json.loads(json.dumps(found))
    assert set(found) == {"definitions", "numbers", "data"} and found["data"] == {}
    names = [word.partition(":")[0] for word in found["definitions"].split()]
    assert {"table", "note", "shift", "OFFSET", "SIZE", "choose"} <= set(names)
    assert not {"other", "unrelated", "World"} & set(names) and names == sorted(names)


def test_what_keeps_results_is_no_part_of_them(folio: Path) -> None:
    """A key names a number; an edit of `keys.py` computes no other one."""
    reached = {module for module, _ in code_of(SEEN, ("specks/train",)).places}
    assert not {module for module in reached if module.startswith("book.tools")}
    assert {"folio.ch01_poses.measured", "data_tools.views", "posecore.scale"} <= reached


def test_who_opens_a_world_depends_on_what_reads_it(folio: Path) -> None:
    plain, opening = code_of(SEEN), code_of(SEEN, ("specks/train",))
    assert plain.definitions < opening.definitions
    names = {name for name, _ in opening.definitions}
    assert {"World.open", "WorldDataset.__getitem__", "Store.__getitem__"} <= names
    assert "record" not in names  # of no particular world: those stand with the data


def test_numbers_are_those_of_their_scale(folio: Path) -> None:
    def numbers() -> list[str]:
        return [dependencies(TABLE, (), scale)["numbers"] for scale in ("tiny", "book", "paper")]

    before = numbers()
    assert len(set(before)) == 3
    edit(folio / "ch01_poses" / "measured.py", ("book=2", "book=9"))
    after = numbers()
    assert [one != other for one, other in zip(before, after, strict=True)] == [False, True, False]
    edit(folio / "ch01_poses" / "measured.py", ("2 * seed", "4 * seed"))
    assert numbers() == after  # a number that is the same at every scale


def test_data_is_that_of_its_scale(folio: Path) -> None:
    tiny, book = (
        dependencies(SEEN, ("specks/train", "specks/test", "specks/train"), scale)["data"]["specks"]
        for scale in ("tiny", "book")
    )
    assert tiny["definitions"] == book["definitions"]
    assert list(tiny["splits"]) == ["test", "train"]
    assert [side["splits"]["train"]["count"] for side in (tiny, book)] == [3, 4]
    assert [side["splits"]["train"]["scale"] for side in (tiny, book)] == ["tiny", "book"]


def test_nothing_of_a_world_is_made(folio: Path, tmp_path: Path) -> None:
    dependencies(SEEN, ("specks/train",), "book")
    assert not (tmp_path / "cache").exists()


def test_datasets_that_are_declared_or_no_longer(folio: Path) -> None:
    code = code_of(SEEN, ("specks/train",))
    one, two, none = (
        dependencies(SEEN, data, "tiny")
        for data in (("specks/train",), ("specks/train", "specks/test"), ())
    )
    assert reasons(one, one, code) == ()
    assert reasons(one, two, code) == ("specks: splits test, train in place of train",)
    assert [line for line in reasons(one, none, code) if line[:6] == "specks"] == [
        "specks: no longer declared"
    ]
    assert [line for line in reasons(none, one, code) if line[:6] == "specks"] == [
        "specks: not yet declared"
    ]


def test_a_digest_of_records_is_that_of_their_content(folio: Path, tmp_path: Path) -> None:
    first = records_digest("specks/train")
    assert re.fullmatch("[0-9a-f]{16}", first)
    assert first != records_digest("specks/test") != records_digest("specks/train", "book")
    specks = folio / "ch01_poses" / "specks.py"
    edit(specks, ('"""One speck."""', '"""One of the specks."""'), ("FAINTEST", "DARKEST"))
    forget()
    assert records_digest("specks/train") == first
    edit(specks, ("DARKEST = 7", "DARKEST = 8"))
    forget()
    assert records_digest("specks/train") != first
    assert (tmp_path / "cache" / "worlds" / "specks").is_dir()


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("specks/valid", "split: expected one of 'train', 'test', got 'valid'"),
        ("specks", "split: expected one of 'train', 'test', got None"),
        ("sparks/train", "source: expected KIND or KIND:PATH with KIND one of .*, got 'sparks'"),
        ("linemod", "data: expected a world and a split, 'tabletop/train', got 'linemod'"),
    ],
)
def test_what_is_no_world(source: str, message: str, folio: Path) -> None:
    with pytest.raises(ValueError, match=message):
        open_world(source, "tiny")
    with pytest.raises(ValueError, match=message):
        dependencies(SEEN, (source,), "tiny")


@pytest.mark.parametrize("name", ["folio.ch01_poses.measured:none", "folio.none:table", "math:pi"])
def test_what_is_no_function(name: str, folio: Path) -> None:
    with pytest.raises(ValueError, match=f"roots: expected a module with a file, .*, got '{name}'"):
        dependencies(name, (), "tiny")
