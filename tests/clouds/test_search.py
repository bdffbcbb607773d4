"""The two roads of the search find the same indices, ties and copies included."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.clouds import search

NEAREST = [search._nearest_by_trees, search._nearest_by_blocks]
BALLS = [search._balls_by_trees, search._balls_by_blocks]


def loop_nearest(points, queries, k):
    """Indices (M, k) by (distance, index), in the precision of the points."""
    x, y, z = np.moveaxis((points - queries[:, None]) ** 2, -1, 0)
    squared = x + y + z
    return np.array([sorted(range(len(points)), key=lambda i: row[i])[:k] for row in squared])


def loop_balls(points, queries, radius, count):
    """By index, filled with the first; -1 in an empty ball."""
    x, y, z = np.moveaxis((points - queries[:, None]) ** 2, -1, 0)
    inside = [np.flatnonzero(row) for row in x + y + z < points.dtype.type(radius**2)]
    return [[*ball, *ball[:1].repeat(count), *[-1] * count][:count] for ball in inside]


@st.composite
def pairs_of_clouds(draw):
    """Points and queries on a coarse grid: distances tie, points repeat, at any scale and place."""

    def grid(n):
        rows = st.tuples(*[st.integers(-2, 2)] * 3)
        return np.array(draw(st.lists(rows, min_size=n, max_size=n)))

    scale, shift = draw(st.sampled_from([(1, 0), (1e-3, 0), (1 / 3, 0), (0.25, 1e6), (1e6, 0)]))
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    n, m = draw(st.integers(1, 20)), draw(st.integers(1, 5))
    points, queries = (grid(size) * scale + shift for size in (n, m))
    return points.astype(dtype), queries.astype(dtype), scale


def both(road, points, queries, *rest):
    return road(torch.from_numpy(points)[None], torch.from_numpy(queries)[None], *rest)


@pytest.mark.parametrize("road", NEAREST)
@given(pairs_of_clouds(), st.data())
def test_nearest_by_distance_and_then_by_index(road, case, data):
    points, queries, _ = case
    k = data.draw(st.integers(1, len(points)))
    found = both(road, points, queries, k, True)[0]
    np.testing.assert_array_equal(found, loop_nearest(points, queries, k))


@pytest.mark.parametrize("road", NEAREST)
@given(pairs_of_clouds())
def test_without_settled_ties_the_distances_are_still_the_smallest(road, case):
    points, queries, _ = case
    k = min(3, len(points))
    found = both(road, points, queries, k, False)[0].numpy()
    expected = loop_nearest(points, queries, k)
    distances = [np.linalg.norm(points[i] - queries[:, None], axis=-1) for i in (found, expected)]
    np.testing.assert_allclose(*distances, rtol=1e-6)


@pytest.mark.parametrize("road", BALLS)
@given(pairs_of_clouds(), st.sampled_from([0.5, 1.0, 2**0.5, 2.0, 3.0, 100.0]), st.integers(1, 9))
def test_a_ball_ends_before_its_radius(road, case, grid_steps, count):
    points, queries, scale = case
    radius = grid_steps * scale
    found = both(road, points, queries, radius, count)[0]
    np.testing.assert_array_equal(found, loop_balls(points, queries, radius, count))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("repeats", [1, 4, 25])
def test_roads_agree_on_random_clouds_with_copies(rng, monkeypatch, dtype, repeats):
    """Many blocks and many parts of a tree's queries, as in clouds too large for one."""
    monkeypatch.setattr(search, "_BLOCK", 1000)
    monkeypatch.setattr(search, "_QUERIES", 7)
    points = rng.normal(size=(3, 400 // repeats, 3)).astype(dtype).repeat(repeats, axis=1)
    points = torch.from_numpy(rng.permutation(points, axis=1))
    queries = torch.cat([points[:, :20], points[:, :10] + 0.1], dim=1)
    trees, blocks = (road(points, queries, 6, True) for road in NEAREST)
    torch.testing.assert_close(trees, blocks, rtol=0, atol=0)
    for i in range(3):
        expected = loop_nearest(points[i].numpy(), queries[i].numpy(), 6)
        np.testing.assert_array_equal(trees[i], expected)
    trees, blocks = (road(points, queries, 0.5, 8) for road in BALLS)
    torch.testing.assert_close(trees, blocks, rtol=0, atol=0)
    for i in range(3):
        expected = loop_balls(points[i].numpy(), queries[i].numpy(), 0.5, 8)
        np.testing.assert_array_equal(trees[i], expected)


@pytest.mark.parametrize("road", NEAREST)
def test_distances_that_differ_only_in_higher_precision_tie(rng, road):
    """From a million metres away, float32 cannot tell the points of a cloud apart."""
    points = rng.normal(size=(300, 3)).astype(np.float32)
    queries = np.array([[1e6, 0, 0], [0, -1e4, 0], [3e5, 2e5, 0]], dtype=np.float32)
    found = both(road, points, queries, 9, True)[0]
    np.testing.assert_array_equal(found, loop_nearest(points, queries, 9))


def test_small_balls_are_looked_up_in_trees_and_large_ones_computed(rng):
    points = torch.from_numpy(rng.uniform(-1, 1, (2, 2000, 3)))
    assert search._balls_are_small(points, points, 0.1)
    assert not search._balls_are_small(points, points, 1)
    assert not search._balls_are_small(points[:0], points[:0], 0.1)


def test_same_batch_broadcasts():
    points, queries = search.same_batch(torch.ones(4, 1, 5, 3), torch.ones(2, 6, 3))
    assert points.shape == (4, 2, 5, 3) and queries.shape == (4, 2, 6, 3)


@pytest.mark.parametrize(
    "given_type", [torch.float16, torch.bfloat16, torch.float32, torch.float64]
)
def test_the_search_runs_in_single_precision_at_least_and_without_gradient(given_type):
    points = torch.rand(4, 3, dtype=given_type, requires_grad=True)
    result = search.at_least_float32(points)
    assert not result.requires_grad
    assert result.dtype == (torch.float64 if given_type == torch.float64 else torch.float32)
    assert search.nearest_indices(points, points, 1).tolist() == [[0], [1], [2], [3]]
