"""Stale results confirmed at tiny: only where nothing but their code is other."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from book.tools import confirming
from book.tools.checkpoints import stale_weights
from book.tools.confirming import confirm
from book.tools.ledger import stale
from book.tools.measuring import claims, train
from posecore import weights
from tests.book.tools.small_book import edit, forget

EXPERIMENTS = '''"""What can be confirmed, and what cannot."""

import data_tools
import torch

from book.tools.checkpoints import Training
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from folio.ch01_poses.measured import seen
from posecore.scale import choose

RUNS = []
A, B = Key("a"), Key("b")


def sized(seed):
    RUNS.append("sized")
    size = choose(tiny=1, book=2, paper=3)
    return {A: seed + size / 3, B: seed + 1.5 + torch.get_num_threads()}


def clock(seed):
    RUNS.append("clock")
    return {A: 1.0, B: 2.0}


def net():
    RUNS.append("net")
    size = choose(tiny=2, book=3, paper=4)
    return {"w": torch.rand(size) + 1}


def eyes():
    views = data_tools.open("specks", split="train")
    return {"w": torch.tensor([float(view.rgb.max()) for view in views])}


MEASUREMENTS = {
    "sized": Measurement(sized, range(3)),
    "seen": Measurement(seen, range(3), data=("specks/train",)),
    "clock": Measurement(clock, range(3), timed=True),
}
CLAIMS = [
    Claim(id="one", statement="a is lower", source="Table 1", measurement="sized", favoured=A,
          other=B, better="lower"),
]
CHECKPOINTS = {"net": Training(net), "eyes": Training(eyes, data=("specks/train",))}
'''
pytestmark = pytest.mark.slow  # every test makes a world and looks at all definitions again
NAMES = ("sized", "seen", "clock", "net.safetensors", "eyes.safetensors")
CHAPTER = "ch01_poses"
FRESH = dict.fromkeys(NAMES, "fresh")


RESULTS: dict[Path, bytes] = {}
"""What measuring and training give: the same in every test, so that it is done once."""


@pytest.fixture
def book(folio: Path) -> Path:
    """Measured and trained at book scale by code of before, which was kept at tiny."""
    (folio / CHAPTER / "experiments.py").write_text(EXPERIMENTS)
    chapter = folio / CHAPTER
    if not RESULTS:
        claims("1", folio)
        train("1", folio)
        confirm("1", folio)
        files = [chapter / "claims.json", *(chapter / "weights").iterdir()]
        RESULTS.update({path.relative_to(folio): path.read_bytes() for path in files})
    (chapter / "weights").mkdir(exist_ok=True)
    for path, data in RESULTS.items():
        (folio / path).write_bytes(data)
    return folio


def said(book: Path) -> dict[str, str]:
    """What `confirm` says of each result, as another process would."""
    forget()
    lines = [line.removeprefix("01_poses, ").split(": ", 1) for line in confirm("1", book)]
    return dict(lines)


def change(book: Path, *changes: tuple[str, str], file: str = "experiments.py") -> None:
    edit(book / CHAPTER / file, *changes)


def entry(book: Path, name: str) -> dict:
    """What is kept of a measurement or a network."""
    if name.endswith(".safetensors"):
        return json.loads((book / CHAPTER / "weights" / name).with_suffix(".json").read_bytes())
    return json.loads((book / CHAPTER / "claims.json").read_bytes())["measurements"][name]


def runs(book: Path) -> list[str]:
    """What was run since the modules were last imported."""
    from folio.ch01_poses import experiments

    return experiments.RUNS


# What is kept -----------------------------------------------------------------------------------


def test_what_is_fresh_is_run_once_and_kept(folio: Path) -> None:
    (folio / CHAPTER / "experiments.py").write_text(EXPERIMENTS)
    assert said(folio) == {
        **{name: "not measured yet" for name in NAMES[:3]},
        **{name: "nothing says how it was trained" for name in NAMES[3:]},
    }
    claims("1", folio)
    train("1", folio)
    before = {name: entry(folio, name) for name in NAMES}
    first = "fresh; kept what it gives at tiny"
    assert said(folio) == {**dict.fromkeys(NAMES, first), "clock": "fresh"}
    assert runs(folio) == ["sized", "net"]
    kept = {name: entry(folio, name) for name in NAMES}
    assert said(folio) == FRESH and runs(folio) == []
    assert {name: entry(folio, name) for name in NAMES} == kept
    for name in NAMES:
        tiny = kept[name].pop("tiny", None)
        assert kept[name] == before[name]
        assert (tiny is None) == (name == "clock")
        if tiny and name in ("sized", "net.safetensors"):
            assert tiny["data"] == {} and tiny["machine"] == confirming._machine()
    tiny = entry(folio, "sized")["tiny"]["values"]
    assert tiny == {"method=a": 1 / 3, "method=b": 2.5}  # seed 0, at tiny, on one thread
    with torch.random.fork_rng():
        torch.manual_seed(0)
        digest = weights.digest({"w": torch.rand(2) + 1})
    assert entry(folio, "net.safetensors")["tiny"]["values"] == {"digest": digest}
    assert entry(folio, "net.safetensors")["digest"] != digest  # of three weights
    data = [entry(folio, name)["tiny"]["data"] for name in ("seen", "eyes.safetensors")]
    assert data[0] == data[1] and list(data[0]) == ["specks/train"]


def test_what_another_machine_kept_is_kept_anew_where_it_is_fresh(
    book: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = confirming._machine()
    monkeypatch.setattr(confirming, "_machine", lambda: "Plan 9, vax")
    again = "fresh; kept what it gives at tiny"
    assert said(book) == {**dict.fromkeys(NAMES, again), "clock": "fresh"}
    assert entry(book, "sized")["tiny"]["machine"] == "Plan 9, vax" != here


# What is confirmed ------------------------------------------------------------------------------


def test_the_same_at_tiny_is_confirmed_and_fresh_again(book: Path) -> None:
    before = {name: entry(book, name) for name in NAMES}
    change(book, ("size / 3", "size * 1 / 3"), ("torch.rand(size) + 1", "1 + torch.rand(size)"))
    change(book, ("int(view.rgb.max())", "int(view.rgb[0].max())"), file="measured.py")
    forget()
    assert stale(before["sized"]) == ("experiments.sized",)
    path = book / CHAPTER / "weights" / "net.safetensors"
    assert stale_weights(path) == ("experiments.net",)
    assert said(book) == {
        **FRESH,
        "sized": "confirmed at tiny (experiments.sized)",
        "seen": "confirmed at tiny (measured.seen)",
        "net.safetensors": "confirmed at tiny (experiments.net)",
    }
    assert stale(entry(book, "sized")) == () == stale_weights(path)
    for name in ("sized", "seen", "net.safetensors"):
        after = entry(book, name)
        assert after.pop("confirmed") == "tiny"
        assert after.pop("definitions") != before[name].pop("definitions")
        assert after == before[name]
    assert said(book) == FRESH
    assert claims("1", book) and runs(book) == []  # it counts as measured by this code
    assert entry(book, "sized")["confirmed"] == "tiny"


def test_a_world_made_otherwise_with_the_same_bytes_is_confirmed(book: Path) -> None:
    change(book, ("+ FAINTEST", "- -FAINTEST"), file="specks.py")
    words = "confirmed at tiny (specks.record)"
    assert said(book) == {**FRESH, "seen": words, "eyes.safetensors": words}
    assert said(book) == FRESH


def test_a_function_that_moved_is_found_again_without_a_run(book: Path) -> None:
    measured = book / CHAPTER / "measured.py"
    measured.rename(measured.with_name("elsewhere.py"))
    change(book, ("ch01_poses.measured", "ch01_poses.elsewhere"))
    forget()
    assert stale(entry(book, "seen")) == ("folio.ch01_poses.measured:seen is gone",)
    assert said(book) == FRESH and runs(book) == []
    assert stale(entry(book, "seen")) == () and "confirmed" not in entry(book, "seen")


# What is not ------------------------------------------------------------------------------------


def bits_of_b(book: Path) -> None:
    change(book, ("seed + 1.5", "seed + 1.5000000000000004"))


def bits_of_weights(book: Path) -> None:
    change(book, ("+ 1}", "+ 1.0000001192092896}"))


def another_number_at_book(book: Path) -> None:
    change(book, ("tiny=1, book=2", "tiny=1, book=4"))


def another_size_of_the_net_at_book(book: Path) -> None:
    change(book, ("tiny=2, book=3", "tiny=2, book=5"))


def more_records_at_book(book: Path) -> None:
    change(book, ('"train": 4', '"train": 5'), file="specks.py")


def other_bytes(book: Path) -> None:
    change(book, ("FAINTEST = 7", "FAINTEST = 8"), file="specks.py")


def bytes_that_nobody_sees(book: Path) -> None:
    change(book, ('return {"rgb":', 'return {"more": 1, "rgb":'), file="specks.py")


def a_new_clock(book: Path) -> None:
    change(book, ("{A: 1.0", "{A: 1.0 * 1"))


def a_key_less(book: Path) -> None:
    change(book, ("B: seed + 1.5", "Key('c'): seed + 1.5"))


DATA = ("seen", "eyes.safetensors")
REFUSED: list[tuple[Callable[[Path], None], tuple[str, ...], str]] = [
    (bits_of_b, ("sized",), "other at tiny: method=b is 2.5000000000000004, was 2.5"),
    (bits_of_weights, ("net.safetensors",), "other at tiny: digest is "),
    (another_number_at_book, ("sized",), "other numbers at book scale"),
    (another_size_of_the_net_at_book, ("net.safetensors",), "other numbers at book scale"),
    (more_records_at_book, DATA, "other data"),
    (other_bytes, DATA, "other at tiny: specks/train is "),
    (bytes_that_nobody_sees, DATA, "other at tiny: specks/train is "),
    (a_new_clock, ("clock",), "times cannot be confirmed"),
    (a_key_less, ("sized",), "other at tiny: method=b is None, was 2.5"),
]


@pytest.mark.parametrize(
    ("edits", "names", "words"), REFUSED, ids=[case[0].__name__ for case in REFUSED]
)
def test_what_may_be_other_stays_stale(
    edits: Callable[[Path], None], names: tuple[str, ...], words: str, book: Path
) -> None:
    before = {name: entry(book, name) for name in NAMES}
    edits(book)
    found = said(book)
    assert {name for name in NAMES if found[name] != "fresh"} == set(names)
    for name in names:
        start, _, why = found[name].partition("; ")
        assert start.startswith("stale: ") and why.startswith(words), found[name]
    assert {name: entry(book, name) for name in NAMES} == before
    assert said(book) == found  # nor the next time


def test_numbers_that_were_only_moved_are_confirmed_by_who_has_compared_runs(book: Path) -> None:
    another_number_at_book(book)
    assert "other numbers at book scale" in said(book)["sized"]
    lines = confirm("1", book, same_numbers=True)
    assert "01_poses, sized: confirmed at tiny (experiments.sized)" in lines
    assert entry(book, "sized")["confirmed"] == "tiny, and said to have the same numbers"
    assert said(book)["sized"] == "fresh"
    bits_of_b(book)  # what a run at tiny shows stays an objection
    another_number = ("tiny=1, book=4", "tiny=1, book=2")
    change(book, another_number)
    forget()
    lines = confirm("1", book, same_numbers=True)
    assert any("sized: stale: " in line and "other at tiny" in line for line in lines)


def test_what_another_machine_kept_confirms_nothing(
    book: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confirming, "_machine", lambda: "Plan 9, vax")
    change(book, ("size / 3", "size * 1 / 3"))
    found = said(book)
    assert found["sized"].startswith(
        "stale: experiments.sized; what is kept was made on another kind of machine (Linux"
        if os.uname().sysname == "Linux"
        else "stale: experiments.sized; what is kept was made on another kind of machine ("
    )
    assert "sized" not in runs(book)


def test_what_was_never_kept_confirms_nothing(folio: Path) -> None:
    (folio / CHAPTER / "experiments.py").write_text(EXPERIMENTS)
    claims("1", folio)
    change(folio, ("size / 3", "size * 1 / 3"))
    words = "stale: experiments.sized; nothing of before is kept to compare with"
    assert said(folio)["sized"] == words and "sized" not in runs(folio)


def test_an_older_row_confirms_nothing(book: Path) -> None:
    path = book / CHAPTER / "claims.json"
    ledger = json.loads(path.read_bytes())
    del ledger["measurements"]["sized"]["numbers"]
    path.write_text(json.dumps(ledger))
    about = book / CHAPTER / "weights" / "net.json"
    about.write_text(json.dumps({k: v for k, v in entry(book, "net.safetensors").items()
                                 if k != "definitions"}))  # fmt: skip
    assert said(book) == {
        **FRESH,
        "sized": "stale: how it was measured is not kept",
        "net.safetensors": "stale: how it was trained is not kept",
    }


# Around it --------------------------------------------------------------------------------------


def test_nothing_of_a_run_is_left_behind(
    book: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSECORE_SCALE", "paper")
    monkeypatch.setenv("POSECORE_RETRAIN", "1")
    cache = tmp_path / "nobody's"
    monkeypatch.setenv("POSECORE_CACHE", str(cache))
    change(book, ("size / 3", "size * 1 / 3"))
    change(book, ("+ FAINTEST", "- -FAINTEST"), file="specks.py")
    before, threads = dict(os.environ), torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        assert said(book)["seen"].startswith("confirmed")
        assert torch.get_num_threads() == 3
        change(book, ("size = choose(tiny=1", "size = 1 / 0, choose(tiny=1"))
        with pytest.raises(ZeroDivisionError):
            said(book)
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(threads)
    assert dict(os.environ) == before and not cache.exists()


def test_an_error_leaves_what_was_confirmed_before_it(book: Path) -> None:
    change(book, ("size / 3", "size * 1 / 3"), ("    views = data", "    views = 1 / 0, data"))
    with pytest.raises(ZeroDivisionError):
        said(book)
    assert entry(book, "sized")["confirmed"] == "tiny"


def test_pages_with_nothing_to_confirm(folio: Path) -> None:
    assert confirm("2", folio) == ["02_worlds: nothing to confirm"]
    with pytest.raises(ValueError, match="page: expected one of"):
        confirm("9", folio)


# At once ----------------------------------------------------------------------------------------


def test_what_another_process_has_written_meanwhile_stays(book: Path) -> None:
    """Confirming takes minutes, in which seeds may be finished and networks trained."""
    change(
        book,
        ("seed + size / 3", "size / 3 + seed"),
        ("torch.rand(size) + 1", "1 + torch.rand(size)"),
    )
    path, file = book / CHAPTER / "claims.json", book / CHAPTER / "weights" / "net.json"
    real, kept = confirming._values, {}

    def slow(measurement: object) -> dict:
        ledger = json.loads(path.read_bytes())
        ledger["unfinished"] = {"more": {"values": {"0": {"method=a": 1.0}}}}
        path.write_text(json.dumps(ledger))
        return real(measurement)

    def trained(training: object) -> dict:
        about = json.loads(file.read_bytes()) | {"digest": "of another training"}
        file.write_text(json.dumps(about))
        kept.update(about)
        return {"digest": "0"}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(confirming, "_values", slow)
        patch.setattr(confirming, "_digest", trained)
        lines = said(book)
    assert lines["sized"].startswith("confirmed at tiny")
    assert "more" in json.loads(path.read_bytes())["unfinished"]
    assert lines["net.safetensors"] == confirming.MEANWHILE
    assert json.loads(file.read_bytes()) == kept
    change(book, ("size / 3 + seed", "seed + size / 3"))

    def again(measurement: object) -> dict:
        ledger = json.loads(path.read_bytes())
        ledger["measurements"]["sized"]["values"]["7"] = {"method=a": 1.0, "method=b": 2.0}
        path.write_text(json.dumps(ledger))
        return real(measurement)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(confirming, "_values", again)
        assert said(book)["sized"] == confirming.MEANWHILE
    assert "7" in entry(book, "sized")["values"]
