"""Shards made by several processes at once.

Each process holds one end of a pipe: it is told a number, makes that shard, says so, and is told
the next. A process that is killed leaves nothing behind that could hold up another; and if the one
that hands out the numbers is killed, the others notice and end as well.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

__all__ = ["START_METHODS", "MakingError", "can_be_sent", "make_in_processes"]

START_METHODS = ("spawn", "fork", "forkserver")
PATIENCE = 5.0  # seconds for a process to take away what it has not finished

MakeShard = Callable[[int, Callable[[], Any]], bool | None]
"""Makes the shard with a number, and calls back after each of its records; False for one that is to
be asked for again later, when all others have been."""


class MakingError(RuntimeError):
    """A shard could not be made; says which record or file, and why. Finished shards are kept."""


def make_in_processes(
    make_shard: MakeShard,
    numbers: Iterable[int],
    processes: int,
    start_method: str,
    tick: Callable[[], Any],
) -> None:
    """Call `make_shard` for all numbers, in other processes.

    After a failure no further shard is begun; those in hand are finished. An interrupt stops all
    at once.

    Args:
        make_shard: can be pickled, unless processes are forked.
        numbers: of the shards.
        processes: how many to start.
        start_method: how, see `multiprocessing`.
        tick: called after each record.

    Raises:
        MakingError: the first failure, also if a process was killed.
    """
    context: Any = multiprocessing.get_context(start_method)
    waiting = deque(numbers)
    workers: dict[Connection, BaseProcess] = {}
    busy: dict[Connection, int] = {}
    failures: list[MakingError] = []

    def go_on(connection: Connection) -> None:
        busy.pop(connection, None)
        if waiting and not failures:
            busy[connection] = waiting.popleft()
            with contextlib.suppress(OSError):  # it has died, which shows when its answer is read
                connection.send(busy[connection])

    # A process is only given the script that asks for it if it needs what is defined there.
    aside = contextlib.nullcontext
    if start_method != "fork" and b"__main__" not in pickle.dumps(make_shard):
        aside = _script_aside
    if start_method != "fork" and os.name == "posix":
        resource_tracker.ensure_running()  # as it is started it would let interrupts through
    try:
        for _ in range(processes):
            ours, theirs = context.Pipe()
            workers[ours] = context.Process(target=_work, args=(make_shard, theirs), daemon=True)
            with aside(), _interrupts_kept():
                workers[ours].start()
            theirs.close()
            go_on(ours)
        while busy:
            for connection in wait(list(busy)):
                try:
                    message = connection.recv()
                except (EOFError, OSError):
                    failures.append(_died(workers[connection], busy.pop(connection)))
                    continue
                if message == "record":
                    tick()
                    continue
                if message == "later":
                    waiting.append(busy[connection])
                elif message != "made":
                    failures.append(_failed(*message))
                go_on(connection)
    finally:
        for process in workers.values():
            if process.pid is not None:  # it was started
                while process.is_alive():  # a library may have swallowed what ends it
                    process.terminate()
                    process.join(PATIENCE)
        for connection in workers:
            connection.close()
    if failures:
        raise failures[0]


def can_be_sent(function: Callable[..., Any], start_method: str) -> bool:
    """Whether another process can be given this function."""
    if start_method == "fork":
        return True
    if getattr(function, "__module__", None) == "__main__":
        # What was typed at a prompt or in a notebook is in no file that another process could run.
        return hasattr(sys.modules["__main__"], "__file__")
    try:
        pickle.dumps(function)
    except Exception:  # each kind of object has its own way of refusing
        return False
    return True


@contextlib.contextmanager
def _script_aside() -> Iterator[None]:
    """Processes started meanwhile do not run the main script, so it needs no `__main__` guard.

    They would begin with the file or module that these two names of the main module point to.
    """
    main = vars(sys.modules["__main__"])
    kept = {name: main[name] for name in ("__spec__", "__file__") if name in main}
    main.update(dict.fromkeys(kept))
    try:
        yield
    finally:
        main.update(kept)


@contextlib.contextmanager
def _interrupts_kept() -> Iterator[None]:
    """An interrupt comes after this; processes started meanwhile have none until they ask for it.

    They would end in the middle of their imports, with a word about it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(make_shard: MakeShard, connection: Connection) -> None:
    """What another process does until the pipe closes."""
    # An interrupt from the keyboard reaches all processes; the first one decides. When that ends
    # the others, they leave as from an error, so that unfinished files are taken away.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = multiprocessing.parent_process().sentinel
    try:
        # A forked process has the other end of its pipe too, so it would never see that closed.
        while connection in wait([connection, parent]):
            number = connection.recv()
            try:
                made = make_shard(number, lambda: connection.send("record"))
            except Exception as error:
                connection.send((str(error), traceback.format_exc()))
            else:
                connection.send("later" if made is False else "made")
    except (EOFError, OSError):  # nobody is there any more
        pass


def _failed(message: str, trace: str) -> MakingError:
    error = MakingError(message)
    error.add_note(f"In another process:\n{trace}")
    return error


def _died(process: BaseProcess, number: int) -> MakingError:
    process.join()
    code = process.exitcode or 0
    reason = f"exit code {code}" if code >= 0 else f"signal {-code}"
    return MakingError(f"shard {number}: the process that made it ended early, with {reason}")
