"""What a chapter measures and trains: its ledger of claims and the networks that it ships.

`chNN_name/experiments.py` declares any of

    CLAIMS = [Claim(id="iv_6d", ..., measurement="table_iv")]
    MEASUREMENTS = {"table_iv": Measurement(table_iv, range(5), data=("tabletop/easy",))}
    CHECKPOINTS = {"codec": Training(train_codec)}       # function() -> {"weight": tensor, ...}

A result is stale as soon as a definition that its function reaches changes, or a dataset that it
declares; `make.py claims NN --confirm` (`book.tools.confirming`) finds out whether that matters.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from book.tools.checkpoints import SEED, Training, read_about, stale_weights, trained
from book.tools.claims import Claim, Row, ledger_table
from book.tools.contents import BOOK, Page, find_page
from book.tools.dependencies import dependencies
from book.tools.ledger import (
    Measurement,
    measure,
    read_file,
    read_ledger,
    record,
    require_named,
    stale,
)
from book.tools.variables import variables
from data_tools.storage.locks import file_lock
from posecore import weights
from posecore.arrays import fail, require_choice
from posecore.files import write_bytes
from posecore.scale import SCALES
from posecore.scale import scale as scale_in_force

__all__ = ["LARGEST", "claims", "declared", "stale_results", "status", "train"]

LARGEST = 2_000_000  # bytes of a checkpoint


def claims(page: str, book: Path = BOOK, *, scale: str | None = None) -> list[Row]:
    """Measure the claims of a page, record them in its `claims.json` and print the table.

    Every finished seed is kept at once: stopped at any moment, the next call goes on from there.

    Args:
        page: name or number of the page.
        book: the folder of a book.
        scale: measures at this scale and, if it is not "book", records in `_build/SCALE`. Not
            given, the scale in force counts, and must be "book".

    Returns:
        The rows of the ledger; none where the page declares no claims.

    Raises:
        ValueError: if the page, the scale or a declaration is not as it should be, or a ledger is
            damaged. Errors of the measured functions come through; finished seeds are kept.
    """
    found = find_page(page, book)
    with _at(scale, book) as (folder, now):
        module = _experiments(found, book, ("CLAIMS", "MEASUREMENTS"), "nothing to measure")
        if module is None:
            return []
        stated, measurements, _ = declared(module)
        path = folder / found.package / "claims.json"
        for key, measurement in measurements.items():
            _say(f"{found.name}, {key}: {len(measurement.seeds)} seeds at {now} scale")
            measure(key, measurement, path, say=_say)
        record(stated, path)
        rows = read_ledger(path)
    _say(f"{ledger_table(rows)!r}\n{path}")
    return rows


def train(page: str, book: Path = BOOK, *, scale: str | None = None) -> list[Path]:
    """Train what a page ships, into its `weights/KEY.safetensors`.

    A file appears whole or not at all. `KEY.json` beside it says how it was made: the digest of the
    weights, and what they depend on.

    Args:
        page, book, scale: as in `claims`.

    Returns:
        The files; none where the page declares no checkpoints.

    Raises:
        ValueError: as `claims`; or if a result is no dict of tensors, has a weight that is not
            finite, or takes more than 2 MB. A file of before stays as it was.
        OSError: if a file cannot be written, or does not read back as what was written.
    """
    found = find_page(page, book)
    with _at(scale, book) as (folder, now):
        module = _experiments(found, book, ("CHECKPOINTS",), "nothing to train")
        if module is None:
            return []
        written = []
        for key, training in declared(module)[2].items():
            about = about_training(training, now)
            start = time.perf_counter()
            tensors = trained(training)
            seconds = round(time.perf_counter() - start, 1)
            data = _packed(f"CHECKPOINTS[{key!r}]", tensors)
            about["digest"] = weights.digest(weights.parse(data))
            about["seconds"] = {str(SEED): seconds}
            path = folder / found.package / "weights" / f"{key}.safetensors"
            path.parent.mkdir(parents=True, exist_ok=True)
            with file_lock(path):  # both files are of one training, whoever else trains
                write_bytes(path, data)
                if path.read_bytes() != data:
                    raise OSError(f"{path}: does not read back as it was written")
                write_about(path, about)
            _say(f"{found.name}, {key}: {seconds} s, {len(data) / 1e6:.2f} MB at {path}")
            written.append(path)
    return written


def about_training(training: Training, scale: str) -> dict[str, Any]:
    """How a network is made, as `KEY.json` keeps it."""
    function = require_named("function", training.function)
    names = {"module": function.__module__, "function": function.__qualname__}
    return {**names, **dependencies(function, training.data, scale), "scale": scale, "seed": SEED}


def write_about(path: Path, about: Mapping[str, Any]) -> None:
    """Write `KEY.json` beside a file of weights."""
    text = json.dumps(about, indent=1, sort_keys=True, ensure_ascii=False)
    write_bytes(path.with_suffix(".json"), text.encode() + b"\n")


# What is stale ------------------------------------------------------------------------------------


def stale_results(page: Page, book: Path = BOOK) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The measurements and weights of a page that are stale, each with what has changed."""
    folder = book / page.package
    for name, entry in read_file(folder / "claims.json")["measurements"].items():
        if changed := stale(entry):
            yield name, changed
    for path in sorted((folder / "weights").glob("*.safetensors")):
        if changed := stale_weights(path):
            yield f"weights/{path.name}", changed


