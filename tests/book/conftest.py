"""What the tests of all chapters' exercises share."""

from collections.abc import Callable
from typing import Any

import pytest

from book.tools.checks import NOT_RIGHT, Exercise


@pytest.fixture
def refused() -> Callable[..., str]:
    """`refused(check, exercise, student, words)`: the line that answers a wrong solution."""

    def refused(check: Exercise, exercise: str, student: Callable[..., Any], words: str) -> str:
        check.failures = 0
        answer = check(student)
        line, _, hint = answer.line.partition(" Hint 1 of 2: ")
        assert answer.status == NOT_RIGHT
        assert line.startswith(f"{exercise}: not right yet. On {words}"), line
        assert " = " in line
        assert hint == check.hints[0]
        assert check(student).line.endswith(f" Hint 2 of 2: {check.hints[1]}")
        return line

    return refused
