"""What a training is made from, part by part: so that another run is not taken for it.

A loss is its code and what this uses; data are their numbers. All is read as it lies and nothing is
called: making a batch may take minutes, and may count. The same program is never told from itself:

- numbers are compared up to rounding;
- arrays only where as many threads compute, code only by the same Python: else both come out
  otherwise;
- a part that is not there on both sides, or is None, is no difference: caches fill as it comes;
- what changes while a training goes on is no origin (`Checkpoints` leaves it out).

So some edits are missed, and `recipe` of `fit` is for what must not be.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from posecore.fingerprint import PACKAGES

__all__ = ["Part", "difference", "origins"]

Part = str | list[float]
"""Words that must be equal, or numbers up to rounding, the first of them the norm."""

ROUNDING = 1e-4  # relative to the norm; sums in another order differ by far less
PARTS, ITEMS, DEPTH = 2000, 64, 10  # of one origin; of a list, evenly over it; of what holds what
WHOLE, BLOCK = 2**18, 2**10  # numbers; of a larger array as many blocks as ITEMS

ARRAY = "threads)"  # ends the names of arrays
CACHED = type(functools.lru_cache(lambda: None))
PLAIN = (bool, int, complex, str, bytes, range, slice, torch.dtype)
NAMED = (type, ModuleType, BuiltinFunctionType)
ARRAYS = Tensor | np.ndarray | np.generic
SIMPLE = (*PLAIN, *NAMED, Enum, ARRAYS, float)
USED = (bool, int, float, complex, str, list, tuple, dict)
ENTRIES = ["__call__", "forward", "__iter__", "__next__", "__getitem__"]
NUMBERS = {"bool", *(f"{kind}{2**n}" for kind in ("int", "uint", "float") for n in range(3, 7))}
NUMBERS |= {"bfloat16", "complex64", "complex128"}
LIBRARIES = {*sys.stdlib_module_names, *PACKAGES, "torch", "numpy"}  # have versions


def origins(value: Any, name: str) -> dict[str, Part]:
    """What something is made from; by names that begin with its own, and the same in any process.

    - An array: its shape and type, and sums of its numbers.
    - A function: its code without comments; its defaults, what it encloses, and what it uses of its
      module: numbers, arrays, containers and functions. Code of libraries and of this project does
      not count: a new version of them goes on with what an old one began.
    - A network: the kinds of its layers, not their weights. A module without weights: its buffers.
    - Another object: its attributes, and its `__call__`; of private attributes the arrays only. If
      it has an attribute `made_from`, that alone: for what is computed at length, and differs each
      time.
    - Lists, tuples, dictionaries: what they hold.

    Args:
        value: a loss, batches, a schedule.
        name: what it is called.
    """
    found: dict[str, Part] = {}
    for key, part in itertools.islice(_parts(value, name, {}, 0), PARTS):
        found.setdefault(key, part)
    return found


def difference(kept: Mapping[str, Part], now: Mapping[str, Part]) -> str | None:
    """The name of the first part that is another now; None if there is none."""
    for key, part in now.items():
        if key in kept and not _same(kept[key], part):
            return key.partition(" (")[0]
    return None


def _same(one: Part, other: Part) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    far = ROUNDING * max(one[0], other[0])
    return not any(abs(a - b) > far for a, b in zip(one, other, strict=True))


Parts = Iterator[tuple[str, Part]]


def _parts(value: Any, name: str, seen: dict[int, Any], depth: int) -> Parts:
    """All parts, in an order that is always the same; `seen` keeps what was met."""
    if isinstance(value, ARRAYS | float):
        yield from _numbers(value, name)
    elif isinstance(value, Enum):
        yield name, value.name
    elif isinstance(value, NAMED):
        yield name, getattr(value, "__qualname__", value.__name__)
    elif isinstance(value, PLAIN):
        if not (isinstance(value, str) and os.sep in value):  # files may lie elsewhere
            yield name, _short(repr(value))
    if value is None or isinstance(value, SIMPLE) or id(value) in seen:
        return
    if depth > DEPTH or len(seen) > PARTS:
        return
    seen[id(value)] = value
    deeper = functools.partial(_parts, seen=seen, depth=depth + 1)
    if isinstance(value, list | tuple):
        yield name, f"{len(value)} items"
        for i in range(0, len(value), max(1, -(-len(value) // ITEMS))):
            yield from deeper(value[i], f"{name}[{i}]")
    elif isinstance(value, dict):
        for key, item in itertools.islice(list(value.items()), ITEMS):
            yield from deeper(item, f"{name}[{key if isinstance(key, PLAIN) else type(key)!r}]")
    elif isinstance(value, functools.partial):
        yield name, f"partial of {len(value.args)} and {sorted(value.keywords)}"
        yield from deeper(value.args, f"{name}.args")
        yield from deeper(value.keywords, f"{name}.keywords")
        yield from deeper(value.func, f"{name}.func")
    elif isinstance(value, MethodType):
        yield from _methods(type(value.__self__), [value.__name__], name, deeper)
        yield from deeper(value.__self__, name)
    elif isinstance(value, CACHED):
        yield from deeper(value.__wrapped__, name)
    elif isinstance(value, FunctionType):
        yield from _function(value, name, deeper)
    else:
        yield from _object(value, name, deeper)


def _function(function: FunctionType, name: str, deeper: Callable[..., Parts]) -> Parts:
    home, code = function.__module__, function.__code__
    defaults, named = function.__defaults__ or (), function.__kwdefaults__ or {}
    if _of_library(function):
        yield name, function.__qualname__
    else:
        unset = [value is None for value in (*defaults, *named.values())]
        python = ".".join(map(str, sys.version_info[:2]))
        words = [*_words(code, function.__doc__), unset]
        yield f"{name} (Python {python})", _short(repr(words), 0)
        for used in _names(code):
            value = function.__globals__.get(used)
            if isinstance(value, FunctionType | CACHED) and value.__module__ == home:
                yield from deeper(value, f"{name}.{used}")
            elif isinstance(value, type) and value.__module__ == home:
                yield from _methods(value, list(vars(value)), f"{name}.{used}", deeper)
            elif type(value) in USED or isinstance(value, ARRAYS):
                yield from deeper(value, f"{name}.{used}")
    yield from deeper(defaults, f"{name}.__defaults__")
    yield from deeper(named, f"{name}.__kwdefaults__")
    for enclosed, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # it has no value yet
            yield from deeper(cell.cell_contents, f"{name}.{enclosed}")


def _object(value: Any, name: str, deeper: Callable[..., Parts]) -> Parts:
    kind, held = type(value), dict(getattr(value, "__dict__", {}))
    if "made_from" in held:
        yield from deeper(held["made_from"], f"{name}.made_from")
        return
    package = kind.__module__.partition(".")[0]
    if isinstance(value, nn.Module):
        yield name, " ".join(type(layer).__qualname__ for layer in value.modules())
        held = {key: some for key, some in held.items() if key[0] != "_" and key != "training"}
        if not any(True for _ in value.parameters()):
            held |= {**dict(value.named_buffers(recurse=False)), **dict(value.named_children())}
    else:
        yield name, kind.__qualname__
        if package == "torch":  # its loaders: of these the data alone
            held = {key: held[key] for key in ("dataset", "tensors") if key in held}
        elif package in sys.stdlib_module_names:  # locks, threads, files
            held = {}
    yield from _methods(kind, ENTRIES, name, deeper)
    for key, some in held.items():
        own = f"{name}.{key}"
        for part in deeper(some, own):
            # How an object is made inside: timers, progress bars, what was read last.
            if key[0] != "_" or (part[0].endswith(ARRAY) and "._" not in part[0][len(own) :]):
                yield part


def _methods(kind: type, first: list[str], name: str, deeper: Callable[..., Parts]) -> Parts:
    """Methods of a class, and those that they use."""
    names = list(first)
    for one in names:
        held = next((vars(base)[one] for base in kind.__mro__ if one in vars(base)), None)
        method = getattr(held, "fget", getattr(held, "func", getattr(held, "__func__", held)))
        if isinstance(method, FunctionType) and not _of_library(method):
            names += [used for used in _names(method.__code__) if used not in names]
            yield from deeper(method, f"{name}.{one}()")


def _of_library(function: FunctionType) -> bool:
    return (function.__module__ or "").partition(".")[0] in LIBRARIES


def _names(code: CodeType) -> list[str]:
    """Names that code uses, in it and in the functions that it makes."""
    inside = [const for const in code.co_consts if isinstance(const, CodeType)]
    return sorted({*code.co_names, *(name for one in inside for name in _names(one))})


def _words(code: CodeType, doc: str | None = None) -> Iterator[Any]:
    yield code.co_code
    yield code.co_names
    for const in code.co_consts:
        if isinstance(const, CodeType):
            yield from _words(const)
        elif isinstance(const, frozenset):
            yield sorted(const, key=repr)
        elif const is None or const != doc:
            yield const


def _short(text: str, most: int = 64) -> str:
    return text if len(text) <= most else hashlib.sha256(text.encode()).hexdigest()[:16]


def _numbers(value: Any, name: str) -> Parts:
    """Shape and type, how many are no numbers, and sums."""
    if isinstance(value, float):
        yield name, _sums(np.array([value])) if math.isfinite(value) else repr(value)
        return
    yield name, "an array"
    value = value if isinstance(value, Tensor) else np.asarray(value)
    dtype = str(value.dtype).removeprefix("torch.")
    if dtype not in NUMBERS or (isinstance(value, Tensor) and not _dense(value)):
        return
    some, threads = _some(value), f"{torch.get_num_threads()} {ARRAY}"
    words = f"{tuple(value.shape)} {dtype}, {(~np.isfinite(some)).sum()} not finite"
    yield f"{name} (shape, {threads}", words
    yield f"{name} ({threads}", _sums(some)


def _sums(numbers: np.ndarray) -> list[float]:
    """The norm, and two sums in which a change shows wherever it is."""
    numbers, place = np.where(np.isfinite(numbers), numbers, 0.0), np.arange(len(numbers))
    waves = np.cos(place), np.cos(math.sqrt(2) * place)
    with np.errstate(over="ignore", invalid="ignore"):
        return [float(np.linalg.norm(numbers)), *(float(numbers @ wave) for wave in waves)]


def _dense(value: Tensor) -> bool:
    return value.layout == torch.strided and value.device.type != "meta" and not value.is_nested


def _some(value: Tensor | np.ndarray) -> np.ndarray:
    """The numbers in a row, of many only some blocks, as float64."""
    flat = value.detach().reshape(-1) if isinstance(value, Tensor) else value.reshape(-1)
    if len(flat) > WHOLE:
        starts = np.linspace(0, len(flat) - BLOCK, ITEMS).astype(int)
        blocks = [flat[start : start + BLOCK] for start in starts.tolist()]
        flat = torch.cat(blocks) if isinstance(flat, Tensor) else np.concatenate(blocks)
    if isinstance(flat, Tensor):
        flat = flat.cpu().to(torch.complex128 if flat.is_complex() else torch.float64).numpy()
    parts = (flat.real, flat.imag) if flat.dtype.kind == "c" else (flat,)
    return np.concatenate(parts).astype(np.float64)
