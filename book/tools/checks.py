"""The check of an exercise: a student's function beside the reference, answered in one line.

An exercise is made once, beside its solution, from a reference and a generator of inputs:

    def inputs(rng):
        yield "a random cloud", rng.normal(size=(5, 3))
        yield "two equal points", np.zeros((2, 3))

    check_centroid = Exercise(centroid, inputs, hints=("Average over N.", "Use mean(-2)."))

and the page says

    answer = check_centroid(my_centroid)
    centroid_from_here = use(answer, clouds.centroid)
    answer

Where it is not right, a student goes on with `my_centroid(*answer.inputs)` in a cell of his own.
"""

from __future__ import annotations

import copy
import html
import inspect
import linecache
import re
import warnings
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from torch import Tensor

from book.tools.running import Limit, Outcome, run
from book.tools.syntax import Broken
from book.tools.values import difference, show
from posecore.arrays import fail, require_integer, require_number

__all__ = ["DONE", "NOT_DONE", "NOT_RIGHT", "Answer", "Exercise", "use"]

DONE, NOT_DONE, NOT_RIGHT = "done", "not done yet", "not right yet"
SIGNS = {DONE: ("✓", "#009E73"), NOT_DONE: ("…", "#56B4E9"), NOT_RIGHT: ("✗", "#D55E00")}


@dataclass(frozen=True, repr=False)
class Answer:
    """What a check says: `status` is one of three, `line` is for the student.

    Where an answer is not right on an input, `inputs` are copies of the arguments, by name
    (`answer.inputs.points`) and in their order (`f(*answer.inputs)`), else an empty tuple. `got` is
    what came, and `expected` what should have; None where there is none, as after an error, or
    where many results are right.
    """

    status: str
    line: str
    function: Any = field(compare=False)
    inputs: tuple[Any, ...] = field(default=(), compare=False)
    expected: Any = field(default=None, compare=False)
    got: Any = field(default=None, compare=False)

    def __repr__(self) -> str:
        return self.line

    def _repr_html_(self) -> str:
        sign, colour = SIGNS[self.status]
        # The sign and the words say what the colour says.
        style = f"border-left: 4px solid {colour}; padding: 0.2em 0.6em"
        text = re.sub(r" (Hint \d+ of \d+: )", r"<br>\1", html.escape(self.line))
        return f'<div role="status" style="{style}">{sign} {text}</div>'


def use(answer: Answer, library: Callable[..., Any]) -> Callable[..., Any]:
    """The student's function where its check said done, else the library's: the page goes on.

    Bind the result to another name than the student's, or the next check looks at the library's.

    Raises:
        ValueError: if `answer` is no answer of an exercise.
    """
    if not isinstance(answer, Answer):
        fail("answer", "the answer of an exercise's check", show(answer))
    return answer.function if answer.status == DONE else library


