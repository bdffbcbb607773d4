"""Making a world with several processes, and everything that may go wrong meanwhile."""

import contextlib
import errno
import functools
import multiprocessing
import os
import select
import signal
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.storage import MakingError
from data_tools.storage import store as module
from data_tools.storage.making import can_be_sent, make_in_processes
from tests.data_tools.storage import small_worlds
from tests.data_tools.storage.small_worlds import COUNT, files, make, world

resource = pytest.importorskip("resource", reason="these tests need Unix")
pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="these tests fork"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]
SHARDS = 8


@pytest.fixture(scope="session")
def expected(tmp_path_factory):
    """The files of the world, made without disturbance in one process."""
    store = world(tmp_path_factory.mktemp("whole"))
    store.make(1, progress=False)
    return files(store)


def in_a_process(function, *arguments, errors=os.devnull, **named):
    """Call a function in a process of its own that has a group of its own; returns the process."""

    def call():
        os.setsid()
        sys.stderr = open(errors, "a", buffering=1)
        function(*arguments, **named)

    process = multiprocessing.get_context("fork").Process(target=call)
    # The end for writing goes to it and to all that it starts: it is closed when all have ended.
    process.alive, writing = os.pipe()
    process.start()
    os.close(writing)
    return process


def ended(process):
    process.join(20)
    assert not process.is_alive()
    return process.exitcode


def group_is_gone(process):
    """Whether within seconds a process and all that it started have ended."""
    readable, _, _ = select.select([process.alive], [], [], 10)
    return bool(readable) and os.read(process.alive, 1) == b""


def unfinished(store):
    return [p.name for p in store.folder.glob(".*")] if store.folder.exists() else []


def finished(store):
    """The shards that are there, each of them whole."""
    there = set(range(SHARDS)) - set(store.missing())
    broken = [line for line in store.check() if not line.endswith("missing")]
    assert broken == []
    return there


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_several_processes_make_the_same_files(tmp_path, expected, method):
    store = world(tmp_path, shard_size=3)
    assert store.make(2, start_method=method, progress=False) == SHARDS
    assert files(store) == expected
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("processes", [1, 2])
def test_parts_on_several_machines(tmp_path, expected, processes):
    numbers = []
    for i in (1, 2, 3):
        store = world(tmp_path)
        before = finished(store)
        store.make(processes, part=(i, 3), start_method="fork", progress=False)
        numbers.append(sorted(finished(store) - before))
    assert numbers == [[0, 3, 6], [1, 4, 7], [2, 5]]
    assert files(store) == expected


@settings(max_examples=8)
@given(numbers=st.lists(st.integers(0, 99), max_size=9), processes=st.integers(1, 3))
def test_every_number_is_made_once(tmp_path_factory, numbers, processes):
    log = tmp_path_factory.mktemp("log") / "log"

    def make_shard(number, tick):
        with log.open("a") as file:
            file.write(f"{number}\n")
        tick()
        tick()

    ticks = []
    make_in_processes(make_shard, numbers, processes, "fork", lambda: ticks.append(1))
    made = log.read_text().split() if numbers else []
    assert sorted(map(int, made)) == sorted(numbers)
    assert len(ticks) == 2 * len(numbers)


# Killed at moments chosen by the clock: while processes start, make records, write or end.
@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("moment", [0.0, 0.03, 0.08, 0.13, 0.18, 0.24])
def test_killed_at_any_moment(tmp_path, expected, moment, processes):
    store = world(tmp_path, slow)
    process = in_a_process(store.make, processes, start_method="fork", progress=False)
    time.sleep(moment / processes)  # two are ready in half the time
    os.kill(process.pid, signal.SIGKILL)
    status = ended(process)
    assert group_is_gone(process), "the processes that it started end as well"
    kept = {number: store.path(number).stat().st_mtime_ns for number in finished(store)}
    # On a busy machine the last kill may come when all is done.
    assert status == -signal.SIGKILL or len(kept) == SHARDS
    assert world(tmp_path).make(1, progress=False) == SHARDS - len(kept)
    for number, made in kept.items():
        assert store.path(number).stat().st_mtime_ns == made, "what was there is not made again"
    assert without_unfinished(files(store)) == expected


def slow(recipe, index):
    """All 23 records take about 0.28 s."""
    time.sleep(0.012)
    return make(recipe, index)


def slower(recipe, index):
    time.sleep(0.04)
    return make(recipe, index)


