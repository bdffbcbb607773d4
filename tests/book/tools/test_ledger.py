"""The ledger: measured once, kept through a kill, stale when what it was made from has changed."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

import posecore
from book.tools import ledger
from book.tools.dependencies import KEEPING
from book.tools.keys import Key
from book.tools.ledger import all_rows, measure, read_ledger, record, require_ledger
from posecore.fingerprint import closure
from tests.book.tools.small_book import CLAIM, A, B, due, edit, of, texts


@pytest.fixture
def house(folio: Path) -> ModuleType:
    """The module of the functions that are measured."""
    from folio.ch01_poses import measured

    return measured


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "claims.json"


def like(function: Callable[..., object]) -> Callable[..., Callable[[int], object]]:
    """A decorator: another function counts as this one."""
    return wraps(function)


# Measuring --------------------------------------------------------------------------------------


def test_every_seed_is_measured_once(house: ModuleType, path: Path) -> None:
    result = measure("m", of(house.table), path)
    assert result == {seed: due(seed) for seed in range(3)}
    first = path.read_bytes()
    assert measure("m", of(house.table), path) == result
    assert house.calls == [0, 1, 2] and path.read_bytes() == first
    assert list(measure("m", of(house.table, [4, 2, 1, 0]), path)) == [4, 2, 1, 0]
    assert house.calls == [0, 1, 2, 4]
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_what_is_stored(house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its form is what others read: `measurements.NAME.values.SEED`, `claims.ID`."""
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    measure("m", of(house.table), path)
    record([CLAIM], path)
    text = path.read_text(encoding="utf-8")
    stored = json.loads(text)
    assert text == json.dumps(stored, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    assert set(stored) == {"claims", "measurements"}
    assert stored["claims"] == {"c": {**CLAIM.entry(), "place": 0}}
    entry = stored["measurements"]["m"]
    assert entry.pop("values") == {str(seed): texts(due(seed)) for seed in range(3)}
    machine = entry.pop("machine")
    assert f"{os.cpu_count()} cores" in machine and "Python 3." in machine
    code = closure(house.table, without=KEEPING)
    assert {"table", "shift", "OFFSET", "SIZE", "choose"} <= {name for name, _ in code.definitions}
    assert list(entry.pop("seconds")) == ["0", "1", "2"]
    assert entry == {
        "module": "folio.ch01_poses.measured",
        "function": "table",
        "definitions": code.text,
        "numbers": code.numbers("tiny"),
        "data": {},
        "scale": "tiny",
        "version": posecore.__version__,
    }


def test_what_is_stored_of_a_dataset(house: ModuleType, path: Path) -> None:
    measure("m", of(house.seen, data=("specks/train", "specks/test")), path)
    data = json.loads(path.read_bytes())["measurements"]["m"]["data"]
    assert list(data) == ["specks"]
    names = {word.split(":")[0] for word in data["specks"]["definitions"].split()}
    assert {"record", "views", "FAINTEST", "View"} <= names and "SIZES" not in names
    recipe = {"world": "specks", "scale": "book", "width": 4, "height": 3, "seed": 0}
    assert data["specks"]["splits"] == {
        "train": {**recipe, "split": "train", "count": 4},
        "test": {**recipe, "split": "test", "count": 2},
    }


def test_the_time_of_every_seed_is_kept(house: ModuleType, path: Path) -> None:
    said: list[str] = []

    def slow(seed: int) -> dict[Key, float]:
        time.sleep(0.06)
        return due(seed)

    measure("m", of(like(house.table)(slow)), path, say=said.append)
    seconds = json.loads(path.read_bytes())["measurements"]["m"]["seconds"]
    assert all(0.1 <= seconds[str(seed)] < 5 for seed in range(3))
    assert said == [f"  seed {seed}: {seconds[str(seed)]} s" for seed in range(3)]
    measure("m", of(house.table, range(4)), path)
    again = json.loads(path.read_bytes())["measurements"]["m"]["seconds"]
    assert {seed: again[seed] for seed in seconds} == seconds and "3" in again


def test_a_decorated_function_of_a_module(house: ModuleType, path: Path) -> None:
    @wraps(house.table)
    def decorated(seed: int) -> dict[Key, float]:
        return house.table(seed)

    assert measure("m", of(decorated), path)[2] == due(2)
    assert json.loads(path.read_bytes())["measurements"]["m"]["function"] == "table"


@pytest.mark.parametrize("change", ["scale", "code", "machine", "version", "function", "data"])
def test_other_conditions_measure_again_and_keep_the_old_until_whole(
    change: str, house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure("m", of(house.table), path)
    old = json.loads(path.read_bytes())["measurements"]["m"]
    function, data = house.table, ()
    if change == "scale":
        monkeypatch.setenv("POSECORE_SCALE", "tiny")
    elif change == "code":
        edit(Path(house.__file__).with_name("helper.py"), ("0.125", "0.25"))
    elif change == "machine":
        monkeypatch.setattr(ledger.os, "cpu_count", lambda: 99)
    elif change == "version":
        monkeypatch.setattr(posecore, "__version__", "9.9")
    elif change == "function":
        function = house.other
    else:
        data = ("specks/train",)
    calls = []

    def fails(seed: int) -> dict[Key, float]:
        calls.append(seed)
        if seed == 2 and len(calls) == 3:
            raise KeyboardInterrupt
        return due(seed)

    measurement = of(like(function)(fails), data=data)
    with pytest.raises(KeyboardInterrupt):
        measure("m", measurement, path)
    stored = json.loads(path.read_bytes())
    assert stored["measurements"]["m"] == old
    assert list(stored["unfinished"]["m"]["values"]) == ["0", "1"]
    measure("m", measurement, path)
    assert calls == [0, 1, 2, 2]
    stored = json.loads(path.read_bytes())
    assert stored["measurements"]["m"] != old and "unfinished" not in stored


def test_results_that_are_not_as_they_should_be(house: ModuleType, path: Path) -> None:
    for result, message in (
        (3.0, r"function\(seed=0\): expected a dict of numbers, got 3.0"),
        ({}, r"function\(seed=0\): expected a dict of numbers, got {}"),
        ({"a": 1.0}, r"function\(seed=0\): expected a Key for each number, got 'a'"),
        ({A: float("nan")}, r"seed=0\)\[method=a\]: expected a finite number, got nan"),
        ({A: None}, r"seed=0\)\[method=a\]: expected a finite number, got None"),
    ):
        with pytest.raises(ValueError, match=message):
            measure("m", of(like(house.table)(lambda seed, r=result: r)), path)
    assert not path.exists()
    names = like(house.table)(lambda seed: {A: 1.0} if seed < 2 else {B: 1.0})
    with pytest.raises(
        ValueError, match=r"seed=2\): expected the keys \['method=a'\] as for the o"
    ):
        measure("m", of(names), path)
    assert list(json.loads(path.read_bytes())["unfinished"]["m"]["values"]) == ["0", "1"]


def test_a_disk_that_refuses_leaves_the_old_ledger(
    house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure("m", of(house.table), path)
    before = path.read_bytes()

    def full(*names: object) -> None:
        raise OSError(28, "No space left on device")

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(ledger.os, name, full)
            with pytest.raises(OSError, match="No space"):
                measure("m", of(house.table, range(4)), path)
        assert path.read_bytes() == before
    assert measure("m", of(house.table, range(4)), path)[3] == due(3)


# Killed -----------------------------------------------------------------------------------------

PROGRAM = """
import json, os, sys, time
from pathlib import Path
from book.tools.ledger import Measurement, measure
from folio.ch01_poses import measured

def wait(*arguments):
    measured.note("waiting")
    time.sleep(60)

children = []
for target, log, where in json.loads(sys.argv[1]):  # one import of torch serves all
    child = os.fork()
    if not child:
        measured.LOG = log
        if where:
            setattr(os, where, wait)
        measure("m", Measurement(measured.table, range(5)), Path(target))
        os._exit(0)
    children.append(child)
print(json.dumps(children), flush=True)
print(json.dumps([os.waitpid(child, 0)[1] for child in children]))
"""
MOMENTS = [  # what the log's last line is, how much later, where the program is made to wait
    ("start 0", 0.02, ""),
    ("start 1", 0.0, ""),
    ("end 1", 0.0, ""),
    ("end 2", 0.002, ""),
    ("start 4", 0.03, ""),
    ("waiting", 0.0, "replace"),
    ("waiting", 0.0, "fsync"),
]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills by signal, as POSIX has them")
def test_a_killed_measurement_goes_on(house: ModuleType, tmp_path: Path, path: Path) -> None:
    def whole(path: Path) -> dict:
        """The ledger but for the times that seeds took."""
        content = json.loads(path.read_bytes())
        assert sorted(content["measurements"]["m"].pop("seconds")) == list("01234")
        return content

    measure("m", of(house.table, range(5)), path)
    undisturbed = whole(path)
    root = str(Path(posecore.__file__).parents[1])
    runs = [
        (tmp_path / f"killed{i}" / "claims.json", tmp_path / f"log{i}", line, delay, wait)
        for i, (line, delay, wait) in enumerate(MOMENTS)
    ]
    for _, log, *_ in runs:
        log.write_text("")
    cases = json.dumps([(str(target), str(log), wait) for target, log, _, _, wait in runs])
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, cases],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), root])},
        stdout=subprocess.PIPE,
        text=True,
    )
    children = json.loads(program.stdout.readline())
    try:
        waiting = list(zip(children, runs, strict=True))
        deadline = time.monotonic() + 30
        while waiting and time.monotonic() < deadline:
            for child, run in list(waiting):
                _, log, line, delay, _ = run
                if line in log.read_text().splitlines():
                    time.sleep(delay)
                    os.kill(child, signal.SIGKILL)
                    waiting.remove((child, run))
            time.sleep(0.001)
        assert not waiting
    finally:
        for child, _ in waiting:
            os.kill(child, signal.SIGKILL)
        statuses = json.loads(program.communicate(timeout=30)[0])
    assert statuses == [signal.SIGKILL] * len(runs)
    for target, log, line, _, _ in runs:
        kept = json.loads(target.read_bytes())["unfinished"]["m"] if target.exists() else {}
        finished = [int(seed) for seed in kept.get("values", {})]
        ended = sum(text.startswith("end") for text in log.read_text().splitlines())
        # At most the seed whose writing was under way is lost.
        assert finished in (list(range(ended)), list(range(ended - 1))), line
        house.calls.clear()
        measure("m", of(house.table, range(5)), target)
        assert house.calls == [seed for seed in range(5) if seed not in finished]
        assert whole(target) == undisturbed
        # A killed write may leave its unfinished copy, under a name that nothing reads.
        names = {file.name for file in target.parent.iterdir()}
        assert {name for name in names if not name.endswith(".tmp")} == {"claims.json"}


