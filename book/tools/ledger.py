"""The ledger: a JSON file of claims and of the measurements that they rest on.

A measurement is a function of a seed that returns named numbers; one measurement may serve several
claims, as one table of a paper does:

    MEASUREMENTS = {"table_iv": Measurement(table_iv, range(5))}  # {Key("6d"): 0.55, ...}
    measure("table_iv", MEASUREMENTS["table_iv"], path)
    record([Claim(...)], path)
    ledger_table(read_ledger(path))

Several processes may write a ledger at once: each change is made in what is there by then.
"""

from __future__ import annotations

import inspect
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import torch

import posecore
from book.tools.claims import FEWEST_SEEDS, Claim, Row
from book.tools.contents import pages
from book.tools.dependencies import code_of, dependencies, reasons
from book.tools.keys import Key
from data_tools.storage.locks import file_lock
from posecore.arrays import fail, require_integer, require_number
from posecore.files import write_bytes
from posecore.fingerprint import HOME
from posecore.fingerprint.modules import find_module
from posecore.scale import scale

__all__ = [
    "KEPT",
    "Measurement",
    "all_rows",
    "changing",
    "measure",
    "read_file",
    "read_ledger",
    "record",
    "require_ledger",
    "require_named",
    "stale",
]

KEPT = {"data", "definitions", "numbers"}
"""What an entry says of what it depends on; older ones say something else."""


class Measurement(NamedTuple):
    """What a chapter measures.

    Attributes:
        function: `function(seed)` returns numbers by key, the same keys for every seed.
        seeds: at least three.
        data: the datasets that it opens, "world/split".
        timed: whether the numbers are times, other ones in every run.
        witness: `witness(seed)` returns numbers and digests by name that differ with all that
            decides the numbers of `function`, where those say too little at `tiny`: recalls of
            networks that have hardly learnt are all 0. What confirms a measurement compares both.
    """

    function: Callable[[int], Mapping[Key, float]]
    seeds: Sequence[int]
    data: tuple[str, ...] = ()
    timed: bool = False
    witness: Callable[[int], Mapping[str, object]] | None = None


def measure(
    name: str,
    measurement: Measurement,
    path: Path,
    say: Callable[[str], None] = lambda line: None,
) -> dict[int, dict[Key, float]]:
    """Call the function for every seed and keep the results in the ledger at `path`.

    Every finished seed is written at once, so a measurement that was killed goes on where it was.
    Results count only under the conditions they were made in: definitions, datasets, scale, the
    library's version and the machine. Where one has changed, all seeds are measured again; the old
    results stay in the ledger until the new ones are whole. Of a seed that another process finishes
    meanwhile, its result is taken.

    Args:
        name: of the measurement in the ledger.
        measurement: its function stands at the top level of a module that can be imported by name,
            and returns finite numbers.
        path: the JSON file, made where there is none.
        say: is told how long each seed took.

    Returns:
        seed -> key -> number.

    Raises:
        ValueError: for such a function, result or seeds as above are not, or a damaged ledger.
    """
    wanted = [require_integer("seeds", seed, low=0) for seed in measurement.seeds]
    if len(set(wanted)) < max(FEWEST_SEEDS, len(wanted)):
        fail("seeds", f"at least {FEWEST_SEEDS}, each once", wanted)
    conditions = _conditions(measurement)
    values: dict[str, Any] = {}
    more: dict[str, Any] = {"seconds": {}}  # what is no condition
    for seed in wanted:
        _take(read_file(path), name, conditions, values, more)
        if str(seed) in values:
            continue
        start = time.perf_counter()
        numbers = _checked(measurement.function(seed), values, seed)
        seconds = round(time.perf_counter() - start, 1)
        say(f"  seed {seed}: {seconds} s")
        values[str(seed)], more["seconds"][str(seed)] = numbers, seconds
        with changing(path) as ledger:
            _take(ledger, name, conditions, values, more)
            ledger["unfinished"][name] = {**conditions, **more, "values": values}
    with changing(path) as ledger:
        _take(ledger, name, conditions, values, more)
        values = {str(seed): values[str(seed)] for seed in wanted}
        ledger["unfinished"].pop(name, None)
        ledger["measurements"][name] = {**conditions, **more, "values": values}
    return {seed: _keyed(values[str(seed)]) for seed in wanted}


