"""Chapter 3's figures of volumes show what they are given."""

import numpy as np

from book.ch03_infrared_to_clouds.drawing import splats


def test_the_shares_of_eight_corners_are_written():
    volume = np.zeros((3, 3, 4))
    volume[0:2, 1:3, 1:3] = 0.125
    figure = splats.eight_corners(volume, (1.5, 1.5, 0.5))
    assert [len(axes.texts) for axes in figure.axes] == [4, 4]
    assert {text.get_text() for axes in figure.axes for text in axes.texts} <= {"0.12", "0.13"}


def test_ray_reach_and_pulled():
    occupancy = np.array([0, 0.5, 0, 0.5])
    left = np.array([1, 1, 0.5, 0.5])
    figure = splats.ray(occupancy, left, occupancy * left)
    assert len(figure.axes[0].lines) == 3 and "0.50 of it" in figure.alt
    far = np.linspace(0, 3, 4)
    assert splats.reach({"a": (far, 1 - far / 3), "b": (far, far)}).png()
    stages = {"step 1": np.zeros((5, 2)), "step 9": np.ones((5, 2))}
    figure = splats.pulled(stages, np.eye(6))
    assert np.array_equal(figure.axes[1].collections[0].get_offsets(), np.ones((5, 2)))


def test_a_cloud_is_turned_from_panel_to_panel():
    points = np.array([[0.1, 0, 0], [0, 0.05, -0.1], [0, 0, 0.1]])
    figure = splats.turning({"step 1": points, "step 2": points, "step 3": points}, most=3)
    offsets = [np.asarray(axes.collections[0].get_offsets()) for axes in figure.axes]
    # The farthest is drawn first: seen from the front, the third.
    np.testing.assert_allclose(offsets[0], [[0, 0], [10, 0], [0, 5]], atol=1e-9)
    np.testing.assert_allclose(sorted(offsets[2][:, 0]), [-10, 0, 10], atol=1e-9)
    assert [axes.get_title() for axes in figure.axes] == ["step 1", "step 2", "step 3"]
    empty = splats.turning({"step 1": points}, most=3)
    assert [len(axes.collections) for axes in empty.axes] == [1, 0, 0]
