import numpy as np
import pytest

from data_tools.shapes import Material
from data_tools.shapes.faces import Proportions, ears, eyes, face, head_shape, lips
from data_tools.textures import infrared

ONES = dict.fromkeys(("width", "height", "depth", "jaw", "nose", "chin", "cheeks"), 1.0)
FLESH = Material((0.6, 0.4, 0.3))


def size(**changes):
    p = Proportions(**{**ONES, **changes})
    return face(head_shape(p), p, FLESH).vertices


def test_an_average_head_has_the_size_of_one():
    """Mean adult: 15 cm wide, 20 cm deep, 23 cm from crown to chin (DIN 33402-2)."""
    width, height, depth = np.ptp(size(), axis=0)
    assert width == pytest.approx(0.153, abs=0.006)
    assert height == pytest.approx(0.23, abs=0.012)
    assert depth == pytest.approx(0.205, abs=0.015)  # with the nose


@pytest.mark.parametrize(
    ("name", "axis", "least"),
    [("width", 0, 0.01), ("height", 1, 0.02), ("depth", 2, 0.01)],
)
def test_each_measure_grows_with_its_factor(name, axis, least):
    small, large = (np.ptp(size(**{name: f}), axis=0) for f in (0.92, 1.08))
    change = large - small
    assert change[axis] > least
    assert change.argmax() == axis


def test_noses_jaws_chins_and_cheeks_show():
    small, large = size(nose=0.7), size(nose=1.35)
    assert large[:, 2].max() - small[:, 2].max() > 0.003
    for name, low, high in (("jaw", 0.82, 1.14), ("chin", 0.8, 1.2), ("cheeks", 0.7, 1.3)):
        gap = np.linalg.norm(size(**{name: low}) - size(**{name: high}), axis=1)
        assert gap.max() > 0.001


def test_heads_are_left_right_symmetric():
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (200, 3))
    shape = head_shape(Proportions(**ONES))
    mirrored = shape(points * [-1, 1, 1])
    np.testing.assert_allclose(shape(points), mirrored, atol=1.5e-3)  # blends depend on order


def test_features_lie_on_the_surface():
    p = Proportions(**ONES)
    shape = head_shape(p)
    rng = np.random.default_rng(0)
    for parts in (eyes(FLESH, rng), lips(p, FLESH, 0.0), ears(p, FLESH)):
        for part in parts:
            value = shape(part.vertices)
            assert value.min() < 0 < value.max()  # neither sunk nor floating
    for part in eyes(FLESH, rng)[::3]:
        assert abs(abs(part.vertices[:, 0].mean()) - 0.0315) < 1e-9  # 63 mm apart
    assert lips(p, FLESH, 0.01)[0].vertices[:, 2].max() == pytest.approx(
        lips(p, FLESH, 0.0)[0].vertices[:, 2].max() + 0.01
    )


@pytest.mark.parametrize("height", [0.92, 1.0, 1.08])
def test_brows_and_mouth_are_painted_where_they_belong(height):
    p = Proportions(**{**ONES, "height": height})
    flesh = Material((0.6, 0.4, 0.3), infrared=1.0, second_infrared=0.0)
    part = face(head_shape(p), p, flesh)
    points = np.array(
        [
            (0.031, 0.0225, -0.01),
            (-0.031, 0.0225, -0.01),
            (0.012, -0.0625 * height, -0.005),
            (0.045, -0.03, -0.02),  # a cheek
            (0.0, 0.06, -0.015),  # the forehead
            (0.0, -0.05 * height - 0.04, -0.02),  # the chin
        ]
    )
    bright = infrared(part.materials, np.zeros(6, int), points, np.zeros((6, 3)))
    assert (bright[:2] < 0.1).all() and bright[2] < 0.4
    assert (bright[3:] > 0.85).all()


def test_lips_follow_the_height_of_the_face():
    short, tall = (Proportions(**{**ONES, "height": h}) for h in (0.92, 1.08))
    assert (lips(short, FLESH, 0.0)[0].vertices - lips(tall, FLESH, 0.0)[0].vertices)[
        :, 1
    ].min() > 0.005