# At once ----------------------------------------------------------------------------------------

TOGETHER = """
import json, os, sys, time
from pathlib import Path
from book.tools.ledger import Measurement, measure, record
from folio.ch01_poses import measured
from tests.book.tools.small_book import CLAIM

def due(name, seeds):
    return Measurement(measured.table, seeds)

jobs = json.loads(sys.argv[2])
children = []
for number, (name, seeds) in enumerate(jobs):
    child = os.fork()
    if not child:
        measured.LOG = sys.argv[3] + str(number)  # a moment for each seed
        measure(name, due(name, seeds), Path(sys.argv[1]))
        if name == "m":
            record([CLAIM], Path(sys.argv[1]))
        os._exit(0)
    children.append(child)
print(json.dumps([os.waitpid(child, 0)[1] for child in children]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_two_at_once_lose_nothing_of_each_other(
    house: ModuleType, tmp_path: Path, path: Path
) -> None:
    """Other seeds of the same, and another measurement, in one ledger."""
    jobs = [("m", list(range(5))), ("m", list(range(4, -1, -1))), ("n", [0, 1, 2])]
    root = str(Path(posecore.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", TOGETHER, str(path), json.dumps(jobs), str(tmp_path / "log")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), root])},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert json.loads(done.stdout) == [0, 0, 0], done.stderr
    stored = json.loads(path.read_bytes())
    assert sorted(stored) == ["claims", "measurements"] and list(stored["claims"]) == ["c"]
    for name, seeds in (("m", range(5)), ("n", range(3))):
        kept = stored["measurements"][name]["values"]
        assert kept == {str(seed): texts(due(seed)) for seed in seeds}
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    begun = "".join((tmp_path / f"log{i}").read_text() for i in (0, 1)).count("start")
    assert begun < 10, "what one has finished the other does not measure"


def test_a_seed_that_another_process_finishes_meanwhile(house: ModuleType, path: Path) -> None:
    """In the middle of a measurement another one comes and goes."""

    def interrupted(seed: int) -> dict[Key, float]:
        if seed == 1:
            measure("m", of(like(house.table)(lambda s: due(s)), [0, 1, 2, 3]), path)
            measure("n", of(house.table), path)
        return due(seed)

    calls: list[int] = []
    counted = like(house.table)(lambda seed: calls.append(seed) or interrupted(seed))
    assert measure("m", of(counted, range(5)), path) == {seed: due(seed) for seed in range(5)}
    assert calls == [0, 1, 4]
    stored = json.loads(path.read_bytes())
    assert sorted(stored["measurements"]) == ["m", "n"] and "unfinished" not in stored
    assert sorted(stored["measurements"]["m"]["values"]) == list("01234")


# Claims -----------------------------------------------------------------------------------------


def test_rows_come_back_in_their_order(house: ModuleType, path: Path) -> None:
    assert read_ledger(path) == []
    measure("m", of(house.table, [10, 2, 3]), path)
    claims = [CLAIM, replace(CLAIM, id="b", statement="é", better="higher", favoured=B, other=A)]
    record(claims, path)
    rows = read_ledger(path)
    assert [row.claim for row in rows] == claims
    assert rows[0].values == {seed: due(seed) for seed in (2, 3, 10)}
    assert not rows[0].stale and rows[0].verdict.words == "undecided"
    first = path.read_bytes()
    record(claims, path)
    assert path.read_bytes() == first
    record(claims[1:], path)
    assert [row.claim for row in read_ledger(path)] == claims[1:]


@given(
    st.dictionaries(
        st.integers(0, 10**6),
        st.fixed_dictionaries({A: st.floats(-1e9, 1e9), B: st.floats(-1e9, 1e9)}),
        min_size=3,
        max_size=5,
    )
)
def test_numbers_come_back_to_the_last_bit(values: dict[int, dict[Key, float]]) -> None:
    def table(seed: int) -> dict[Key, float]:
        return values[seed]

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        patch.setattr(ledger, "_conditions", lambda function: {"module": "m", "function": "f"})
        patch.setattr(ledger.os, "fsync", lambda number: None)
        target = Path(folder) / "a.json"
        assert measure("m", of(table, list(values)), target) == values
        record([CLAIM], target)
        assert read_ledger(target)[0].values == values


def test_all_ledgers_in_the_order_of_the_contents(house: ModuleType, folio: Path) -> None:
    contents = folio / "site" / "contents.toml"
    contents.write_text("".join(f'[[page]]\nname = "{n}"\n' for n in ("09_b", "05_a", "01_poses")))
    assert all_rows(folio) == {}
    for name in ("05_a", "09_b"):
        measure("m", of(house.table), folio / f"ch{name}" / "claims.json")
        record([CLAIM], folio / f"ch{name}" / "claims.json")
    rows = all_rows(folio)
    assert list(rows) == ["09_b", "05_a"]
    assert rows["05_a"] == read_ledger(folio / "ch05_a" / "claims.json")
    (folio / "ch05_a").rename(folio / "ch06_a")
    with pytest.raises(ValueError, match=r"book: expected a page for each ledger, .*\['ch06_a'\]"):
        all_rows(folio)
    (folio / "ch06_a").rename(folio / "ch05_a")
    (folio / "ch05_a" / "claims.json").write_text("{")
    with pytest.raises(ValueError, match=r"ch05_a.claims\.json: damaged ledger"):
        all_rows(folio)
    contents.unlink()
    with pytest.raises(ValueError, match=r"contents\.toml: no table of contents"):
        all_rows(folio)


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda h, p: measure("m", of(h.table, range(2)), p),
            "seeds: expected at least 3, each once, got [0, 1]",
        ),
        (
            lambda h, p: measure("m", of(h.table, [0, 1, 2, 2]), p),
            "seeds: expected at least 3, each once, got [0, 1, 2, 2]",
        ),
        (
            lambda h, p: measure("m", of(h.table, [0, 1, -2]), p),
            "seeds: expected an integer of at least 0, got -2",
        ),
        (
            lambda h, p: measure("m", of(h.table, [0, 1, 0.5]), p),
            "seeds: expected an integer of at least 0, got 0.5",
        ),
        (
            lambda h, p: measure("m", of(len), p),
            "function: expected a plain function, got builtin_function_or_method",
        ),
        (lambda h, p: measure("m", of(3), p), "function: expected a plain function, got int"),
        (
            lambda h, p: measure("m", of(h.nested), p),
            "function: expected a function at the top level of a module, got <lambda> of "
            "folio.ch01_poses.measured",
        ),
        (
            lambda h, p: measure("m", of(in_a_notebook()), p),
            "function: expected a function from a module that can be imported, "
            "got typed of __main__",
        ),
        (
            lambda h, p: measure("m", of(in_a_notebook("posecore")), p),
            "function: expected a function from a module that can be imported, "
            "got typed of posecore",
        ),
        (
            lambda h, p: measure("m", of(h.table, data=("specks/valid",)), p),
            "split: expected one of 'train', 'test', got 'valid'",
        ),
        (
            lambda h, p: record([CLAIM], p),
            "claims: expected a measurement of [] for 'c', got 'm'",
        ),
    ],
)
def test_refused(call: Callable[..., object], message: str, house: ModuleType, path: Path) -> None:
    with pytest.raises(ValueError) as caught:
        call(house, path)
    assert str(caught.value) == message
    assert not path.exists()


def in_a_notebook(module: str = "__main__") -> Callable[[int], dict]:
    space: dict = {"__name__": module}
    exec(compile("def typed(seed): return {}", "<ipython-input-1>", "exec"), space)
    return space["typed"]


def test_claims_that_do_not_fit_are_refused(house: ModuleType, path: Path) -> None:
    measure("m", of(house.table), path)
    before = path.read_bytes()
    side = replace(CLAIM, id="d", other=Key("nothing"))
    for claims, message in (
        ([CLAIM, CLAIM], "claims: expected ids that differ, got 'c' twice"),
        (
            [CLAIM, side],
            "claims: expected sides of ['method=a', 'method=b'] for 'd', got 'method=nothing'",
        ),
    ):
        with pytest.raises(ValueError) as caught:
            record(claims, path)
        assert str(caught.value) == message
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "3",
        '{"claims": 3}',
        '{"claims": {"c": {}}}',
        '{"claims": {"c": {"place": 0, "id": "c"}}}',
        '{"measurements": {"m": {}}}',
        '{"measurements": {"m": 3}}',
        '{"measurements": {"m": {"values": {"0": {"a": NaN}}}}}',
        '{"measurements": {"m": {"values": {"x": {"a": 1}}}}}',
        '{"unfinished": {"m": {"values": {"0": 3}}}}',
        "[" * 100_000,
    ],
)
def test_a_damaged_ledger_is_named_and_left_alone(text: str, house: ModuleType, path: Path) -> None:
    path.parent.mkdir()
    path.write_text(text)
    for read in (read_ledger, require_ledger):
        with pytest.raises(ValueError, match=r"claims\.json: damaged ledger: "):
            read(path)
    if "claims" not in text:  # claims are made anew by `record`
        for call in (
            lambda: measure("m", of(house.table), path),
            lambda: record([CLAIM], path),
        ):
            with pytest.raises(ValueError, match=r"claims\.json: damaged ledger: "):
                call()
        assert path.read_text() == text and house.calls == []


def test_a_ledger_cut_off_anywhere_is_damaged(house: ModuleType, path: Path) -> None:
    measure("m", of(house.table), path)
    record([CLAIM], path)
    require_ledger(path)
    whole = path.read_bytes()
    for length in range(0, len(whole) - 2, 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="damaged ledger"):
            require_ledger(path)
