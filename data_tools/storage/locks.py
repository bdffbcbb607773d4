"""Locks that the operating system keeps: whatever ends a process, even a kill, ends its locks.

They hold between processes that share a file system, whether they share a machine, a container and
process ids or not; not between threads of one process. Where a system or a file system knows no
locks everybody gets them, so they may save work and join edits, but nothing else rests on them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
    import msvcrt

__all__ = ["Claim", "byte_lock", "claim", "file_lock"]

FAR = 1 << 30  # Windows lets nobody read what is locked, so that is no byte that a file has
POLL = 0.02  # seconds
HELD: set[Path] = set()  # claims of this process, whose threads the system's locks let through
BUSY = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextlib.contextmanager
def byte_lock(path: Path, byte: int = 0) -> Iterator[bool]:
    """Take one of the many locks that go with a file, if nobody has it; the file stays as it is.

    Args:
        path: of a file that is there.
        byte: which lock, from 0 on.

    Yields:
        False if another process has it; True if this one has it now, or locks are not to be had.
    """
    try:
        file = path.open("r+b")
    except OSError:  # it is not there, or may only be read
        yield True
        return
    with file:
        yield _taken(file.fileno(), FAR + byte)


@contextlib.contextmanager
def file_lock(path: Path) -> Iterator[None]:
    """Wait for the lock of a file that is replaced as a whole, and hold it.

    It is `.NAME.lock.tmp` in the same folder, there as long as somebody has it; a kill leaves it
    behind, and whoever comes next takes it.

    Raises:
        OSError: if there is no such folder, or it cannot be written to.
    """
    lock = path.with_name(f".{path.name}.lock.tmp")
    while True:
        with lock.open("ab") as file:
            if _taken(file.fileno(), FAR) and _is_still(lock, file.fileno()):
                try:
                    yield
                finally:
                    with contextlib.suppress(OSError):  # open on Windows
                        lock.unlink()
                return
        time.sleep(POLL)


class Claim(NamedTuple):
    """What came of a claim.

    Attributes:
        mine: whether nobody else has it.
        left: whether one who had it before was killed, so that what is found there is of nobody.
    """

    mine: bool
    left: bool


@contextlib.contextmanager
def claim(path: Path) -> Iterator[Claim]:
    """Take a file or a folder, there or not, for this process alone; nobody waits.

    As for `file_lock` `.NAME.lock.tmp` lies in the same folder as long as somebody has it; a kill
    leaves it behind.

    Raises:
        OSError: if there is no such folder, or it cannot be written to.
    """
    path = Path(os.path.realpath(path))
    lock = path.with_name(f".{path.name}.lock.tmp")
    if path in HELD:
        yield Claim(False, False)
        return
    found = lock.exists()
    while True:
        with lock.open("ab") as file:
            if not (sure := _locked(file.fileno(), FAR)) and sure is not None:
                yield Claim(False, False)
                return
            if not _is_still(lock, file.fileno()):  # its last owner has just removed it
                found = False
                continue
            HELD.add(path)
            try:
                yield Claim(True, found and sure is True)
            finally:
                HELD.discard(path)
                with contextlib.suppress(OSError):  # open on Windows
                    lock.unlink()
            return


def _taken(descriptor: int, byte: int) -> bool:
    return _locked(descriptor, byte) is not False


def _locked(descriptor: int, byte: int) -> bool | None:
    """Whether the lock could be taken; None where there are no locks."""
    try:
        if fcntl is not None:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
        else:
            os.lseek(descriptor, byte, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        return False if error.errno in BUSY else None
    return True


def _is_still(path: Path, descriptor: int) -> bool:
    """Whether an open file is the one of this name; its last owner may just have removed it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
