"""The ledger: a JSON file of claims and of the measurements that they rest on.

A measurement is a function of a seed that returns named numbers; one measurement may serve several
claims, as one table of a paper does:

    measure("table_iv", table_iv, seeds=range(5), path=path)  # {"quaternion": 2.5, "6D": 0.55}
    record([Claim("iv_6d", "6D beats quaternions", "Table IV", "lower", "6D", "quaternion",
                  (0.55, 2.5), "table_iv", "degrees")], path)
    ledger_table(read_ledger(path))

One process at a time may write a ledger.
"""

from __future__ import annotations

import inspect
import json
import os
import platform
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

import torch

import posecore
from book.tools.claims import FEWEST_SEEDS, Claim, Row
from posecore.arrays import fail, require_integer, require_number
from posecore.files import write_bytes
from posecore.fingerprint import HOME, code_hash, imported_modules
from posecore.scale import scale

__all__ = ["all_rows", "measure", "read_ledger", "record"]


def measure(
    measurement: str,
    function: Callable[[int], Mapping[str, float]],
    seeds: Sequence[int],
    path: Path,
) -> dict[int, dict[str, float]]:
    """Call `function(seed)` for every seed and keep the results in the ledger at `path`.

    Every finished seed is written at once, so a measurement that was killed goes on where it was.
    Results count only under the conditions they were made in: the code (`code_hash` of the
    function's module), the scale, the library's version and the machine. Where one has changed, all
    seeds are measured again; the old results stay in the ledger until the new ones are whole.

    Args:
        measurement: its name in the ledger.
        function: a function of a module that can be imported by name; returns finite numbers by
            name, the same names for every seed.
        seeds: at least three.
        path: the JSON file, made where there is none.

    Returns:
        seed -> name -> number.

    Raises:
        ValueError: for such a function, result or seeds as above are not, or a damaged ledger.
    """
    wanted = [require_integer("seeds", seed, low=0) for seed in seeds]
    if len(set(wanted)) < max(FEWEST_SEEDS, len(wanted)):
        fail("seeds", f"at least {FEWEST_SEEDS}, each once", wanted)
    conditions = _conditions(function)
    ledger = _read(path)
    values: dict[str, Any] = {}
    for part in ("measurements", "unfinished"):
        entry = ledger[part].get(measurement, {})
        if {key: entry.get(key) for key in conditions} == conditions:
            values.update(entry["values"])
    for seed in wanted:
        if str(seed) not in values:
            values[str(seed)] = _checked(function(seed), values, seed)
            ledger["unfinished"][measurement] = {**conditions, "values": values}
            _write(path, ledger)
    values = {str(seed): values[str(seed)] for seed in wanted}
    ledger["unfinished"].pop(measurement, None)
    ledger["measurements"][measurement] = {**conditions, "values": values}
    _write(path, ledger)
    return {seed: values[str(seed)] for seed in wanted}


def _conditions(function: Callable[..., Any]) -> dict[str, str]:
    plain = inspect.unwrap(function)
    if not inspect.isfunction(plain):
        fail("function", "a plain function", type(function).__name__)
    module = plain.__module__
    try:
        files = imported_modules(module)
        same = os.path.samefile(files[module], plain.__code__.co_filename)
    except (KeyError, OSError, ValueError):
        same = False
    if not same:
        fail("function", "one from a module that can be imported", f"{plain.__name__} of {module}")
    return {
        "module": module,
        "function": plain.__qualname__,
        "code": code_hash(module),
        "scale": scale(),
        "version": posecore.__version__,
        "machine": _machine(),
    }


def _machine() -> str:
    parts = [platform.system(), platform.machine(), f"{os.cpu_count()} cores"]
    if torch.cuda.is_available():
        parts.append(torch.cuda.get_device_name())
    return ", ".join([*parts, f"Python {platform.python_version()}", f"torch {torch.__version__}"])


