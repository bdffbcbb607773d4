"""What a page declares is measured and trained, whole or not at all, and goes on after a kill."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import load_file

from book.tools import measuring as ledgers
from book.tools.ledger import read_ledger
from book.tools.measuring import all_rows, claims, train
from posecore import fingerprint

ROOT = Path(ledgers.__file__).resolve().parents[2]
CONTENTS = "".join(
    f'[[page]]\nname = "{name}"\n' for name in ("index", "01_poses", "02_worlds", "03_more")
)
MEASURED = """
import os
import time
from posecore.scale import choose

SIZE = choose(tiny=1, book=2, paper=3)

def note(text):
    if log := os.environ.get("MEASURED_LOG"):
        with open(log, "a") as file:
            file.write(text + "\\n")
        time.sleep(0.1)

def table(seed):
    note(f"start {seed}")
    note(f"end {seed}")
    return {"a": seed / 3 + SIZE, "b": 2 * seed / 3 + 1.5}

def other(seed):
    return {"a": 1.0, "b": 2.0 + seed, "c": 0.0}
"""
EXPERIMENTS = """
import torch
from book.tools.claims import Claim
from folio.experiments.measured import other, table

CLAIMS = [
    Claim("one", "a is lower", "Table 1", "lower", "a", "b", (1.0, None), "other", "mm"),
    Claim("two", "a is higher", "Table 2", "higher", "a", "b", (1.0, 2.0), "table"),
]
MEASUREMENTS = {"table": (table, range(5)), "other": (other, [0, 1, 2])}

def net():
    layer = torch.nn.Linear(3, 2)
    state = dict(layer.state_dict())
    return {**state, "tied": state["weight"], "turned": state["weight"].T}

def bigger():
    return {"w": torch.zeros(100)}

CHECKPOINTS = {"net": net, "bigger": bigger}
"""


@pytest.fixture
def book(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A book named folio, so that it stands beside the real one."""
    book = tmp_path / "folio"
    for folder in ("site", "experiments"):
        (book / folder).mkdir(parents=True)
    (book / "site" / "contents.toml").write_text(CONTENTS)
    (book / "experiments" / "measured.py").write_text(MEASURED)
    (book / "experiments" / "01_poses.py").write_text(EXPERIMENTS)
    monkeypatch.delenv("POSECORE_SCALE", raising=False)
    monkeypatch.setattr(fingerprint, "PACKAGES", (*fingerprint.PACKAGES, "folio"))
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield book
    for name in [name for name in sys.modules if name.partition(".")[0] == "folio"]:
        del sys.modules[name]


def declare(book: Path, text: str) -> None:
    (book / "experiments" / "01_poses.py").write_text(EXPERIMENTS + text)


def copied(book: Path, to: Path) -> Path:
    return shutil.copytree(book, to, ignore=shutil.ignore_patterns("claims", "__pycache__"))


# Claims -----------------------------------------------------------------------------------------


def test_claims_are_measured_recorded_and_shown(book: Path, capsys: pytest.CaptureFixture) -> None:
    rows = claims("1", book)
    path = book / "claims" / "01_poses.json"
    assert [row.claim.id for row in rows] == ["one", "two"]
    assert rows[1].values == {s: {"a": s / 3 + 2, "b": 2 * s / 3 + 1.5} for s in range(5)}
    assert rows[0].conditions["module"] == "folio.experiments.measured"
    assert not any(row.stale for row in rows) and read_ledger(path) == rows
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "01_poses, table: 5 seeds at book scale"
    assert [line.split(":")[0] for line in lines[1:6]] == [f"  seed {seed}" for seed in range(5)]
    assert all(line.endswith(" s") for line in lines[1:6])
    assert "a is lower (Table 1)" in lines
    assert lines[-1] == str(path)
    before = path.read_bytes()
    assert claims("01_poses", book) == rows  # nothing is measured twice
    assert "seed 0:" not in capsys.readouterr().out
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_rows_are_stale_once_what_was_measured_has_changed(book: Path) -> None:
    claims("1", book)
    path = book / "claims" / "01_poses.json"
    declare(book, "# a word\n")  # nothing that was measured stands in this file
    assert [row.stale for row in read_ledger(path)] == [False, False]
    (book / "experiments" / "measured.py").write_text(MEASURED + "# a word\n")
    assert [row.stale for row in read_ledger(path)] == [True, True]
    assert [row.stale for row in claims("1", book)] == [False, False]


