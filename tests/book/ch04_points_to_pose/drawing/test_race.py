import pytest
import torch

from book.ch04_points_to_pose.drawing import race
from posecore.methods.points_to_pose.evaluation import AngleBin

BINS = [AngleBin(0.0, 90, 2.0), AngleBin(5.0, 20, 3.0), AngleBin(40.0, 1, 9.0)]


def test_errors_stand_over_the_number_of_views():
    other = [one._replace(error=1.5 * one.error) for one in BINS]
    upper, lower = race.by_angle({"P2P": BINS, "P2R": other}).axes
    assert [len(line.get_xdata()) for line in upper.get_lines()] == [3, 3]
    assert upper.get_lines()[0].get_xdata().tolist() == [2.5, 7.5, 42.5]
    assert [bar.get_height() for bar in lower.patches] == [90, 20, 1]
    assert lower.get_yscale() == "log"


def test_methods_must_have_the_same_bins():
    with pytest.raises(ValueError, match="methods"):
        race.by_angle({"P2P": BINS, "P2R": BINS[:2]})
    with pytest.raises(ValueError, match="methods"):
        race.by_angle({})


def test_likely_classes_are_large():
    classes = torch.linspace(-70, 70, 8).expand(3, 8)
    shares = (-((classes - 25) / 10).square()).softmax(-1)
    axes = race.random_bins(classes, shares, 25.0, 24.0).axes[0]
    sizes = axes.collections[0].get_sizes()
    assert sizes.argmax() == 5 and len(axes.collections) == 3
    with pytest.raises(ValueError, match="probabilities"):
        race.random_bins(classes, shares[:2], 25.0, 24.0)
