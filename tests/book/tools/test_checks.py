"""Checks of exercises: every answer word for word, and nothing that a student can break."""

import contextvars
import itertools
import linecache
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from book.tools.checks import DONE, NOT_DONE, NOT_RIGHT, Answer, Exercise, use


def centroid(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return (points * weights[:, None]).sum(0) / weights.sum()


def inputs(rng: np.random.Generator) -> Iterator[tuple]:
    yield "one point", np.ones((1, 2)), np.ones(1)
    for _ in range(3):
        yield "a random cloud", rng.normal(size=(6, 2)), rng.uniform(1, 2, size=6)
    yield "two equal points", np.full((2, 2), 0.5), np.array([1.0, 3.0])


HINTS = ("Weigh first.", "Divide by the sum.")
check = Exercise(centroid, inputs)
ONE = "On one point (answer.inputs: points = array (1, 2) [[1., 1.]], weights = array (1,) [1.])"


def answer_to(student: Any, **settings: Any) -> Answer:
    return Exercise(centroid, inputs, **settings)(student)


# Done -------------------------------------------------------------------------------------------


def test_done() -> None:
    for student in (centroid, lambda p, w: np.average(p, axis=0, weights=w)):
        answer = check(student)
        assert answer.status == DONE == "done"
        assert repr(answer) == "centroid: done, 5 inputs agree."
        assert answer.function is student


def test_the_inputs_are_the_same_in_every_check_and_differ_with_the_seed() -> None:
    seen: list[list[np.ndarray]] = [[], [], []]
    for seed, points in zip((0, 0, 1), seen, strict=True):
        answer_to(lambda p, w: (points.append(p), centroid(p, w))[1], seed=seed)  # noqa: B023
    assert all(map(np.array_equal, seen[0], seen[1]))
    assert not np.array_equal(seen[0][1], seen[2][1])


def test_edits_in_place_harm_nothing() -> None:
    shared = np.arange(4.0)

    def one(rng: np.random.Generator) -> Iterator[tuple]:
        yield "a list", [shared, torch.ones(2)], rng

    def reference(parts: list, rng: np.random.Generator) -> float:
        return float(parts[0].sum() + parts[1].sum()) + rng.normal()

    def student(parts: list, rng: np.random.Generator) -> float:
        result = reference(parts, rng)
        parts[0][:] = 7
        parts[1].zero_()
        parts.clear()
        return result

    assert Exercise(reference, one)(student).status == DONE
    assert np.array_equal(shared, np.arange(4.0))


def test_an_array_of_the_caller_must_stay_as_it_was() -> None:
    def one(rng: np.random.Generator) -> Iterator[tuple]:
        yield "ones", np.ones(2), torch.full((2,), torch.nan)

    def reference(points: np.ndarray, more: torch.Tensor) -> float:
        return float(points.sum())

    def student(points: np.ndarray, more: torch.Tensor) -> float:
        points *= 2
        return float(points.sum()) / 2

    answer = Exercise(reference, one)(student)
    assert answer.status == NOT_RIGHT
    assert answer.line.endswith(
        ": it changes its points, which belongs to the caller; work on a copy."
    )
    changed = Exercise(reference, one)(lambda p, m: (m.zero_(), reference(p, m))[1])
    assert "it changes its more" in changed.line
    assert Exercise(reference, one)(reference).status == DONE
    # Where changing it is the exercise, the reference does so too.
    in_place = Exercise(student, one)
    assert in_place(student).status == DONE
    assert "it changes its points" in in_place(reference).line


def test_compare_as() -> None:
    def turn(rng: np.random.Generator) -> Iterator[tuple]:
        yield "a turn", rng.normal(size=4)

    check = Exercise(lambda q: q, turn, compare_as=lambda q: q * np.sign(q[0]))
    assert check(lambda q: -q).status == DONE
    assert check(lambda q: q[:3]).line.endswith(": expected shape (4,), got shape (3,).")
    assert check(lambda q: 2 * q).status == NOT_RIGHT


def one_root(n: float) -> float:
    return n**0.5


def root_inputs(rng: np.random.Generator) -> Iterator[tuple]:
    yield "four", 4.0
    yield "nine", 9.0


def is_root(result: float, n: float) -> str:
    if result > 100:
        raise ValueError(f"result: expected at most 100,\n got {result}")
    if result < -100:
        raise ValueError
    return "" if result * result == n else f"expected a root of {n}, got {result}"


def test_a_judge_takes_any_right_answer() -> None:
    check = Exercise(one_root, root_inputs, judge=is_root, hints=HINTS)
    for student in (one_root, lambda n: -(n**0.5), lambda n: 2 if n == 4 else -3.0):
        assert check(student).line == "one_root: done, 2 inputs pass."


@pytest.mark.parametrize(
    ("student", "words"),
    [
        (lambda n: 2.0, "nine (answer.inputs: n = 9): expected a root of 9.0, got 2.0."),
        (lambda n: 101.0, "four (answer.inputs: n = 4): result: expected at most 100, got 101.0."),
        (lambda n: -101.0, "four (answer.inputs: n = 4): it is refused."),
        (lambda n: "2", "four (answer.inputs: n = 4): expected a number, got text."),
        (
            lambda n: np.ones(2),
            "four (answer.inputs: n = 4): expected a number, got an array of shape (2,).",
        ),
        (lambda n: np.nan, "four (answer.inputs: n = 4): expected a root of 4.0, got nan."),
        (
            lambda n: n / 0,
            "four (answer.inputs: n = 4): it raised ZeroDivisionError: float division by zero",
        ),
    ],
)
def test_a_judge_says_what_is_wrong(student: Any, words: str) -> None:
    answer = Exercise(one_root, root_inputs, judge=is_root)(student)
    assert answer.status == NOT_RIGHT
    assert answer.line.startswith(f"one_root: not right yet. On {words}")


def test_a_judge_leaves_a_stub_alone_and_sees_the_inputs_as_they_were() -> None:
    def reference(points: np.ndarray) -> np.ndarray:
        return points

    def cloud(rng: np.random.Generator) -> Iterator[tuple]:
        yield "ones", np.ones(2)

    def judge(result: np.ndarray, points: np.ndarray) -> str:
        return "" if (points == 1).all() else "the inputs changed"

    def edits(points: np.ndarray) -> np.ndarray:
        points[:] = 7
        return points

    check = Exercise(reference, cloud, judge=judge)
    assert "it changes its points" in check(edits).line  # and not what the judge would say
    assert check(lambda points: None).status == NOT_DONE
    assert check(lambda points: ...).status == NOT_DONE


def test_where_the_reference_refuses_the_student_must_too() -> None:
    def reference(n: int) -> int:
        if n < 0:
            raise ValueError("n: expected at least 0")
        return n

    def student(n: int) -> int:
        if n < 0:
            raise KeyError("n")
        return n

    def numbers(rng: np.random.Generator) -> Iterator[tuple]:
        yield "three", 3
        yield "a negative number", -1

    check = Exercise(reference, numbers)
    assert check(reference).status == DONE
    start = "reference: "
    assert check(lambda n: n).line == (
        start + "not right yet. On a negative number (answer.inputs: n = -1): "
        "expected a ValueError (n: expected at least 0), got -1."
    )
    assert check(student).line == (
        start
        + "not right yet. On a negative number (answer.inputs: n = -1): expected a ValueError "
        "(n: expected at least 0), it raised KeyError: 'n' at `raise KeyError(\"n\")`."
    )


# Not done yet -----------------------------------------------------------------------------------


def stub(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The centre."""
    ...


def unfinished(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    total = ...
    return points.sum(0) / total


def unfinished_attribute(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    total = ...
    return total.sum(0)


def raising(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    raise NotImplementedError("your turn")


@pytest.mark.parametrize(
    ("student", "line"),
    [
        (stub, "centroid: not done yet (it returns nothing)."),
        (lambda p, w: (None, None), "centroid: not done yet (it returns nothing)."),
        (lambda p, w: ..., "centroid: not done yet (it returns ...)."),
        (lambda p, w: (p, ...), "centroid: not done yet (it returns ...)."),
        (unfinished, "centroid: not done yet (there is still a ... in it)."),
        (unfinished_attribute, "centroid: not done yet (there is still a ... in it)."),
        (raising, "centroid: not done yet."),
        (..., "centroid: not done yet."),
        (None, "centroid: not done yet."),
    ],
)
def test_not_done_yet(student: Any, line: str) -> None:
    check = Exercise(centroid, inputs, hints=HINTS)
    answer = check(student)
    assert (answer.status, answer.line) == (NOT_DONE, line)
    assert check.failures == 0  # no hint is spent on a stub


def test_a_reference_that_returns_nothing_can_be_met() -> None:
    check = Exercise(lambda p, w: None, inputs)
    assert check(stub).status == DONE
    assert check(lambda p, w: 1).line.endswith("expected nothing (None), got a number.")


# Not right yet ----------------------------------------------------------------------------------


def forgets(points: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    if len(points) == 1:
        return points[0]


def deep(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return deep(points, weights)


def leave(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    raise SystemExit(1)


def in_numpy(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.linalg.inv(np.zeros((2, 2)))


class Evil:
    def __repr__(self) -> str:
        raise RuntimeError

    def __call__(self, *arguments: Any) -> Any:
        raise EvilError


class EvilError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("student", "words"),
    [
        (3, ". Expected a function, got 3."),
        (lambda p, w: p, f". {ONE}: expected shape (2,), got shape (1, 2)."),
        (lambda p, w: [1, 1], f". {ONE}: expected an array of shape (2,), got a list."),
        (
            lambda p, w: torch.ones(2),
            f". {ONE}: expected an array of shape (2,), got a tensor of shape (2,).",
        ),
        (lambda p, w: 1.0, f". {ONE}: expected an array of shape (2,), got a number."),
        (
            lambda p, w: p[0] * np.nan,
            f". {ONE}: expected array (2,) [1., 1.], got array (2,) [nan, nan].",
        ),
        (
            lambda p: p,
            f". {ONE}: it raised TypeError: <lambda>() takes 1 positional argument "
            "but 2 were given.",
        ),
        (
            leave,
            f". {ONE}: it raised SystemExit: 1 at `raise SystemExit(1)`.",
        ),
        (
            deep,
            f". {ONE}: it raised RecursionError: maximum recursion depth exceeded "
            "at `return deep(points, weights)`.",
        ),
        (
            in_numpy,
            f". {ONE}: it raised LinAlgError: Singular matrix "
            "at `return np.linalg.inv(np.zeros((2, 2)))`.",
        ),
        (Evil(), f". {ONE}: the result cannot be compared (RuntimeError)."),
    ],
)
def test_not_right_yet(student: Any, words: str) -> None:
    answer = check(student)
    assert (answer.status, answer.line) == (NOT_RIGHT, "centroid: not right yet" + words)


def test_the_first_input_that_differs_is_named() -> None:
    answer = check(lambda p, w: p.mean(0))
    assert answer.line.startswith(
        "centroid: not right yet. On a random cloud (answer.inputs: points = array (6, 2) [["
    )
    answer = check(forgets)  # not the stub: it returns something at first
    assert answer.line.endswith(": expected an array of shape (2,), got nothing (None).")


def test_an_error_with_many_lines_is_one_line() -> None:
    def student(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        raise RuntimeError("first\n  second\n" + "x" * 300)

    line = check(student).line
    assert "\n" not in line and ": it raised RuntimeError: first second xxx" in line
    assert line.endswith('x... at `raise RuntimeError("first\\n second\\n" + "x" * 300)`.')


def test_the_line_of_a_notebook_cell_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "def typed(points, weights):\n    return points @ weights.T.nothing\n"
    monkeypatch.setitem(
        linecache.cache, "<cell>", (len(text), None, text.splitlines(True), "<cell>")
    )
    space: dict = {}
    exec(compile(text, "<cell>", "exec"), space)
    assert check(space["typed"]).line.endswith(
        "it raised AttributeError: 'numpy.ndarray' object has no attribute 'nothing' "
        "at `return points @ weights.T.nothing`."
    )


def test_warnings_of_the_student_do_not_show(recwarn: pytest.WarningsRecorder) -> None:
    answer = check(lambda p, w: np.zeros(2) / np.zeros(2))
    assert answer.status == NOT_RIGHT and answer.line.endswith("got array (2,) [nan, nan].")
    assert not recwarn.list


def test_hints_come_one_by_one_and_begin_again_after_success() -> None:
    check = Exercise(centroid, inputs, hints=HINTS)
    lines = [check(lambda p, w: 0.0).line for _ in range(3)]
    for line, hint in zip(lines, (1, 2, 2), strict=True):
        assert line == (
            f"centroid: not right yet. {ONE}: expected an array of shape (2,), got a number. "
            f"Hint {hint} of 2: {HINTS[hint - 1]}"
        )
    assert "Hint" not in check(stub).line
    assert check(centroid).line == "centroid: done, 5 inputs agree."
    assert check(3).line.endswith(". Expected a function, got 3. Hint 1 of 2: Weigh first.")


FITTING = (
    {
        "equal points": "Their weights count.",
        "it raised": "Look at the line.",
        "a number": "A centre is a point.",
        "": "Weigh first.",
    },
    {"one point": "It is its own centre.", "": "Divide by the sum."},
)


@pytest.mark.parametrize(
    ("student", "first", "second"),
    [
        (lambda p, w: 0.0, "A centre is a point.", "It is its own centre."),
        (lambda p, w: p / 0, "Weigh first.", "It is its own centre."),
        (lambda p, w: p[7], "Look at the line.", "It is its own centre."),
        (lambda p, w: p.mean(0), "Weigh first.", "Divide by the sum."),
        (
            lambda p, w: p[0] + 1 if p.std() == 0 and len(p) > 1 else centroid(p, w),
            "Their weights count.",
            "Divide by the sum.",
        ),
    ],
)
def test_a_hint_fits_the_input_or_what_is_wrong(student: Any, first: str, second: str) -> None:
    check = Exercise(centroid, inputs, hints=FITTING)
    for number, hint in ((1, first), (2, second)):
        assert check(student).line.endswith(f" Hint {number} of 2: {hint}")


def test_a_misspelled_name_spends_no_hint() -> None:
    check = Exercise(centroid, inputs, hints=HINTS)
    for student in (lambda p, w: mean(p), lambda p, w: __import__("nmupy")):  # noqa: F821
        line = check(student).line
        assert "Error: " in line and "Hint" not in line
    assert check(lambda p, w: 0.0).line.endswith(" Hint 1 of 2: Weigh first.")


def test_the_failing_input_is_handed_out() -> None:
    answer = check(lambda p, w: p.mean(0))
    (cloud,) = [
        given for given in inputs(np.random.default_rng(0)) if given[0] == "a random cloud"
    ][:1]
    assert answer.inputs._fields == ("points", "weights")  # type: ignore[attr-defined]
    assert np.array_equal(answer.inputs.points, cloud[1])  # type: ignore[attr-defined]
    assert np.array_equal(answer.expected, centroid(*answer.inputs))
    assert np.array_equal(answer.got, answer.inputs[0].mean(0))
    assert " (answer.inputs: points = array (6, 2) " in answer.line
    for student in (centroid, stub, 3, None):
        answer = check(student)
        assert answer.inputs == () and answer.expected is None is answer.got


def test_what_is_handed_out_is_a_copy_from_before_the_students_edits() -> None:
    kept = np.ones(2)

    def edits(points: np.ndarray) -> np.ndarray:
        points *= 2
        return points

    check = Exercise(np.copy, yielding(("ones", kept)))
    answer = check(edits)
    assert answer.inputs[0].tolist() == answer.expected.tolist() == [1, 1]
    answer.inputs[0][:] = 7
    assert kept.tolist() == [1, 1] and check(edits).inputs[0].tolist() == [1, 1]


def test_where_there_is_no_result_none_is_handed_out() -> None:
    raised = check(lambda p, w: p[7])
    assert raised.got is None and raised.expected.tolist() == [1, 1] and len(raised.inputs) == 2
    refused = Exercise(int, yielding(("words", "x")))(lambda text: 3)
    assert (refused.inputs, refused.expected, refused.got) == (("x",), None, 3)
    judged = Exercise(one_root, root_inputs, judge=is_root)(lambda n: 2.0)
    assert (judged.inputs, judged.expected, judged.got) == ((9.0,), None, 2.0)  # -3 is right, too


@given(st.floats(1e-9, 1.0), st.floats(0, 10), st.floats(-10, 10))
def test_an_error_is_found_exactly_where_it_passes_the_tolerance(
    tolerance: float, share: float, value: float
) -> None:
    def one(rng: np.random.Generator) -> Iterator[tuple]:
        yield "a number", value

    if abs(share - 1) < 1e-3:
        return
    check = Exercise(lambda x: x, one, tolerance=tolerance)
    answer = check(lambda x: x + share * tolerance * (1 + abs(x)))
    assert answer.status == (DONE if share < 1 else NOT_RIGHT)


ANYTHING = st.one_of(st.none(), st.integers(), st.floats(), st.text(), st.binary(), st.just(...))


@given(ANYTHING | st.lists(ANYTHING) | st.tuples(ANYTHING) | ANYTHING.map(np.array))
def test_whatever_a_student_returns_is_answered_in_one_line(value: Any) -> None:
    for student in (value, lambda p, w: value):
        answer = check(student)
        assert answer.status in (NOT_DONE, NOT_RIGHT)
        assert answer.line.startswith(f"centroid: {answer.status}") and "\n" not in answer.line


# Time -------------------------------------------------------------------------------------------


def forever(points: np.ndarray, weights: np.ndarray) -> None:
    while True:
        pass


RELEASED = threading.Event()  # so that this process gets rid of the next two


def stubborn(points: np.ndarray, weights: np.ndarray) -> None:
    while not RELEASED.is_set():
        try:
            while not RELEASED.is_set():
                pass
        except BaseException:
            continue


def asleep(points: np.ndarray, weights: np.ndarray) -> None:
    RELEASED.wait(60)


def by_and_by(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    end = time.thread_time() + 0.15
    while time.thread_time() < end:
        pass
    return centroid(points, weights)


def patient(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    time.sleep(0.1)
    return centroid(points, weights)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("student", "words"),
    [
        (forever, "0.3 s; perhaps a loop never ends."),
        (stubborn, "0.3 s; perhaps a loop never ends."),
        (asleep, "1.8 s; perhaps it waits for ever."),
        (by_and_by, "0.3 s; perhaps a loop never ends."),
    ],
)
def test_a_function_that_is_late_does_not_hold_the_page(
    student: Callable[..., Any], words: str
) -> None:
    RELEASED.clear()
    before = threading.active_count()
    answer = answer_to(student, seconds=0.3)
    # Had the page waited, two of the four would hold it for ever, and two come to another answer.
    assert answer.status == NOT_RIGHT
    assert answer.line.endswith(f": not finished after {words}")
    if student is forever:
        assert threading.active_count() == before  # stopped, not only left behind
    RELEASED.set()
    deadline = time.monotonic() + 10
    # Whatever is left of it does not keep the kernel from ending.
    assert all(thread.daemon for thread in threading.enumerate()[before:])
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert threading.active_count() == before


@pytest.mark.slow
def test_a_right_answer_is_in_time_on_a_machine_that_does_other_things() -> None:
    """The five calls pass 0.5 s, nearly all of which the processor is not theirs."""
    assert answer_to(patient, seconds=0.3).status == DONE


def test_the_stop_button_ends_the_students_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    join, calls = threading.Thread.join, itertools.count()

    def pressed(thread: threading.Thread, timeout: float | None = None) -> None:
        if timeout is not None and next(calls) == 0:
            raise KeyboardInterrupt
        join(thread, timeout)

    monkeypatch.setattr(threading.Thread, "join", pressed)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        check(forever)
    assert threading.active_count() == before


# What the page shows, and how it goes on --------------------------------------------------------


def test_the_page_shows_the_line_escaped() -> None:
    answer = Answer(NOT_RIGHT, "f: not right yet. <b> & </b>", None)
    assert repr(answer) == answer.line
    page = answer._repr_html_()
    assert "✗ f: not right yet. &lt;b&gt; &amp; &lt;/b&gt;</div>" in page
    assert 'role="status"' in page and page.count("<") == 2
    pages = [Answer(status, "x", None)._repr_html_() for status in (DONE, NOT_DONE, NOT_RIGHT)]
    assert [page[page.index(">") + 1] for page in pages] == ["✓", "…", "✗"]


def test_a_hint_begins_a_line_of_its_own_on_the_page() -> None:
    answer = answer_to(3, hints=HINTS)
    assert answer._repr_html_().endswith("got 3.<br>Hint 1 of 2: Weigh first.</div>")
    assert "\n" not in answer.line


def test_use_goes_on_with_the_library_unless_done() -> None:
    student = lambda p, w: centroid(p, w)  # noqa: E731
    assert use(check(student), centroid) is student
    for wrong in (stub, lambda p, w: p, None):
        assert use(check(wrong), centroid) is centroid
    with pytest.raises(
        ValueError, match="^answer: expected the answer of an exercise's check, got"
    ):
        use(student, centroid)  # type: ignore[arg-type]


def test_prints_of_the_student_reach_the_page(capsys: pytest.CaptureFixture) -> None:
    check(lambda p, w: print("looking") or centroid(p, w))
    assert capsys.readouterr().out == 5 * "looking\n"


def test_the_student_runs_in_the_context_of_the_cell() -> None:
    cell: contextvars.ContextVar[str] = contextvars.ContextVar("cell", default="none")
    cell.set("this one")  # the kernel keeps there which cell gets what is printed
    seen = []
    check(lambda p, w: seen.append(cell.get()))
    assert seen == ["this one"]


# The author's mistakes --------------------------------------------------------------------------


EXPECTED_HINTS = 'expected a tuple of strings, or of dicts of them whose last key is ""'


def yielding(*items: Any) -> Callable[..., Any]:
    return lambda rng: iter(items)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Exercise(3, inputs), "reference: expected a function, got 3"),
        (lambda: Exercise(centroid, [1]), "inputs: expected a function, got [1]"),
        (lambda: answer_to(stub, hints="abc"), f"hints: {EXPECTED_HINTS}, got 'abc'"),
        (lambda: answer_to(stub, hints=(1,)), f"hints: {EXPECTED_HINTS}, got (1,)"),
        (lambda: answer_to(stub, hints={"": "a"}), f"hints: {EXPECTED_HINTS}, got {{'': 'a'}}"),
        (lambda: answer_to(stub, hints=({},)), f"hints: {EXPECTED_HINTS}, got ({{}},)"),
        (
            lambda: answer_to(stub, hints=({"": "a", "b": "c"},)),
            f"hints: {EXPECTED_HINTS}, got ({{'': 'a', 'b': 'c'}},)",
        ),
        (lambda: answer_to(stub, hints=({"": 1},)), f"hints: {EXPECTED_HINTS}, got ({{'': 1}},)"),
        (
            lambda: answer_to(stub, tolerance=-1),
            "tolerance: expected a finite number of at least 0, got -1.0",
        ),
        (
            lambda: answer_to(stub, tolerance=np.nan),
            "tolerance: expected a finite number of at least 0, got nan",
        ),
        (
            lambda: answer_to(stub, seconds=0),
            "seconds: expected a finite number above 0, got 0.0",
        ),
        (lambda: answer_to(stub, judge=3), "judge: expected a function, got 3"),
        (lambda: answer_to(stub, seed=0.5), "seed: expected an integer of at least 0, got 0.5"),
        (
            lambda: Exercise(centroid, yielding())(stub),
            "inputs: expected at least one input, got none",
        ),
        (
            lambda: Exercise(abs, yielding((1, 2)))(abs),
            "inputs: expected tuples that begin with words, got (1, 2)",
        ),
        (
            lambda: Exercise(abs, yielding(3))(abs),
            "inputs: expected tuples that begin with words, got 3",
        ),
        (
            lambda: Exercise(abs, yielding(()))(abs),
            "inputs: expected tuples that begin with words, got ()",
        ),
    ],
)
def test_what_the_author_got_wrong_is_raised(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == message


def test_an_error_of_the_reference_comes_through() -> None:
    with pytest.raises(ZeroDivisionError):
        Exercise(lambda x: 1 / x, yielding(("zero", 0)))(abs)


def test_names_of_arguments_without_a_signature() -> None:
    check = Exercise(max, yielding(("two", 1, 2)))
    assert check(min).line == (
        "max: not right yet. On two (answer.inputs: argument 1 = 1, argument 2 = 2): "
        "expected 2, got 1."
    )
