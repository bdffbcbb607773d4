"""The car around the driver."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from data_tools.worlds.cabin import make_cabin, windows

SEEDS = st.integers(0, 2**32)


def test_seat_and_cabin_leave_room_for_the_driver():
    seat, cabin = make_cabin()
    assert make_cabin() == (seat, cabin)
    assert seat.vertices[2].min() > 0.15  # behind the eyes
    away = np.abs(cabin.vertices).max(0) > 0.15
    assert away.all()
    low, high = cabin.vertices.min(1), cabin.vertices.max(1)
    assert low[1] < -0.25 and high[1] > 0.9  # a roof above, doors below; y is down
    assert high[2] > 1.5  # z is backwards
    assert low[0] < -1 and 0.4 < high[0] < 0.6  # the driver sits left: x to the left


@given(seed=SEEDS, height=st.integers(1, 60), width=st.integers(1, 100), daylight=st.floats(0, 1))
def test_what_is_seen_through_the_windows(seed, height, width, daylight):
    view = windows(np.random.default_rng(seed), daylight, height, width)
    assert view.shape == (height, width)
    assert view.min() >= 0.006
    assert view.max() <= 0.43
    night = windows(np.random.default_rng(seed), 0.0, height, width)
    noon = windows(np.random.default_rng(seed), 1.0, height, width)
    np.testing.assert_allclose(view - night, daylight * (noon - night), atol=1e-12)
    assert np.ptp(night) == 0


@given(seed=SEEDS)
def test_the_sky_is_above_and_trees_stand_out_against_it(seed):
    view = windows(np.random.default_rng(seed), 1.0, 94, 160)
    assert view[:30].min() > 0.42
    assert view[70:].max() < 0.31
    heights = (view > 0.4).sum(0)
    assert np.ptp(heights) > 6  # the line between them is not straight
