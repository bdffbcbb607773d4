"""Fitted cameras are those that were right."""

from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.camera_fits import camera_fits, half_words, usual_sizes
from tests.data_tools.checking.made import changed, median


def shift(x, y):
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])


@pytest.mark.parametrize(
    ("K", "key"),
    [
        (shift(-7, 4), "shifted images"),
        (shift(0.5, 0.5), "half a pixel"),
        (np.diag([2.0, 2, 1]), "wrong image size"),
        (shift(12, -9) @ np.diag([1.5, 1.5, 1]), "cut and resized images"),
    ],
)
def test_cameras(sample, K, key):
    instances = list(changed(sample, K=K))
    found = [c for c in camera_fits(instances) if c.key == key]
    assert max(median(instances, one) for one in found) > 0.93


def test_focal_lengths(sample):
    instances = [replace(i, K=i.K @ np.diag([1.3, 1.3, 1])) for i in sample.instances]
    found = [c for c in camera_fits(instances) if c.key == "wrong focal length" and c.vary]
    tuned = [found[0].vary(f) for f in np.linspace(0.95, 1.05, 21)]
    assert max(median(instances, one) for one in tuned) > 0.95


def test_other_sizes_are_whole_fractions(sample):
    assert len(usual_sizes()) == 10
    instances = list(changed(sample, K=np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]])))
    assert max(median(instances, one) for one in usual_sizes()) > 0.97


def test_half_pixels_in_words():
    assert "too large: they count" in half_words(np.array([-0.5, -0.5]))
    assert half_words(np.array([0.5, 0.5])) == "cx and cy are half a pixel too small"
