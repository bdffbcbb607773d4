"""Farthest point sampling against a loop that keeps to its definition; gathering against loops."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore import clouds

seeds = st.integers(0, 2**32 - 1)


def loop_sampling(points, count, start=0):
    """The definition, one point and one distance at a time; equal distances go to the first."""

    def squared(a, b):
        x, y, z = (a - b) ** 2
        return x + y + z

    if start == "farthest_from_centre":
        centre = (points.min(0) + points.max(0)) / 2
        distances = [squared(p, centre) for p in points]
        chosen = [int(np.argmax(distances))]
    else:
        distances, chosen = [np.inf] * len(points), [start]
    while len(chosen) < count:
        distances = [
            min(d, squared(p, points[chosen[-1]])) for d, p in zip(distances, points, strict=True)
        ]
        free = [i for i in range(len(points)) if i not in chosen]
        chosen.append(max(free, key=lambda i: distances[i]))  # max keeps the first of equal ones
    return chosen


@st.composite
def clouds_with_ties(draw):
    """Points on a coarse grid, so that distances tie and points repeat, at any scale and place."""
    n = draw(st.integers(1, 12))
    grid = draw(st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=n, max_size=n))
    scale, shift = draw(st.sampled_from([(1, 0), (1e-3, 0), (0.25, 1e6), (1e6, 0)]))
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    return (np.array(grid) * scale + shift).astype(dtype)


@given(clouds_with_ties(), st.data())
def test_sampling_keeps_to_the_definition_with_ties_and_copies(points, data):
    count = data.draw(st.integers(1, len(points)))
    start = data.draw(st.sampled_from([*range(len(points)), "farthest_from_centre"]))
    chosen = clouds.farthest_point_sampling(points, count, start)
    assert chosen.dtype == np.int64
    np.testing.assert_array_equal(chosen, loop_sampling(points, count, start))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("start", [0, 17, "farthest_from_centre"])
def test_sampling_of_random_clouds_in_batches(rng, dtype, start):
    points = rng.normal(size=(2, 3, 60, 3)).astype(dtype)
    chosen = clouds.farthest_point_sampling(points, 40, start)
    assert chosen.shape == (2, 3, 40)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_array_equal(chosen[i, j], loop_sampling(points[i, j], 40, start))


def test_points_near_the_origin_are_ordinary_points(rng):
    """A widespread CUDA version passes over everything within 3.16 cm of the origin."""
    points = rng.uniform(-0.01, 0.01, (50, 3))
    assert sorted(clouds.farthest_point_sampling(points, 50)) == list(range(50))


@pytest.mark.parametrize("start", [0, 3, "farthest_from_centre"])
def test_identical_points_follow_in_order_of_index(start):
    chosen = clouds.farthest_point_sampling(np.full((2, 6, 3), 0.3), 5, start)
    first = 0 if isinstance(start, str) else start
    np.testing.assert_array_equal(chosen, [[first, *[i for i in range(6) if i != first][:4]]] * 2)


def test_copies_come_only_when_nothing_else_is_left():
    line = np.array([0, 0, 5, 1, 5, 9.0])[:, None] * [1, 0, 0]
    np.testing.assert_array_equal(clouds.farthest_point_sampling(line, 6), [0, 5, 2, 3, 1, 4])


def test_the_centre_counts_as_chosen():
    """Points: two ends, and one near the middle, which the centre of the box keeps back."""
    line = np.array([0.0, 10, 5.5, 8])[:, None] * [1, 0, 0]
    chosen = clouds.farthest_point_sampling(line, 4, "farthest_from_centre")
    np.testing.assert_array_equal(chosen, [0, 1, 3, 2])


def test_sampling_takes_tensors_half_precision_and_no_clouds_at_all(rng):
    points = torch.from_numpy(rng.normal(size=(20, 3))).bfloat16().requires_grad_()
    chosen = clouds.farthest_point_sampling(points, 9)
    assert chosen.dtype == torch.int64 and not chosen.requires_grad
    assert chosen.tolist() == loop_sampling(points.detach().float().numpy(), 9)
    assert clouds.farthest_point_sampling(np.empty((0, 5, 3)), 2).shape == (0, 2)


@given(seeds, st.sampled_from([(), (4,), (2, 3)]), st.sampled_from([(), (5,), (3, 4)]))
def test_gather_points_looks_up_rows(seed, batch, k):
    rng = np.random.default_rng(seed)
    values, indices = rng.normal(size=(*batch, 6, 2)), rng.integers(0, 6, (*batch, *k))
    gathered = clouds.gather_points(values, indices)
    assert gathered.shape == (*batch, *k, 2)
    for at in np.ndindex(*indices.shape):
        row = values[at[: len(batch)]][indices[at]]
        np.testing.assert_array_equal(gathered[at], row)


@pytest.mark.parametrize("kind", [list, np.uint8, np.int32, torch.int16, torch.int64])
def test_indices_may_be_any_kind_of_integer(kind):
    indices = [[0, 2, 2], [1, 0, 1]]
    if isinstance(kind, torch.dtype):
        given_indices = torch.tensor(indices, dtype=kind)
    else:
        given_indices = indices if kind is list else np.array(indices, dtype=kind)
    values = np.arange(12.0).reshape(2, 3, 2)
    expected = np.stack([values[0][indices[0]], values[1][indices[1]]])
    np.testing.assert_array_equal(clouds.gather_points(values, given_indices), expected)


def test_gradients_of_gathering_add_up_in_the_rows():
    values = torch.randn(2, 4, 3, dtype=torch.float64, requires_grad=True)
    indices = torch.tensor([[[0, 0], [3, 0]], [[1, 2], [2, 2]]])
    assert torch.autograd.gradcheck(lambda v: clouds.gather_points(v, indices), values)


POINTS = np.arange(15.0).reshape(5, 3)
BAD_CALLS = [
    (lambda: clouds.farthest_point_sampling(POINTS, 6), "count"),
    (lambda: clouds.farthest_point_sampling(POINTS, 0), "count"),
    (lambda: clouds.farthest_point_sampling(POINTS, 2.0), "count"),
    (lambda: clouds.farthest_point_sampling(POINTS, 2, 5), "start"),
    (lambda: clouds.farthest_point_sampling(POINTS, 2, -1), "start"),
    (lambda: clouds.farthest_point_sampling(POINTS, 2, "random"), "start"),
    (lambda: clouds.farthest_point_sampling(POINTS, 2, None), "start"),
    (lambda: clouds.gather_points(POINTS, [0, 5]), "indices"),
    (lambda: clouds.gather_points(POINTS, [-1]), "indices"),
    (lambda: clouds.gather_points(POINTS, [0.0, 1.0]), "indices"),
    (lambda: clouds.gather_points(POINTS, [True, False]), "indices"),
    (lambda: clouds.gather_points(POINTS, torch.tensor([1.0])), "indices"),
    (lambda: clouds.gather_points(POINTS[None], [0, 1]), "indices"),
]


@pytest.mark.parametrize(("call", "argument"), BAD_CALLS)
def test_bad_input_is_refused_by_name(call, argument):
    with pytest.raises(ValueError, match=rf"^{argument}: expected .*got"):
        call()
