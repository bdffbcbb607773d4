"""A student's function run beside the page: what counts of its time, and what becomes of it."""

import threading
import time

import numpy as np
import pytest

from book.tools.running import PATIENCE, Limit, run

BUSY = "not finished after 0.2 s; perhaps a loop never ends"


def compute(seconds):
    """Nothing, for so long as the processor counts."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass
    return "computed"


def forever():
    while True:
        pass


def asleep():
    while True:
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def leaves_no_thread_behind():
    before = threading.active_count()
    yield
    deadline = time.monotonic() + 10
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert threading.active_count() == before


def test_a_value_an_error_and_copies():
    points = np.zeros(2)

    def edits(points, fails):
        points += 1
        return 1 / (1 - fails)

    outcome = run(edits, [points, 0])
    assert (outcome.value, outcome.error, outcome.late) == (1, None, "")
    assert (outcome.arguments[0] == 1).all() and (points == 0).all()
    outcome = run(edits, (points, 1), Limit(5))
    assert outcome.value is None and isinstance(outcome.error, ZeroDivisionError)
    assert outcome.late == "" and len(outcome.arguments) == 2


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(time, "pthread_getcpuclockid"), reason="counts by the clock")
def test_waiting_is_no_computing():
    """As where other programs keep the processor: the function is not on it for most of its time"""
    limit = Limit(0.2)
    for _ in range(2):
        outcome = run(lambda: (time.sleep(0.25), compute(0.02))[1], [], limit)
        assert outcome.value == "computed" and not outcome.late
    assert 0.03 < limit.computed < 0.2 < 0.5 <= limit.passed


@pytest.mark.slow
def test_an_endless_loop_ends_and_so_does_one_that_only_waits():
    assert run(forever, [], Limit(0.2)).late == BUSY
    start = time.monotonic()
    late = run(asleep, [], Limit(0.05)).late
    assert late == f"not finished after {0.05 * PATIENCE:g} s; perhaps it waits for ever"
    assert time.monotonic() - start >= 0.05 * PATIENCE


@pytest.mark.slow
def test_a_limit_holds_for_all_calls_together():
    limit = Limit(0.2)
    outcomes = [run(compute, [0.08], limit) for _ in range(5)]
    assert [outcome.value for outcome in outcomes[:2]] == 2 * ["computed"]
    assert [outcome.late for outcome in outcomes[3:]] == 2 * [BUSY]


@pytest.mark.slow
def test_where_no_thread_is_asked_for_its_time_the_clock_counts(monkeypatch):
    monkeypatch.delattr(time, "pthread_getcpuclockid", raising=False)
    assert run(asleep, [], Limit(0.2)).late == BUSY
    limit = Limit(0.2)
    assert run(lambda: time.sleep(0.1), [], limit).late == ""
    assert limit.computed < 0.1  # once it has ended, it can tell
    assert run(compute, [0.01], limit).value == "computed"