class Exercise:
    """Compares a student's function with a reference; call it with the student's function.

    Both run on copies of the same inputs. Where the reference raises ValueError, so must the
    student. Arrays that the student's function changes, and the reference does not, are a fault:
    they would be the page's own. The student runs in a thread, and not in a process, because a
    function typed in a notebook cannot be sent to a process that was spawned, and a fork is not to
    be had everywhere. A thread that is too late is told to stop and left behind if it does not. One
    thing a thread cannot end: a single call into C that never lets Python go on, such as
    `10**10**9`.

    Args:
        reference: the solution; its argument names are those of the messages.
        inputs: takes a generator of random numbers and yields `(words, argument, argument, ...)`,
            the words naming the input for the student: "two equal points".
        hints: what helps; the first failure shows the first, the second the second. In the place
            of a text may stand a dict of texts, `{"planar": ..., "it raised": ..., "": ...}`: the
            first is shown whose key is found in the words of the input or of what is wrong. A
            misspelled name needs no hint, and gets none.
        tolerance: results may differ by `tolerance * (1 + |expected|)`.
        seconds: of the processor's time, the limit for one check, all inputs together
            (`book.tools.running`).
        compare_as: applied to both results before their values are compared, for answers that are
            right in more than one form; for example a quaternion and its negative.
        judge: for questions with many right answers: called with the result and the arguments, it
            says in words what is wrong, or raises a ValueError that does; it returns an empty text
            where nothing is. Of the reference's result only kind and shape are compared then.
        seed: of the random numbers.

    Raises:
        ValueError: for an argument that cannot be, and on a check if there are no inputs or an
            input does not begin with words. Errors of the reference other than ValueError come
            through as they are. Nothing is raised because of the student.
    """

    def __init__(
        self,
        reference: Callable[..., Any],
        inputs: Callable[[np.random.Generator], Iterable[tuple[Any, ...]]],
        *,
        hints: tuple[str | Mapping[str, str], ...] = (),
        tolerance: float = 1e-6,
        seconds: float = 10.0,
        compare_as: Callable[[Any], Any] | None = None,
        judge: Callable[..., str] | None = None,
        seed: int = 0,
    ) -> None:
        for name, value in (("reference", reference), ("inputs", inputs)):
            if not callable(value):
                fail(name, "a function", show(value))
        if not isinstance(hints, tuple | list) or not all(map(_is_hint, hints)):
            fail(
                "hints", 'a tuple of strings, or of dicts of them whose last key is ""', show(hints)
            )
        self.reference, self.inputs, self.hints = reference, inputs, tuple(hints)
        self.tolerance = require_number("tolerance", tolerance, low=0)
        self.seconds = require_number("seconds", seconds, above=0)
        if judge is not None and not callable(judge):
            fail("judge", "a function", show(judge))
        self.compare_as, self.judge = compare_as, judge
        self.seed = require_integer("seed", seed, low=0)
        self.failures = 0

    def __call__(self, student: Any) -> Answer:
        """Check a student's function; see the class for how."""
        name = getattr(self.reference, "__name__", "the function")
        with warnings.catch_warnings():
            # A warning in the student's arithmetic shows in the value, which the line compares.
            warnings.simplefilter("ignore")
            found = self._judge(student)
        line = f"{name}: {found.status}{found.words}"
        if found.status == NOT_RIGHT and self.hints and not found.says_all:
            number = min(self.failures, len(self.hints) - 1)
            text = _fitting(self.hints[number], found.failed)
            line += f" Hint {number + 1} of {len(self.hints)}: {text}"
            self.failures += 1
        if found.status == DONE:
            self.failures = 0
        return Answer(found.status, line, student, found.inputs, found.expected, found.got)

    def _judge(self, student: Any) -> _Found:
        if student is None or student is ...:
            return _Found(NOT_DONE, ".")
        if isinstance(student, Broken):
            return _Found(NOT_RIGHT, f": {student.words}.", says_all=True)
        if not callable(student):
            return _Found(NOT_RIGHT, f". Expected a function, got {show(student)}.")
        limit = Limit(self.seconds)
        count = 0
        for given in self.inputs(np.random.default_rng(self.seed)):
            if not (isinstance(given, tuple) and given and isinstance(given[0], str)):
                fail("inputs", "tuples that begin with words", show(given))
            words, *arguments = given
            expected = run(self.reference, arguments)
            if expected.error is not None and not isinstance(expected.error, ValueError):
                raise expected.error
            got = run(student, arguments, limit)
            if reason := _unfinished(got, expected, first=count == 0):
                return _Found(NOT_DONE, reason)
            try:
                wrong = self._compare(student, got, expected, arguments)
            except Exception as error:  # what came may refuse to be looked at
                wrong = f"the result cannot be compared ({type(error).__name__})"
            if changed := [] if wrong else self._changed(got, expected):
                wrong = f"it changes its {changed[0]}, which belongs to the caller; work on a copy"
            if wrong:
                return _Found(
                    NOT_RIGHT,
                    f". On {words} (answer.inputs: {self._describe(arguments)}): {wrong}.",
                    failed=f"{words}: {wrong}",
                    says_all=isinstance(got.error, NameError | ImportError),
                    inputs=self._handed_out(arguments),
                    expected=expected.value if self.judge is None else None,
                    got=got.value,
                )
            count += 1
        if count == 0:
            fail("inputs", "at least one input", "none")
        return _Found(DONE, f", {count} inputs {'agree' if self.judge is None else 'pass'}.")

    def _compare(self, student: Any, got: Outcome, expected: Outcome, arguments: list[Any]) -> str:
        """What is wrong, in words; empty where nothing is."""
        if got.late:
            return got.late
        if expected.error is not None:
            if isinstance(got.error, ValueError):
                return ""
            came = _describe_error(student, got.error) if got.error else f"got {show(got.value)}"
            return f"expected a ValueError ({_one_line(str(expected.error))}), {came}"
        if got.error is not None:
            return _describe_error(student, got.error)
        if self.judge is None:
            return difference(got.value, expected.value, self.tolerance, self.compare_as)
        try:
            form = difference(got.value, expected.value, None)
            return form or self.judge(got.value, *arguments)
        except ValueError as error:
            return _one_line(str(error)) or "it is refused"

    def _changed(self, got: Outcome, expected: Outcome) -> list[str]:
        """The names of arrays that the student's function left otherwise than the reference."""
        pairs = zip(self._names(got.arguments), got.arguments, expected.arguments, strict=False)
        arrays = np.ndarray | Tensor
        return [name for name, a, b in pairs if isinstance(b, arrays) and difference(a, b, 0.0)]

    def _describe(self, arguments: list[Any]) -> str:
        named = zip(self._names(arguments), arguments, strict=False)
        return ", ".join(f"{name} = {show(argument)}" for name, argument in named)

    def _handed_out(self, arguments: list[Any]) -> tuple[Any, ...]:
        names = self._names(arguments)[: len(arguments)]
        return namedtuple("Inputs", names, rename=True)(*copy.deepcopy(arguments))

    def _names(self, arguments: Sequence[Any]) -> list[str]:
        try:
            names = list(inspect.signature(self.reference).parameters)
        except (TypeError, ValueError):  # some functions of C have none
            names = []
        return names + [f"argument {i + 1}" for i in range(len(names), len(arguments))]


