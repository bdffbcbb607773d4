import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer import Ambient, Light


@given(st.floats(0, 10), st.lists(st.floats(-5, 5), min_size=3, max_size=3))
def test_numbers_become_arrays(power, position):
    light = Light(position, power)
    assert light.position.tolist() == position and light.position.dtype == np.float64
    assert light.power.tolist() == [power] * 3
    assert Ambient(above=power, below=(0, power, 1)).below.tolist() == [0, power, 1]


def test_up_is_a_unit_vector():
    assert Ambient(up=(0, 3, 4)).up == pytest.approx([0, 0.6, 0.8])
    assert Ambient().up.tolist() == [0, -1, 0]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: Light((0, 0)), "position"),
        (lambda: Light((0, 0, np.nan)), "position"),
        (lambda: Light("lamp"), "position"),
        (lambda: Light((0, 0, 0), -1), "power"),
        (lambda: Light((0, 0, 0), (1, 2)), "power"),
        (lambda: Light((0, 0, 0), np.inf), "power"),
        (lambda: Light((0, 0, 0), radius=-1), "radius"),
        (lambda: Light((0, 0, 0), beam=-1), "beam"),
        (lambda: Light((0, 0, 0), shadows="soft"), "shadows"),
        (lambda: Ambient(above=-1), "above"),
        (lambda: Ambient(below=(1, 2)), "below"),
        (lambda: Ambient(up=(0, 0, 0)), "up"),
        (lambda: Ambient(up=(0, 1)), "up"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        call()
