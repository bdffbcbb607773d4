"""Proof of every exercise: stubs are not done, wrong solutions are caught, right ones pass.

A chapter's test writes solutions down as students would, each with what becomes of it,

    SOLUTIONS = Solutions()

    @SOLUTIONS.right("edge_function")
    def edge_by_determinants(a, b, points): ...

    @SOLUTIONS.wrong("edge_function", "a point above a level edge", "[4.]")
    def edge_as_area(a, b, points): ...

and hands them over:

    class TestExercises(ExerciseTests):
        checks = checks
        solutions = SOLUTIONS
"""

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from book.tools.checks import DONE, NOT_DONE, NOT_RIGHT, Exercise

FEWEST, MOST = 4, 7  # exercises of a chapter; more are too many for a reader
WRONG = 5  # solutions of each exercise, each wrong for a reason of its own


class Solution(NamedTuple):
    exercise: str
    function: Callable[..., Any]
    given_away_by: str | None = None  # how the words of an input begin; None for a right solution
    said: str = ""  # a part of what is said of the result

    def __str__(self) -> str:
        return f"{self.exercise}-{self.function.__name__}"


class Solutions(list[Solution]):
    """Of one chapter, or of some of its exercises."""

    def right(self, exercise: str) -> Callable[[Callable], Callable]:
        return self._keep(exercise)

    def wrong(self, exercise: str, given_away_by: str, said: str) -> Callable[[Callable], Callable]:
        return self._keep(exercise, given_away_by, said)

    def _keep(self, exercise: str, *words: str) -> Callable[[Callable], Callable]:
        def keep(function: Callable) -> Callable:
            self.append(Solution(exercise, function, *words))
            return function

        return keep


def stub(*given: Any) -> None:
    """As a student gets it."""
    ...


def texts(hint: str | Mapping[str, str]) -> list[str]:
    """All that a hint may say."""
    return [hint] if isinstance(hint, str) else list(hint.values())


def keys(hint: str | Mapping[str, str]) -> list[str]:
    """What a hint fits; all else is "", which is not among them."""
    return [] if isinstance(hint, str) else [key for key in hint if key]


@functools.cache
def prepared(check: Exercise) -> Exercise:
    """The same check, its inputs made once for all solutions: some take longer than any of them."""
    made = list(check.inputs(np.random.default_rng(check.seed)))
    twin = copy.copy(check)
    twin.inputs = lambda rng: made
    return twin


class ExerciseTests:
    checks: ClassVar[ModuleType]
    solutions: ClassVar[Sequence[Solution]]
    every_line_says: ClassVar[tuple[str, ...]] = ()
    fewest: ClassVar[int] = FEWEST
    """Fewer only while a chapter is being written."""

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        cases = {
            "check": [name for name in vars(self.checks) if name.startswith("check_")],
            "right": [one for one in self.solutions if one.given_away_by is None],
            "wrong": [one for one in self.solutions if one.given_away_by is not None],
        }
        for name in set(cases) & set(metafunc.fixturenames):
            metafunc.parametrize(name, cases[name], ids=str)

    def check_of(self, exercise: str) -> Exercise:
        return prepared(getattr(self.checks, f"check_{exercise}"))

    def test_a_stub_is_not_done_and_the_reference_is(self, check: str) -> None:
        exercise = getattr(self.checks, check)
        for unfinished in (stub, lambda *given: ..., None):
            assert exercise(unfinished).status == NOT_DONE
        answer = exercise(exercise.reference)
        assert answer.status == DONE, answer.line

    def test_another_way_to_be_right(self, right: Solution) -> None:
        answer = self.check_of(right.exercise)(right.function)
        assert answer.status == DONE, answer.line

    def test_a_wrong_solution_is_caught(self, wrong: Solution) -> None:
        """In one line, by the input that gives it away, and hint by hint."""
        exercise = self.check_of(wrong.exercise)
        exercise.failures = 0
        answer = exercise(wrong.function)
        line, _, hint = answer.line.partition(" Hint 1 of 2: ")
        assert answer.status == NOT_RIGHT
        assert line.startswith(f"{wrong.exercise}: not right yet. On {wrong.given_away_by}"), line
        given, _, said = line.partition("): ")
        assert " = " in given
        assert wrong.said in said, line
        assert all(word in said for word in self.every_line_says), line
        assert hint in texts(exercise.hints[0])
        again = exercise(wrong.function).line
        assert again.partition(" Hint 2 of 2: ")[2] in texts(exercise.hints[1])
        # What is wrong can be seen again in a cell of one's own.
        assert answer.inputs

    def test_every_hint_that_fits_something_fits_a_wrong_solution(self, check: str) -> None:
        mine = [one for one in self.solutions if f"check_{one.exercise}" == check]
        known = [f"{one.given_away_by}: {one.said}" for one in mine if one.given_away_by]
        for hint in getattr(self.checks, check).hints:
            unused = [key for key in keys(hint) if not any(key in words for words in known)]
            assert not unused

    def test_every_exercise_has_solutions_of_both_kinds_and_two_hints(self) -> None:
        names = [name for name in vars(self.checks) if name.startswith("check_")]
        assert self.fewest <= len(names) <= MOST
        for name in names:
            assert len(getattr(self.checks, name).hints) == 2
            mine = [one for one in self.solutions if f"check_{one.exercise}" == name]
            wrong = sum(one.given_away_by is not None for one in mine)
            assert wrong >= WRONG
            assert len(mine) > wrong
