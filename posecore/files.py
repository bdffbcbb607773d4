"""Files that appear whole or not at all, and the hash of several."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Iterable
from pathlib import Path

__all__ = ["hash_files", "write_bytes"]


def hash_files(files: Iterable[tuple[str, Path]]) -> str:
    """A hash of text files, in their order; line ends do not count, as Git may change them.

    Args:
        files: what to call each, the same on every machine, and where it lies.

    Returns:
        16 hexadecimal digits.

    Raises:
        OSError: if one cannot be read.
    """
    digest = hashlib.sha256()
    for name, path in files:
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:16]


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that, whatever happens, the old or the whole new one is there, never a part.

    A process killed while it writes leaves its unfinished copy beside the file, as `.NAME.*.tmp`.

    Raises:
        OSError: if it cannot be written; the old file is untouched and nothing else is left.
    """
    path = Path(path)
    # In the same folder, since a rename is atomic only within one file system.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
