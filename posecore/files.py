"""Files that appear whole or not at all, and the hash of several."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["own_stream", "require_path", "write_bytes"]


def require_path(name: str, value: str | Path) -> Path:
    """Return `value` as a path; refuse "", which `Path` takes for the folder one stands in.

    Raises:
        ValueError: if it is no name of a file or folder.
    """
    if not isinstance(value, str | Path) or not str(value) or "\0" in str(value):
        raise ValueError(f"{name}: expected the name of a file or a folder, got {value!r}")
    return Path(value)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that, whatever happens, the old or the whole new one is there, never a part.

    A process killed while it writes leaves its unfinished copy beside the file, as `.NAME.*.tmp`.
    What is there decides what is written: a symbolic link stays one, and the file that it leads to
    is written, with the permissions it had. What is no regular file is never replaced: a terminal,
    a pipe or `/dev/null` is written to, and so is whatever stands behind this process's own output.

    Raises:
        OSError: if it cannot be written, or is a folder or a disk; an old file is untouched and
            nothing else is left.
    """
    path = Path(path)
    with _naming(path):
        status = _status(path)
        if (stream := own_stream(path)) is not None:
            _write_all(stream, data)
        elif status is None or stat.S_ISREG(status.st_mode):
            _replace(path, data, None if status is None else stat.S_IMODE(status.st_mode))
        elif stat.S_ISCHR(status.st_mode) or stat.S_ISFIFO(status.st_mode):
            stream = os.open(path, os.O_WRONLY)
            try:
                _write_all(stream, data)
            finally:
                os.close(stream)
        else:
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "neither a file nor a stream"
            raise OSError(errno.EINVAL, f"expected a file to write, got {kind}")


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let errors of the system name this file, and not none or the unfinished copy beside it."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:
            error.filename = str(path)
            if error.filename2 is not None:
                del error.filename2
        raise


def _status(path: Path) -> os.stat_result | None:
    """Of what is there, at the end of links; None for nothing."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _replace(path: Path, data: bytes, mode: int | None) -> None:
    """Put a new file where a regular one or none is."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    # In the same folder, since a rename is atomic only within one file system.
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None and mode != stat.S_IMODE(temporary.stat().st_mode):
            os.chmod(temporary, mode)
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def own_stream(path: Path) -> int | None:
    """1 or 2 if that output of this process is what lies there, by whatever name; else None.

    Raises:
        OSError: if it cannot be seen what is there.
    """
    status = _status(Path(path))
    if status is None or os.path.samestat(status, os.stat(os.devnull)):
        return None
    for stream in (1, 2):
        with contextlib.suppress(OSError):  # it may be closed
            if os.path.samestat(status, os.fstat(stream)):
                return stream
    return None


def _write_all(stream: int, data: bytes) -> None:
    """Write to an open stream, behind what was printed before."""
    for printed in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # there is none, or it is closed
            printed.flush()
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(stream, rest) :]
