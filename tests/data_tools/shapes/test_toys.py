import numpy as np
import pytest

from data_tools.shapes.toys import car, cat, drill, duck


def part_of(parts, colour_test):
    """Vertices of the parts whose colour passes a test."""
    return np.vstack([p.vertices for p in parts if colour_test(*p.materials[0].colour)])


@pytest.mark.parametrize("build", [duck, cat])
def test_faces_look_forward(build):
    """Eyes and beak or muzzle lie at the front, -y, and in the upper half, left like right."""
    parts = build()
    body = parts[0].vertices
    eyes = part_of(parts, lambda r, g, b: max(r, g, b) < 0.02)
    assert eyes[:, 1].max() < body[:, 1].mean()
    assert eyes[:, 2].min() > np.median(body[:, 2])
    np.testing.assert_allclose(eyes[:, 0].min(), -eyes[:, 0].max(), atol=1e-9)


def test_the_cat_and_the_duck_stand_flat():
    for build in (cat, duck):
        body = build()[0].vertices
        floor = body[body[:, 2] < body[:, 2].min() + 0.003]
        assert np.ptp(floor, axis=0)[:2].min() > 0.04


def test_the_tail_of_the_cat_is_on_its_left_side():
    tail = cat()[1].vertices
    assert tail[:, 0].max() > 0.06 and tail[:, 0].min() > -0.01


def test_wheels_touch_the_ground_and_stand_at_four_corners():
    parts = car()
    wheels = [p.vertices for p in parts if any(m.pattern == "noise" for m in p.materials)]
    assert len(wheels) == 4
    for wheel in wheels:
        assert abs(wheel[:, 2].min()) < 0.0005
        assert np.ptp(wheel[:, 0]) == pytest.approx(0.034, abs=5e-4)
        assert np.ptp(wheel[:, 1]) < 0.015
    centres = np.array([wheel.mean(0)[:2] for wheel in wheels])
    assert len(np.unique(np.sign(centres), axis=0)) == 4
    outer = [np.abs(wheel[:, 1]).max() for wheel in wheels]
    np.testing.assert_allclose(outer, outer[0])
    everything = np.vstack([p.vertices for p in parts])
    assert abs(everything[:, 2].min()) < 0.0005


def test_the_drill_points_forward_and_stands_on_its_battery():
    parts = drill()
    motor, grip = parts[0].vertices, parts[1].vertices
    everything = np.vstack([p.vertices for p in parts])
    tip = everything[everything[:, 0].argmin()]
    np.testing.assert_allclose(tip[1:], [0, motor[:, 2].mean()], atol=2e-3)
    assert motor[:, 2].min() > grip[:, 2].min()
    battery = parts[3].vertices
    assert battery[:, 2].min() == everything[:, 2].min()
    middle = everything[:, 0].mean()
    assert battery[:, 0].min() < middle < battery[:, 0].max()
