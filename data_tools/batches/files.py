"""Images of a dataset in files that are mapped into memory, so that opening them reads nothing.

A chunk is CHUNK_SIZE views. Its file is a shard (`data_tools.storage.shards`) of two or more
records: first the table of what is known of the views, then each kind of image as plain bytes, so
that a NumPy array can look into the file. Table and index are checked when a chunk is opened,
images when they are first asked for.
"""

from __future__ import annotations

import hashlib
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from data_tools.storage import DamagedShard, DamageWarning, MakingError
from data_tools.storage.records import Record, decode_record, encode_record, to_json
from data_tools.storage.shards import Place, pack_shard, read_bytes, read_index
from posecore.files import write_bytes

__all__ = ["CHUNK_SIZE", "ImageChunks"]

CHUNK_SIZE = 64  # views; what a kill costs is one chunk
Images = dict[str, np.ndarray]
Make = Callable[[int], tuple[Record, Images]]


class ImageChunks:
    """The chunks of a dataset: what is not there, or damaged, is made when it is asked for.

    Args:
        folder: where the folder of this dataset lies; None keeps all in memory.
        recipe: everything that the chunks depend on, as JSON can hold it.
        make: `make(number)` gives the table and the images of a chunk.
    """

    def __init__(self, folder: Path | None, recipe: dict, make: Make) -> None:
        self.key = hashlib.sha256(to_json("recipe", recipe).encode()).hexdigest()
        self.folder = None if folder is None else folder / self.key[:16]
        self._make = make
        self._tables: dict[int, Record] = {}
        self._images: dict[int, Images] = {}
        self._sums: dict[int, list[tuple[str, int]]] = {}  # of images that nobody asked for yet

    def path(self, number: int) -> Path:
        """The file of a chunk."""
        return self.folder / f"{number:06d}.shard"

    def table(self, number: int) -> Record:
        """What is known of the views of a chunk."""
        if number not in self._tables:
            self._open(number)
        return self._tables[number]

    def exists(self, number: int) -> bool:
        """Whether a chunk is at hand; its file may yet turn out to be damaged."""
        return number in self._tables or (self.folder is not None and self.path(number).is_file())

    def kinds(self, number: int) -> dict[str, tuple[int, ...]]:
        """The shape of one image of each kind."""
        self.table(number)
        return {name: array.shape[1:] for name, array in self._images[number].items()}

    def images(self, number: int) -> Images:
        """The images of a chunk by their kind, views along the first axis; not to be changed."""
        self.table(number)
        for name, checksum in self._sums.pop(number, ()):
            if zlib.crc32(self._images[number][name].reshape(-1)) != checksum:
                self._images.pop(number)
                self._tables.pop(number)
                self._discard(number, f"wrong checksum of {name}")
                return self.images(number)
        return self._images[number]

    def __getstate__(self) -> dict:
        """Files are opened anew where this is unpickled."""
        if self.folder is None:
            return self.__dict__
        return self.__dict__ | {"_tables": {}, "_images": {}, "_sums": {}}

    def _open(self, number: int) -> None:
        if self.folder is None:
            self._tables[number], self._images[number] = self._make(number)
            return
        try:
            self._map(number)
        except FileNotFoundError:
            self._write(number)
            self._map(number)
        except DamagedShard as error:
            self._discard(number, str(error).removeprefix(f"{self.path(number)}: "))
            self._write(number)
            self._map(number)

    def _map(self, number: int) -> None:
        path = self.path(number)
        first, *rest = read_index(path, self.key, number)
        table = decode_record(read_bytes(path, first))
        kinds = table.pop("images")
        images = {}
        for (name, dtype, shape), place in zip(kinds, rest, strict=True):
            images[name] = _look_into(path, np.dtype(dtype), shape, place)
        self._tables[number], self._images[number] = table, images
        self._sums[number] = [(k[0], p.checksum) for k, p in zip(kinds, rest, strict=True)]

    def _write(self, number: int) -> None:
        table, images = self._make(number)
        kinds = [
            [name, array.dtype.newbyteorder("<").str, list(array.shape)]
            for name, array in images.items()
        ]
        records = [encode_record(table | {"images": kinds})]
        records += [
            array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
            for array in images.values()
        ]
        path, data = self.path(number), pack_shard(self.key, number, records)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, data)
        except OSError as error:
            # Some systems refuse to replace a file that another process reads: then it is there.
            if not (path.is_file() and path.read_bytes() == data):
                problem = f"{path}: cannot be written: {error.strerror}"
                raise MakingError(f"{problem}; finished chunks are kept") from error

    def _discard(self, number: int, reason: str) -> None:
        self.path(number).unlink(missing_ok=True)
        warnings.warn(
            f"{self.path(number)}: {reason}; it is made again", DamageWarning, stacklevel=2
        )


def _look_into(path: Path, dtype: np.dtype, shape: list[int], place: Place) -> np.ndarray:
    if 0 in shape:
        return np.zeros(shape, dtype)
    return np.memmap(path, dtype, "r", offset=place.offset, shape=tuple(shape))
