"""Chapter 1's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from book.ch01_poses_and_cameras import checks
from book.tools.checks import DONE
from posecore import metrics
from tests.book.ch01_poses_and_cameras.solutions import SOLUTIONS, norm
from tests.book.exercises import ExerciseTests


class TestExercises(ExerciseTests):
    checks = checks
    solutions = SOLUTIONS
    every_line_says = ("expected", "got")


@pytest.mark.slow
@given(st.floats(0.01, 0.3), st.floats(-0.02, 0.02))
@settings(max_examples=20)
def test_the_open_exercise_is_judged_by_its_property(slide: float, aside: float) -> None:
    """Whatever is forgiven by one metric and refused by the other on all inputs is done."""

    def student(R: Any, t: Any, K: Any, points: Any, diameter: float) -> Any:
        return R, t * (1 + slide * diameter / norm(t)) + [aside * diameter, 0, 0]

    rng = np.random.default_rng(checks.check_forgiven_pose.seed)
    given_poses = [given[1:] for given in checks.check_forgiven_pose.inputs(rng)]
    forgiven = []
    for R, t, K, points, diameter in given_poses:
        wrong = student(R, t, K, points, diameter)
        pixels = metrics.projection_2d(K, *wrong, R, t, points)
        forgiven.append(pixels < 5 and metrics.add(*wrong, R, t, points) > 0.1 * diameter)
    assert (checks.check_forgiven_pose(student).status == DONE) == all(forgiven)
