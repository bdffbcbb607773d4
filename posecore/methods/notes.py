"""What the command line says beside its results."""

from __future__ import annotations

import sys

__all__ = ["note"]


def note(text: str) -> None:
    """Say something on the error stream, where it does not get into a table."""
    print(f"note: {text}", file=sys.stderr)
