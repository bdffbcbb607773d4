"""Locks end with the process that has them, however it ends."""

import errno
import multiprocessing
import os
import signal
import time

import pytest

from data_tools.storage import locks
from data_tools.storage.locks import byte_lock, claim, file_lock

pytest.importorskip("fcntl", reason="these tests fork")
pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "ledger.json"
    path.write_text("{}")
    return path


def elsewhere(function, *arguments):
    process = multiprocessing.get_context("fork").Process(target=function, args=arguments)
    process.start()
    return process


def hold(lock, path, begun, *arguments):
    with lock(path, *arguments):
        begun.touch()
        time.sleep(60)


def holder(lock, path, *arguments):
    begun = path.with_name("begun")
    process = elsewhere(hold, lock, path, begun, *arguments)
    while not begun.exists():
        time.sleep(0.005)
    begun.unlink()
    return process


def free(path, byte):
    with byte_lock(path, byte) as mine:
        return mine


def test_each_byte_is_a_lock(path):
    process = holder(byte_lock, path, 3)
    assert not free(path, 3) and free(path, 4)
    assert path.read_text() == "{}" and [p.name for p in path.parent.iterdir()] == [path.name]
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert free(path, 3)


def test_what_cannot_be_locked_is_everybodys(path, monkeypatch):
    assert free(path.with_name("none"), 0)
    process = holder(byte_lock, path, 0)

    def none_here(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(locks.fcntl, "lockf", none_here)
    assert free(path, 0)
    process.kill()
    process.join()


def test_a_file_that_is_replaced_is_locked_by_its_name(path):
    """Many add one each, and none is lost."""

    def add():
        for _ in range(20):
            with file_lock(path):
                number = int(path.read_text())
                new = path.with_name(f"new{os.getpid()}")
                new.write_text(str(number + 1))
                os.replace(new, path)

    path.write_text("0")
    processes = [elsewhere(add) for _ in range(4)]
    for process in processes:
        process.join(30)
        assert process.exitcode == 0
    assert path.read_text() == "80"
    assert [p.name for p in path.parent.iterdir()] == [path.name], "nothing is left behind"


def test_a_killed_owner_holds_nobody_up(path):
    process = holder(file_lock, path)
    process.kill()
    process.join()
    assert path.with_name(".ledger.json.lock.tmp").exists()
    with file_lock(path):
        pass
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_an_error_inside_ends_it(path):
    with pytest.raises(ZeroDivisionError), file_lock(path):
        raise ZeroDivisionError
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    with (
        pytest.raises(FileNotFoundError, match="nowhere"),
        file_lock(path.parent / "nowhere" / "x"),
    ):
        pass


def test_a_claim_is_of_one_at_a_time_and_says_who_left_it(tmp_path):
    path = tmp_path / "run"
    with claim(path) as first, claim(path) as second:
        assert first == (True, False) and second == (False, False)
        assert list(tmp_path.iterdir()) == [tmp_path / ".run.lock.tmp"]
    assert list(tmp_path.iterdir()) == []
    (tmp_path / ".run.lock.tmp").touch()  # as a kill leaves it
    with claim(path) as third:
        assert third == (True, True)
    assert list(tmp_path.iterdir()) == []