def without_unfinished(content):
    return {name: data for name, data in content.items() if not name.startswith(".")}


# Killed at moments chosen by the code: in the middle of a record, with the file half written,
# written but not yet in its place, just put there.
@pytest.mark.parametrize("time_around", [1, 4])
@pytest.mark.parametrize(
    ("function", "when"),
    [("make", "before"), ("os.fsync", "before"), ("os.replace", "before"), ("os.replace", "after")],
)
def test_killed_in_the_middle_of_writing(tmp_path, expected, function, when, time_around):
    store = world(tmp_path, lambda recipe, index: small_worlds.make(recipe, index))

    def run():
        owner, name = (small_worlds, "make") if function == "make" else (os, function[3:])
        real, calls = getattr(owner, name), []

        def deadly(*arguments):
            calls.append(1)
            if when == "after":
                result = real(*arguments)
            if len(calls) == time_around + 1:
                os.kill(os.getpid(), signal.SIGKILL)
            return result if when == "after" else real(*arguments)

        setattr(owner, name, deadly)
        store.make(1, progress=False)

    process = in_a_process(run)
    assert ended(process) == -signal.SIGKILL
    # The first file of all is recipe.json; each shard holds three records.
    kept = time_around // 3 if function == "make" else time_around - (when == "before")
    assert len(finished(store)) == kept
    assert len(unfinished(store)) == (function != "make" and when == "before")
    assert store.make(1, progress=False) == SHARDS - kept
    assert without_unfinished(files(store)) == expected


def test_a_process_that_is_killed(tmp_path, expected):
    """One of those that make shards: the error says so, the others finish, the rest comes later."""
    store = world(tmp_path, small_worlds.make_or_die, bad=10, done=str(tmp_path / "done"))
    with pytest.raises(MakingError, match="shard 3: the process .* ended early, with exit code 9"):
        store.make(2, start_method="fork", progress=False)
    assert 3 in store.missing()
    finished(store)
    assert store.make(2, start_method="fork", progress=False) >= 1
    assert store.missing() == []
    for i, record in enumerate(store):
        np.testing.assert_array_equal(record["rgb"], make(small_worlds.RECIPE, i)["rgb"])


@pytest.mark.parametrize("processes", [1, 3])
def test_all_processes_are_killed(processes):
    def die(number, tick):
        os.kill(os.getpid(), signal.SIGKILL)

    def run():
        with pytest.raises(MakingError, match="ended early, with signal 9"):
            make_in_processes(die, range(9), processes, "fork", print)
        os._exit(7)

    assert ended(in_a_process(run)) == 7


@pytest.mark.parametrize("processes", [1, 2])
def test_after_a_failure_no_shard_is_begun(tmp_path, processes):
    def make_shard(number, tick):
        (tmp_path / str(number)).touch()
        time.sleep(0.05 * number)
        raise ZeroDivisionError(f"shard {number}")

    with pytest.raises(MakingError, match="shard 0"):
        make_in_processes(make_shard, range(9), processes, "fork", print)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["0", "1"][:processes]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_record_that_cannot_be_made(tmp_path, processes):
    store = world(tmp_path, small_worlds.make_or_fail, bad=13)
    text = "small: record 13: ZeroDivisionError: nothing to divide by"
    with pytest.raises(MakingError, match=text) as caught:
        store.make(processes, start_method="fork", progress=False)
    if processes == 1:
        assert isinstance(caught.value.__cause__, ZeroDivisionError)
    else:
        assert "in make_or_fail" in caught.value.__notes__[0], "where it happened"
    kept = finished(store)
    assert 4 not in kept
    assert unfinished(store) == []
    for number in set(range(SHARDS)) - {4}:
        store[number * 3]
    assert store.missing() == [4], "all others can be made"
    with pytest.raises(MakingError, match=text):
        store[12]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_record_that_cannot_be_kept(tmp_path, processes):
    store = world(tmp_path, small_worlds.make_wrong, bad=0)
    with pytest.raises(MakingError, match="record 0: ValueError: odd: expected what JSON holds"):
        store.make(processes, start_method="fork", progress=False)


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("room", [0, 1, 4])
def test_a_full_disk(tmp_path, expected, monkeypatch, processes, room):
    """The disk takes a few files, then none."""
    store = world(tmp_path)
    real = os.fsync

    def full(descriptor):
        if len(list(store.folder.glob("[!.]*"))) >= room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(MakingError, match=f"{tmp_path}.*cannot be written: No space left"):
            store.make(processes, start_method="fork", progress=False)
    assert unfinished(store) == []
    kept = finished(store)
    assert max(0, room - 1) <= len(kept) <= room + processes
    assert store.make(1, progress=False) == SHARDS - len(kept)
    assert files(store) == expected


