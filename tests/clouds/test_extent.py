"""The diameter of clouds against all pairs."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from posecore.clouds import diameter


def ball(rng, count):
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def tube(rng, count):
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle), rng.choice([-1, 1.0], count)])


def constant_width(rng, count):
    """Points of a Reuleaux triangle: each arc is equally far from the corner opposite."""
    corners = np.array([[np.cos(a), np.sin(a), 0] for a in 2 * np.pi / 3 * np.arange(3)])
    side, which = np.sqrt(3), rng.integers(0, 3, count)
    angle = np.pi + 2 * np.pi / 3 * which + rng.uniform(-np.pi / 6, np.pi / 6, count)
    arc = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    return corners[which] + side * arc


CLOUDS = {
    "normal": lambda rng, n: rng.normal(size=(n, 3)),
    "box": lambda rng, n: rng.uniform(-1, 1, (n, 3)) * [3, 2, 1],
    "ball": ball,
    "tube": tube,
    "width": constant_width,
    "flat": lambda rng, n: rng.normal(size=(n, 3)) * [1, 1, 0],
    "line": lambda rng, n: rng.normal(size=(n, 1)) * [1.0, 2, 3],
    "lattice": lambda rng, n: rng.integers(0, 4, (n, 3)).astype(float),
    "same": lambda rng, n: np.ones((n, 3)),
}


@pytest.mark.parametrize("kind", CLOUDS.values(), ids=CLOUDS)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(2, 60),
    far=st.sampled_from([0.0, 1.0, 1e4]),
    exponent=st.sampled_from([-150, -3, 0, 150]),
)
def test_like_all_pairs(kind, seed, count, far, exponent):
    rng = np.random.default_rng(seed)
    points = (kind(rng, count) + far * rng.normal(size=3)) * 10.0**exponent
    with np.errstate(under="ignore"):
        expected = pdist(points / 10.0**exponent).max() * 10.0**exponent
    assert diameter(points) == pytest.approx(expected, rel=1e-14 + 1e-15 * far, abs=0)


@pytest.mark.parametrize("kind", CLOUDS.values(), ids=CLOUDS)
def test_many_points_like_all_pairs(kind, rng):
    points = kind(rng, 3000)
    assert diameter(points) == pytest.approx(pdist(points).max(), rel=1e-15)


def test_one_point_has_none():
    assert diameter([[1.0, 2, 3]]) == 0


def test_batches(rng):
    clouds = rng.normal(size=(2, 3, 9, 3))
    found = diameter(clouds)
    expected = [[pdist(cloud).max() for cloud in row] for row in clouds]
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_gradients_pull_the_two_ends():
    points = torch.tensor([[0.0, 0, 0], [3, 4, 0], [1, 1, 1]], requires_grad=True)
    diameter(points).backward()
    expected = torch.tensor([[-0.6, -0.8, 0], [0.6, 0.8, 0], [0, 0, 0]])
    torch.testing.assert_close(points.grad, expected)


def test_distances_that_overflow_are_refused():
    with pytest.raises(ValueError, match="^points: expected points whose squared distances are"):
        diameter([[1e200, 0, 0], [0, 0, 0]])
