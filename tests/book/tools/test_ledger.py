"""The ledger: measured once, kept through a kill, stale when the code has changed."""

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

import posecore
from book.tools.claims import Claim
from book.tools.ledger import all_rows, measure, read_ledger, record
from posecore import fingerprint, ledger

CLAIM = Claim("c", "a is lower", "Table 1", "lower", "a", "b", (1.0, None), "m", "mm")
MEASURED = """
import os
import time
from measured_house.helper import SHIFT

LOG = os.environ.get("MEASURED_LOG")
calls = []

def note(text):
    if LOG:
        with open(LOG, "a") as file:
            file.write(text + "\\n")

def table(seed):
    calls.append(seed)
    note(f"start {seed}")
    time.sleep(0.05 if LOG else 0)
    note(f"end {seed}")
    return {"a": seed / 3 + SHIFT, "b": 2 * seed / 3 + 1.5}

nested = lambda seed: table(seed)
"""


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    folder = tmp_path / "measured_house"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "helper.py").write_text("SHIFT = 0.125\n")
    (folder / "chapter.py").write_text(MEASURED)
    monkeypatch.delenv("POSECORE_SCALE", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(fingerprint, "PACKAGES", ("measured_house",))
    importlib.invalidate_caches()
    yield importlib.import_module("measured_house.chapter")
    for name in [name for name in sys.modules if name.startswith("measured_house")]:
        del sys.modules[name]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "claims" / "05.json"


def due(seed: int) -> dict[str, float]:
    return {"a": seed / 3 + 0.125, "b": 2 * seed / 3 + 1.5}


# Measuring --------------------------------------------------------------------------------------


def test_every_seed_is_measured_once(house: ModuleType, path: Path) -> None:
    result = measure("m", house.table, range(3), path)
    assert result == {seed: due(seed) for seed in range(3)}
    first = path.read_bytes()
    assert measure("m", house.table, range(3), path) == result
    assert house.calls == [0, 1, 2] and path.read_bytes() == first
    assert list(measure("m", house.table, [4, 2, 1, 0], path)) == [4, 2, 1, 0]
    assert house.calls == [0, 1, 2, 4]
    assert [file.name for file in path.parent.iterdir()] == ["05.json"]


def test_what_is_stored(house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    measure("m", house.table, range(3), path)
    record([CLAIM], path)
    text = path.read_text(encoding="utf-8")
    stored = json.loads(text)
    assert text == json.dumps(stored, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    assert set(stored) == {"claims", "measurements"}
    entry = stored["measurements"]["m"]
    assert entry.pop("values") == {str(seed): due(seed) for seed in range(3)}
    machine = entry.pop("machine")
    assert f"{os.cpu_count()} cores" in machine and "Python 3." in machine
    assert entry == {
        "module": "measured_house.chapter",
        "function": "table",
        "code": fingerprint.code_hash("measured_house.chapter"),
        "scale": "tiny",
        "version": posecore.__version__,
    }


def test_a_decorated_function_and_a_lambda_of_a_module(house: ModuleType, path: Path) -> None:
    @wraps(house.table)
    def decorated(seed: int) -> dict[str, float]:
        return house.table(seed)

    assert measure("m", decorated, range(3), path)[2] == due(2)
    assert measure("n", house.nested, range(3), path)[2] == due(2)
    assert set(json.loads(path.read_bytes())["measurements"]) == {"m", "n"}


@pytest.mark.parametrize("change", ["scale", "code", "machine", "version", "function"])
def test_other_conditions_measure_again_and_keep_the_old_until_whole(
    change: str, house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure("m", house.table, range(3), path)
    old = json.loads(path.read_bytes())["measurements"]["m"]
    function = house.table
    if change == "scale":
        monkeypatch.setenv("POSECORE_SCALE", "tiny")
    elif change == "code":
        Path(house.__file__).with_name("helper.py").write_text("SHIFT = 0.125  # a comment\n")
    elif change == "machine":
        monkeypatch.setattr(ledger.os, "cpu_count", lambda: 99)
    elif change == "version":
        monkeypatch.setattr(posecore, "__version__", "9.9")
    else:
        function = house.nested
    calls = []

    def fails(seed: int) -> dict[str, float]:
        calls.append(seed)
        if seed == 2 and len(calls) == 3:
            raise KeyboardInterrupt
        return due(seed)

    wrapped = wraps(function)(fails)
    with pytest.raises(KeyboardInterrupt):
        measure("m", wrapped, range(3), path)
    stored = json.loads(path.read_bytes())
    assert stored["measurements"]["m"] == old
    assert list(stored["unfinished"]["m"]["values"]) == ["0", "1"]
    measure("m", wrapped, range(3), path)
    assert calls == [0, 1, 2, 2]
    stored = json.loads(path.read_bytes())
    assert stored["measurements"]["m"] != old and "unfinished" not in stored


def test_results_that_are_not_as_they_should_be(house: ModuleType, path: Path) -> None:
    for result, message in (
        (3.0, r"function\(seed=0\): expected a dict of numbers, got 3.0"),
        ({}, r"function\(seed=0\): expected a dict of numbers, got {}"),
        ({"a": float("nan")}, r"function\(seed=0\)\['a'\]: expected a finite number, got nan"),
        ({"a": None}, r"function\(seed=0\)\['a'\]: expected a finite number, got None"),
    ):
        with pytest.raises(ValueError, match=message):
            measure("m", wraps(house.table)(lambda seed, r=result: r), range(3), path)
    assert not path.exists()
    names = wraps(house.table)(lambda seed: {"a": 1.0} if seed < 2 else {"b": 1.0})
    with pytest.raises(ValueError, match=r"seed=2\): expected the names \['a'\] as for the other"):
        measure("m", names, range(3), path)
    assert list(json.loads(path.read_bytes())["unfinished"]["m"]["values"]) == ["0", "1"]


def test_a_disk_that_refuses_leaves_the_old_ledger(
    house: ModuleType, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure("m", house.table, range(3), path)
    before = path.read_bytes()

    def full(*names: object) -> None:
        raise OSError(28, "No space left on device")

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(ledger.os, name, full)
            with pytest.raises(OSError, match="No space"):
                measure("m", house.table, range(4), path)
        assert path.read_bytes() == before
    assert measure("m", house.table, range(4), path)[3] == due(3)


# Killed -----------------------------------------------------------------------------------------

PROGRAM = """
import json, os, sys, time
from posecore import fingerprint
fingerprint.PACKAGES = ("measured_house",)
from book.tools.ledger import measure
from measured_house import chapter

def wait(*arguments):
    chapter.note("waiting")
    time.sleep(60)

children = []
for target, log, where in json.loads(sys.argv[1]):  # one import of torch serves all
    child = os.fork()
    if not child:
        chapter.LOG = log
        if where:
            setattr(os, where, wait)
        measure("m", chapter.table, range(5), target)
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


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills by signal, as POSIX has them")
def test_a_killed_measurement_goes_on(house: ModuleType, tmp_path: Path, path: Path) -> None:
    measure("m", house.table, range(5), path)
    whole = path.read_bytes()
    root = str(Path(posecore.__file__).parents[1])
    runs = [
        (tmp_path / f"killed{i}" / "05.json", tmp_path / f"log{i}", line, delay, wait)
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
        measure("m", house.table, range(5), target)
        assert house.calls == [seed for seed in range(5) if seed not in finished]
        assert target.read_bytes() == whole
        # A killed write may leave its unfinished copy, under a name that nothing reads.
        names = {file.name for file in target.parent.iterdir()}
        assert {name for name in names if not name.endswith(".tmp")} == {"05.json"}


# Claims and staleness ---------------------------------------------------------------------------


def test_rows_come_back_in_their_order(house: ModuleType, path: Path) -> None:
    assert read_ledger(path) == []
    measure("m", house.table, [10, 2, 3], path)
    claims = [CLAIM, Claim("b", "é", "text", "higher", "b", "a", (None, None), "m")]
    record(claims, path)
    rows = read_ledger(path)
    assert [row.claim for row in rows] == claims
    assert rows[0].values == {seed: due(seed) for seed in (2, 3, 10)}
    assert not rows[0].stale and rows[0].verdict.words == "holds in part"
    first = path.read_bytes()
    record(claims, path)
    assert path.read_bytes() == first
    record(claims[1:], path)
    assert [row.claim for row in read_ledger(path)] == claims[1:]


def test_a_row_is_stale_once_the_code_has_changed(house: ModuleType, path: Path) -> None:
    measure("m", house.table, range(3), path)
    record([CLAIM], path)
    helper = Path(house.__file__).with_name("helper.py")
    text = helper.read_text()

    def stale() -> bool:
        return read_ledger(path)[0].stale

    assert not stale()
    for change in (text + "\n", text.replace("125", "126"), "no python ("):
        helper.write_text(change)
        assert stale()
        helper.write_text(text)
        assert not stale()
    helper.unlink()
    assert stale()
    helper.write_text(text)
    helper.with_name("unrelated.py").write_text("x = 1\n")
    assert not stale()
    Path(house.__file__).unlink()
    assert stale()


@given(
    st.dictionaries(
        st.integers(0, 10**6),
        st.fixed_dictionaries({"a": st.floats(-1e9, 1e9), "b": st.floats(-1e9, 1e9)}),
        min_size=3,
        max_size=5,
    )
)
def test_numbers_come_back_to_the_last_bit(values: dict[int, dict[str, float]]) -> None:
    def table(seed: int) -> dict[str, float]:
        return values[seed]

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        patch.setattr(ledger, "_conditions", lambda function: {"module": "posecore", "code": "0"})
        patch.setattr(ledger.os, "fsync", lambda number: None)
        target = Path(folder) / "a.json"
        assert measure("m", table, list(values), target) == values
        record([CLAIM], target)
        assert read_ledger(target)[0].values == values


def test_all_ledgers_in_the_order_of_the_contents(house: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    contents = tmp_path / "site" / "contents.toml"
    contents.write_text("".join(f'[[page]]\nname = "{name}"\n' for name in ("b", "05", "a")))
    assert all_rows(tmp_path) == {}
    for name in ("05", "b"):
        measure("m", house.table, range(3), tmp_path / "claims" / f"{name}.json")
        record([CLAIM], tmp_path / "claims" / f"{name}.json")
    rows = all_rows(tmp_path)
    assert list(rows) == ["b", "05"]
    assert rows["05"] == read_ledger(tmp_path / "claims" / "05.json")
    record([CLAIM], tmp_path / "claims" / "05.json")
    (tmp_path / "claims" / "05.json").rename(tmp_path / "claims" / "06.json")
    with pytest.raises(ValueError, match=r"book: expected a page for each ledger in .*\['06'\]"):
        all_rows(tmp_path)
    (tmp_path / "claims" / "06.json").rename(tmp_path / "claims" / "a.json")
    (tmp_path / "claims" / "a.json").write_text("{")
    with pytest.raises(ValueError, match=r"a\.json: damaged ledger"):
        all_rows(tmp_path)
    for text in ("page = 3", "[", ""):
        contents.write_text(text)
        with pytest.raises(ValueError, match=r"book: expected .*contents\.toml to name its pages"):
            all_rows(tmp_path)
    contents.unlink()
    with pytest.raises(ValueError, match=r"book: expected .*contents\.toml to name its pages"):
        all_rows(tmp_path)


def test_the_ledgers_of_the_book_itself() -> None:
    assert all(rows for rows in all_rows().values())


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda h, p: measure("m", h.table, range(2), p),
            "seeds: expected at least 3, each once, got [0, 1]",
        ),
        (
            lambda h, p: measure("m", h.table, [0, 1, 2, 2], p),
            "seeds: expected at least 3, each once, got [0, 1, 2, 2]",
        ),
        (
            lambda h, p: measure("m", h.table, [0, 1, -2], p),
            "seeds: expected an integer of at least 0, got -2",
        ),
        (
            lambda h, p: measure("m", h.table, [0, 1, 0.5], p),
            "seeds: expected an integer of at least 0, got 0.5",
        ),
        (
            lambda h, p: measure("m", len, range(3), p),
            "function: expected a plain function, got builtin_function_or_method",
        ),
        (lambda h, p: measure("m", 3, range(3), p), "function: expected a plain function, got int"),
        (
            lambda h, p: measure("m", in_a_notebook(), range(3), p),
            "function: expected one from a module that can be imported, got typed of __main__",
        ),
        (
            lambda h, p: measure("m", in_a_notebook("posecore"), range(3), p),
            "function: expected one from a module that can be imported, got typed of posecore",
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
    measure("m", house.table, range(3), path)
    before = path.read_bytes()
    side = Claim("d", "x", "y", "lower", "a", "nothing", (None, None), "m")
    for claims, message in (
        ([CLAIM, CLAIM], "claims: expected ids that differ, got 'c' twice"),
        ([CLAIM, side], "claims: expected sides of ['a', 'b'] for 'd', got 'nothing'"),
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
    with pytest.raises(ValueError, match=r"05\.json: damaged ledger: "):
        read_ledger(path)
    if "claims" not in text:  # claims are made anew by `record`
        for call in (
            lambda: measure("m", house.table, range(3), path),
            lambda: record([CLAIM], path),
        ):
            with pytest.raises(ValueError, match=r"05\.json: damaged ledger: "):
                call()
        assert path.read_text() == text and house.calls == []


def test_a_ledger_cut_off_anywhere_is_damaged(house: ModuleType, path: Path) -> None:
    measure("m", house.table, range(3), path)
    record([CLAIM], path)
    whole = path.read_bytes()
    for length in range(0, len(whole) - 2, 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="damaged ledger"):
            read_ledger(path)
