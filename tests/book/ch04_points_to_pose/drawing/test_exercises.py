"""The figures of chapter 4's exercises show the numbers that they are given, and say so."""

import numpy as np
import pytest

from book.ch04_points_to_pose.drawing import exercises as draw


def test_balls_show_who_was_found_for_each_centre():
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.05, 0, 0]])
    centres = np.array([[0.0, 0, 0], [0.09, 0.01, 0]])
    figure = draw.balls(points, centres, 0.02, np.array([[0, 1, 0], [2, 2, 2]]))
    (axes,) = figure.axes
    assert [(*c.center, c.radius) for c in axes.patches] == [(0, 0, 20), (90, 10, 20)]
    shown = {line.get_label(): line.get_xdata().tolist() for line in axes.lines}
    assert shown["ball 0: 2 points, 3 places"] == [0, 10, 0]
    assert shown["ball 1: empty, so the nearest"] == [50, 50, 50]
    assert axes.yaxis_inverted()
    assert "3 points from the front with 2 balls of 20 mm" in figure.alt
    assert "ball 1: empty" in figure.alt


def test_pooled_crosses_out_what_does_not_count():
    features, balls = np.array([[1.0, -2], [5, 4]]), np.array([[1, 0, 1], [-1, 0, -1]])
    figure = draw.pooled(features, balls, features, 10 * features)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["features of points", "points of balls", "maximum", "mean"]
    texts = [[t.get_text() for t in axes.texts] for axes in figure.axes]
    assert texts == [["1", "-2", "5", "4"], ["1", "0", "1", "-1", "0", "-1"],
                     ["1", "-2", "5", "4"], ["10", "-20", "50", "40"]]  # fmt: skip
    crossed = [line for line in figure.axes[1].lines if line.get_gid() == "skipped"]
    at = [tuple(line.get_xydata().mean(0).round(6).tolist()) for line in crossed]
    assert at == [(2, 0), (0, 1), (2, 1)]
    assert not any(axes.lines for axes in (figure.axes[0], *figure.axes[2:]))
    assert "2 balls of 3 places that hold 2, 1 different points" in figure.alt


def test_distances_are_drawn_over_degrees():
    angles = np.linspace(0, 2 * np.pi, 5)
    losses = {"one": np.array([0, 1, 2, 1, 0.5]), "other": np.array([0, 0.25, 0, 0.1, 0])}
    figure = draw.distances(angles, losses, "loss")
    one, other = figure.axes[0].lines
    assert one.get_xdata() == pytest.approx([0, 90, 180, 270, 360])
    assert other.get_ydata().tolist() == losses["other"].tolist()
    assert figure.axes[0].get_ylabel() == "loss"
    assert "one: 0.00 at 0°, at most 2.00 at 180°, 0.50 at 360°" in figure.alt


def test_votes_stand_around_true_places_and_answers():
    true = np.array([[0.0, 0, 1], [0.1, 0.05, 1]])
    votes = np.stack([true + 0.01, true - 0.01, true])
    figure = draw.votes(votes, true, {"mean": true + [0, 0.003, 0], "exact": true}, 0.02)
    (axes,) = figure.axes
    assert axes.lines[1].get_xdata() == pytest.approx([110, 90, 100])
    shown = {line.get_label(): line.get_xydata() for line in axes.lines}
    assert shown["true keypoint"] == pytest.approx(1000 * true[:, :2])
    assert shown["mean: 3.0 mm off"] == pytest.approx(1000 * true[:, :2] + [0, 3])
    assert axes.get_xlim() == pytest.approx((-20, 120))
    assert axes.get_ylim() == pytest.approx((70, -20))
    assert "3 votes for each of 2 keypoints" in figure.alt
    assert "mean 3.0 mm, exact 0.0 mm" in figure.alt


def test_bins_show_means_and_counts_up_to_the_last_one_in_use():
    true = np.radians([1.0, -2, 12])
    counts, means = np.array([2, 0, 1, 0]), np.radians([3, np.nan, 7, np.nan])
    figure = draw.bins(true + np.radians([2, -4, 7]), true, np.radians(5), counts, means,
                       np.radians(5))  # fmt: skip
    above, below = figure.axes
    assert above.lines[0].get_xydata() == pytest.approx(np.array([[1, 2], [2, 4], [12, 7]]))
    steps = np.array([step for step in above.collections[0].get_segments() if len(step)])
    assert steps[[0, -1]] == pytest.approx(np.array([[[0, 3], [5, 3]], [[10, 7], [15, 7]]]))
    assert [bar.get_height() for bar in below.patches] == [2, 0, 1]
    assert [text.get_text() for text in above.get_legend().get_texts()][2:] == [
        "BMAE 5.0°", "MAE 4.3°",
    ]  # fmt: skip
    assert "up to 15 degrees" in figure.alt and "1 of 3 bins are empty" in figure.alt
    assert "Mean error 4.3, mean of the bins 5.0 degrees" in figure.alt


def test_errors_stand_below_the_draws():
    edges = np.arange(-80, 81, 40)
    draws = {"alike": np.array([0, 0.5, 0.5, 0]), "other": np.array([0.25, 0.25, 0.25, 0.25])}
    figure = draw.errors_and_draws(edges, draws)
    (axes,) = figure.axes
    assert [patch.get_data().values.tolist() for patch in axes.patches] == [
        [0, 50, 50, 0], [25, 25, 25, 25],
    ]  # fmt: skip
    assert axes.get_xlabel() == "true yaw, degrees"
    assert "0% with alike, 50% with other" in figure.alt
    errors = {"alike": np.array([30, 2, 4, np.nan]), "other": np.array([9.0, 5, 5, 9])}
    figure = draw.errors_and_draws(edges, draws, errors)
    line = next(one for one in figure.axes[1].lines if one.get_label() == "other")
    assert line.get_xydata() == pytest.approx(np.array([[-60, 9], [-20, 5], [20, 5], [60, 9]]))
    assert "Error with alike: 3.0 degrees inside, 30.0 beyond." in figure.alt
    assert figure.axes[1].get_ylabel() == "mean error, degrees"
