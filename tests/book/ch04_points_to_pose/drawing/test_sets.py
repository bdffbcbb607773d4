"""Chapter 4's figures of sets show what they are given, and say what they show."""

import numpy as np
import torch

from book.ch04_points_to_pose.drawing import sets

CLOUD = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.3]])
SURFACE = sets.Surface(CLOUD.repeat(3, 1) + 0.01, CLOUD[:0])


def offsets(axes, number):
    return np.asarray(axes.collections[number].get_offsets())


def test_what_does_not_change_is_called_flat():
    figure = sets.shuffles({"row": np.array([[0, 1], [0.5, 1.25]]), "max": np.ones((2, 2))})
    assert "row: they vary by up to 0.50" in figure.alt and "max: all flat" in figure.alt
    np.testing.assert_allclose(figure.axes[0].lines[1].get_ydata(), [1, 1.25])


def test_points_are_seen_from_the_front_in_centimetres():
    figure = sets.centres(CLOUD, {"one": [0], "two": torch.tensor([0, 3])}, SURFACE)
    first, second = figure.axes
    np.testing.assert_allclose(offsets(first, 0), 100 * SURFACE.head[:, :2], rtol=1e-6)
    np.testing.assert_allclose(offsets(first, 1), 100 * CLOUD[:, :2], rtol=1e-6)
    np.testing.assert_allclose(offsets(second, 2), [[0, 0], [10, 10]], rtol=1e-6)
    assert first.yaxis_inverted() and first.get_aspect() == 1


def test_the_worst_point_is_the_farthest_from_its_nearest_centre():
    figure = sets.centres(CLOUD, {"one": [0], "two": [0, 3]}, SURFACE)
    np.testing.assert_allclose(offsets(figure.axes[0], 3), [[10, 10]], rtol=1e-6)
    assert "one: 33.2 cm; two: 10.0 cm" in figure.alt


def test_a_ball_shows_what_is_kept_and_what_is_left_out():
    full = sets.Ball(0, [0, 1, 2], torch.tensor([0, 1]))
    short = sets.Ball(3, [3], [3, 3])
    figure = sets.balls(CLOUD, {"full": full, "short": short}, 0.12, SURFACE)
    assert "full: 3 points, 2 kept; short: 1 points, 1 kept" in figure.alt and figure.png()
    np.testing.assert_allclose(offsets(figure.axes[0], 2), [[0, 10]], rtol=1e-6)
    np.testing.assert_allclose(offsets(figure.axes[0], 3), [[0, 0], [10, 0]], rtol=1e-6)
    assert figure.axes[0].patches[0].radius == 12
    assert len(figure.axes[1].collections) == len(figure.axes[0].collections) - 1


def test_seeds_colour_what_they_know_of():
    knows = torch.tensor([True, False, True, False])
    seeds = {"SA1": (CLOUD[0], knows), "none": (CLOUD[1], ~knows & knows)}
    figure = sets.seen_by(CLOUD, seeds, SURFACE)
    assert "SA1: 50%, none: 0%" in figure.alt
    np.testing.assert_allclose(offsets(figure.axes[0], 2), [[0, 0], [0, 10]], rtol=1e-6)
    assert len(figure.axes[1].collections) == 3


def test_shares_are_written_beside_those_who_lend():
    figure = sets.lent(CLOUD[0], CLOUD[1:], [0, 1, 2], torch.tensor([0.5, 0.3, 0.2]), SURFACE)
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["0.50", "0.30", "0.20"]
    assert len(axes.lines) == 3 and "0.50, 0.30, 0.20" in figure.alt
