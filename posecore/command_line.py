"""A command line as a process: Ctrl-C is one line, from the first import to the end of Python."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import importlib
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

__all__ = ["INTERRUPTED", "Interrupts", "refuse_empty", "start"]

INTERRUPTED = 130
"""The exit status after Ctrl-C: 128 and the number of the signal, as a shell has it."""
AGAIN = 0.2  # seconds from an interrupt to the next look at whether it arrived


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
    ended: list[int] = []
    atexit.register(_end, ended)  # before all others, so it is called after them
    module = importlib.import_module(name)
    options = module.parse()
    if listens:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        status = module.run(options)
    except SystemExit as end:
        status = end.code
    if listens:
        signal.signal(signal.SIGINT, _stop)
    if status == INTERRUPTED:
        # Nothing that was interrupted half-way, such as the import of a library, is to be ended in
        # good order: there threads of its own would go on while Python is taken away under them.
        _end([INTERRUPTED])
    if isinstance(status, int):
        ended.append(status)
    sys.exit(status)


def refuse_empty(options: argparse.Namespace, *positional: str) -> None:
    """Refuse what was given as "": it would be taken for the folder one stands in, or for nothing.

    Args:
        options: of a command.
        positional: names of those that are given without their name.

    Raises:
        ValueError: naming the first one.
    """
    for name, value in vars(options).items():
        if value == "" or (isinstance(value, list) and "" in value):
            shown = name if name in positional else "--" + name.replace("_", "-")
            raise ValueError(f"{shown}: expected a text that is not empty, got ''")


class Interrupts:
    """While it is entered, Ctrl-C and SIGTERM are a `KeyboardInterrupt` that arrives.

    Libraries catch everything here and there, and `__del__` and callbacks lose it: so as long as
    the interrupt is not being handled it is raised again and again. Where it is, in clean-ups and
    until this is left, nothing disturbs. Does nothing outside the main thread, or where the process
    ignores the signal.

    Attributes:
        came: whether there was one; libraries make errors of their own of it.
    """

    came = False

    def __enter__(self) -> Interrupts:
        self._before: dict[int, Any] = {}
        usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
        with contextlib.suppress(ValueError):  # not the main thread
            for number, handler in usual.items():
                if signal.getsignal(number) is handler:
                    signal.signal(number, self._arrives)
                    self._before[number] = handler
        return self

    def __exit__(self, *_: object) -> None:
        if self.came and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _arrives(self, number: int, frame: FrameType | None) -> None:
        if not self.came and hasattr(signal, "setitimer"):  # Windows has none
            if signal.getsignal(signal.SIGALRM) is signal.SIG_DFL:
                self._before[signal.SIGALRM] = signal.SIG_DFL
                signal.signal(signal.SIGALRM, self._looks)
                signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
        self.came = True
        raise KeyboardInterrupt

    def _looks(self, number: int, frame: FrameType | None) -> None:
        """Raise it once more, unless what it met is just being cleaned up."""
        error = sys.exc_info()[1]  # what is handled where this signal came
        while error is not None:
            if isinstance(error, KeyboardInterrupt):
                return
            error = error.__context__
        raise KeyboardInterrupt


def _stop(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


def _end(status: list[int]) -> None:
    """End here, if there is a status: Python that takes itself down no longer hears Ctrl-C."""
    if not status:
        return
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (AttributeError, OSError, ValueError):  # closed, or nobody reads
            if status != [INTERRUPTED]:
                return  # to Python, which has a status for it
    os._exit(status[0])
