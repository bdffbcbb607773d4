"""Chapter 2's exercises: plausible wrong solutions are caught, other right ones are accepted."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from book.ch02_small_worlds import checks
from posecore import cameras, poses
from tests.book.ch02_small_worlds.solutions import SOLUTIONS
from tests.book.exercises import ExerciseTests


class TestExercises(ExerciseTests):
    checks = checks
    solutions = SOLUTIONS


# What the references say, against the world -------------------------------------------------------

numbers = st.floats(-2, 2)
triples = st.tuples(numbers, numbers, numbers)


@given(st.tuples(triples, triples, triples), numbers)
def test_what_is_clipped_off_lies_behind(triangle: tuple, near: float) -> None:
    """Both sides of the plane have the triangle's area together, and each is on its side."""
    corners = np.array(triangle)
    front = checks.clip_near(corners, near)
    behind = checks.clip_near(corners * [1, 1, -1], -near) * [1, 1, -1]
    assert (front[:, 2] >= near - 1e-9).all() and (behind[:, 2] <= near + 1e-9).all()
    if not (corners[:, 2] == near).all():

        def area(polygon: np.ndarray) -> np.ndarray:
            return np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(0) if len(polygon) else 0

        assert np.allclose(area(front) + area(behind), area(corners), atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_interpolated_points_are_seen_where_they_are(seed: int) -> None:
    """The oracle is a ray cut with the triangle's plane."""
    rng = np.random.default_rng(seed)
    K = np.array([[100.0, 3, 20], [0, 90, 10], [0, 0, 1]])
    X = rng.uniform([-1, -1, 1], [1, 1, 4], size=(3, 3))
    corners, weights = cameras.project(K, X), rng.dirichlet(np.ones(3), size=4)
    rays = np.c_[weights @ corners, np.ones(4)] @ np.linalg.inv(K).T
    normal = np.cross(X[1] - X[0], X[2] - X[0])
    expected = rays * (normal @ X[0] / (rays @ normal))[:, None]
    if np.abs(rays @ normal).min() > 1e-2:  # else the triangle is nearly seen edge on
        assert np.allclose(checks.interpolate(weights, X[:, 2], X), expected, atol=1e-8)


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=3))
def test_edge_values_are_twice_the_area(corners: list) -> None:
    a, b, c = np.array(corners, float)
    E = float(checks.edge_function(a, b, c[None])[0])
    if E == 0:
        assert np.linalg.matrix_rank([b - a, c - a]) < 2
    else:
        assert np.isclose(abs(E), 2 * ConvexHull(corners).volume)


@given(st.floats(-4, 4), st.integers(0, 2**32 - 1))
def test_points_land_on_their_turned_pixels(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array([[500.0, 20, 300], [0, 400, 100], [0, 0, 1]])
    points, t = rng.normal(size=(5, 3)) / 10, np.array([0.1, -0.2, 1.5])
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R_new, t_new, A = checks.turn_picture(R, t, K, angle)
    before = cameras.project(K, poses.apply(R, t, points))
    after = cameras.project(K, poses.apply(R_new, t_new, points))
    assert np.allclose(before @ A[:2, :2].T + A[:2, 2], after, atol=1e-8)
    assert A[2].tolist() == [0, 0, 1]


@given(st.integers(0, 2**32 - 1), st.integers(0, 2))
def test_merging_and_counting_agree_with_loops(seed: int, margin: int) -> None:
    rng = np.random.default_rng(seed)
    layers = rng.integers(0, 4, size=(3, 5, 6)) / 2
    depth, instance = checks.merge_layers(layers)
    seen = np.zeros(3)
    for row, column in np.ndindex(5, 6):
        there = [(z, k) for k, z in enumerate(layers[:, row, column]) if z > 0]
        assert (depth[row, column], instance[row, column]) == min(there, default=(0, -1))
        if there and margin <= row < 5 - margin and margin <= column < 6 - margin:
            seen[min(there)[1]] += 1
    counts = (layers > 0).sum((1, 2))
    assert np.allclose(checks.visible_fraction(layers, margin) * counts, seen)


def test_albedo_is_what_the_lamp_was_told() -> None:
    """A plane and light made by hand, without noise."""
    K = np.array([[10.0, 0, 2], [0, 10, 1], [0, 0, 1]])
    n, albedo = np.array([0.0, -0.6, -0.8]), np.linspace(0.1, 0.9, 15).reshape(3, 5)
    depth, brightness = np.zeros((2, 3, 5))
    for v, u in np.ndindex(3, 5):
        ray = np.array([(u - 2) / 10, (v - 1) / 10, 1])
        X = ray * (n @ [0, 0, 0.7] / (n @ ray))
        r = np.linalg.norm(X)
        depth[v, u], brightness[v, u] = X[2], 0.3 * albedo[v, u] * (-n @ X / r) / r**2
    found = checks.recover_albedo(brightness, depth, np.tile(n, (3, 5, 1)), K, 0.3, 0.001)
    assert np.allclose(found, albedo)
