"""Stale results confirmed: what they are made from has changed, but not what comes out.

With each result is kept what the same code gave at `tiny`, seed 0, on one thread. After an edit
that should change nothing, the code of today gives the same at `tiny`, bit for bit, and so do the
datasets; then the result counts as that of today's code, "confirmed at tiny". Not confirmed can be
times, and what has other numbers at its own scale: a run at `tiny` does not see them. (Numbers that
were only moved look like others. Who has compared runs of both at that scale may say so:
`same_numbers`; the result keeps that it was said.) Where the numbers of a run at `tiny` say too
little, a measurement declares a `witness`.
"""

from __future__ import annotations

import copy
import functools
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from book.tools.checkpoints import Training, read_about, trained
from book.tools.contents import BOOK, find_page
from book.tools.dependencies import code_of, dependencies, reasons, records_digest
from book.tools.ledger import KEPT, Measurement, changing, read_file, require_named
from book.tools.measuring import declared, import_experiments, shown, write_about
from book.tools.variables import variables
from data_tools.storage.locks import file_lock
from posecore import weights

__all__ = ["confirm"]

MEANWHILE = "another process has changed it meanwhile, and nothing is kept; again?"


def confirm(page: str, book: Path = BOOK, same_numbers: bool = False) -> list[str]:
    """Confirm what is stale of a page by running it at `tiny`, and keep what runs of today give.

    What is fresh is only run where nothing of this kind of machine is kept yet: do that before an
    edit. Results that cannot be confirmed stay as they are, stale.

    Args:
        page: name or number of the page.
        book: the folder of a book.
        same_numbers: whether what seem to be other numbers at the own scale of a result are the
            same, stated elsewhere, as runs of both at that scale have shown.

    Returns:
        A line for each measurement and each network.

    Raises:
        ValueError: if the page, a declaration or a ledger is not as it should be. Errors of what is
            run come through; what was confirmed before them is kept.
    """
    found = find_page(page, book)
    folder = book / found.package
    path = folder / "claims.json"
    lines = []
    with _at_tiny():
        if not (folder / "experiments.py").is_file():
            return [f"{found.name}: nothing to confirm"]
        _, measurements, trainings = declared(import_experiments(found, book))
        for name, measurement in measurements.items():
            entry = read_file(path)["measurements"].get(name)
            if entry is None:
                lines.append(f"{found.name}, {name}: not measured yet")
                continue
            before = copy.deepcopy(entry)
            run = functools.partial(_values, measurement)
            words = _confirm(entry, measurement, run, same_numbers)
            if entry != before:
                with changing(path) as ledger:
                    if ledger["measurements"].get(name) == before:
                        ledger["measurements"][name] = entry
                    else:
                        words = MEANWHILE
            lines.append(f"{found.name}, {name}: {words}")
        for name, training in trainings.items():
            file = folder / "weights" / f"{name}.safetensors"
            if not (about := read_about(file)):
                lines.append(f"{found.name}, {file.name}: nothing says how it was trained")
                continue
            before = copy.deepcopy(about)
            run = functools.partial(_digest, training)
            words = _confirm(about, training, run, same_numbers)
            with file_lock(file):
                if read_about(file) == before:
                    write_about(file, about)
                else:
                    words = MEANWHILE
            lines.append(f"{found.name}, {file.name}: {words}")
    return lines


def _confirm(
    entry: dict[str, Any],
    declared: Measurement | Training,
    run: Callable[[], Mapping[str, Any]],
    same_numbers: bool,
) -> str:
    """Confirm one result, or keep what it gives at tiny; says in words what was done."""
    made = "measured" if isinstance(declared, Measurement) else "trained"
    if not entry.keys() >= KEPT:
        return f"stale: how it was {made} is not kept"
    function = require_named("function", declared.function)
    names = {"module": function.__module__, "function": function.__qualname__}
    code = code_of(function, declared.data)
    now = dependencies(function, declared.data, entry["scale"], code)
    changed = reasons(entry, now, code)
    kept = entry.get("tiny", {})
    here = kept.get("machine") == _machine()
    if not changed:
        entry |= names  # it may have moved to another module
    if not changed and (here or getattr(declared, "timed", False)):
        return "fresh"
    moved = same_numbers and entry["numbers"] != now["numbers"]
    why = "" if not changed else _refused(entry, now, kept, here, declared, moved)
    if why:
        return f"stale: {shown(changed)}; {why}"
    found = {
        "machine": _machine(),
        "values": dict(run()),
        "data": {source: records_digest(source) for source in declared.data},
    }
    if changed:
        if different := _differing(kept, found):
            return f"stale: {shown(changed)}; other at tiny: {different}"
        how = "tiny, and said to have the same numbers" if moved else "tiny"
        entry |= names | now | {"confirmed": how}
    entry["tiny"] = found
    return (
        f"confirmed at tiny ({shown(changed)})" if changed else "fresh; kept what it gives at tiny"
    )


def _refused(
    entry: Mapping[str, Any],
    now: Mapping[str, Any],
    kept: Mapping[str, Any],
    here: bool,
    declared: Measurement | Training,
    moved: bool,
) -> str:
    """Why a run at tiny could not confirm this, in words; empty where it could."""
    if getattr(declared, "timed", False):
        return "times cannot be confirmed"
    if not kept:
        return "nothing of before is kept to compare with"
    if len(kept["values"]) > 1 and len(set(kept["values"].values())) == 1:
        return "what is kept is one number throughout, so it needs a witness"
    if not here:
        return f"what is kept was made on another kind of machine ({kept['machine']})"
    if entry["numbers"] != now["numbers"] and not moved:
        return f"other numbers at {entry['scale']} scale"
    splits = [{n: w["splits"] for n, w in side["data"].items()} for side in (entry, now)]
    return "other data" if splits[0] != splits[1] else ""


def _differing(kept: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """What is not the same, by its first name; empty where all is."""
    for part in ("data", "values"):
        before, after = kept[part], found[part]
        for name in sorted(before.keys() | after.keys()):
            if before.get(name) != after.get(name):
                return f"{name} is {after.get(name)}, was {before.get(name)}"
    return ""


def _values(measurement: Measurement) -> dict[str, Any]:
    values: dict[str, Any] = {str(k): float(v) for k, v in measurement.function(0).items()}
    if measurement.witness is not None:
        values |= {f"witness: {k}": v for k, v in measurement.witness(0).items()}
    return values


def _digest(training: Training) -> dict[str, str]:
    return {"digest": weights.digest(trained(training))}


def _machine() -> str:
    """All on which the last bits of a result depend: libraries know each processor."""
    parts = (platform.system(), _processor(), torch.backends.cpu.get_cpu_capability())
    return ", ".join([*parts, f"Python {platform.python_version()}", f"torch {torch.__version__}"])


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


@contextmanager
def _at_tiny() -> Iterator[None]:
    """Scale tiny, one thread, and a cache of its own, in which nothing is found again."""
    threads = torch.get_num_threads()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as cache:
        changes = {"POSECORE_SCALE": "tiny", "POSECORE_CACHE": cache, "POSECORE_RETRAIN": None}
        torch.set_num_threads(1)
        try:
            with variables(changes):
                yield
        finally:
            torch.set_num_threads(threads)