@dataclass
class _Found:
    """What a check finds: as an `Answer`, its words without name, status and hint."""

    status: str
    words: str
    failed: str = ""  # the input in words, and what is wrong: hints fit it
    says_all: bool = False  # a hint would say no more
    inputs: tuple[Any, ...] = ()
    expected: Any = None
    got: Any = None


def _is_hint(hint: Any) -> bool:
    if not isinstance(hint, Mapping):
        return isinstance(hint, str)
    return list(hint)[-1:] == [""] and all(
        isinstance(x, str) for pair in hint.items() for x in pair
    )


def _fitting(hint: str | Mapping[str, str], failed: str) -> str:
    if isinstance(hint, str):
        return hint
    return next(text for key, text in hint.items() if key in failed)  # "" is in everything


def _unfinished(got: Outcome, expected: Outcome, first: bool) -> str:
    """Why this is a stub and not a wrong answer; empty where it is none."""
    if isinstance(got.error, NotImplementedError):
        return "."
    if isinstance(got.error, TypeError | AttributeError) and "'ellipsis'" in str(got.error):
        return " (there is still a ... in it)."
    if got.error or got.late or (expected.error is None and expected.value is None):
        return ""
    values = got.value if isinstance(got.value, tuple) and got.value else (got.value,)
    if any(value is ... for value in values):
        return " (it returns ...)."
    # Later on, a None is a branch that forgot its return.
    return " (it returns nothing)." if first and all(value is None for value in values) else ""


def _describe_error(student: Any, error: BaseException) -> str:
    kind, message = type(error).__name__, _one_line(str(error))
    return f"it raised {kind}{': ' + message if message else ''}{_place(student, error)}"


def _place(student: Any, error: BaseException) -> str:
    """The last line of the student's own text on the way to the error, quoted."""
    code = getattr(inspect.unwrap(student), "__code__", None)
    line, trace = "", error.__traceback__
    while trace is not None:
        if code is not None and trace.tb_frame.f_code.co_filename == code.co_filename:
            line = linecache.getline(code.co_filename, trace.tb_lineno).strip()
        trace = trace.tb_next
    return f" at `{_one_line(line)}`" if line else ""


def _one_line(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 160 else text[:157] + "..."
