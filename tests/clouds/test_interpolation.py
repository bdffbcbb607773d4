"""Interpolation between three points: against scikit-learn, loops and finite differences."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.neighbors import KNeighborsRegressor

from posecore import clouds

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 12), st.sampled_from([2.0, 1.0, 0.5]))
def test_interpolation_agrees_with_scikit_learn(seed, n, power):
    rng = np.random.default_rng(seed)
    points, features, queries = (rng.normal(size=(size, 3)) for size in (n, n, 6))
    regressor = KNeighborsRegressor(min(3, n), weights=lambda d: d**-power).fit(points, features)
    result = clouds.three_nearest_interpolation(points, features, queries, power)
    np.testing.assert_allclose(result, regressor.predict(queries), rtol=1e-10, atol=1e-12)


@given(seeds)
def test_weights_are_shares_by_inverse_square_distance(seed):
    rng = np.random.default_rng(seed)
    points, queries = rng.normal(size=(2, 9, 3)), rng.normal(size=(2, 4, 3))
    indices, weights = clouds.interpolation_weights(points, queries)
    assert indices.shape == weights.shape == (2, 4, 3)
    np.testing.assert_allclose(weights.sum(-1), 1, rtol=1e-15)
    for i, j in np.ndindex(2, 4):
        squared = ((points[i] - queries[i, j]) ** 2).sum(-1)
        np.testing.assert_array_equal(indices[i, j], np.argsort(squared)[:3])
        inverse = 1 / np.sort(squared)[:3]
        np.testing.assert_allclose(weights[i, j], inverse / inverse.sum(), rtol=1e-12)


@given(seeds, st.sampled_from([1.0, 1e-6, 1e6]))
def test_interpolate_is_a_weighted_sum(seed, scale):
    rng = np.random.default_rng(seed)
    features, weights = rng.normal(size=(2, 1, 6, 4)) * scale, rng.normal(size=(3, 5, 2))
    indices = rng.integers(0, 6, (3, 5, 2))
    result = clouds.interpolate(features, indices, weights)
    assert result.shape == (2, 3, 5, 4)
    for i, j, m in np.ndindex(2, 3, 5):
        expected = weights[j, m] @ features[i, 0, indices[j, m]]
        np.testing.assert_allclose(result[i, j, m], expected, rtol=1e-12, atol=1e-13 * scale)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_query_on_a_point_takes_its_feature_exactly(rng, scale, dtype):
    points = (rng.normal(size=(20, 3)) * scale).astype(dtype)
    features = rng.normal(size=(20, 5)).astype(dtype)
    result = clouds.three_nearest_interpolation(points, features, points)
    np.testing.assert_array_equal(result, features)


def test_copies_of_a_point_share_equally_and_few_points_do_what_they_can():
    points = np.array([[0.0, 0, 0], [0, 0, 0], [3, 0, 0], [9, 0, 0]])
    indices, weights = clouds.interpolation_weights(points, points)
    np.testing.assert_array_equal(weights[:2], [[0.5, 0.5, 0]] * 2)
    np.testing.assert_array_equal(indices[:2], [[0, 1, 2]] * 2)
    identical = clouds.interpolation_weights(np.ones((5, 3)), np.ones((2, 3)))
    np.testing.assert_array_equal(identical[0], [[0, 1, 2]] * 2)
    np.testing.assert_allclose(identical[1], 1 / 3, rtol=1e-15)
    indices, weights = clouds.interpolation_weights(points[:1], points)
    assert indices.shape == (4, 1) and (weights == 1).all()


def test_a_constant_and_a_far_query_give_an_average(rng):
    points, far = rng.normal(size=(5, 3)), np.full((1, 3), 1e6)
    constant = clouds.three_nearest_interpolation(points, np.full((5, 1), 7.5), far)
    np.testing.assert_allclose(constant, 7.5, rtol=1e-15)
    weights = clouds.interpolation_weights(points, far)[1]
    np.testing.assert_allclose(weights, 1 / 3, rtol=1e-4)


@pytest.mark.slow
def test_gradients_are_exact_in_features_geometry_and_weights(rng):
    points, features, queries = (
        torch.from_numpy(rng.normal(size=(2, size, 3))).requires_grad_() for size in (7, 7, 4)
    )
    assert torch.autograd.gradcheck(clouds.three_nearest_interpolation, (points, features, queries))
    indices, weights = clouds.interpolation_weights(points, queries)
    weights = weights.detach().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda f, w: clouds.interpolate(f, indices, w), (features, weights)
    )


def test_gradients_are_finite_where_points_coincide(rng):
    points = torch.from_numpy(rng.normal(size=(6, 3)))
    points[1] = points[0]
    points.requires_grad_()
    features = torch.from_numpy(rng.normal(size=(6, 2))).requires_grad_()
    clouds.three_nearest_interpolation(points, features, points).square().sum().backward()
    assert torch.isfinite(points.grad).all()
    assert torch.isfinite(features.grad).all() and (features.grad != 0).all()


def test_one_geometry_serves_a_batch_of_features(rng):
    points, queries = rng.normal(size=(8, 3)), rng.normal(size=(5, 3))
    features = rng.normal(size=(4, 8, 6)).astype(np.float32)
    result = clouds.three_nearest_interpolation(points, features, queries)
    assert result.shape == (4, 5, 6)
    single = [clouds.three_nearest_interpolation(points, one, queries) for one in features]
    np.testing.assert_array_equal(result, single)


POINTS = np.arange(15.0).reshape(5, 3)
WEIGHTS = np.ones((2, 3))
BAD_CALLS = [
    (lambda: clouds.interpolation_weights(POINTS, POINTS, power=0), "power"),
    (lambda: clouds.interpolate(POINTS, [[0, 1], [2, 3]], WEIGHTS), "indices"),
    (lambda: clouds.interpolate(POINTS, [[0, 1, 2], [2, 3, 5]], WEIGHTS), "indices"),
    (lambda: clouds.interpolate(POINTS, [[0, 1, 2], [2, 3, -1]], WEIGHTS), "indices"),
    (lambda: clouds.interpolate(POINTS, np.zeros((2, 3)), WEIGHTS), "indices"),
]


@pytest.mark.parametrize(("call", "argument"), BAD_CALLS)
def test_bad_input_is_refused_by_name(call, argument):
    with pytest.raises(ValueError, match=rf"^{argument}: expected .*got"):
        call()
