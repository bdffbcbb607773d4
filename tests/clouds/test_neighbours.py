"""Neighbours against loops, SciPy and their definitions."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from posecore import clouds
from posecore.clouds import search

seeds = st.integers(0, 2**32 - 1)


def loop_ball(points, query, radius, count):
    """The definition: by index, filled with the first; an empty ball holds the nearest point."""
    distances = ((points - query) ** 2).sum(-1)
    inside = [i for i in range(len(points)) if distances[i] < radius**2][:count]
    inside = inside or [int(np.argmin(distances))]
    return inside + inside[:1] * (count - len(inside))


@given(seeds, st.integers(1, 30), st.integers(1, 8))
def test_nearest_neighbours_agree_with_scipy(seed, n, m):
    rng = np.random.default_rng(seed)
    points, queries = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    k = int(rng.integers(1, n + 1))
    distances, indices = clouds.nearest_neighbours(points, queries, k)
    expected = cKDTree(points).query(queries, np.arange(1, k + 1))
    assert indices.dtype == np.int64
    np.testing.assert_array_equal(indices, expected[1])
    np.testing.assert_allclose(distances, expected[0], rtol=1e-14)


def test_nearest_neighbours_of_batches_that_broadcast(rng):
    points, queries = rng.normal(size=(2, 1, 9, 3)), rng.normal(size=(3, 4, 3))
    distances, indices = clouds.nearest_neighbours(points, queries, 2)
    assert distances.shape == indices.shape == (2, 3, 4, 2)
    for i, j in np.ndindex(2, 3):
        single = clouds.nearest_neighbours(points[i, 0], queries[j], 2)
        np.testing.assert_array_equal(indices[i, j], single[1])
        np.testing.assert_array_equal(distances[i, j], single[0])


def test_distances_are_sorted_and_a_point_finds_itself_first(rng):
    points = rng.normal(size=(100, 3)).astype(np.float32)
    distances, indices = clouds.nearest_neighbours(points, points, 100)
    assert (np.diff(distances) >= 0).all() and distances.dtype == np.float32
    np.testing.assert_array_equal(indices[:, 0], np.arange(100))
    np.testing.assert_array_equal(np.sort(indices), np.tile(np.arange(100), (100, 1)))


def test_gradients_of_distances_are_exact_and_finite_at_zero(rng):
    points = torch.from_numpy(rng.normal(size=(6, 3))).requires_grad_()
    queries = torch.from_numpy(rng.normal(size=(4, 3))).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda p, q: clouds.nearest_neighbours(p, q, 3)[0], (points, queries)
    )
    distances, indices = clouds.nearest_neighbours(points, points, 1)
    assert not indices.requires_grad
    (gradient,) = torch.autograd.grad(distances.sum(), points)
    torch.testing.assert_close(gradient, torch.zeros_like(gradient))


@given(seeds, st.sampled_from([0.05, 0.4, 1.0, 5.0]), st.integers(1, 12))
def test_ball_query_keeps_to_its_definition(seed, radius, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(2, 15, 3))
    queries = np.concatenate([points[:, :3], rng.normal(size=(2, 4, 3))], axis=1)
    indices = clouds.ball_query(points, queries, radius, count)
    assert indices.dtype == np.int64 and indices.shape == (2, 7, count)
    for i, j in np.ndindex(2, 7):
        assert indices[i, j].tolist() == loop_ball(points[i], queries[i, j], radius, count)


@pytest.mark.parametrize("share", [0.0, 2.0], ids=["blocks", "trees"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_ball_query_agrees_with_scipy_on_both_roads(rng, monkeypatch, share, dtype):
    monkeypatch.setattr(search, "_SMALL_BALL", share)
    points = rng.uniform(-1, 1, (3, 500, 3)).astype(dtype)
    queries, radius, count = points[:, ::3], 0.3, 8
    indices = clouds.ball_query(points, queries, radius, count)
    for i in range(3):
        lists = cKDTree(points[i]).query_ball_point(queries[i], radius, return_sorted=True)
        expected = [(found + found[:1] * count)[:count] for found in lists]
        np.testing.assert_array_equal(indices[i], expected)


@pytest.mark.parametrize("share", [0.0, 2.0], ids=["blocks", "trees"])
def test_empty_balls_hold_the_nearest_point_wherever_they_stand(monkeypatch, share):
    monkeypatch.setattr(search, "_SMALL_BALL", share)
    points = np.array([[[0.0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 0, 0]]])
    queries = np.array([[[9.0, 0, 0], [1, 0, 0], [0, 1e6, 0]]])
    indices = clouds.ball_query(points, queries, 1e-3, 2)
    np.testing.assert_array_equal(indices, [[[1, 1], [1, 1], [0, 0]], [[0, 0]] * 3])


def test_the_radius_itself_is_outside():
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [-0.5, 0, 0], [0, 0.25, 0]])
    assert clouds.ball_query(points, points[:1], 0.5, 3).tolist() == [[0, 3, 0]]


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-3, 0), (1e6, 0), (1, 1e6)])
def test_identical_points_are_found_in_order_of_index(scale, shift):
    points = np.full((5, 3), 0.5) * scale + shift
    far = points[:1] + scale
    np.testing.assert_array_equal(
        clouds.ball_query(points, points[:2], scale, 7)[1], [*range(5), 0, 0]
    )
    np.testing.assert_array_equal(clouds.nearest_neighbours(points, far, 4)[1], [[0, 1, 2, 3]])
    assert clouds.nearest_neighbours(points[:1], far)[1].tolist() == [[0]]


def test_tensors_of_low_precision_and_batches_without_clouds():
    points = torch.rand(8, 3).bfloat16().requires_grad_()
    distances, indices = clouds.nearest_neighbours(points, points, 2)
    assert distances.dtype == torch.bfloat16 and indices[:, 0].tolist() == list(range(8))
    assert clouds.ball_query(points, points, 9.0, 3).tolist() == [[0, 1, 2]] * 8
    none = np.empty((0, 4, 3))
    assert clouds.nearest_neighbours(none, none, 2)[1].shape == (0, 4, 2)
    assert clouds.ball_query(none, none, 0.1, 2).shape == (0, 4, 2)


POINTS = np.arange(15.0).reshape(5, 3)
BAD_CALLS = [
    (lambda: clouds.nearest_neighbours(POINTS, POINTS, 0), "k"),
    (lambda: clouds.nearest_neighbours(POINTS, POINTS, 6), "k"),
    (lambda: clouds.nearest_neighbours(POINTS, POINTS, 1.5), "k"),
    (lambda: clouds.ball_query(POINTS, POINTS, 0, 4), "radius"),
    (lambda: clouds.ball_query(POINTS, POINTS, -0.1, 4), "radius"),
    (lambda: clouds.ball_query(POINTS, POINTS, np.inf, 4), "radius"),
    (lambda: clouds.ball_query(POINTS, POINTS, "wide", 4), "radius"),
    (lambda: clouds.ball_query(POINTS, POINTS, 0.1, 0), "count"),
    (lambda: clouds.ball_query(POINTS, POINTS, 0.1, 2.0), "count"),
]


@pytest.mark.parametrize(("call", "argument"), BAD_CALLS)
def test_bad_input_is_refused_by_name(call, argument):
    with pytest.raises(ValueError, match=rf"^{argument}: expected .*got"):
        call()