def _take(
    ledger: Mapping[str, Mapping[str, Any]],
    name: str,
    conditions: Mapping[str, Any],
    values: dict[str, Any],
    more: dict[str, Any],
) -> None:
    """Add what a ledger holds of a measurement that was made under the same conditions."""
    for part in ("measurements", "unfinished"):
        entry = ledger[part].get(name, {})
        # A function may move to another module, as what it reaches may.
        if all(entry.get(key) == conditions[key] for key in conditions.keys() - {"module"}):
            values |= entry["values"]
            more["seconds"] |= entry.get("seconds", {})
            more |= {key: entry[key] for key in ("tiny", "confirmed") if key in entry}


def _conditions(measurement: Measurement) -> dict[str, Any]:
    plain = require_named("function", measurement.function)
    return {
        "module": plain.__module__,
        "function": plain.__qualname__,
        **dependencies(plain, measurement.data, scale()),
        "scale": scale(),
        "version": posecore.__version__,
        "machine": machine(),
    }


def require_named(name: str, value: object) -> Callable[..., Any]:
    """A function without its decorators, which its name finds again.

    Raises:
        ValueError: if it is none, or stands inside another one or a class, or has no name.
    """
    plain = inspect.unwrap(value) if callable(value) else value
    if not inspect.isfunction(plain):
        fail(name, "a plain function", type(plain).__name__)
    where = f"{plain.__qualname__} of {plain.__module__}"
    if not plain.__qualname__.isidentifier():
        fail(name, "a function at the top level of a module", where)
    module = find_module(plain.__module__)
    if module is None or plain.__qualname__ not in module.definitions:
        fail(name, "a function from a module that can be imported", where)
    return plain


def machine() -> str:
    """The machine and what runs on it, in words."""
    parts = [platform.system(), platform.machine(), f"{os.cpu_count()} cores"]
    if torch.cuda.is_available():
        parts.append(torch.cuda.get_device_name())
    return ", ".join([*parts, f"Python {platform.python_version()}", f"torch {torch.__version__}"])


def _checked(result: Any, values: Mapping[str, Any], seed: int) -> dict[str, float]:
    where = f"function(seed={seed})"
    if not isinstance(result, Mapping) or not result:
        fail(where, "a dict of numbers", repr(result))
    for key in result:
        if not isinstance(key, Key):
            fail(where, "a Key for each number", repr(key))
    numbers = {str(key): require_number(f"{where}[{key}]", v) for key, v in result.items()}
    names = set(next(iter(values.values()), numbers))
    if set(numbers) != names:
        fail(where, f"the keys {sorted(names)} as for the other seeds", sorted(numbers))
    return numbers


def _keyed(numbers: Mapping[str, float]) -> dict[Key, float]:
    return {Key.parse(name): value for name, value in numbers.items()}


def record(claims: Iterable[Claim], path: Path) -> None:
    """Put claims into the ledger, in place of those that are there; measurements stay.

    Raises:
        ValueError: if two claims have one id, or a claim's measurement or sides are not there.
    """
    with changing(path) as ledger:
        entries: dict[str, Any] = {}
        for claim in claims:
            if claim.id in entries:
                fail("claims", "ids that differ", f"{claim.id!r} twice")
            measured = ledger["measurements"].get(claim.measurement)
            if measured is None:
                there = sorted(ledger["measurements"])
                fail(
                    "claims", f"a measurement of {there} for {claim.id!r}", repr(claim.measurement)
                )
            names = next(iter(measured["values"].values()))
            for side in (claim.favoured, claim.other):
                if str(side) not in names:
                    fail("claims", f"sides of {sorted(names)} for {claim.id!r}", repr(str(side)))
            entries[claim.id] = {**claim.entry(), "place": len(entries)}
        ledger["claims"] = entries


def read_ledger(path: Path) -> list[Row]:
    """The rows of a ledger in the order they were recorded; none where there is no file.

    A row is stale if a definition that its measurement reached, or a dataset that it declares, has
    changed.

    Raises:
        ValueError: if the file is damaged.
    """
    return _rows(path, stale)


def require_ledger(path: Path) -> None:
    """Refuse a ledger that cannot be read; whether its rows are stale is not asked.

    Raises:
        ValueError: if the file is damaged.
    """
    _rows(path, lambda conditions: ())


