"""Average precision against its definition in a loop, and by hand."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore import metrics
from tests.metrics import bop_loop

detections = st.lists(
    st.tuples(st.sampled_from([0.1, 0.2, 0.3, 0.5, 0.9]), st.booleans()), max_size=25
)


def precision_envelope(scores, correct, count):
    """The area by definition: at every recall the best precision there or beyond."""
    points = []
    for threshold in np.unique(scores):
        chosen = scores >= threshold
        points.append((correct[chosen].sum() / count, correct[chosen].mean()))
    area, recalls = 0.0, sorted({r for r, _ in points} | {0.0})
    for low, high in itertools.pairwise(recalls):
        area += (high - low) * max(p for r, p in points if r >= high)
    return area


@pytest.mark.slow
@given(detections, st.integers(0, 5))
def test_average_precision_is_its_definition(rows, missed):
    scores = np.array([s for s, _ in rows])
    correct = np.array([c for _, c in rows], bool)
    count = int(correct.sum()) + missed + (not correct.any())
    expected = precision_envelope(scores, correct, count)
    assert metrics.average_precision(scores, correct, count) == pytest.approx(expected)


def test_average_precision_by_hand():
    # right, wrong, right: precision 1 up to recall 1/2, then 2/3.
    assert metrics.average_precision([3, 2, 1], [True, False, True], 2) == pytest.approx(5 / 6)
    assert metrics.average_precision([1, 2], [True, True], 2) == 1
    assert metrics.average_precision([1, 2], [True, True], 4) == 0.5
    assert metrics.average_precision([], np.array([], bool), 3) == 0
    # Equal scores: the order in the file must not matter.
    assert metrics.average_precision([1, 1], [True, False], 1) == 0.5
    assert metrics.average_precision([1, 1], [False, True], 1) == 0.5


@given(detections, st.integers(0, 5))
@settings(max_examples=15)
def test_coco_precision_is_its_definition(rows, missed):
    scores, correct = np.array([s for s, _ in rows]), np.array([c for _, c in rows], bool)
    count = int(correct.sum()) + missed + (not correct.any())
    got = metrics.coco_average_precision(scores, correct, count)
    assert got == pytest.approx(bop_loop.coco(rows, count), abs=1e-12)


def test_coco_precision_by_hand():
    # right, wrong, right: precision 1 at the recalls 0 to 0.5, then 2/3.
    expected = (51 + 50 * 2 / 3) / 101
    assert metrics.coco_average_precision([3, 2, 1], [True, False, True], 2) == pytest.approx(
        expected
    )
    assert metrics.coco_average_precision([], np.array([], bool), 3) == 0
    assert metrics.coco_average_precision([1, 1], [False, True], 1) == 0.5  # in their order
    with pytest.raises(ValueError, match="^correct"):
        metrics.coco_average_precision([1], [True, False], 1)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_many_thresholds_are_one_after_the_other(seed):
    rng = np.random.default_rng(seed)
    D, G, thresholds = rng.integers(0, 6), rng.integers(0, 4), np.array([0.1, 0.3, 0.8])
    errors, scores = rng.uniform(0, 1, (3, D, G)), rng.choice([0.2, 0.5, 0.9], D)
    errors[rng.random(errors.shape) < 0.2] = np.inf
    got = metrics.match_at_thresholds(errors[0], scores, thresholds)
    expected = [metrics.match_by_error(errors[0], scores, t) for t in thresholds]
    np.testing.assert_array_equal(got, expected)
    got = metrics.match_at_thresholds(errors, scores, thresholds)
    expected = [
        metrics.match_by_error(*x, t)
        for *x, t in zip(errors, [scores] * 3, thresholds, strict=True)
    ]
    np.testing.assert_array_equal(got, expected)


@given(st.integers(0, 2**32 - 1))
def test_each_object_is_found_once(seed):
    rng = np.random.default_rng(seed)
    overlaps, scores = rng.uniform(0, 1, (rng.integers(0, 6), rng.integers(0, 4))), None
    scores = rng.permutation(len(overlaps)).astype(float)
    found = metrics.match_by_overlap(overlaps, scores, 0.3)
    assert found.sum() <= overlaps.shape[1]
    assert not found[(overlaps < 0.3).all(1)].any()
    if overlaps.size and overlaps[scores.argmax()].max() >= 0.3:
        assert found[scores.argmax()]  # the surest one has the first choice


def test_the_surest_choose_first():
    overlaps = [[0.6, 0.9], [0.0, 0.8], [0.7, 0.0]]
    assert metrics.match_by_overlap(overlaps, [1, 2, 3], 0.5).tolist() == [False, True, True]
    assert metrics.match_by_overlap(overlaps, [3, 2, 1], 0.5).tolist() == [True, False, True]
    assert metrics.match_by_overlap(overlaps, [3, 3, 3], 0.5).tolist() == [True, False, True]
    assert metrics.match_by_overlap(np.zeros((2, 0)), [1, 2], 0.5).tolist() == [False, False]
    assert metrics.match_by_overlap([[0.5]], [1], 0.5).tolist() == [False]  # must exceed


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.match_by_overlap([0.5], [1], 0.5), "overlaps"),
        (lambda: metrics.match_by_overlap([[0.5]], [1, 2], 0.5), "scores"),
        (lambda: metrics.match_by_overlap([["a"]], [1], 0.5), "overlaps"),
        (lambda: metrics.match_by_overlap([[np.nan]], [1], 0.5), "overlaps"),
        (lambda: metrics.match_by_overlap([[0.5]], [np.inf], 0.5), "scores"),
        (lambda: metrics.match_by_overlap([[0.5]], [1], None), "threshold"),
        (lambda: metrics.match_at_thresholds([[0.5]], [1, 2], [0.5]), "errors"),
        (lambda: metrics.match_at_thresholds([[[0.5]]], [1], [0.5, 0.6]), "errors"),
        (lambda: metrics.match_at_thresholds([[-0.5]], [1], [0.5]), "errors"),
        (lambda: metrics.match_at_thresholds([[np.nan]], [1], [0.5]), "errors"),
        (lambda: metrics.match_at_thresholds([[0.5]], [1], 0.5), "thresholds"),
        (lambda: metrics.match_at_thresholds([[0.5]], [np.inf], [0.5]), "scores"),
        (lambda: metrics.average_precision([1], [True, False], 1), "correct"),
        (lambda: metrics.average_precision([1], [1], 1), "correct"),
        (lambda: metrics.average_precision([1, 2], [True, True], 1), "correct"),
        (lambda: metrics.average_precision([1], [True], 0), "object_count"),
        (lambda: metrics.average_precision([np.nan], [True], 1), "scores"),
        (lambda: metrics.average_precision([[1.0]], [[True]], 1), "scores"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


def test_pairs_by_error_are_greedy_at_each_threshold():
    """The surest takes the nearest; the second best pairing by sums would be another."""
    errors = np.array([[1.0, 2.0], [1.5, 9.0]])
    assert metrics.match_by_error(errors, [0.9, 0.5], 3.0).tolist() == [True, False]
    assert metrics.match_by_error(errors, [0.5, 0.9], 3.0).tolist() == [True, True]
    assert metrics.match_by_error(errors, [0.9, 0.5], 1.0).tolist() == [False, False]  # not below
    assert metrics.match_by_error([[np.inf]], [1.0], 5.0).tolist() == [False]
    assert metrics.match_by_error(np.zeros((0, 2)), [], 5.0).tolist() == []
    assert metrics.match_by_error(np.zeros((2, 0)), [1.0, 1.0], 5.0).tolist() == [False, False]


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (([[np.nan]], [1.0], 1.0), "errors"),
        (([[-1.0]], [1.0], 1.0), "errors"),
        (([1.0], [1.0], 1.0), "errors"),
        (([[1.0]], [1.0, 2.0], 1.0), "scores"),
        (([[1.0]], [1.0], np.inf), "threshold"),
    ],
)
def test_bad_errors_are_named(arguments, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        metrics.match_by_error(*arguments)
