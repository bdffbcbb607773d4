"""What a training is made from, in a few letters: so that another is not taken for it.

A loss is its code and the numbers that it takes from outside; data are their numbers. Both are read
as they lie, nothing is called: making a batch may take minutes, and may count.
"""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

__all__ = ["origin"]

_WHOLE, _SOME = 2**20, 2**14  # an array of more numbers than the first: so many, spread over it
_DEPTH = 8
_PLAIN = (bool, int, float, complex, str, bytes, type(None), torch.dtype, torch.device)


def origin(value: Any) -> str:
    """Eight hexadecimal digits of what something is made from; the same in another process.

    - An array: its shape, type and numbers; of one that has more than a million, for data may fill
      the memory and more, some 16 thousand that are spread over it.
    - A function: its code without names and comments of its source, its defaults, what it encloses,
      and the numbers, arrays and functions of its own module that it uses.
    - A network: its layers, not their weights, which training changes.
    - Another object: its type, the code of its call, and what it holds, as above.
    - Lists, tuples and dictionaries: what they hold.

    What a program notes while it runs does not count: a list of plain numbers, a plain number in an
    attribute that is private or whose object has `state_dict`, a cached property.
    """
    hashed = hashlib.sha256()
    for part in _parts(value, None, 0, set()):
        hashed.update(part)
        hashed.update(b"\0")
    return hashed.hexdigest()[:8]


def _parts(value: Any, home: str | None, depth: int, seen: set[int]) -> Iterator[bytes]:
    """All that counts, in an order that is always the same; functions of the module `home` too."""
    if isinstance(value, _PLAIN):
        yield repr(value).encode()
        return
    if isinstance(value, Tensor | np.ndarray):
        yield from _numbers(value)
        return
    if id(value) in seen or depth > _DEPTH:
        return
    seen.add(id(value))
    deeper = functools.partial(_parts, home=home, depth=depth + 1, seen=seen)
    if isinstance(value, Mapping):
        for key in sorted(value, key=repr):
            yield repr(key).encode() if isinstance(key, _PLAIN) else b"key"
            yield from deeper(value[key])
    elif (
        isinstance(value, Sequence)
        and type(value).__module__ == "builtins"
        and not isinstance(value, range)
    ):
        noted = isinstance(value, list) and all(isinstance(item, _PLAIN) for item in value)
        yield b"" if noted else str(len(value)).encode()
        for item in () if noted else value:
            yield from deeper(item)
    elif isinstance(value, functools.partial):
        for part in (value.func, value.args, value.keywords):
            yield from deeper(part)
    elif isinstance(value, MethodType):
        yield from deeper(value.__func__)
        yield from deeper(value.__self__)
    elif isinstance(value, FunctionType):
        yield from _function(value, depth, seen)
    elif isinstance(value, nn.Module):
        yield repr(value).encode()
    elif isinstance(value, type | ModuleType):
        yield value.__name__.encode()
    elif hasattr(value, "__wrapped__"):  # by lru_cache
        yield from deeper(value.__wrapped__)
    else:
        yield from _object(value, depth, seen)


def _function(function: FunctionType, depth: int, seen: set[int]) -> Iterator[bytes]:
    home, code = function.__module__, function.__code__
    yield from _code(code, function.__doc__)
    deeper = functools.partial(_parts, home=home, depth=depth + 1, seen=seen)
    yield from deeper(function.__defaults__)
    yield from deeper(function.__kwdefaults__)
    inside = [code]
    for one in inside:
        inside += [const for const in one.co_consts if isinstance(const, CodeType)]
    for name in sorted({name for one in inside for name in one.co_names}):
        used = function.__globals__.get(name)
        ours = isinstance(used, FunctionType) and used.__module__ == home
        if ours or isinstance(used, Tensor | np.ndarray | float | int | str):
            yield name.encode()
            yield from deeper(used)
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        yield name.encode()
        try:
            yield from deeper(cell.cell_contents)
        except ValueError:  # not yet
            continue


def _code(code: CodeType, doc: str | None = None) -> Iterator[bytes]:
    yield code.co_code
    yield repr(code.co_names).encode()
    for const in code.co_consts:
        if isinstance(const, CodeType):
            yield from _code(const)
        elif isinstance(const, frozenset):
            yield repr(sorted(const, key=repr)).encode()
        elif const is None or const != doc:
            yield repr(const).encode()


def _object(value: Any, depth: int, seen: set[int]) -> Iterator[bytes]:
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    deeper = functools.partial(_parts, home=kind.__module__, depth=depth + 1, seen=seen)
    call = kind.__dict__.get("__call__")
    if isinstance(call, FunctionType):
        yield from deeper(call)
    package = kind.__module__.partition(".")[0]
    if package in sys.stdlib_module_names:  # locks, threads, files
        return
    held = getattr(value, "__dict__", None) or {}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        held = value._asdict()
    if package == "torch":  # its loaders: of these the data alone
        held = {name: held[name] for name in ("dataset", "tensors") if name in held}
    notes = hasattr(value, "state_dict")
    for name in sorted(held):
        if isinstance(getattr(kind, name, None), functools.cached_property):
            continue  # follows from the rest, and is there or not
        if not (isinstance(held[name], _PLAIN) and (notes or name.startswith("_"))):
            yield name.encode()
            yield from deeper(held[name])


def _numbers(value: Tensor | np.ndarray) -> Iterator[bytes]:
    yield f"{tuple(value.shape)} {str(value.dtype).removeprefix('torch.')}".encode()
    if isinstance(value, Tensor):
        flat = value.detach()
        if value.layout != torch.strided or value.device.type == "meta":
            return
        flat = flat.reshape(-1) if flat.is_contiguous() else flat.flatten()
        some = flat[:: _stride(len(flat))].cpu().contiguous()
        yield some.view(torch.uint8).numpy().tobytes() if some.numel() else b""
    elif value.dtype != object:
        flat = value.reshape(-1)
        yield np.ascontiguousarray(flat[:: _stride(len(flat))]).tobytes()


def _stride(count: int) -> int:
    return 1 if count <= _WHOLE else count // _SOME