def test_another_scale_is_refused_or_written_elsewhere(
    book: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    for call in (claims, train):
        with pytest.raises(ValueError) as caught:
            call("1", book)
        assert (
            str(caught.value) == "POSECORE_SCALE: expected book, or --scale to write elsewhere, "
            "got 'tiny'"
        )
    assert {path.name for path in book.iterdir()} == {"site", "experiments"}
    (tiny, *_), (large, *_) = claims("1", book, scale="tiny"), claims("1", book, scale="book")
    assert (tiny.conditions["scale"], large.conditions["scale"]) == ("tiny", "book")
    assert os.environ["POSECORE_SCALE"] == "tiny"
    train("1", book, scale="paper")
    monkeypatch.delenv("POSECORE_SCALE")
    claims("1", book, scale="tiny")
    assert "POSECORE_SCALE" not in os.environ
    files = {
        str(p.relative_to(book)) for p in book.rglob("*") if p.suffix in (".json", ".safetensors")
    }
    assert files == {
        "claims/01_poses.json",
        "_build/tiny/claims/01_poses.json",
        "_build/paper/checkpoints/01_poses.net.safetensors",
        "_build/paper/checkpoints/01_poses.bigger.safetensors",
    }


def test_numbers_chosen_at_the_top_of_the_file_have_the_scale_that_is_recorded(book: Path) -> None:
    text = EXPERIMENTS.replace("from folio.experiments.measured import other, table", MEASURED)
    (book / "experiments" / "01_poses.py").write_text(text)
    assert claims("1", book)[1].values[0]["a"] == 2
    assert claims("1", book, scale="tiny")[1].values[0]["a"] == 1
    assert claims("1", book, scale="paper")[1].values[0]["a"] == 3


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (
            None,
            "01_poses: nothing to measure, as there is no experiments/01_poses.py\n"
            "01_poses: nothing to train, as there is no experiments/01_poses.py\n",
        ),
        (
            "",
            "01_poses: nothing to measure, as 01_poses.py declares no CLAIMS and no MEASUREMENTS\n"
            "01_poses: nothing to train, as 01_poses.py declares no CHECKPOINTS\n",
        ),
        (
            "CLAIMS, MEASUREMENTS, CHECKPOINTS = [], {}, {}\n",
            "01_poses: nothing to measure, as 01_poses.py declares no CLAIMS and no MEASUREMENTS\n"
            "01_poses: nothing to train, as 01_poses.py declares no CHECKPOINTS\n",
        ),
    ],
)
def test_a_page_without_experiments_says_so(
    text: str | None, lines: str, book: Path, capsys: pytest.CaptureFixture
) -> None:
    file = book / "experiments" / "01_poses.py"
    file.unlink() if text is None else file.write_text(text)
    assert claims("1", book) == [] and train("1", book) == []
    assert capsys.readouterr().out == lines
    assert {path.name for path in book.iterdir()} <= {"site", "experiments"}


