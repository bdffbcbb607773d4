"""A world on disk: records that a function makes, kept in shards, read by their index.

    def make(recipe, index):  # the same for the same arguments, always and everywhere
        rng = np.random.default_rng([recipe["seed"], index])
        ...
        return {"rgb": rgb, "depth": depth, "K": K, "ids": [3, 1], "name": "easy"}

    store = Store("tabletop", {"seed": 1, "width": 320}, 2000, make, version=code_version(...))
    store.make()  # what is not there yet, in parallel; may be killed and called again
    store[1234]

A world lies in a folder of its own, named by a hash of everything its bytes depend on: recipe,
count, shard size and version. So what is found there is what would be made, and nothing is ever out
of date; two processes that make the same world at once write the same files.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import operator
import os
import random
import re
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from tqdm.auto import tqdm

from data_tools.storage.locks import byte_lock
from data_tools.storage.making import START_METHODS, MakingError, can_be_sent, make_in_processes
from data_tools.storage.records import Record, decode_record, encode_record, to_json
from data_tools.storage.shards import (
    DamagedShard,
    Place,
    check_shard,
    pack_shard,
    read_bytes,
    read_index,
)
from posecore.arrays import fail, require_choice, require_integer
from posecore.files import write_bytes
from posecore.scale import cache_folder

__all__ = ["WORLDS", "DamageWarning", "Store"]

WORLDS = "worlds"  # the folder of all worlds in the cache
FORMAT = 1  # of the files; another one makes all worlds anew
FORGOTTEN = 3600  # seconds after which an unfinished file has nobody who still writes it
PATIENCE = 30  # seconds for a shard that another process has begun; more where shards take long
POLL = 0.05  # seconds
FILES_PER_PROCESS = 4  # at the least: a new process takes as long to start as a few files to make


class DamageWarning(UserWarning):
    """A shard was damaged, and is made again."""


class Store:
    """The records of one world, on disk. It can be pickled, and holds no file open.

    Args:
        name: of the world: small letters, digits, "-" and "_".
        recipe: everything that the records depend on besides the code, as JSON can hold it.
        count: how many records there are.
        function: `function(recipe, index)` returns the record with that index (`encode_record` says
            what it may hold), the same one whenever it is called. None only reads.
        version: of the code that makes the records, see `code_version`.
        shard_size: records in a file. What a kill costs is one such file.
        folder: where the worlds lie; None for `worlds` in `cache_folder()`.

    Attributes:
        name, count, version, shard_size: as above.
        recipe: as the function gets it: names in alphabetical order, lists for tuples.
        key: hash of all that the files depend on.
        folder: where this world's files are.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(
        self,
        name: str,
        recipe: Mapping[str, Any],
        count: int,
        function: Callable[[dict[str, Any], int], Record] | None = None,
        *,
        version: str,
        shard_size: int = 16,
        folder: str | Path | None = None,
    ) -> None:
        if not isinstance(name, str) or not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", name):
            fail("name", "small letters, digits, - and _", repr(name))
        if function is not None and not callable(function):
            fail("function", "a function of recipe and index", repr(function))
        if not isinstance(version, str) or not version:
            fail("version", "a string that names the version of the code", repr(version))
        self.name = name
        self.count = require_integer("count", count, 0)
        self.shard_size = require_integer("shard_size", shard_size, 1)
        self.version = version
        self._function = function
        # As text, so that no call of the function can change it for the next one.
        self._recipe = to_json("recipe", dict(recipe) if isinstance(recipe, Mapping) else recipe)
        if not isinstance(self.recipe, dict):
            fail("recipe", "a dict", self._recipe[:80])
        parts = {"format": FORMAT, "name": name, "recipe": self.recipe, "version": version}
        parts |= {"count": self.count, "shard_size": self.shard_size}
        self._description = to_json("recipe", parts)
        self.key = hashlib.sha256(self._description.encode()).hexdigest()
        root = cache_folder() / WORLDS if folder is None else Path(folder)
        self.folder = root / name / self.key[:16]
        self._indices: dict[int, list[Place]] = {}
        self._met: dict[int, float] = {}  # when a shard was first seen in the hands of another
        self._longest = 0.0  # seconds that a shard took here

    @property
    def recipe(self) -> dict[str, Any]:  # noqa: D102
        return json.loads(self._recipe)

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        return f"Store({self.name!r}, {self.count} records in {str(self.folder)!r})"

    def __iter__(self) -> Iterator[Record]:
        return (self[i] for i in range(self.count))

    def __getitem__(self, index: int) -> Record:
        """The record with this index. A shard that is missing or damaged is made, here and now.

        If another process is just making it, that is waited for.

        Raises:
            IndexError: if there is no such record.
            FileNotFoundError: if its shard is missing, and this store has no function.
            DamagedShard: if its shard is damaged, and this store has no function.
            MakingError: if its shard cannot be made.
        """
        index = operator.index(index)
        if not -self.count <= index < self.count:
            raise IndexError(f"{self.name}: no record {index} among {self.count}")
        number, row = divmod(index % self.count, self.shard_size)
        try:
            return self._read(number, row)
        except FileNotFoundError:
            if self._function is None:
                raise FileNotFoundError(
                    f"{self.path(number)}: not made yet, and this store has no function for it"
                ) from None
        except DamagedShard as error:
            if self._function is None:
                raise
            self._discard(number, error)
        self._prepare_folder()
        while not self._make_shard(number):
            pass
        return self._read(number, row)

    @property
    def shards(self) -> int:
        """How many files the world has when it is whole."""
        return -(-self.count // self.shard_size)

    def path(self, number: int) -> Path:
        """The file of a shard."""
        return self.folder / f"{number:06d}.shard"

    def missing(self) -> list[int]:
        """The shards that are not there. Looks at the beginning of every file, and at its size."""
        return [number for number in range(self.shards) if not self._is_there(number)]

    def check(self) -> list[str]:
        """What is wrong with the files, a line for each that is not as it was made; reads all."""
        problems = []
        for number in range(self.shards):
            try:
                check_shard(self.path(number), self.key, number)
            except FileNotFoundError:
                problems.append(f"{self.path(number)}: missing")
            except DamagedShard as error:
                problems.append(str(error))
            except OSError as error:
                problems.append(f"{self.path(number)}: cannot be opened: {error.strerror}")
        return problems

    def make(
        self,
        processes: int | None = None,
        *,
        part: tuple[int, int] = (1, 1),
        progress: bool = True,
        start_method: str = "spawn",
    ) -> int:
        """Make the shards that are missing; damaged ones, found by reading all, are made again.

        Every finished shard is kept, whatever happens to the others.

        Args:
            processes: how many make them; None for one on each core, and fewer for a few files.
                With 1 they are made right here, which any function allows. Several need one from a
                module, since a notebook's or a prompt's cannot be sent (None then means 1).
            part: (i, n) makes every n-th shard from the i-th on, i from 1 to n, to divide a world
                among n machines: their files then belong in one folder.
            progress: whether to show a bar.
            start_method: of other processes: "spawn", "forkserver" or "fork".

        Returns:
            How many shards were not there, or damaged.

        Raises:
            ValueError: naming the argument that does not fit this description.
            MakingError: naming the record or the file that could not be made, and why.
        """
        if self._function is None:
            fail("function", "one that makes records", "none, this store only reads")
        require_choice("start_method", start_method, START_METHODS)
        wanted = range(self.shards)[_part(part)]
        sendable = can_be_sent(self._function, start_method)
        if (
            processes is not None
            and require_integer("processes", processes, 1) > 1
            and not sendable
        ):
            fail("function", "one from a module, for other processes to call", self._function)
        todo = [number for number in wanted if not self._is_whole(number)]
        if not todo:
            return 0
        if processes is None:
            cores = (os.cpu_count() or 1) if sendable else 1
            processes = max(1, min(cores, len(todo) // FILES_PER_PROCESS))
        self._prepare_folder()
        # Whoever makes the same world at the same time takes another order, and skips what is there
        # or begun when its turn comes: so the work is done once.
        _shuffle(todo)
        total = sum(len(self._rows(number)) for number in todo)
        with tqdm(total=total, desc=self.name, unit="record", disable=not progress) as bar:
            if (processes := min(processes, len(todo))) > 1:
                make_in_processes(self._make_shard, todo, processes, start_method, bar.update)
            else:
                waiting = deque(todo)
                while waiting:
                    if not self._make_shard(number := waiting.popleft(), bar.update):
                        waiting.append(number)
        return len(todo)

    def _rows(self, number: int) -> range:
        """The indices of the records in a shard."""
        return range(self.count)[number * self.shard_size : (number + 1) * self.shard_size]

    def _read(self, number: int, row: int) -> Record:
        if number not in self._indices:
            self._indices[number] = read_index(self.path(number), self.key, number)
        return decode_record(read_bytes(self.path(number), self._indices[number][row]))

    def _is_there(self, number: int) -> bool:
        try:
            read_index(self.path(number), self.key, number)
        except (FileNotFoundError, DamagedShard):
            return False
        return True

    def _is_whole(self, number: int) -> bool:
        try:
            check_shard(self.path(number), self.key, number)
        except FileNotFoundError:
            return False
        except DamagedShard as error:
            self._discard(number, error)
            return False
        return True

    def _discard(self, number: int, error: DamagedShard) -> None:
        self._indices.pop(number, None)
        try:
            self.path(number).unlink(missing_ok=True)
        except OSError as problem:
            raise MakingError(f"{error}; it cannot be deleted: {problem.strerror}") from problem
        warnings.warn(f"{error}; it is made again", DamageWarning, stacklevel=2)

    def _prepare_folder(self) -> None:
        for file in self.folder.glob(".*.tmp"):  # of processes that were killed while writing
            with contextlib.suppress(OSError):  # somebody else was quicker
                if time.time() - file.stat().st_mtime > FORGOTTEN:
                    file.unlink()
        if not (self.folder / "recipe.json").is_file():  # for those who look into the folder
            self._write(self.folder / "recipe.json", (self._description + "\n").encode())

    def _make_shard(self, number: int, tick: Callable[[], Any] = lambda: None) -> bool:
        """Make a shard, unless another process has done so in the meantime, or is at it.

        Returns:
            Whether it is there now. If not it is in the hands of another process; asked again and
            again, this waits, and makes it in the end.
        """
        # Two that begin the world may each have a recipe.json at first, and make one shard twice.
        with byte_lock(self.folder / "recipe.json", number) as mine:
            there = self._is_there(number)
            if not there and not mine and not self._waited(number):
                return False
            start, records = time.monotonic(), []
            for index in self._rows(number):
                if not there:
                    records.append(self._make_record(index))
                tick()
            if not there:
                self._write(self.path(number), pack_shard(self.key, number, records))
                self._longest = max(self._longest, time.monotonic() - start)
        self._met.pop(number, None)
        return True

    def _waited(self, number: int) -> bool:
        """Whether a shard has been in the hands of another process for too long."""
        now = time.monotonic()
        if number not in self._met:
            self._met[number] = now
        else:
            time.sleep(POLL)  # nothing else is left to do
        return now - self._met[number] > max(PATIENCE, 2 * self._longest)

    def _make_record(self, index: int) -> bytes:
        try:
            return encode_record(self._function(self.recipe, index))
        except Exception as error:
            kind = type(error).__name__
            raise MakingError(f"{self.name}: record {index}: {kind}: {error}") from error

    def _write(self, path: Path, data: bytes) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, data)
        except OSError as error:
            # Some systems refuse to replace a file that another process reads: then it is there.
            if not (path.is_file() and path.read_bytes() == data):
                raise MakingError(
                    f"{path}: cannot be written: {error.strerror}; finished shards are kept"
                ) from error


def _shuffle(numbers: list[int]) -> None:
    random.SystemRandom().shuffle(numbers)  # two containers may have equal process ids


def _part(part: tuple[int, int]) -> slice:
    try:
        i, n = part
    except (TypeError, ValueError):
        fail("part", "a pair (i, n)", repr(part))
    n = require_integer("part", n, 1)
    return slice(require_integer("part", i, 1, n) - 1, None, n)
