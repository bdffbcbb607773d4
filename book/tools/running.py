"""A student's function run beside the page: on copies, and for a limited time of the processor."""

from __future__ import annotations

import contextvars
import copy
import ctypes
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["PATIENCE", "Limit", "Outcome", "run"]

PATIENCE = 6.0
"""How many times as long as it may compute a function may take in all: it may wait, or sleep."""
SHORTEST = 0.02  # seconds; a page need not look oftener whether a function has ended


@dataclass
class Outcome:
    """What became of a call: a value, an error, or that it was too late.

    `late` says in words how long the page waited, and is empty where the function ended by itself;
    `arguments` are its copies of what it was given, as they are afterwards.
    """

    value: Any = None
    error: BaseException | None = None
    late: str = ""
    arguments: tuple[Any, ...] = ()


class Limit:
    """How long functions may take, several calls together.

    What counts is the time that the processor spends on the function's thread, so that a right
    answer is in time on a busy machine, too. A system that cannot say this of a thread which still
    runs (Windows, macOS) counts the time of the clock instead.

    Args:
        seconds: of computing; of the clock `PATIENCE` times as many.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.computed = self.passed = 0.0

    def wait(self, thread: threading.Thread, computed: Callable[[], float]) -> str:
        """Wait for a thread; why no longer, in words, or nothing where it ended.

        Args:
            thread: which runs.
            computed: how many seconds it has computed so far.
        """
        start, before = time.monotonic(), (self.computed, self.passed)
        longest = PATIENCE * self.seconds
        while True:
            # In that time it can compute no longer than it may.
            left = min(self.seconds - self.computed, longest - self.passed)
            thread.join(max(left, SHORTEST))
            self.computed, self.passed = before[0] + computed(), before[1] + _since(start)
            if not thread.is_alive():
                return ""
            if self.computed >= self.seconds:
                return f"not finished after {self.seconds:g} s; perhaps a loop never ends"
            if self.passed >= longest:
                return f"not finished after {longest:g} s; perhaps it waits for ever"


def run(
    function: Callable[..., Any], arguments: Sequence[Any], limit: Limit | None = None
) -> Outcome:
    """Call a function with copies of arguments, in a thread, for a limited time.

    What it prints appears under the cell that called. Its errors are part of the outcome; nothing
    is raised, but KeyboardInterrupt where the reader stops the page.

    Args:
        function: whatever a student wrote.
        arguments: they stay as they are.
        limit: by default none.
    """
    copies = copy.deepcopy(list(arguments))
    outcome = Outcome(arguments=tuple(copies))
    clock = _Clock()

    def work() -> None:
        clock.start()
        try:
            outcome.value = function(*copies)
        except BaseException as error:
            outcome.error = error
        finally:
            clock.stop()

    # In this cell's context, so that what the student prints appears under this cell.
    context = contextvars.copy_context()
    thread = threading.Thread(target=context.run, args=(work,), daemon=True)
    thread.start()
    late = ""
    try:
        if limit is None:
            thread.join()
        else:
            late = limit.wait(thread, clock.seconds)
    finally:  # also where the reader presses the stop button
        if thread.is_alive():
            _stop(thread)
    return Outcome(late=late) if late else outcome


class _Clock:
    """The seconds for which a thread has computed; the thread itself starts and stops it."""

    def __init__(self) -> None:
        self._begin, self._name, self._total = time.monotonic(), None, None

    def start(self) -> None:
        # Asked for by the thread itself: of one that has ended it must not be asked.
        name_of = getattr(time, "pthread_getcpuclockid", None)
        self._name = None if name_of is None else name_of(threading.get_ident())

    def stop(self) -> None:
        self._total = time.thread_time()

    def seconds(self) -> float:
        if self._total is not None:
            return self._total
        if self._name is not None:
            try:
                return time.clock_gettime(self._name)
            except OSError:  # it has ended just now
                return self._total or 0.0
        return _since(self._begin)


def _since(start: float) -> float:
    return time.monotonic() - start


class _Stop(SystemExit):
    """Sent into a student's thread; a SystemExit ends a thread without a word."""


def _stop(thread: threading.Thread) -> None:
    """Raise in the thread at its next step of Python: a loop must not go on stealing time."""
    for _ in range(20):  # it may catch what is raised
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(thread.ident or 0), ctypes.py_object(_Stop)
        )
        thread.join(0.02)
        if not thread.is_alive():
            return