def test_a_file_that_really_cannot_grow(tmp_path, expected):
    """The operating system itself ends the writing in the middle of a file."""
    store = world(tmp_path)

    def run():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # a shard has about 2300 bytes
        with pytest.raises(MakingError, match="cannot be written: File too large"):
            store.make(1, progress=False)
        os._exit(7)

    assert all(len(data) > 1000 for name, data in expected.items() if name.endswith("shard"))
    assert ended(in_a_process(run)) == 7
    assert [p.name for p in store.folder.iterdir()] == ["recipe.json"]
    store.make(1, progress=False)
    assert files(store) == expected


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("to_all", [True, False])
def test_interrupted_from_the_keyboard(tmp_path, expected, processes, to_all):
    """In a terminal all processes get the signal, in a notebook only the first."""
    store = world(tmp_path, slower)

    def run():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            store.make(processes, start_method="fork", progress=False)
        except KeyboardInterrupt:
            os._exit(7)

    process = in_a_process(run, errors=tmp_path / "errors")
    while not list(tmp_path.rglob("*.shard")):  # it is well under way
        time.sleep(0.002)
    (os.killpg if to_all else os.kill)(process.pid, signal.SIGINT)
    assert ended(process) == 7
    assert group_is_gone(process)
    assert (tmp_path / "errors").read_text() == "", "the others go without a word"
    assert unfinished(store) == []
    kept = finished(store)
    assert 1 <= len(kept) < SHARDS
    assert world(tmp_path).make(1, progress=False) == SHARDS - len(kept)
    assert files(store) == expected


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("pid", [None, 1], ids=["", "equal process ids"])
@pytest.mark.parametrize("order", ["the same", "opposite"])
def test_two_at_once(tmp_path, expected, processes, pid, order, monkeypatch):
    """Both end well, and the work is done once, whatever the order that chance gives them.

    Until makers announced what they begin, both made all where their process ids were equal.
    """
    log = tmp_path / "log"
    if pid is not None:
        monkeypatch.setattr(os, "getpid", lambda: pid)

    def logged(recipe, index):
        with log.open("a") as file:
            file.write(f"{index}\n")
        time.sleep(0.015)
        return make(recipe, index)

    def run(many, turned):
        module._shuffle = lambda numbers: numbers.sort(reverse=turned)
        world(tmp_path / "world", logged).make(many, start_method="fork", progress=False)

    world(tmp_path / "world", logged)._prepare_folder()
    makers = [
        in_a_process(run, many, turned and order == "opposite", errors=tmp_path / "errors")
        for many, turned in ((1, False), (processes, True))
    ]
    assert [ended(maker) for maker in makers] == [0, 0], (tmp_path / "errors").read_text()
    assert files(world(tmp_path / "world")) == expected
    made = list(map(int, log.read_text().split()))
    assert sorted(made) == list(range(COUNT))


def test_the_order_is_chance_whatever_the_process_id(monkeypatch):
    monkeypatch.setattr(os, "getpid", lambda: 1)
    orders = set()
    for _ in range(20):
        module._shuffle(numbers := list(range(99)))
        assert sorted(numbers) == list(range(99))
        orders.add(tuple(numbers))
    assert len(orders) == 20


@pytest.mark.parametrize("reading", [True, False])
def test_a_maker_that_stands_still_is_not_waited_for_for_ever(tmp_path, reading, monkeypatch):
    """As one that was suspended. What it has in hand comes last, and is made in the end."""
    log = tmp_path / "log"

    def stopping(recipe, index):
        if os.getpid() != here:
            (tmp_path / "begun").touch()
            os.kill(os.getpid(), signal.SIGSTOP)
        with log.open("a") as file:
            file.write(f"{index}\n")
        return make(recipe, index)

    here = os.getpid()
    monkeypatch.setattr(module, "_shuffle", list.sort)
    maker = in_a_process(world(tmp_path / "world", stopping).make, 1, progress=False)
    while not (tmp_path / "begun").exists():
        time.sleep(0.01)
    monkeypatch.setattr(module, "PATIENCE", 0.3)
    store, start = world(tmp_path / "world", stopping), time.monotonic()
    if reading:
        assert [record["index"] for record in store] == list(range(COUNT))
    else:
        assert store.make(1, progress=False) == SHARDS
    assert time.monotonic() - start > 0.3
    assert store.missing() == []
    indices = list(map(int, log.read_text().split()))
    others = [index for index in range(COUNT) if index > 2]
    assert indices == ([0, 1, 2, *others] if reading else [*others, 0, 1, 2])
    os.kill(maker.pid, signal.SIGCONT)
    os.kill(maker.pid, signal.SIGKILL)
    assert ended(maker) == -signal.SIGKILL


