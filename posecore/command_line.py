"""A command line as a process: Ctrl-C is one line, from the first import to the end of Python."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from typing import NoReturn

__all__ = ["start"]


def start(name: str) -> NoReturn:
    """Run a command line and end the process with the status it returns.

    Until its options are read, and after its end, Ctrl-C ends the process at once with status 130:
    nothing is begun that would need an end, and libraries that are being imported would make errors
    of their own of a `KeyboardInterrupt`. A process in the background that ignores it goes on.

    Args:
        name: the full name of a module with `parse() -> options` and `run(options) -> status`.
    """
    # Threads that wait by spinning take the cores on which others compute: on a busy machine two of
    # them took four times the time of one. Read when torch is loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if listens:
        signal.signal(signal.SIGINT, _stop)
    module = importlib.import_module(name)
    options = module.parse()
    if listens:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    status = module.run(options)
    if listens:
        signal.signal(signal.SIGINT, _stop)
    sys.exit(status)


def _stop(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(130)