def status(page: Page, book: Path = BOOK) -> list[str]:
    """What measuring a page anew would take, a line for each stale measurement or network."""
    lines, folder = [], book / page.package
    measured = read_file(folder / "claims.json")["measurements"]
    for name, changed in stale_results(page, book):
        entry = measured.get(name) or read_about(folder / name)
        seconds = entry.get("seconds", {}).values()
        minutes = f"{max(1, math.ceil(sum(seconds) / 60))} min" if seconds else "a time not kept"
        lines.append(f"{page.name}, {name}: stale: {shown(changed)}; made anew in {minutes}")
    return lines or [f"{page.name}: nothing is stale"]


def shown(changed: Sequence[str], most: int = 3) -> str:
    """The first few names, and how many more there are."""
    more = f" and {len(changed) - most} more" if len(changed) > most else ""
    return ", ".join(changed[:most]) + more


# What is declared ---------------------------------------------------------------------------------


def declared(
    module: ModuleType,
) -> tuple[list[Claim], dict[str, Measurement], dict[str, Training]]:
    """The claims, measurements and trainings of a module of experiments.

    Raises:
        ValueError: naming what is no such declaration, before hours are spent on it.
    """
    stated, measurements, trainings = (
        getattr(module, name, {}) for name in ("CLAIMS", "MEASUREMENTS", "CHECKPOINTS")
    )
    for claim in stated if isinstance(stated, Iterable) else [stated]:
        if not isinstance(claim, Claim):
            fail("CLAIMS", "a list of Claim", repr(claim))
    for name, mapping, kind in (
        ("MEASUREMENTS", measurements, Measurement),
        ("CHECKPOINTS", trainings, Training),
    ):
        if not isinstance(mapping, Mapping):
            fail(name, "a dict", type(mapping).__name__)
        for key, value in mapping.items():
            if not isinstance(key, str) or not re.fullmatch("[a-z0-9_]+", key):
                fail(name, "names of small letters, digits and _", repr(key))
            if not isinstance(value, kind):
                fail(f"{name}[{key!r}]", f"a {kind.__name__} of a function", repr(value))
            require_named(f"{name}[{key!r}].function", value.function)
    ids = [claim.id for claim in stated]
    for claim in stated:
        wanted = claim.measurement
        if wanted not in measurements:
            there = sorted(measurements)
            fail("CLAIMS", f"a measurement of {there} for {claim.id!r}", repr(wanted))
        if ids.count(claim.id) > 1:
            fail("CLAIMS", "ids that differ", f"{claim.id!r} twice")
    return list(stated), dict(measurements), dict(trainings)


def _experiments(page: Page, book: Path, parts: tuple[str, ...], without: str) -> ModuleType | None:
    """The module of experiments; None, with a word, where it declares none of the parts."""
    file = book / page.package / "experiments.py"
    if not file.is_file():
        return _say(f"{page.name}: {without}, as there is no {file.parent.name}/{file.name}")
    module = import_experiments(page, book)
    if not any(getattr(module, part, None) for part in parts):
        return _say(f"{page.name}: {without}, as {file.name} declares no {' and no '.join(parts)}")
    return module


def import_experiments(page: Page, book: Path = BOOK) -> ModuleType:
    """The module of a page's experiments, imported afresh with all of its package.

    Numbers chosen by scale may stand at the top of a file.

    Raises:
        ValueError: if another book of the same name is found first.
    """
    file = book.resolve() / page.package / "experiments.py"
    package = f"{book.resolve().name}.{page.package}"
    name = f"{package}.experiments"
    for loaded in [module for module in sys.modules if module.startswith(f"{package}.")]:
        del sys.modules[loaded]
    importlib.invalidate_caches()
    imported = importlib.import_module(name)
    if not os.path.samefile(imported.__file__ or "", file):
        fail("book", f"a folder whose {name} is found first", f"that of {imported.__file__}")
    return imported


def _packed(name: str, tensors: Any) -> bytes:
    """The bytes of a checkpoint, the same for the same weights, once they are fit to be shipped."""
    if not isinstance(tensors, Mapping) or not tensors:
        fail(name, "a dict of tensors", repr(tensors)[:80])
    kept = {}
    for key, tensor in tensors.items():
        if not isinstance(tensor, Tensor):
            fail(f"{name}[{key!r}]", "a tensor", type(tensor).__name__)
        if not torch.isfinite(tensor).all():
            count = int((~torch.isfinite(tensor)).sum())
            fail(f"{name}[{key!r}]", "finite weights", f"{count} that are not")
        kept[key] = tensor.detach().cpu()
    data = weights.pack(kept)
    if len(data) > LARGEST:
        fail(name, f"at most {LARGEST / 1e6:g} MB", f"{len(data) / 1e6:.2f} MB")
    back = weights.parse(data)
    same = back.keys() == kept.keys() and all(torch.equal(back[key], kept[key]) for key in kept)
    if not same:
        fail(name, "weights that safetensors keeps", "others read back")
    return data


# Where, and what is said --------------------------------------------------------------------------


@contextmanager
def _at(scale: str | None, book: Path) -> Iterator[tuple[Path, str]]:
    """The folder to write into and the scale, which is in force inside."""
    if scale is None and scale_in_force() != "book":
        fail("POSECORE_SCALE", "book, or --scale to write elsewhere", repr(scale_in_force()))
    now = "book" if scale is None else scale
    require_choice("scale", now, SCALES)
    with variables({"POSECORE_SCALE": now}):
        yield (book if now == "book" else book / "_build" / now), now


def _say(line: str) -> None:
    print(line, flush=True)
