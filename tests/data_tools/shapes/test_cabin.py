import numpy as np

from data_tools.shapes import Material
from data_tools.shapes.cabin import PIVOT, make_seat, torso
from data_tools.shapes.glasses import MODELLED

FLESH = Material((0.6, 0.4, 0.3))


def parts(seed):
    return torso(FLESH, np.random.default_rng(seed))


def test_the_neck_rises_from_the_collar_to_the_pivot():
    pivot = MODELLED @ PIVOT
    for seed in range(8):
        neck, dome, body, collar = parts(seed)
        assert abs(neck.vertices[:, 1].max() - pivot[1]) < 0.01
        np.testing.assert_allclose(dome.vertices.mean(0), pivot, atol=1e-3)
        width = np.ptp(neck.vertices[np.abs(neck.vertices[:, 1] + 0.12) < 0.02], axis=0)[0]
        assert 0.09 < width < 0.14
        assert neck.vertices[:, 1].min() < body.vertices[:, 1].max()  # no gap over the shoulders
        low, high = collar.vertices[:, 1].min(), collar.vertices[:, 1].max()
        assert neck.vertices[:, 1].min() < high and low < body.vertices[:, 1].max()


def test_shoulders_and_clothes_vary():
    bodies = [parts(seed)[2] for seed in range(12)]
    widths = [np.ptp(body.vertices[:, 0]) for body in bodies]
    assert 0.4 < min(widths) and max(widths) < 0.65 and np.ptp(widths) > 0.04
    assert len({body.materials[0].colour for body in bodies}) > 3
    assert len({body.materials[0].pattern for body in bodies}) == 3
    assert np.ptp([body.materials[0].infrared for body in bodies]) > 0.2


def test_the_headrest_is_behind_the_head():
    seat = make_seat()
    rest = seat.vertices[(seat.vertices[:, 1] < 0.05) & (seat.vertices[:, 2] > 0.2)]
    assert rest[:, 1].min() < -0.05 and rest[:, 0].max() > 0.12
    assert 0.2 < rest[:, 2].min() < 0.26
    assert seat.bounds[1, 1] > 0.7  # and the backrest runs down
    np.testing.assert_allclose(seat.bounds[:, 0].sum(), 0, atol=0.01)
