"""What the command line says: its results, and what there is to say beside them."""

from __future__ import annotations

from posecore.command_line import OUTPUT, note

__all__ = ["note", "say"]


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
