"""What a measurement or a training depends on: its definitions, and the datasets it declares.

kept = dependencies(from_images, ("tabletop/train", "tabletop/easy"), "book")
reasons(kept, dependencies(...), code_of(...))  # ("shading._lambert", "tabletop: easy count")
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import data_tools
from data_tools.storage.records import encode_record
from data_tools.worlds.world import WorldDataset
from posecore.arrays import fail
from posecore.fingerprint import Closure, changes, closure, closure_as_loaded

__all__ = [
    "KEEPING",
    "code_of",
    "dependencies",
    "open_world",
    "reasons",
    "records_digest",
    "roots_of",
]

OPENING = "data_tools.worlds.world:World"
"""What finds the records of any world, and reads them."""
KEEPING = ("book.tools", "posecore.fingerprint", "posecore.loaded")
"""What keeps results and finds them again is no part of them."""


def dependencies(
    function: Callable[..., Any] | str,
    data: Iterable[str],
    scale: str,
    code: Closure | None = None,
) -> dict[str, Any]:
    """What the result of a function depends on, as JSON can hold it.

    Args:
        function: or its name, "module:function".
        data: the datasets that it opens, "world/split".
        scale: at which it runs.
        code: its `code_of`, where that is known.

    Returns:
        "definitions", as `Closure.text`; "numbers", a hash of what is chosen by scale; and "data":
        by world its "definitions" and by split its recipe and count.

    Raises:
        ValueError: if there is no such function, world or split.
        RuntimeError: as `code_of`.
    """
    code = code_of(function, data) if code is None else code
    worlds: dict[str, dict[str, Any]] = {}
    for source in sorted(set(data)):
        name, _, split = source.partition("/")
        dataset = open_world(source, scale)
        if name not in worlds:
            worlds[name] = {"definitions": closure(*dataset.world.code).text, "splits": {}}
        worlds[name]["splits"][split] = {**dataset.store.recipe, "count": len(dataset.store)}
    return {"definitions": code.text, "numbers": code.numbers(scale), "data": worlds}


def code_of(function: Callable[..., Any] | str, data: Iterable[str] = ()) -> Closure:
    """The definitions of a function, and, if it opens worlds, of what reads them.

    Args:
        function, data: as for `dependencies`.

    Raises:
        ValueError: if there is no such function.
        RuntimeError: if a definition has been edited since this process loaded it.
    """
    return closure_as_loaded(*roots_of(function, data), without=KEEPING)


def roots_of(
    function: Callable[..., Any] | str, data: Iterable[str]
) -> list[Callable[..., Any] | str]:
    """Where the code of a function begins, and that of reading what it opens."""
    return [function, *([OPENING] if tuple(data) else [])]


def open_world(source: str, scale: str) -> WorldDataset:
    """A split of a world at a scale, nothing of it made.

    Raises:
        ValueError: if `source` is not "world/split" of a world of ours.
    """
    name, _, split = source.partition("/")
    try:
        dataset = data_tools.open(name, split=split or None, scale=scale, whole=False)
    except TypeError:  # other readers know no scale
        dataset = None
    if not isinstance(dataset, WorldDataset):
        fail("data", "a world and a split, 'tabletop/train'", repr(source))
    return dataset


def records_digest(source: str, scale: str = "tiny") -> str:
    """16 hexadecimal digits of all records of a split; makes what is missing."""
    store = open_world(source, scale).store
    store.make(progress=False)
    total = hashlib.sha256()
    for record in store:
        total.update(encode_record(record))
    return total.hexdigest()[:16]


def reasons(kept: Mapping[str, Any], now: Mapping[str, Any], code: Closure) -> tuple[str, ...]:
    """Why a result is stale: the names of what has changed since; none if it is fresh.

    Args:
        kept, now: `dependencies` of then and of today.
        code: the closure of today, which knows where definitions stand.
    """
    found = changes(kept["definitions"], code)
    for name in sorted(kept["data"].keys() | now["data"].keys()):
        before, after = (side["data"].get(name) for side in (kept, now))
        if before is None or after is None:
            found.append(f"{name}: {'no longer' if after is None else 'not yet'} declared")
            continue
        if before["definitions"] != after["definitions"]:
            world = open_world(f"{name}/{next(iter(after['splits']))}", "tiny").world
            found += changes(before["definitions"], closure(*world.code))
        if before["splits"] != after["splits"]:
            found.append(f"{name}: {_differing(before['splits'], after['splits'])}")
    return tuple(dict.fromkeys(found))


def _differing(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Which splits and which of their numbers differ."""
    if before.keys() != after.keys():
        return f"splits {', '.join(after)} in place of {', '.join(before)}"
    parts = {
        f"{split} {key}"
        for split in after
        for key in before[split].keys() | after[split].keys()
        if json.dumps(before[split].get(key)) != json.dumps(after[split].get(key))
    }
    return ", ".join(sorted(parts))
