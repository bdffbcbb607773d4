"""What does not fit into memory is refused before any is taken."""

from __future__ import annotations

import contextlib
import functools
import os
from pathlib import Path

from posecore.arrays import fail

__all__ = ["BYTES", "machine_memory", "require_bytes", "require_room"]

BYTES = 30  # of a pixel of a batch at the least: colours, which object, and what they are made from
UNKNOWN = 64 * 2**30  # where a system does not say how much memory there is
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


@functools.cache
def machine_memory() -> int:
    """Bytes that this machine has, or that its container may take."""
    known = [UNKNOWN]
    with contextlib.suppress(AttributeError, OSError, ValueError):  # no POSIX
        known = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in LIMITS:
        with contextlib.suppress(OSError, ValueError):  # no Linux, or no limit
            known.append(int(Path(path).read_text()))
    return min(number for number in known if number > 0)


def require_room(name: str, images: int, size: tuple[int, int], each: int = BYTES) -> None:
    """Refuse a batch that is larger than the machine.

    Args:
        name: of the argument that asks for it.
        images: how many.
        size: (width, height) of each in pixels.
        each: bytes that a pixel takes at the least.

    Raises:
        ValueError: if they need more than `machine_memory()`.
    """
    needed = images * size[0] * size[1] * each
    require_bytes(
        name, "a batch that fits into", f"{images} images of {size[0]} x {size[1]}", needed
    )


def require_bytes(name: str, expected: str, what: str, needed: float) -> None:
    """Refuse what needs more bytes than `machine_memory()`.

    Raises:
        ValueError: "NAME: expected EXPECTED 16 GiB of memory, got WHAT, which need 20 GiB".
    """
    if needed > machine_memory():
        there, needed = machine_memory() / 2**30, needed / 2**30
        got = f"{what}, which need {needed:.3g} GiB"
        fail(name, f"{expected} {there:.3g} GiB of memory", got)
