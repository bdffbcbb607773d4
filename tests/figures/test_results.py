"""Charts of what was measured: the numbers are where they belong, and in the words."""

import numpy as np
import pytest

from posecore.figures import results
from posecore.figures.style import COLOURS

K = np.array([[200.0, 0, 79.5], [0, 200, 59.5], [0, 0, 1]])
SIZE = np.array([0.1, 0.2, 0.3])
POSE = np.eye(3), np.array([0.05, 0, 1.0])


def estimate(**words):
    yy, xx = np.mgrid[0:120, 0:160]
    image = np.uint8(np.stack([xx, yy, 255 - xx], -1))
    return results.Estimate(image, K, SIZE, POSE, **words)


def test_best_median_and_worst():
    assert results.best_median_worst([3, 1, 2, np.inf]) == {"best": 1, "median": 2, "worst": 3}
    assert results.best_median_worst([7]) == {"best": 0, "median": 0, "worst": 0}
    assert results.best_median_worst([np.inf, np.inf, 1])["worst"] == 0
    for bad in ([], [np.nan], np.eye(2)):
        with pytest.raises(ValueError, match="errors"):
            results.best_median_worst(bad)


def test_the_gallery_has_a_box_for_each_pose():
    other = POSE[0], POSE[1] + [0.02, 0, 0]
    rows = {"easy": {"good": estimate(found=other), "lost": estimate()}, "hard": {"x": estimate()}}
    figure = results.gallery(rows)
    good, lost, one, _ = figure.axes
    assert [axes.get_title() for axes in figure.axes] == ["good", "lost", "x", ""]
    colours = [{line.get_color() for line in axes.lines} for axes in figure.axes]
    assert colours == [{COLOURS[0], COLOURS[1]}, {COLOURS[0]}, {COLOURS[0]}, set()]
    assert "easy: good, lost; hard: x" in figure.alt
    x, y = K[0, 0] * POSE[1][0] / POSE[1][2] + K[0, 2], K[1, 2]
    for axes in (good, lost, one):
        low, high = sorted(axes.get_xlim())
        assert low < x < high
        assert min(axes.get_ylim()) < y < max(axes.get_ylim())
    assert results.gallery(rows, alt="mine").alt == "mine"


def test_the_gallery_looks_where_the_box_is():
    away = estimate(centre=np.array([-0.2, 0, 0]))
    (axes,) = results.gallery({"a": {"b": away}}).axes
    assert min(axes.get_xlim()) < K[0, 0] * -0.15 + K[0, 2] < max(axes.get_xlim())


@pytest.mark.parametrize("rows", [{}, {"a": {}}])
def test_an_empty_gallery_is_refused(rows):
    with pytest.raises(ValueError, match="rows"):
        results.gallery(rows)


def test_a_bad_estimate_is_named():
    with pytest.raises(ValueError, match="size"):
        results.gallery({"a": {"b": estimate()._replace(size=np.ones(2))}})


def test_by_visibility_draws_means_and_seeds():
    figure = results.by_visibility(
        [0, 0.5, 1], {"a": [[10, 20], [30, np.nan]], "b": [5, 6]}, [3, 4]
    )
    axes = figure.axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    np.testing.assert_array_equal(lines["a"].get_ydata(), [20, np.nan])
    np.testing.assert_array_equal(lines["b"].get_ydata(), [5, 6])
    means = lines["a"], lines["b"]
    seeds = [y for line in axes.lines if line not in means for y in line.get_ydata()]
    assert sorted(y for y in seeds if np.isfinite(y)) == [10, 20, 30]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["0% to 50%\n(3)", "50% to 100%\n(4)"]
    assert "a 20 %, none; b 5 %, 6 %" in figure.alt
    assert results.by_visibility([0, 1], {"a": [1]}, alt="mine").alt == "mine"


@pytest.mark.parametrize("right", [{}, {"a": [1, 2, 3]}, {"a": [1, 2], "b": [1]}])
def test_bad_numbers_by_visibility_are_named(right):
    with pytest.raises(ValueError, match="right"):
        results.by_visibility([0, 0.5, 1], right)


def test_over_a_threshold():
    at = np.array([0.0, 0.5, 1.0])
    figure = results.over_threshold(at, {"easy": [50, 70, 60]}, 0.25, xlabel="at least")
    line, chosen = figure.axes[0].lines
    np.testing.assert_array_equal(line.get_xydata(), np.stack([at, [50, 70, 60]], 1))
    assert set(chosen.get_xdata()) == {0.25}
    for part in ("easy: 50.0 at 0, 60.0 at 1, most 70.0 at 0.50", "Chosen: 0.25", "at least"):
        assert part in figure.alt
    with pytest.raises(ValueError, match="'a'"):
        results.over_threshold(at, {"a": [1, 2]}, 0.5, xlabel="x")


def test_over_seeds():
    groups = {"one": {"a": [10, 20], "b": [30.0]}, "two": {"a": [5, 7, 9]}}
    figure = results.over_seeds(groups, {"one": {"b": 40.0}}, others_are="theirs")
    first, second = figure.axes
    heights = [line.get_ydata().tolist() for line in first.lines]
    assert heights == [[10, 20], [15, 15], [30], [30, 30], [40]]
    assert [line.get_ydata().tolist() for line in second.lines][:2] == [[5, 7, 9], [7, 7]]
    assert "one, a 15.0; one, b 30.0; two, a 7.0" in figure.alt
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["theirs"]
    assert not results.over_seeds(groups).legends
    for bad in ({}, {"one": {}}):
        with pytest.raises(ValueError, match="groups"):
            results.over_seeds(bad)