def _checked(result: Any, values: Mapping[str, Any], seed: int) -> dict[str, float]:
    where = f"function(seed={seed})"
    if not isinstance(result, Mapping) or not result:
        fail(where, "a dict of numbers", repr(result))
    numbers = {str(name): require_number(f"{where}[{name!r}]", v) for name, v in result.items()}
    names = set(next(iter(values.values()), numbers))
    if set(numbers) != names:
        fail(where, f"the names {sorted(names)} as for the other seeds", sorted(numbers))
    return numbers


def record(claims: Iterable[Claim], path: Path) -> None:
    """Put claims into the ledger, in place of those that are there; measurements stay.

    Raises:
        ValueError: if two claims have one id, or a claim's measurement or sides are not there.
    """
    ledger, entries = _read(path), {}
    for claim in claims:
        if claim.id in entries:
            fail("claims", "ids that differ", f"{claim.id!r} twice")
        measured = ledger["measurements"].get(claim.measurement)
        if measured is None:
            there = sorted(ledger["measurements"])
            fail("claims", f"a measurement of {there} for {claim.id!r}", repr(claim.measurement))
        names = next(iter(measured["values"].values()))
        for side in (claim.favoured, claim.other):
            if side not in names:
                fail("claims", f"sides of {sorted(names)} for {claim.id!r}", repr(side))
        entries[claim.id] = {**asdict(claim), "place": len(entries)}
    ledger["claims"] = entries
    _write(path, ledger)


def read_ledger(path: Path) -> list[Row]:
    """The rows of a ledger in the order they were recorded; none where there is no file.

    A row is stale if the code that measured it, or anything of ours that it imports, has changed.

    Raises:
        ValueError: if the file is damaged.
    """
    ledger = _read(path)
    codes: dict[str, str | None] = {}
    rows = []
    try:
        for entry in sorted(ledger["claims"].values(), key=lambda entry: entry["place"]):
            fields = {k: tuple(v) if k == "paper" else v for k, v in entry.items() if k != "place"}
            claim = Claim(**fields)
            conditions = dict(ledger["measurements"][claim.measurement])
            values = {int(seed): numbers for seed, numbers in conditions.pop("values").items()}
            module = conditions["module"]
            if module not in codes:
                codes[module] = _code_now(module)
            rows.append(Row(claim, values, conditions, codes[module] != conditions["code"]))
            _ = rows[-1].verdict  # fails here, with the file's name, and not on the page
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: damaged ledger: {error!r}") from error
    return rows


def all_rows(book: Path = HOME / "book") -> dict[str, list[Row]]:
    """The rows of all ledgers, by page, in the order of the table of contents.

    Args:
        book: the folder of a book: `site/contents.toml` names its pages, `claims/NAME.json` are
            their ledgers. Found beside the library, wherever a notebook runs.

    Returns:
        page -> its rows, without pages that have none; `ledger_table` shows them.

    Raises:
        ValueError: if there is no table of contents, a ledger is damaged, or belongs to no page.
    """
    contents = Path(book) / "site" / "contents.toml"
    try:
        pages = [page["name"] for page in tomllib.loads(contents.read_text("utf-8"))["page"]]
    except (KeyError, OSError, TypeError, ValueError) as error:
        raise ValueError(f"book: expected {contents} to name its pages: {error!r}") from error
    folder = Path(book) / "claims"
    if strays := {path.stem for path in folder.glob("*.json")} - set(pages):
        fail("book", f"a page for each ledger in {folder}", f"{sorted(strays)} without one")
    rows = {page: read_ledger(folder / f"{page}.json") for page in pages}
    return {page: found for page, found in rows.items() if found}


def _code_now(module: str) -> str | None:
    try:
        return code_hash(module)
    except ValueError:  # it is gone, or no Python any more
        return None


def _read(path: Path) -> dict[str, dict[str, Any]]:
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


def _write(path: Path, ledger: dict[str, dict[str, Any]]) -> None:
    """The same ledger gives the same bytes, and the old or the new file is there, never a part."""
    content = {key: value for key, value in ledger.items() if value}
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, text.encode() + b"\n")