def _rows(path: Path, changed: Callable[[Mapping[str, Any]], tuple[str, ...]]) -> list[Row]:
    ledger = read_file(path)
    known: dict[str, tuple[str, ...]] = {}
    rows = []
    try:
        for entry in sorted(ledger["claims"].values(), key=lambda entry: entry["place"]):
            claim = Claim.from_entry({k: v for k, v in entry.items() if k != "place"})
            conditions = dict(ledger["measurements"][claim.measurement])
            values = {int(s): _keyed(n) for s, n in conditions.pop("values").items()}
            if claim.measurement not in known:
                known[claim.measurement] = changed(conditions)
            rows.append(Row(claim, values, conditions, known[claim.measurement]))
            _ = rows[-1].verdict  # fails here, with the file's name, and not on the page
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: damaged ledger: {error!r}") from error
    return rows


def stale(conditions: Mapping[str, Any], made: str = "measured") -> tuple[str, ...]:
    """What has changed since a result was made; nothing if it is fresh.

    Args:
        conditions: an entry of `measurements` in a ledger, or what is kept of a training.
        made: how, in a word.

    Raises:
        KeyError, TypeError: if it is no such entry.
    """
    function = f"{conditions['module']}:{conditions['function']}"
    if not conditions.keys() >= KEPT:
        return (f"how it was {made} is not kept",)
    data = [f"{n}/{split}" for n, world in conditions["data"].items() for split in world["splits"]]
    try:
        code = code_of(function, data)
    except ValueError as error:
        return (str(error) if "no Python" in str(error) else f"{function} is gone",)
    try:
        return reasons(conditions, dependencies(function, data, conditions["scale"], code), code)
    except ValueError as error:  # a world or a split is gone
        return (f"{function}: {error}",)


def all_rows(book: Path = HOME / "book") -> dict[str, list[Row]]:
    """The rows of all ledgers, by page, in the order of the table of contents.

    Args:
        book: the folder of a book: `site/contents.toml` names its pages, `chNN_name/claims.json`
            are their ledgers. Found beside the library, wherever a notebook runs.

    Returns:
        page -> its rows, without pages that have none; `ledger_table` shows them.

    Raises:
        ValueError: if there is no table of contents, a ledger is damaged, or belongs to no page.
    """
    files = {page.name: Path(book) / page.package / "claims.json" for page in pages(Path(book))}
    if strays := sorted(set(Path(book).glob("ch*/claims.json")) - set(files.values())):
        names = [path.parent.name for path in strays]
        fail("book", "a page for each ledger", f"{names} without one")
    rows = {page: read_ledger(path) for page, path in files.items()}
    return {page: found for page, found in rows.items() if found}


# The file -----------------------------------------------------------------------------------------


def read_file(path: Path) -> dict[str, dict[str, Any]]:
    """A ledger as it is on disk: "claims", "measurements" and "unfinished", each by name.

    Raises:
        ValueError: if the file is damaged.
    """
    ledger: dict[str, dict[str, Any]] = {"claims": {}, "measurements": {}, "unfinished": {}}
    if not Path(path).exists():
        return ledger
    try:
        found = json.loads(Path(path).read_bytes(), parse_constant=_refuse)
        for part in ("measurements", "unfinished"):
            for entry in found.get(part, {}).values():
                for seed, numbers in entry["values"].items():
                    require_integer("seed", int(seed), low=0)
                    for number in numbers.values():
                        require_number("value", number)
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: damaged ledger: {error!r}") from error
    return ledger | found


def _refuse(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


@contextmanager
def changing(path: Path) -> Iterator[dict[str, dict[str, Any]]]:
    """A ledger to be changed, alone: it is written at the end, unless there is an error.

    Raises:
        ValueError: if the file is damaged.
        OSError: if it cannot be written; the old one is untouched.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with file_lock(path):
        ledger = read_file(path)
        yield ledger
        _write_file(path, ledger)


def _write_file(path: Path, ledger: Mapping[str, Mapping[str, Any]]) -> None:
    """The same ledger gives the same bytes, and the old or the new file is there, never a part."""
    content = {key: value for key, value in ledger.items() if value}
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_bytes(path, text.encode() + b"\n")
