"""A shard: one file with several records of a world, any of which can be read alone.

    8 bytes   POSESHRD
    4 bytes   length of the index
    4 bytes   CRC-32 of the index
    index     JSON: {"key": KEY, "number": NUMBER, "records": [[length, CRC-32], ...]}
    records   one behind the other

Numbers are unsigned and little-endian. The key is that of the world, so a shard of another world or
with another number is noticed; so is every cut and every flipped bit, here or when the record that
has it is read.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from data_tools.storage.records import to_json

__all__ = ["DamagedShard", "Place", "check_shard", "pack_shard", "read_bytes", "read_index"]

MAGIC = b"POSESHRD"
START = struct.Struct("<8sII")


class DamagedShard(ValueError):
    """A file that is not, or no longer, the shard that it should be; says which, and why."""


class Place(NamedTuple):
    """Where a record stands in its file, and its checksum."""

    offset: int
    length: int
    checksum: int


def pack_shard(key: str, number: int, records: Sequence[bytes]) -> bytes:
    """The bytes of a shard."""
    places = [[len(record), zlib.crc32(record)] for record in records]
    index = to_json("index", {"key": key, "number": number, "records": places}).encode()
    return b"".join([START.pack(MAGIC, len(index), zlib.crc32(index)), index, *records])


def read_index(path: Path, key: str, number: int) -> list[Place]:
    """Where the records of a shard are. Of the records themselves nothing is read.

    Raises:
        FileNotFoundError: if there is no such file.
        DamagedShard: if the file is cut off, too long, damaged before its first record, or another
            shard.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        start = _read(file, path, START.size)
        if not start:
            raise DamagedShard(f"{path}: empty file")
        if len(start) < START.size or not start.startswith(MAGIC):
            raise DamagedShard(f"{path}: no shard: begins with {start[:8]!r}")
        _, length, checksum = START.unpack(start)
        index = _read(file, path, min(length, size))
    if zlib.crc32(index) != checksum:
        raise DamagedShard(f"{path}: damaged or cut off: wrong checksum of the index")
    content = json.loads(index)
    if content["key"] != key:
        raise DamagedShard(f"{path}: a shard of another world, with the key {content['key'][:16]}")
    if content["number"] != number:
        raise DamagedShard(f"{path}: shard {content['number']} in the place of shard {number}")
    places, end = [], START.size + length
    for length, checksum in content["records"]:
        places.append(Place(end, length, checksum))
        end += length
    if size != end:
        raise DamagedShard(f"{path}: damaged or cut off: expected {end} bytes, got {size}")
    return places


def read_bytes(path: Path, place: Place) -> bytes:
    """The bytes of one record.

    Raises:
        FileNotFoundError: if there is no such file.
        DamagedShard: if they are not what was written.
    """
    with path.open("rb") as file:
        file.seek(place.offset)
        data = _read(file, path, place.length)
    if zlib.crc32(data) != place.checksum:
        raise DamagedShard(f"{path}: damaged: wrong checksum at byte {place.offset}")
    return data


def check_shard(path: Path, key: str, number: int) -> None:
    """Read a shard to its last byte.

    Raises:
        FileNotFoundError: if there is no such file.
        DamagedShard: if it is not what was written.
    """
    for place in read_index(path, key, number):
        read_bytes(path, place)


def _read(file: BinaryIO, path: Path, count: int) -> bytes:
    try:
        return file.read(count)
    except OSError as error:  # of a bad disk; it does not say in which file
        raise DamagedShard(f"{path}: cannot be read: {error.strerror}") from error