def test_two_ask_for_the_same_record(tmp_path, expected):
    log = tmp_path / "log"

    def run(store):
        assert [record["index"] for record in store] == list(range(COUNT))

    def logged(recipe, index):
        with log.open("a") as file:
            file.write(f"{index}\n")
        return slow(recipe, index)

    store = world(tmp_path / "world", logged)
    store._prepare_folder()
    readers = [in_a_process(run, world(tmp_path / "world", logged)) for _ in range(2)]
    assert [ended(reader) for reader in readers] == [0, 0]
    assert files(store) == expected
    assert sorted(map(int, log.read_text().split())) == list(range(COUNT)), "each is made once"


def test_in_a_process_that_may_not_start_others(tmp_path, expected):
    """As the workers of a data loader, which are daemons: what is missing is made right there."""
    store = world(tmp_path)
    context = multiprocessing.get_context("fork")
    process = context.Process(target=lambda: os._exit(store[4]["index"]), daemon=True)
    process.start()
    assert ended(process) == 4
    assert store.path(1).read_bytes() == expected["000001.shard"]


def test_which_functions_can_be_sent():
    def local(recipe, index):
        return {}

    typed = type(local)(local.__code__, {"__name__": "__main__"})
    assert typed.__module__ == "__main__"
    assert all(can_be_sent(f, "fork") for f in (make, local, typed))
    assert all(can_be_sent(f, "spawn") for f in (make, functools.partial(make, index=1)))
    assert not can_be_sent(local, "spawn")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "modules", sys.modules | {"__main__": type(os)("__main__")})
        assert not can_be_sent(typed, "spawn"), "a notebook is in no file"
        sys.modules["__main__"].__file__ = "script.py"
        assert can_be_sent(typed, "spawn"), "a script is run again by the other process"


def test_a_function_of_a_notebook_is_called_here(tmp_path, expected):
    here = os.getpid()

    def local(recipe, index):
        assert os.getpid() == here
        return make(recipe, index)

    store = world(tmp_path, local)
    assert store.make(progress=False) == SHARDS
    assert files(store) == expected
    with pytest.raises(ValueError, match="function: expected one from a module"):
        store.make(2)
    with contextlib.suppress(FileNotFoundError):
        store.path(1).unlink()
    assert world(tmp_path).make(2, start_method="fork", progress=False) == 1


def nothing(number, tick):
    """A shard without records."""


def test_an_interrupt_while_processes_start_waits_for_them(monkeypatch, capfd):
    """They would end in the middle of their imports, with tracebacks; nor may it be lost."""

    class Interrupted(multiprocessing.context.SpawnProcess):
        def start(self):
            signal.raise_signal(signal.SIGINT)
            super().start()
            os.kill(self.pid, signal.SIGINT)

    context = multiprocessing.get_context("spawn")
    monkeypatch.setattr(context, "Process", Interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            make_in_processes(nothing, range(3), 2, "spawn", print)
    finally:
        signal.signal(signal.SIGINT, before)
    assert multiprocessing.active_children() == []
    assert capfd.readouterr().err == ""


def test_a_process_that_swallows_its_end_is_told_again(tmp_path, monkeypatch):
    from data_tools.storage import making

    def deaf(number, tick):
        if number:
            while not (tmp_path / "deaf").exists():
                time.sleep(0.001)
            raise ZeroDivisionError
        with contextlib.suppress(SystemExit):
            (tmp_path / "deaf").touch()
            time.sleep(60)
        while True:
            time.sleep(0.01)

    def run():
        monkeypatch.setattr(making, "PATIENCE", 0.1)
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with contextlib.suppress(KeyboardInterrupt):
            make_in_processes(deaf, range(2), 2, "fork", print)
        os._exit(7)

    process = in_a_process(run)
    assert ended(process) == 7
    assert group_is_gone(process)