PROGRAM = """
import json, os, sys
from pathlib import Path
from book.tools.measuring import claims
from posecore import fingerprint

fingerprint.PACKAGES += ("folio",)
children = []
for book, log in json.loads(sys.argv[1]):  # one import of torch serves all
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # only the parent is listened to
        os.environ["MEASURED_LOG"] = log
        claims("1", Path(book))
        os._exit(0)
    children.append(child)
print("\\n" + json.dumps(children), flush=True)
print("\\n" + json.dumps([os.waitpid(child, 0)[1] for child in children]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills by signal, as POSIX has them")
def test_killed_and_called_again_it_is_as_if_undisturbed(book: Path, tmp_path: Path) -> None:
    claims("1", book)
    ledger = Path("claims") / "01_poses.json"
    whole = (book / ledger).read_bytes()
    moments = ("start 0", "end 1", "start 3", "end 4")
    runs = []
    for number in range(len(moments)):
        other = copied(book, tmp_path / str(number) / "folio")
        runs.append((other, tmp_path / f"log{number}"))
        runs[-1][1].write_text("")
    command = [sys.executable, "-c", PROGRAM, json.dumps([list(map(str, run)) for run in runs])]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    program = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    lines = (line for line in program.stdout if line.startswith("["))
    waiting = list(zip(json.loads(next(lines)), runs, moments, strict=True))
    deadline = time.monotonic() + 30
    try:
        while waiting and time.monotonic() < deadline:
            for child, run, moment in list(waiting):
                if moment in run[1].read_text().splitlines():
                    os.kill(child, signal.SIGKILL)
                    waiting.remove((child, run, moment))
            time.sleep(0.001)
        assert not waiting
    finally:
        for child, *_ in waiting:
            os.kill(child, signal.SIGKILL)
        statuses = json.loads(next(lines))
        program.communicate(timeout=30)
    assert statuses == [signal.SIGKILL] * len(runs)
    for other, log in runs:
        assert not (other / ledger).exists() or (other / ledger).read_bytes() != whole
        log.write_text("")
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert result.stdout.rstrip().endswith("[0, 0, 0, 0]"), result.stderr
    for (other, log), moment in zip(runs, moments, strict=True):
        again = [int(line[-1]) for line in log.read_text().splitlines() if "start" in line]
        # All that was finished stays; at most the seed in hand is measured again.
        assert again == list(range(int(moment[-1]), 5)), moment
        assert (other / ledger).read_bytes() == whole


# Checkpoints ------------------------------------------------------------------------------------


def test_checkpoints_hold_what_was_trained_and_how(
    book: Path, capsys: pytest.CaptureFixture
) -> None:
    state = torch.get_rng_state()
    net, bigger = train("1", book)
    assert torch.equal(torch.get_rng_state(), state)
    assert net == book / "checkpoints" / "01_poses.net.safetensors"
    torch.manual_seed(ledgers.SEED)
    layer = torch.nn.Linear(3, 2)
    found = load_file(net)
    assert set(found) == {"weight", "bias", "tied", "turned"}
    assert torch.equal(found["weight"], layer.weight) and torch.equal(found["bias"], layer.bias)
    assert torch.equal(found["tied"], layer.weight) and torch.equal(found["turned"], layer.weight.T)
    with safe_open(net, "pt") as file:
        assert json.loads(file.metadata()["posecore"]) == {
            "code": fingerprint.code_hash("folio.experiments.01_poses"),
            "key": "net",
            "page": "01_poses",
            "scale": "book",
            "seed": 0,
        }
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("01_poses, net: ") and first.endswith(f"0.00 MB at {net}")
    assert second.endswith(str(bigger))
    assert {path.name for path in net.parent.iterdir()} == {net.name, bigger.name}


def test_the_same_training_gives_the_same_bytes_in_another_process(book: Path) -> None:
    here = [path.read_bytes() for path in train("1", book)]
    program = (
        "import sys; from pathlib import Path; from posecore import fingerprint as f;"
        "f.PACKAGES += ('folio',); from book.tools.measuring import train;"
        "train('1', Path(sys.argv[1]))"
    )
    for path in (book / "checkpoints").iterdir():
        path.unlink()
    subprocess.run(
        [sys.executable, "-c", program, str(book)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    paths = [book / "checkpoints" / f"01_poses.{key}.safetensors" for key in ("net", "bigger")]
    assert [path.read_bytes() for path in paths] == here


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ("{'w': torch.zeros(500_000)}", "CHECKPOINTS['net']: expected at most 2 MB, got 2.00 MB"),
        (
            "{'w': torch.tensor([1.0, torch.nan, torch.inf])}",
            "CHECKPOINTS['net']['w']: expected finite weights, got 2 that are not",
        ),
        ("{'w': 3.0}", "CHECKPOINTS['net']['w']: expected a tensor, got float"),
        ("{}", "CHECKPOINTS['net']: expected a dict of tensors, got {}"),
        ("None", "CHECKPOINTS['net']: expected a dict of tensors, got None"),
    ],
)
def test_unfit_weights_are_refused_and_the_old_stay(result: str, message: str, book: Path) -> None:
    files = train("1", book)
    before = [file.read_bytes() for file in files]
    declare(book, f"def net():\n    return {result}\nCHECKPOINTS = {{'net': net}}\n")
    with pytest.raises(ValueError) as caught:
        train("1", book)
    assert str(caught.value) == message
    assert [file.read_bytes() for file in files] == before
    assert len(list(files[0].parent.iterdir())) == 2


@pytest.mark.parametrize("shape", [(), (0,), (3, 4)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.int64, torch.bool])
def test_every_kind_of_weight_comes_back(shape: tuple, dtype: torch.dtype, book: Path) -> None:
    declare(
        book,
        f"def net():\n    return {{'w': torch.ones({shape}, dtype={dtype})}}\n"
        "CHECKPOINTS = {'net': net}\n",
    )
    (path,) = train("1", book)
    assert torch.equal(load_file(path)["w"], torch.ones(shape, dtype=dtype))
    assert load_file(path)["w"].dtype == dtype


def test_a_disk_that_refuses_or_forgets_is_told_of(
    book: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = train("1", book)
    before = files[0].read_bytes()

    def full(*names: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            train("1", book)
    assert files[0].read_bytes() == before and len(list(files[0].parent.iterdir())) == 2
    monkeypatch.setattr(ledgers, "write_bytes", lambda path, data: path.write_bytes(data[:-1]))
    with pytest.raises(OSError, match=r"01_poses\.net\.safetensors: does not read back"):
        train("1", book)


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CLAIMS = ['a']", "CLAIMS: expected a list of Claim, got 'a'"),
        ("CLAIMS = 3", "CLAIMS: expected a list of Claim, got 3"),
        ("MEASUREMENTS = [1]", "MEASUREMENTS: expected a dict, got list"),
        (
            "MEASUREMENTS = {'table': table}",
            "MEASUREMENTS['table']: expected (function, seeds), got <function",
        ),
        (
            "MEASUREMENTS = {'table': (table, 3)}",
            "MEASUREMENTS['table']: expected (function, seeds), got (<function",
        ),
        (
            "MEASUREMENTS = {'table': (3, range(3))}",
            "MEASUREMENTS['table']: expected (function, seeds), got (3, ",
        ),
        (
            "MEASUREMENTS = {'table': (table, range(3))}",
            "CLAIMS: expected a measurement of ['table'] for 'one', got 'other'",
        ),
        (
            "MEASUREMENTS = {'other': (other, [0, 1])}; CLAIMS = []",
            "seeds: expected at least 3, each once, got [0, 1]",
        ),
        (
            "CLAIMS.append(CLAIMS[0])",
            "CLAIMS: expected ids that differ, got 'one' twice",
        ),
        ("CHECKPOINTS = [1]", "CHECKPOINTS: expected a dict, got list"),
        (
            "CHECKPOINTS = {'../net': net}",
            "CHECKPOINTS: expected names of small letters, digits and _, got '../net'",
        ),
        ("CHECKPOINTS = {'net': 3}", "CHECKPOINTS['net']: expected a function, got 3"),
    ],
)
def test_declarations_are_refused_before_anything_is_measured(
    text: str, message: str, book: Path
) -> None:
    declare(book, text + "\n")
    with pytest.raises(ValueError) as caught:
        (train if "CHECKPOINTS" in text else claims)("1", book)
    assert str(caught.value).startswith(message)
    assert {path.name for path in book.iterdir()} == {"site", "experiments"}


@pytest.mark.parametrize("call", [claims, train])
def test_pages_and_scales_that_are_not_there(call, book: Path) -> None:
    with pytest.raises(ValueError, match=r"page: expected one of index, 01_poses, .*, got '7'"):
        call("7", book)
    with pytest.raises(ValueError, match="scale: expected one of 'tiny', 'book', 'paper', got 'x'"):
        call("1", book, scale="x")


def test_a_book_that_hides_behind_another_is_refused(book: Path, tmp_path: Path) -> None:
    claims("1", book)
    second = copied(book, tmp_path / "other" / "folio")
    sys.path.append(str(second.parent))
    with pytest.raises(
        ValueError, match="book: expected a folder whose folio.experiments.01_poses"
    ):
        claims("1", second)


def test_errors_of_a_measured_function_come_through(book: Path) -> None:
    declare(
        book,
        "def breaks(seed):\n    if seed == 2: raise RuntimeError('no luck')\n"
        "    return {'a': 1.0, 'b': 2.0}\n"
        "MEASUREMENTS = {'table': (breaks, range(3)), 'other': (other, range(3))}\n",
    )
    with pytest.raises(RuntimeError, match="no luck"):
        claims("1", book)
    kept = json.loads((book / "claims" / "01_poses.json").read_bytes())
    assert list(kept["unfinished"]["table"]["values"]) == ["0", "1"]
    assert "POSECORE_SCALE" not in os.environ


@settings(max_examples=20)
@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=5))
def test_weights_are_packed_to_the_last_bit(values: list[float]) -> None:
    data = ledgers._packed("net", {"w": torch.tensor(values)}, {"a": 1})
    assert torch.equal(ledgers.safetensors.torch.load(data)["w"], torch.tensor(values))
    assert data == ledgers._packed("net", {"w": torch.tensor(values)}, {"a": 1})


# All ledgers -------------------------------------------------------------------------------------


def test_the_rows_of_all_pages_in_the_order_of_the_contents(book: Path) -> None:
    assert all_rows(book) == {}
    for name in ("03_more", "02_worlds"):
        (book / "experiments" / f"{name}.py").write_text(EXPERIMENTS)
        claims(name, book)
    rows = all_rows(book)
    assert list(rows) == ["02_worlds", "03_more"]
    assert [row.claim.id for row in rows["03_more"]] == ["one", "two"]


def test_the_book_itself_has_no_damaged_and_no_stray_ledger() -> None:
    assert isinstance(all_rows(), dict)
