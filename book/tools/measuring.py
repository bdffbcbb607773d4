"""What a page measures and trains: its ledger of claims and its checkpoints.

`experiments/NN_name.py` declares any of

    CLAIMS = [Claim("iv_6d", ..., measurement="table_iv")]
    MEASUREMENTS = {"table_iv": (table_iv, range(5))}    # function(seed) -> {"6D": 0.55, ...}
    CHECKPOINTS = {"codec": train_codec}                 # function() -> {"weight": tensor, ...}

A measurement is stale as soon as the file of its function changes, or a file of ours that it
imports: functions that are slow to measure stand in a module of their own, away from `CLAIMS`.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

from book.tools.claims import Claim, Row, ledger_table
from book.tools.contents import BOOK, find_page
from book.tools.ledger import all_rows, measure, read_ledger, record
from posecore.arrays import fail, require_choice
from posecore.files import write_bytes
from posecore.fingerprint import code_hash
from posecore.scale import SCALES
from posecore.scale import scale as scale_in_force

__all__ = ["LARGEST", "SEED", "all_rows", "claims", "train"]

LARGEST = 2_000_000  # bytes of a checkpoint
SEED = 0  # of torch's own generator, from which layers take their first weights


def claims(page: str, book: Path = BOOK, *, scale: str | None = None) -> list[Row]:
    """Measure the claims of a page, record them in `claims/NN_name.json` and print the table.

    Every finished seed is kept at once: stopped at any moment, the next call goes on from there.

    Args:
        page: name or number of the page.
        book: the folder of a book.
        scale: measures at this scale and, if it is not "book", records in `_build/SCALE/claims`.
            Not given, the scale in force counts, and must be "book".

    Returns:
        The rows of the ledger; none where the page declares no claims.

    Raises:
        ValueError: if the page, the scale or a declaration is not as it should be, or a ledger is
            damaged. Errors of the measured functions come through; finished seeds are kept.
    """
    name = find_page(page, book).name
    with _at(scale, book) as (folder, now):
        declared = _declared(name, book, ("CLAIMS", "MEASUREMENTS"), "nothing to measure")
        if declared is None:
            return []
        stated, measurements = _checked_claims(*declared)
        path = folder / "claims" / f"{name}.json"
        for key, (function, seeds) in measurements.items():
            _say(f"{name}, {key}: {len(seeds)} seeds at {now} scale")
            measure(key, _timed(function), seeds, path)
        record(stated, path)
        rows = read_ledger(path)
    _say(f"{ledger_table(rows)!r}\n{path}")
    return rows


def train(page: str, book: Path = BOOK, *, scale: str | None = None) -> list[Path]:
    """Train what a page ships, into `checkpoints/NN_name.KEY.safetensors`.

    A file appears whole or not at all. Its metadata `posecore` is JSON: page, key, the `code_hash`
    of the training function's module, scale, seed.

    Args:
        page, book, scale: as in `claims`; at another scale the folder is
            `_build/SCALE/checkpoints`.

    Returns:
        The files; none where the page declares no checkpoints.

    Raises:
        ValueError: as `claims`; or if a result is no dict of tensors, has a weight that is not
            finite, or takes more than 2 MB. A file of before stays as it was.
        OSError: if a file cannot be written, or does not read back as what was written.
    """
    name = find_page(page, book).name
    with _at(scale, book) as (folder, now):
        declared = _declared(name, book, ("CHECKPOINTS",), "nothing to train")
        if declared is None:
            return []
        written = []
        for key, function in _checked_checkpoints(*declared).items():
            about = {"code": code_hash(inspect.unwrap(function).__module__), "key": key}
            about |= {"page": name, "scale": now, "seed": SEED}
            start = time.perf_counter()
            with torch.random.fork_rng():
                torch.manual_seed(SEED)
                tensors = function()
            data = _packed(f"CHECKPOINTS[{key!r}]", tensors, about)
            path = folder / "checkpoints" / f"{name}.{key}.safetensors"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, data)
            if path.read_bytes() != data:
                raise OSError(f"{path}: does not read back as it was written")
            _say(f"{name}, {key}: {_seconds(start)}, {len(data) / 1e6:.2f} MB at {path}")
            written.append(path)
    return written


# What is declared --------------------------------------------------------------------------------


def _declared(name: str, book: Path, parts: tuple[str, ...], without: str) -> list[Any] | None:
    """The declarations of these names, empty where absent; None, with a word, without all."""
    file = book / "experiments" / f"{name}.py"
    if not file.is_file():
        return _say(f"{name}: {without}, as there is no {file.parent.name}/{file.name}")
    module = _import(f"{book.resolve().name}.experiments.{name}", file)
    found = [getattr(module, part, {}) for part in parts]
    if not any(found):
        return _say(f"{name}: {without}, as {file.name} declares no {' and no '.join(parts)}")
    return found


def _import(module: str, file: Path) -> ModuleType:
    root = str(file.resolve().parents[2])
    if root not in sys.path:
        sys.path.insert(0, root)
    # Afresh, since numbers chosen by scale may stand at the top of the file.
    sys.modules.pop(module, None)
    importlib.invalidate_caches()
    imported = importlib.import_module(module)
    if not os.path.samefile(imported.__file__ or "", file):
        fail("book", f"a folder whose {module} is found first", f"that of {imported.__file__}")
    return imported


def _checked_claims(stated: Any, measurements: Any) -> tuple[list[Claim], dict[str, Any]]:
    """Refused before hours are spent on measuring."""
    for claim in stated if isinstance(stated, Iterable) else [stated]:
        if not isinstance(claim, Claim):
            fail("CLAIMS", "a list of Claim", repr(claim))
    if not isinstance(measurements, Mapping):
        fail("MEASUREMENTS", "a dict", type(measurements).__name__)
    checked = {}
    for key, value in measurements.items():
        pair = value if isinstance(value, tuple) and len(value) == 2 else (None, None)
        if not inspect.isfunction(pair[0]) or not isinstance(pair[1], Sequence):
            fail(f"MEASUREMENTS[{key!r}]", "(function, seeds)", repr(value))
        checked[key] = pair
    ids = [claim.id for claim in stated]
    for claim in stated:
        wanted = claim.measurement
        if wanted not in checked:
            fail("CLAIMS", f"a measurement of {sorted(checked)} for {claim.id!r}", repr(wanted))
        if ids.count(claim.id) > 1:
            fail("CLAIMS", "ids that differ", f"{claim.id!r} twice")
    return list(stated), checked


def _checked_checkpoints(checkpoints: Any) -> dict[str, Callable[[], Any]]:
    if not isinstance(checkpoints, Mapping):
        fail("CHECKPOINTS", "a dict", type(checkpoints).__name__)
    for key, function in checkpoints.items():
        if not (isinstance(key, str) and re.fullmatch("[a-z0-9_]+", key)):
            fail("CHECKPOINTS", "names of small letters, digits and _", repr(key))
        if not inspect.isfunction(inspect.unwrap(function)):
            fail(f"CHECKPOINTS[{key!r}]", "a function", repr(function))
    return dict(checkpoints)


def _packed(name: str, tensors: Any, about: Mapping[str, Any]) -> bytes:
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
        # A copy of its own: tied weights share memory, which the format refuses.
        kept[key] = tensor.detach().cpu().contiguous().clone()
    # One entry only: safetensors writes several in an order that changes from run to run.
    data = safetensors.torch.save(kept, {"posecore": json.dumps(about, sort_keys=True)})
    if len(data) > LARGEST:
        fail(name, f"at most {LARGEST / 1e6:g} MB", f"{len(data) / 1e6:.2f} MB")
    back = safetensors.torch.load(data)
    same = back.keys() == kept.keys() and all(torch.equal(back[key], kept[key]) for key in kept)
    if not same:
        fail(name, "weights that safetensors keeps", "others read back")
    return data


# Where, and what is said --------------------------------------------------------------------------


@contextmanager
def _at(scale: str | None, book: Path) -> Iterator[tuple[Path, str]]:
    """The folder to write into and the scale, which is in force inside."""
    before = os.environ.get("POSECORE_SCALE")
    if scale is None and scale_in_force() != "book":
        fail("POSECORE_SCALE", "book, or --scale to write elsewhere", repr(before))
    now = "book" if scale is None else scale
    require_choice("scale", now, SCALES)
    os.environ["POSECORE_SCALE"] = now
    try:
        yield (book if now == "book" else book / "_build" / now), now
    finally:
        del os.environ["POSECORE_SCALE"]
        if before is not None:
            os.environ["POSECORE_SCALE"] = before


def _timed(function: Callable[[int], Any]) -> Callable[[int], Any]:
    @wraps(function)  # the ledger asks what it wraps
    def timed(seed: int) -> Any:
        start = time.perf_counter()
        result = function(seed)
        _say(f"  seed {seed}: {_seconds(start)}")
        return result

    return timed


def _seconds(start: float) -> str:
    return f"{time.perf_counter() - start:.1f} s"


def _say(line: str) -> None:
    print(line, flush=True)
