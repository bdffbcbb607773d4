"""What a page declares is measured and trained, whole or not at all, and goes on after a kill."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file

from book.tools import measuring
from book.tools.contents import ROOT, find_page
from book.tools.dependencies import KEEPING
from book.tools.ledger import all_rows, read_ledger
from book.tools.measuring import claims, stale_results, status, train
from posecore import weights
from posecore.fingerprint import closure
from tests.book.tools.small_book import EXPERIMENTS, MEASURED, A, copied, due, edit, forget

CHAPTER = "ch01_poses"
PARTS = {"site", "__init__.py", CHAPTER}
"""What the small book has before anything is measured."""
FILES = {"__init__.py", "helper.py", "measured.py", "specks.py", "experiments.py"}


def declare(book: Path, text: str) -> None:
    (book / CHAPTER / "experiments.py").write_text(EXPERIMENTS + text)


def made(book: Path) -> set[str]:
    """The files that measuring and training made."""
    found = {path.relative_to(book).as_posix() for path in book.rglob("*") if path.is_file()}
    return {name for name in found if Path(name).suffix in (".json", ".safetensors")}


def without_times(path: Path) -> dict:
    """A ledger but for how long its seeds took."""
    ledger = json.loads(path.read_bytes())
    for entry in ledger["measurements"].values():
        assert sorted(entry.pop("seconds")) == sorted(entry["values"])
    return ledger


# Claims -----------------------------------------------------------------------------------------


def test_claims_are_measured_recorded_and_shown(folio: Path, capsys: pytest.CaptureFixture) -> None:
    rows = claims("1", folio)
    path = folio / CHAPTER / "claims.json"
    assert [row.claim.id for row in rows] == ["one", "two"]
    assert rows[1].values == {seed: due(seed) for seed in range(5)}
    assert rows[0].conditions["module"] == "folio.ch01_poses.measured"
    assert not any(row.stale for row in rows) and read_ledger(path) == rows
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "01_poses, table: 5 seeds at book scale"
    assert [line.split(":")[0] for line in lines[1:6]] == [f"  seed {seed}" for seed in range(5)]
    assert all(line.endswith(" s") for line in lines[1:6])
    assert "a is lower (Table 1)" in lines
    assert lines[-1] == str(path)
    before = path.read_bytes()
    assert claims("01_poses", folio) == rows  # nothing is measured twice
    assert "seed 0:" not in capsys.readouterr().out
    assert path.read_bytes() == before
    assert made(folio) == {"ch01_poses/claims.json"}


def test_rows_are_stale_once_what_was_measured_has_changed(folio: Path) -> None:
    claims("1", folio)
    path = folio / CHAPTER / "claims.json"
    declare(folio, "SEEDS = 3\n")  # nothing that was measured stands in this file
    assert [row.stale for row in read_ledger(path)] == [(), ()]
    edit(folio / CHAPTER / "measured.py", ("2 * seed", "4 * seed"))
    forget()
    assert [row.stale for row in read_ledger(path)] == [(), ("measured.table",)]
    assert [row.stale for row in claims("1", folio)] == [(), ()]


def test_another_scale_is_refused_or_written_elsewhere(
    folio: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    for call in (claims, train):
        with pytest.raises(ValueError) as caught:
            call("1", folio)
        assert (
            str(caught.value) == "POSECORE_SCALE: expected book, or --scale to write elsewhere, "
            "got 'tiny'"
        )
    assert {path.name for path in folio.iterdir()} == PARTS
    (tiny, *_), (large, *_) = claims("1", folio, scale="tiny"), claims("1", folio, scale="book")
    assert (tiny.conditions["scale"], large.conditions["scale"]) == ("tiny", "book")
    assert os.environ["POSECORE_SCALE"] == "tiny"
    train("1", folio, scale="paper")
    monkeypatch.delenv("POSECORE_SCALE")
    claims("1", folio, scale="tiny")
    assert "POSECORE_SCALE" not in os.environ
    trained = {f"{name}.{end}" for name in ("net", "bigger") for end in ("json", "safetensors")}
    assert made(folio) == {
        "ch01_poses/claims.json",
        "_build/tiny/ch01_poses/claims.json",
        *(f"_build/paper/ch01_poses/weights/{name}" for name in trained),
    }


def test_numbers_chosen_at_the_top_of_the_file_have_the_scale_that_is_recorded(
    folio: Path,
) -> None:
    line = "from folio.ch01_poses.measured import other, table\n"
    for text in (EXPERIMENTS, EXPERIMENTS.replace(line, MEASURED)):  # or of a module beside it
        (folio / CHAPTER / "experiments.py").write_text(text)
        for scale, size in (("book", 2), ("tiny", 1), ("paper", 3)):
            assert claims("1", folio, scale=scale)[1].values[0][A] == 0.125 + size


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "there is no ch01_poses/experiments.py"),
        ("", "experiments.py declares no "),
        ("CLAIMS, MEASUREMENTS, CHECKPOINTS = [], {}, {}\n", "experiments.py declares no "),
    ],
)
def test_a_page_without_experiments_says_so(
    text: str | None, why: str, folio: Path, capsys: pytest.CaptureFixture
) -> None:
    file = folio / CHAPTER / "experiments.py"
    file.unlink() if text is None else file.write_text(text)
    assert claims("1", folio) == [] and train("1", folio) == []
    measure, training = capsys.readouterr().out.splitlines()
    missing = ("", "") if text is None else ("CLAIMS and no MEASUREMENTS", "CHECKPOINTS")
    assert measure == f"01_poses: nothing to measure, as {why}{missing[0]}"
    assert training == f"01_poses: nothing to train, as {why}{missing[1]}"
    assert {path.name for path in folio.iterdir()} == PARTS and not made(folio)


PROGRAM = """
import json, os, sys
from pathlib import Path
from book.tools.measuring import claims

