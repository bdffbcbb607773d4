"""A command line as a process: one line for what goes wrong, and for Ctrl-C at any time."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import errno
import importlib
import os
import re
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn

__all__ = [
    "INTERRUPTED",
    "OUTPUT",
    "PIPE_CLOSED",
    "Interrupts",
    "carry_out",
    "lacks_memory",
    "note",
    "refuse_empty",
    "start",
    "warn",
]

INTERRUPTED = 130
"""The exit status after Ctrl-C: 128 and the number of the signal, as a shell has it."""
PIPE_CLOSED = 141
"""The exit status where nobody reads the output to its end, as with `| head`, by the same rule."""
OUTPUT = "standard output"
"""What errors call it."""
# Of PyTorch's allocators; of oneDNN, which cannot prepare a layer; of threads without a stack.
MEMORY = re.compile(
    "allocate memory|not enough memory|out of memory|bad_alloc|start new thread"
    "|could not create a (primitive|memory)"
)
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
    try:
        options = module.parse()
    except SystemExit as end:
        sys.exit(_printed(end.code))  # of a help text, too, one is told that it is not all there
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


def carry_out(
    command: Callable[[], int | None],
    *,
    name: str = "error",
    stopped: str = "interrupted",
    refusals: tuple[type[Exception], ...] = (ValueError, OSError),
    failed: int = 1,
) -> int:
    """Do the work of a command; what is wrong with its input or the machine becomes one line.

    Args:
        command: returns its exit status, None for 0.
        name: with which the line begins.
        stopped: the line after Ctrl-C or SIGTERM.
        refusals: errors that are no fault of the program; others go through, unless they say that
            there is not enough memory.
        failed: the exit status after one of them.

    Returns:
        The exit status; `INTERRUPTED` and `PIPE_CLOSED` are always the same.
    """
    with Interrupts() as interrupts:
        try:
            return _printed(command() or 0, name, failed)
        except KeyboardInterrupt:
            status, line = INTERRUPTED, stopped
        except Exception as error:
            if interrupts.came:  # libraries make errors of their own of it
                status, line = INTERRUPTED, stopped
            elif isinstance(error, BrokenPipeError):
                _leave_output()
                return PIPE_CLOSED
            elif lacks_memory(error):
                words = " ".join(str(error).split())
                status, line = failed, f"{name}: not enough memory: {words:.200}".rstrip(": ")
            elif isinstance(error, refusals):
                if getattr(error, "filename", None) == OUTPUT:
                    _leave_output()
                status, line = failed, f"{name}: {' '.join(str(error).split())}"
            else:
                raise
        # After what was printed before: both may go to one place.
        status = _printed(status, name, failed)
        if status == INTERRUPTED and sys.stderr is not None and sys.stderr.isatty():
            line = f"\n{line}"  # the terminal shows ^C
        warn(line)
        return status


def lacks_memory(error: BaseException) -> bool:
    """Whether an error says that there is not enough memory: libraries have no kind for it."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and MEMORY.search(" ".join(str(error).split())) is not None
    )


def warn(line: str) -> None:
    """Print a line on the error stream; where nobody reads it, the work goes on all the same."""
    with contextlib.suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)


def note(text: str) -> None:
    """Say something on the error stream, where it does not get into a table."""
    warn(f"note: {text}")


def _leave_output() -> None:
    """Let the end of the interpreter find nothing that it would try to print again."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _printed(status: Any, name: str = "error", failed: int = 1) -> Any:
    """Print now what is waiting to be: at Python's end nobody could tell of a full disk.

    Returns:
        `status`, or another one if it was 0 and the output cannot be written.
    """
    try:
        sys.stdout.flush()
    except (AttributeError, ValueError):  # there is none, or it is closed
        return status
    except OSError as error:
        _leave_output()
        if error.errno == errno.EPIPE:
            return status or PIPE_CLOSED
        warn(f"{name}: {OSError(error.errno, error.strerror, OUTPUT)}")
        return status or failed
    return status


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
