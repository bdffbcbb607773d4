"""What the command line says: its results, and what there is to say beside them."""

from __future__ import annotations

import contextlib
import os
import re
import sys

__all__ = ["OUTPUT", "lacks_memory", "leave_output", "note", "say", "warn"]

OUTPUT = "standard output"
"""What errors call it."""


# Of PyTorch's allocators; of oneDNN, which cannot prepare a layer; of threads without a stack.
MEMORY = re.compile(
    "allocate memory|not enough memory|out of memory|bad_alloc|start new thread"
    "|could not create a (primitive|memory)"
)


def lacks_memory(error: BaseException) -> bool:
    """Whether an error says that there is not enough memory: libraries have no kind for it."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and MEMORY.search(" ".join(str(error).split())) is not None
    )


def say(text: str) -> None:
    """Print results, all of them now.

    Raises:
        OSError: naming `OUTPUT`, if nobody reads it any more or its disk is full.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        error.filename = OUTPUT
        raise


def note(text: str) -> None:
    """Say something on the error stream, where it does not get into a table."""
    warn(f"note: {text}")


def warn(line: str) -> None:
    """Print a line on the error stream; where nobody reads it, the work goes on all the same."""
    with contextlib.suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)


def leave_output() -> None:
    """Let the end of the interpreter find nothing that it would try to print again."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