children = []
for book, log in json.loads(sys.argv[1]):  # one import of torch serves all
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # only the parent is listened to
        os.environ["MEASURED_LOG"] = log
        sys.path.insert(0, str(Path(book).parent))
        claims("1", Path(book))
        os._exit(0)
    children.append(child)
print("\\n" + json.dumps(children), flush=True)
print("\\n" + json.dumps([os.waitpid(child, 0)[1] for child in children]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills by signal, as POSIX has them")
def test_killed_and_called_again_it_is_as_if_undisturbed(folio: Path, tmp_path: Path) -> None:
    claims("1", folio)
    ledger = Path(CHAPTER) / "claims.json"
    whole = without_times(folio / ledger)
    moments = ("start 0", "end 1", "start 3", "end 4")
    runs = []
    for number in range(len(moments)):
        other = copied(folio, tmp_path / str(number) / "folio")
        runs.append((other, tmp_path / f"log{number}"))
        runs[-1][1].write_text("")
    command = [sys.executable, "-c", PROGRAM, json.dumps([list(map(str, run)) for run in runs])]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    program = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    lines = (line for line in program.stdout if line.startswith("["))
    waiting = list(zip(json.loads(next(lines)), runs, moments, strict=True))
    deadline = time.monotonic() + 60
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
        program.communicate(timeout=60)
    assert statuses == [signal.SIGKILL] * len(runs)
    for other, log in runs:
        kept = json.loads((other / ledger).read_bytes()) if (other / ledger).exists() else {}
        assert not kept.get("claims")  # they are recorded last
        log.write_text("")
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert result.stdout.rstrip().endswith("[0, 0, 0, 0]"), result.stderr
    for (other, log), moment in zip(runs, moments, strict=True):
        again = [int(line[-1]) for line in log.read_text().splitlines() if "start" in line]
        # All that was finished stays; at most the seed in hand is measured again.
        assert again == list(range(int(moment[-1]), 5)), moment
        assert without_times(other / ledger) == whole


# Checkpoints ------------------------------------------------------------------------------------


def test_checkpoints_hold_what_was_trained_and_how(
    folio: Path, capsys: pytest.CaptureFixture
) -> None:
    state = torch.get_rng_state()
    net, bigger = train("1", folio)
    assert torch.equal(torch.get_rng_state(), state)
    assert net == folio / CHAPTER / "weights" / "net.safetensors"
    torch.manual_seed(measuring.SEED)
    layer = torch.nn.Linear(3, 2)
    found = load_file(net)
    assert set(found) == {"weight", "bias", "tied", "turned"}
    assert torch.equal(found["weight"], layer.weight) and torch.equal(found["bias"], layer.bias)
    assert torch.equal(found["tied"], layer.weight) and torch.equal(found["turned"], layer.weight.T)
    text = net.with_suffix(".json").read_text()
    about = json.loads(text)
    assert text == json.dumps(about, indent=1, sort_keys=True) + "\n"
    code = closure("folio.ch01_poses.experiments:bigger", without=KEEPING)
    other = json.loads(bigger.with_suffix(".json").read_bytes())
    assert other["numbers"] == code.numbers("book") != code.numbers("tiny")
    assert other["definitions"] == code.text
    assert 0 <= about.pop("seconds")["0"] < 5
    assert about.pop("definitions").startswith("net:") and about.pop("numbers")
    assert about == {
        "module": "folio.ch01_poses.experiments",
        "function": "net",
        "data": {},
        "digest": weights.digest(found),
        "scale": "book",
        "seed": 0,
    }
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("01_poses, net: ") and first.endswith(f"0.00 MB at {net}")
    assert second.endswith(str(bigger))
    names = {f"{path.stem}.{end}" for path in (net, bigger) for end in ("json", "safetensors")}
    assert {path.name for path in net.parent.iterdir()} == names


@pytest.mark.slow
def test_the_same_training_gives_the_same_bytes_in_another_process(folio: Path) -> None:
    here = [path.read_bytes() for path in train("1", folio)]
    program = (
        "import sys; from pathlib import Path; folder = Path(sys.argv[1]);"
        "sys.path.insert(0, str(folder.parent));"
        "from book.tools.measuring import train; train('1', folder)"
    )
    for path in (folio / CHAPTER / "weights").iterdir():
        path.unlink()
    subprocess.run(
        [sys.executable, "-c", program, str(folio)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    paths = [folio / CHAPTER / "weights" / f"{key}.safetensors" for key in ("net", "bigger")]
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
def test_unfit_weights_are_refused_and_the_old_stay(result: str, message: str, folio: Path) -> None:
    files = train("1", folio)
    files += [file.with_suffix(".json") for file in files]
    before = [file.read_bytes() for file in files]
    declare(folio, f"def net():\n    return {result}\nCHECKPOINTS = {{'net': Training(net)}}\n")
    with pytest.raises(ValueError) as caught:
        train("1", folio)
    assert str(caught.value) == message
    assert [file.read_bytes() for file in files] == before
    assert len(list(files[0].parent.iterdir())) == 4


@pytest.mark.parametrize("shape", [(), (0,), (3, 4)])
@pytest.mark.parametrize(
    "dtype", [torch.float64, torch.float16, torch.bfloat16, torch.int64, torch.bool]
)
def test_every_kind_of_weight_comes_back(shape: tuple, dtype: torch.dtype, folio: Path) -> None:
    declare(
        folio,
        f"def net():\n    return {{'w': torch.ones({shape}, dtype={dtype})}}\n"
        "CHECKPOINTS = {'net': Training(net)}\n",
    )
    (path,) = train("1", folio)
    assert torch.equal(load_file(path)["w"], torch.ones(shape, dtype=dtype))
    assert load_file(path)["w"].dtype == dtype


def test_a_disk_that_refuses_or_forgets_is_told_of(
    folio: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = train("1", folio)
    before = files[0].read_bytes()

    def full(*names: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            train("1", folio)
    assert files[0].read_bytes() == before and len(list(files[0].parent.iterdir())) == 4
    monkeypatch.setattr(measuring, "write_bytes", lambda path, data: path.write_bytes(data[:-1]))
    with pytest.raises(OSError, match=r"net\.safetensors: does not read back"):
        train("1", folio)


@settings(max_examples=20)
@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=5))
def test_weights_are_packed_to_the_last_bit(values: list[float]) -> None:
    data = measuring._packed("net", {"w": torch.tensor(values)})
    assert torch.equal(weights.parse(data)["w"], torch.tensor(values))
    assert data == measuring._packed("net", {"w": torch.tensor(values)})


# What is stale ----------------------------------------------------------------------------------


def test_the_status_says_what_is_stale_and_how_long_it_takes(folio: Path) -> None:
    page, ledger = find_page("1", folio), folio / CHAPTER / "claims.json"
    assert status(page, folio) == ["01_poses: nothing is stale"]  # nor measured
    claims("1", folio)
    train("1", folio)
    assert status(page, folio) == ["01_poses: nothing is stale"]
    assert list(stale_results(page, folio)) == []
    content = json.loads(ledger.read_bytes())
    content["measurements"]["table"]["seconds"] = {"0": 100.0, "1": 30.5}
    del content["measurements"]["other"]["seconds"]
    ledger.write_text(json.dumps(content))
    edit(folio / CHAPTER / "measured.py", ("2 * seed", "4 * seed"), ("2.0 + seed", "3.0 + seed"))
    edit(folio / CHAPTER / "experiments.py", ("book=100", "book=101"))
    forget()
    assert list(stale_results(page, folio)) == [
        ("other", ("measured.other",)),
        ("table", ("measured.table",)),
        ("weights/bigger.safetensors", ("experiments.bigger",)),
    ]
    assert status(page, folio) == [
        "01_poses, other: stale: measured.other; made anew in a time not kept",
        "01_poses, table: stale: measured.table; made anew in 3 min",
        "01_poses, weights/bigger.safetensors: stale: experiments.bigger; made anew in 1 min",
    ]
    assert measuring.shown(["a", "b", "c"]) == "a, b, c"
    assert measuring.shown(list("abcde")) == "a, b, c and 2 more"


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CLAIMS = ['a']", "CLAIMS: expected a list of Claim, got 'a'"),
        ("CLAIMS = 3", "CLAIMS: expected a list of Claim, got 3"),
        ("MEASUREMENTS = [1]", "MEASUREMENTS: expected a dict, got list"),
        (
            "MEASUREMENTS = {'table': table}",
            "MEASUREMENTS['table']: expected a Measurement of a function, got <function",
        ),
        (
            "MEASUREMENTS = {'table': (table, range(3))}",
            "MEASUREMENTS['table']: expected a Measurement of a function, got (<function",
        ),
        (
            "MEASUREMENTS = {'table': Measurement(3, range(3))}",
            "MEASUREMENTS['table'].function: expected a plain function, got int",
        ),
        (
            "MEASUREMENTS = {'table': Measurement(lambda seed: table(seed), range(3))}",
            "MEASUREMENTS['table'].function: expected a function at the top level of a module, "
            "got <lambda> of folio.ch01_poses.experiments",
        ),
        (
            "MEASUREMENTS = {'table': Measurement(table, range(3))}",
            "CLAIMS: expected a measurement of ['table'] for 'one', got 'other'",
        ),
        (
            "MEASUREMENTS = {'other': Measurement(other, [0, 1])}; CLAIMS = []",
            "seeds: expected at least 3, each once, got [0, 1]",
        ),
        (
            "CLAIMS.append(CLAIMS[0])",
            "CLAIMS: expected ids that differ, got 'one' twice",
        ),
        ("CHECKPOINTS = [1]", "CHECKPOINTS: expected a dict, got list"),
        (
            "CHECKPOINTS = {'../net': Training(net)}",
            "CHECKPOINTS: expected names of small letters, digits and _, got '../net'",
        ),
        ("CHECKPOINTS = {'net': net}", "CHECKPOINTS['net']: expected a Training of a function"),
        (
            "CHECKPOINTS = {'net': Training(3)}",
            "CHECKPOINTS['net'].function: expected a plain function, got int",
        ),
    ],
)
def test_declarations_are_refused_before_anything_is_measured(
    text: str, message: str, folio: Path
) -> None:
    declare(folio, text + "\n")
    with pytest.raises(ValueError) as caught:
        (train if "CHECKPOINTS" in text else claims)("1", folio)
    assert str(caught.value).startswith(message)
    assert {path.name for path in folio.iterdir()} == PARTS and not made(folio)


@pytest.mark.parametrize("call", [claims, train])
def test_pages_and_scales_that_are_not_there(call, folio: Path) -> None:
    with pytest.raises(ValueError, match=r"page: expected one of index, 01_poses, .*, got '7'"):
        call("7", folio)
    with pytest.raises(ValueError, match="scale: expected one of 'tiny', 'book', 'paper', got 'x'"):
        call("1", folio, scale="x")


def test_a_book_that_hides_behind_another_is_refused(folio: Path, tmp_path: Path) -> None:
    claims("1", folio)
    second = copied(folio, tmp_path / "other" / "folio")
    with pytest.raises(
        ValueError, match="book: expected a folder whose folio.ch01_poses.experiments"
    ):
        claims("1", second)


def test_errors_of_a_measured_function_come_through(folio: Path) -> None:
    declare(
        folio,
        "def breaks(seed):\n    if seed == 2: raise RuntimeError('no luck')\n"
        "    return {Key('a'): 1.0, Key('b'): 2.0}\n"
        "MEASUREMENTS = {'table': Measurement(breaks, range(3)),"
        " 'other': Measurement(other, range(3))}\n",
    )
    with pytest.raises(RuntimeError, match="no luck"):
        claims("1", folio)
    kept = json.loads((folio / CHAPTER / "claims.json").read_bytes())
    assert list(kept["unfinished"]["table"]["values"]) == ["0", "1"]
    assert "POSECORE_SCALE" not in os.environ


# All ledgers ------------------------------------------------------------------------------------


def test_the_rows_of_all_pages_in_the_order_of_the_contents(folio: Path) -> None:
    assert all_rows(folio) == {}
    for name in ("03_more", "02_worlds"):
        (folio / f"ch{name}").mkdir()
        (folio / f"ch{name}" / "experiments.py").write_text(EXPERIMENTS)
        claims(name, folio)
    rows = all_rows(folio)
    assert list(rows) == ["02_worlds", "03_more"]
    assert [row.claim.id for row in rows["03_more"]] == ["one", "two"]


@pytest.mark.slow
def test_the_book_itself_has_no_damaged_and_no_stray_ledger() -> None:
    assert all(rows for rows in all_rows().values())
