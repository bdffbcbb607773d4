"""Chapter 03's exercises: plausible wrong solutions are caught, another right one is accepted."""

import numpy as np

from book.ch03_infrared_to_clouds import checks
from tests.book.exercises import ExerciseTests, Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


class TestExercises(ExerciseTests):
    checks = checks
    solutions = SOLUTIONS
    fewest = 1  # when the chapter is done it has four, and this line goes


@right("translation")
def by_hand(K, pixel, z):
    y = (pixel[1] - K[1, 2]) / K[1, 1]
    return z * np.array([(pixel[0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y, 1])


@wrong("translation", "a camera with skew", "got")
def without_skew(K, pixel, z):
    return z * np.array([*((pixel - K[:2, 2]) / np.diag(K)[:2]), 1])


@wrong("translation", "a pixel below it", "got")
def one_focal_length(K, pixel, z):
    return z * np.array([*((pixel - K[:2, 2]) / K[0, 0]), 1])


@wrong("translation", "the principal point", "got")
def without_the_principal_point(K, pixel, z):
    return z * np.array([*(pixel / np.diag(K)[:2]), 1])


@wrong("translation", "the principal point", "got")
def at_unit_distance(K, pixel, z):
    return np.linalg.solve(K, [*pixel, 1])


@wrong("translation", "the principal point", "got")
def projecting_once_more(K, pixel, z):
    return K @ [*pixel, z]
