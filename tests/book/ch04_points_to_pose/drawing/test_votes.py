"""Chapter 4's figures of votes show what they are given, and say what they show."""

import numpy as np
import pytest
import torch

from book.ch04_points_to_pose.drawing import votes

RNG = np.random.default_rng(0)
SEEDS = RNG.normal(0, 0.1, (5, 3))
VOTES = torch.from_numpy(RNG.normal(0, 0.1, (5, 4, 3)))


def test_keypoints_are_numbered_in_both_views():
    chosen = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.2], [0.05, 0, 0.1]])
    figure = votes.keypoints({"head": SEEDS, "glasses": VOTES[0]}, chosen)
    front, side = figure.axes
    assert [text.get_text() for text in side.texts] == ["0", "1", "2", "3"]
    drawn = np.asarray(side.collections[4].get_offsets())  # of z and y
    np.testing.assert_allclose(drawn, 100 * chosen[:-1][:, [2, 1]])
    assert "4 keypoints" in figure.alt and "head and glasses" in figure.alt
    assert front.yaxis_inverted() and side.yaxis_inverted()
    # 0 and 1 are at the same place from the side: their numbers stand apart.
    assert side.texts[0].get_ha() != side.texts[1].get_ha()


def test_an_arrow_leads_from_start_to_tip():
    starts, tips = np.zeros((2, 3)), np.array([[0.3, 0, 0], [0, 0, 0]])
    segments = votes.arrows(starts, tips, head=0.01)
    assert segments.shape == (3, 2, 3)  # the arrow without a length has none
    np.testing.assert_allclose(segments[0], [[0, 0, 0], [0.3, 0, 0]])
    np.testing.assert_allclose(segments[1:, 0], [[0.3, 0, 0]] * 2)
    np.testing.assert_allclose(segments[1:, 1, 0], 0.29)
    np.testing.assert_allclose(segments[1, 1] + segments[2, 1], [0.58, 0, 0], atol=1e-12)
    assert len(votes.arrows(SEEDS[:, None], VOTES)) == 3 * 5 * 4


def test_votes_of_the_keypoints_asked_for_are_drawn():
    viewer = votes.vote_arrows(SEEDS, SEEDS, VOTES, VOTES.mean(0), which=(0, 2), most=3)
    parts = {part["label"]: part for part in viewer.payload()["parts"]}
    assert list(parts) == [
        "cloud", "seeds", "true keypoint", "votes for keypoint 0", "votes for keypoint 2",
    ]  # fmt: skip
    assert "from 3 seeds" in viewer.alt and "keypoint 0, 2" in viewer.alt
    assert "true keypoint" not in votes.vote_arrows(SEEDS, SEEDS, VOTES).still.alt
    with pytest.raises(ValueError, match="which"):
        votes.vote_arrows(SEEDS, SEEDS, VOTES, which=(4,))
    with pytest.raises(ValueError, match="votes"):
        votes.vote_arrows(SEEDS, SEEDS[:2], VOTES)


def test_votes_are_spread_about_the_truth():
    truth = np.array([0.01, 0.0, 0.0])
    answers = {"mean": truth + [0, 0.03, 0], "robust mean": torch.from_numpy(truth)}
    figure = votes.spread(VOTES[:, 0], answers, truth)
    (axes,) = figure.axes
    drawn = np.asarray(axes.collections[0].get_offsets())
    np.testing.assert_allclose(drawn, 100 * (VOTES[:, 0].numpy() - truth)[:, :2])
    assert "mean 3.0 cm, robust mean 0.0 cm" in figure.alt


def test_both_signs_are_on_the_circle():
    angles = torch.linspace(0, 2 * np.pi, 49)
    losses = {"plain": 2 * (angles / 2).sin(), "sign-free": angles.sin().abs()}
    pulls = {"plain": (angles / 2).cos(), "sign-free": angles.cos()}
    figure = votes.double_cover(angles, losses, pulls)
    assert len(figure.axes) == 3 and len(figure.axes[2].lines) == 2 and figure.png()
    assert figure.axes[0].get_title() == "plain: where it pushes"
