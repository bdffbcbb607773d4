from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.batches import Augmentation

NAMES = [field.name for field in fields(Augmentation)]


@given(st.integers(0, 60), st.integers(0, 2**62))
def test_draws_keep_their_bounds(count, seed):
    augment = Augmentation()
    draws = augment.draw(count, seed)
    for value in vars(draws).values():
        assert len(value) == count
    assert (np.abs(draws.turn) <= augment.turn).all()
    assert (np.abs(draws.shift) <= augment.shift).all()
    assert ((draws.zoom >= 1 / augment.zoom) & (draws.zoom <= augment.zoom)).all()
    for value in (draws.brightness, draws.contrast, draws.gamma):
        assert (np.abs(np.log(value)) <= augment.light).all()
    for value in (draws.saturation, draws.gains):
        assert (np.abs(np.log(value)) <= augment.colour).all()
    for name in ("blur", "noise", "depth_noise"):
        value = getattr(draws, name)
        assert ((value >= 0) & (value <= getattr(augment, name))).all()
    again = augment.draw(count, seed)
    assert all(np.array_equal(getattr(again, n), v) for n, v in vars(draws).items())


@given(st.integers(2, 60), st.integers(0, 2**62))
def test_everybody_has_another_partner(count, seed):
    partner = Augmentation().draw(count, seed).partner
    assert sorted(partner) == list(range(count))
    assert (partner != np.arange(count)).all()


def test_one_image_has_no_partner():
    assert Augmentation().draw(1, 0).partner.tolist() == [0]


@pytest.mark.parametrize("name", [n for n in NAMES if n != "keep"])
def test_what_is_left_on_stays_as_it_was(name):
    kinds = {"light": {"brightness", "contrast", "gamma"}, "colour": {"saturation", "gains"}}
    changed = kinds.get(name, {name})
    a = vars(Augmentation().draw(40, 4))
    b = vars(Augmentation(**{name: float(name == "zoom")}).draw(40, 4))
    for key in a:
        assert np.array_equal(a[key], b[key]) == (key not in changed), key


def test_none_is_nothing():
    draws = Augmentation.none().draw(5, 0)
    for name in ("turn", "shift", "blur", "noise", "depth_noise"):
        assert not getattr(draws, name).any()
    for name in ("zoom", "brightness", "contrast", "gamma", "saturation", "gains"):
        assert (getattr(draws, name) == 1).all()
    assert not (draws.background | draws.occluder | draws.holes).any()


def test_shares():
    draws = Augmentation(background=0.2, occluder=0.9, holes=0.5).draw(4000, 0)
    for name, share in (("background", 0.2), ("occluder", 0.9), ("holes", 0.5)):
        assert abs(getattr(draws, name).mean() - share) < 0.03


BAD = [({name: -0.1}, name) for name in NAMES] + [
    ({"turn": 4}, "turn"),
    ({"zoom": 0.9}, "zoom"),
    ({"zoom": 100}, "zoom"),
    ({"background": 1.1}, "background"),
    ({"keep": np.nan}, "keep"),
    ({"blur": "much"}, "blur"),
]


@pytest.mark.parametrize("arguments, name", BAD)
def test_bad_input(arguments, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        Augmentation(**arguments)


@pytest.mark.parametrize(
    "count, seed, name", [(-1, 0, "count"), (2.5, 0, "count"), (2, -1, "seed")]
)
def test_bad_draws(count, seed, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        Augmentation().draw(count, seed)
