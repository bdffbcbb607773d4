"""Summaries of errors against loops, numerical integrals and hand-made tables."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posecore import metrics

errors_ = arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 0.3))
angles_ = st.lists(
    st.tuples(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi)), min_size=1, max_size=40
)


@given(errors_, st.floats(0, 0.3))
def test_accuracy_counts(errors, threshold):
    assert metrics.accuracy(errors, threshold) == sum(e < threshold for e in errors) / len(errors)


def test_accuracy_is_strict_and_takes_a_threshold_for_each():
    assert metrics.accuracy([0.1, 0.2], 0.1) == 0
    assert metrics.accuracy([0.1, 0.2], [0.2, 0.2]) == 0.5
    assert metrics.accuracy([0.1, np.inf], 1.0) == 0.5
    assert metrics.accuracy(torch.tensor([0.1, 0.3]), 0.2) == 0.5


@given(errors_, arrays(np.float64, 7, elements=st.floats(0, 0.3)))
def test_accuracy_curve_is_accuracy_at_every_threshold(errors, thresholds):
    curve = metrics.accuracy_curve(errors, thresholds)
    np.testing.assert_array_equal(curve, [metrics.accuracy(errors, x) for x in thresholds])
    assert metrics.average_recall(errors, thresholds) == pytest.approx(curve.mean())


@given(errors_)
def test_auc_is_the_integral_of_the_curve(errors):
    """Between two jumps the curve is constant, so the sum of rectangles is the integral."""
    knots = np.unique(np.concatenate([[0, 0.1], errors[errors < 0.1]]))
    middle = (knots[1:] + knots[:-1]) / 2
    area = (metrics.accuracy_curve(errors, middle) * np.diff(knots)).sum() / 0.1
    assert metrics.auc(errors) == pytest.approx(area, abs=1e-12)


def test_auc_of_missing_estimates():
    assert metrics.auc([0.0, np.inf]) == 0.5
    assert metrics.auc([np.inf]) == 0


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_angle_difference_goes_the_short_way(a, b):
    difference = metrics.angle_difference(a, b)
    assert -np.pi <= difference <= np.pi
    assert np.cos(difference) == pytest.approx(np.cos(a - b), abs=1e-9)
    assert np.sin(difference) == pytest.approx(np.sin(a - b), abs=1e-9)


@given(arrays(np.float64, st.integers(1, 20), elements=st.floats(-3, 3)))
def test_mae_and_rmse(errors):
    assert metrics.mean_absolute_error(errors) == pytest.approx(sum(abs(errors)) / len(errors))
    expected = np.sqrt(sum(e * e for e in errors) / len(errors))
    assert metrics.root_mean_squared_error(errors) == pytest.approx(expected)
    assert metrics.mean_absolute_error(errors) <= metrics.root_mean_squared_error(errors) + 1e-12


def test_no_number_is_too_large():
    assert metrics.root_mean_squared_error([1e200, 1e200]) == 1e200
    assert metrics.root_mean_squared_error([0.0]) == 0
    assert metrics.root_mean_squared_error([1.0, np.inf]) == np.inf
    assert metrics.auc([1e308, 0], 1e-308) == 0.5


@given(angles_)
def test_bmae_is_the_mean_of_the_means_of_36_bins(pairs):
    errors, angles = np.array(pairs).T
    degrees = np.abs(np.rad2deg(angles))
    means = []
    for k in range(36):
        low, high = 5 * k, 5 * k + 5
        inside = (degrees >= low - 5e-9) & (degrees < high - 5e-9)
        if k == 35:
            inside |= degrees >= 180 - 5e-9
        if inside.any():
            means.append(np.abs(errors[inside]).mean())
    result = metrics.balanced_mean_angular_error(errors, angles)
    assert result == pytest.approx(np.mean(means), rel=1e-9)


def test_bmae_lets_rare_poses_weigh_as_much_as_frequent_ones():
    """99 frontal poses off by 1 degree and one extreme pose off by 21."""
    errors = np.deg2rad([1.0] * 99 + [21.0])
    yaw = np.deg2rad([2.0] * 99 + [-88.0])
    assert np.rad2deg(metrics.mean_absolute_error(errors)) == pytest.approx(1.2)
    assert np.rad2deg(metrics.balanced_mean_angular_error(errors, yaw)) == pytest.approx(11)


def test_bmae_bins_are_half_open():
    """All 36 edges: 5 degrees opens a bin, 180 belongs to the last one."""
    edges = np.deg2rad(np.arange(37) * 5.0)
    errors = np.arange(37.0)
    expected = (errors[:35].sum() + errors[35:].mean()) / 36
    assert metrics.balanced_mean_angular_error(errors, edges) == pytest.approx(expected)


@given(errors_, st.integers(0, 9))
def test_within_needs_both(errors, seed):
    translation = np.random.default_rng(seed).uniform(0, 0.1, len(errors))
    both = metrics.within(errors, translation, 5, 5)
    expected = [np.degrees(e) < 5 and t * 100 < 5 for e, t in zip(errors, translation, strict=True)]
    assert both.tolist() == expected


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.accuracy([], 1), "errors"),
        (lambda: metrics.accuracy([[1.0]], 1), "errors"),
        (lambda: metrics.accuracy([np.nan], 1), "errors.*index 0"),
        (lambda: metrics.accuracy([1, -1], 1), "errors.*index 1"),
        (lambda: metrics.accuracy(["a"], 1), "errors"),
        (lambda: metrics.accuracy([[1.0, 2.0], [3.0]], 1), "errors.*lengths"),
        (lambda: metrics.accuracy([1.0], np.nan), "threshold:"),
        (lambda: metrics.accuracy([1.0], [1.0, 2.0]), "threshold"),
        (lambda: metrics.accuracy_curve([1.0], [[1.0]]), "threshold"),
        (lambda: metrics.average_recall([1.0], []), "threshold"),
        (lambda: metrics.auc([1.0], 0), "max_threshold"),
        (lambda: metrics.auc([1.0], np.inf), "max_threshold"),
        (lambda: metrics.auc([1.0], "far"), "max_threshold"),
        (lambda: metrics.within([1.0], [1.0, 2.0], 5, 5), "translation_errors"),
        (lambda: metrics.within([1.0], [1.0], 0, 5), "degrees"),
        (lambda: metrics.within([1.0], [1.0], 5, None), "centimetres"),
        (lambda: metrics.mean_absolute_error([np.nan]), "errors"),
        (lambda: metrics.root_mean_squared_error([]), "errors"),
        (lambda: metrics.balanced_mean_angular_error([1.0], [4.0]), "true_angles"),
        (lambda: metrics.balanced_mean_angular_error([1.0], [1.0, 2.0]), "true_angles"),
        (lambda: metrics.balanced_mean_angular_error([1.0], [1.0], bin_width=0), "bin_width"),
        (lambda: metrics.balanced_mean_angular_error([1.0], [1.0], max_angle=0.01), "max_angle"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()
