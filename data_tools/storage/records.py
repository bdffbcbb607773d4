"""One record as bytes and back: named arrays and JSON values, nothing that could run.

    4 bytes   length of the head
    head      JSON: {"arrays": [[name, dtype, shape, length], ...], "values": {name: value, ...}}
    bodies    one for each array, in the order of the head: `length` bytes, compressed by zlib

Lengths are unsigned and little-endian. A body is the array in C order and little-endian, turned so
that it compresses better: of booleans eight share a byte; of numbers of one byte each row after the
first, along the first axis, is its difference to the row above, modulo 256, as in PNG's filter
"Up"; of wider numbers all first bytes come first, then all second ones, and so on.

Names are in alphabetical order, so the same record gives the same bytes, whatever the order of its
names and the layout of its arrays in memory.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from typing import Any

import numpy as np

from posecore.arrays import fail

__all__ = ["Record", "decode_record", "encode_record", "to_json"]

Record = dict[str, Any]
"""Arrays and JSON values by name."""

LENGTH = struct.Struct("<I")
LEVEL = 1  # of zlib: the higher ones take several times as long for a few per cent


def encode_record(record: Record) -> bytes:
    """The bytes of a record.

    Args:
        record: NumPy arrays of booleans, integers or floats of up to 64 bits; and what JSON holds:
            None, truth values, finite numbers, strings, and lists and dicts of them. Tuples become
            lists.

    Raises:
        ValueError: naming the entry that is something else.
    """
    _require_names("record", record)
    arrays, bodies, values = [], [], {}
    for name, value in sorted(record.items()):
        if type(value) is not np.ndarray:  # a masked array would lose its mask
            values[name] = value
            continue
        if value.dtype.kind not in "biuf" or value.dtype.itemsize > 8:
            fail(name, "booleans, integers or floats of up to 64 bits", f"dtype {value.dtype}")
        dtype = value.dtype.newbyteorder("<")
        bodies.append(zlib.compress(_to_body(value.astype(dtype)), LEVEL))
        arrays.append([name, dtype.str, list(value.shape), len(bodies[-1])])
    for name, value in values.items():
        _require_json(name, value)
    head = to_json("record", {"arrays": arrays, "values": values}).encode()
    return b"".join([LENGTH.pack(len(head)), head, *bodies])


def decode_record(data: bytes) -> Record:
    """The record that `encode_record` turned into these bytes; its arrays may be written to."""
    end = LENGTH.size + LENGTH.unpack_from(data)[0]
    head = json.loads(data[LENGTH.size : end])
    record = head["values"]
    for name, dtype, shape, length in head["arrays"]:
        body = zlib.decompress(data[end : end + length])
        record[name] = _from_body(body, np.dtype(dtype), shape)
        end += length
    return record


def to_json(name: str, value: object) -> str:
    """JSON that is the same for equal values, whatever the order of their names.

    Raises:
        ValueError: naming the part that JSON does not hold.
    """
    _require_json(name, value)
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _to_body(array: np.ndarray) -> bytes:
    if array.dtype.kind == "b":
        return np.packbits(array).tobytes()
    if array.dtype.itemsize == 1:
        rows = array.view(np.uint8).copy()
        if array.ndim:
            rows[1:] -= array.view(np.uint8)[:-1]
        return rows.tobytes()
    return np.frombuffer(array.tobytes(), np.uint8).reshape(-1, array.dtype.itemsize).T.tobytes()


def _from_body(body: bytes, dtype: np.dtype, shape: list[int]) -> np.ndarray:
    flat = np.frombuffer(body, np.uint8)
    if dtype.kind == "b":
        return np.unpackbits(flat, count=math.prod(shape)).view(bool).reshape(shape)
    if dtype.itemsize == 1:
        rows = flat.reshape(shape)
        rows = np.cumsum(rows, axis=0, dtype=np.uint8) if shape else rows.copy()
        return rows.view(dtype)
    planes = flat.reshape(dtype.itemsize, -1)
    array = np.array(planes.T, order="C").view(dtype).reshape(shape)
    return array.astype(dtype.newbyteorder("="), copy=False)


def _require_json(name: str, value: object) -> None:
    if isinstance(value, float):
        if not math.isfinite(value):
            fail(name, "a finite number", value)
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            _require_json(f"{name}[{i}]", item)
    elif isinstance(value, dict):
        _require_names(name, value)
        for key, item in value.items():
            _require_json(f"{name}[{key!r}]", item)
    elif not isinstance(value, bool | int | str | None):
        fail(name, "what JSON holds", f"a {type(value).__name__}")


def _require_names(name: str, value: object) -> None:
    if not isinstance(value, dict):
        fail(name, "a dict", f"a {type(value).__name__}")
    for key in value:
        if not isinstance(key, str):
            fail(name, "strings for names", repr(key))
