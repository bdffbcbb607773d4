"""Chapter 03's figures show the numbers that they are given, and say what they show."""

import numpy as np

from book.ch03_infrared_to_clouds.drawing import figures


def test_distances():
    z_gt, z_est = np.array([0.5, 1.0, 1.5]), np.array([0.6, 1.0, 1.48])
    figure = figures.distances(z_gt, z_est)
    (axes,) = figure.axes
    assert np.array_equal(axes.lines[1].get_xydata(), np.c_[z_gt, z_est])
    assert axes.get_xlabel().endswith(", m") and axes.get_ylabel().endswith(", m")
    assert "less than 20 mm" in figure.alt and figure.png()
