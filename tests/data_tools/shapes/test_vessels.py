import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.shapes.vessels import SECTIONS, bottle, bowl, can, mug

seeds = st.integers(0, 2**32 - 1)


@settings(deadline=None, max_examples=10)
@given(seeds)
@pytest.mark.parametrize("build", [bottle, bowl, can])
def test_solids_of_revolution(build, seed):
    (part,) = build(np.random.default_rng(seed))
    step = 2 * np.pi / SECTIONS
    turn = np.array([[np.cos(step), -np.sin(step)], [np.sin(step), np.cos(step)]])
    key = np.round(part.vertices * 1e9).astype(np.int64)
    turned = part.vertices.copy()
    turned[:, :2] = turned[:, :2] @ turn.T
    turned = np.round(turned * 1e9).astype(np.int64)
    order, other = (np.lexsort((k // 10).T) for k in (key, turned))
    assert np.abs(np.sort(key[:, 2]) - np.sort(turned[:, 2])).max() == 0
    assert len(order) == len(other)
    radius = np.hypot(*part.vertices[:, :2].T)
    for height in np.unique(part.vertices[:, 2]):
        level = radius[part.vertices[:, 2] == height]
        counts = np.unique(np.round(level, 9), return_counts=True)[1]
        assert ((counts % SECTIONS == 0) | (counts == 1)).all()  # whole rings, or a pole
    assert part.vertices[:, 2].min() >= 0


@settings(deadline=None, max_examples=25)
@given(seeds)
@pytest.mark.parametrize("build", [bowl, mug])
def test_open_vessels_are_hollow(build, seed):
    """On the axis there is the bottom alone, well under the rim."""
    body = build(np.random.default_rng(seed))[0]
    height = body.vertices[:, 2].max()
    poles = body.vertices[np.hypot(*body.vertices[:, :2].T) < 1e-9][:, 2]
    assert len(poles) == 2
    floor = poles.max()
    assert 0.001 < floor - poles.min()
    assert floor < 0.5 * height


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_handles_stay_out_of_mugs_and_hold_on_to_them(seed):
    body, handle = mug(np.random.default_rng(seed))
    assert handle.vertices[:, 0].min() > 0
    np.testing.assert_allclose(handle.vertices[:, 1].min(), -handle.vertices[:, 1].max())
    rows = body.vertices[np.abs(np.arctan2(body.vertices[:, 1], body.vertices[:, 0])) < 1e-6]
    outer = rows[rows[:, 0] > 0.01]
    for ring in handle.vertices[:220].reshape(22, 10, 3)[[0, -1]]:  # both ends, in the wall
        middle = ring.mean(0)
        near = outer[np.abs(outer[:, 2] - middle[2]) < 0.008][:, 0]
        assert near.min() - 0.0025 < middle[0] < near.max() + 0.0005
    for point in handle.vertices:
        near = outer[np.abs(outer[:, 2] - point[2]) < 0.008][:, 0]
        assert np.hypot(*point[:2]) > near.min() - 0.0015


def test_cans_of_three_kinds():
    slender = [np.ptp(can(np.random.default_rng(k))[0].vertices, axis=0) for k in range(40)]
    ratio = np.array([size[2] / size[0] for size in slender])
    assert (ratio < 0.8).any() and (ratio > 1.5).any() and ((ratio > 0.8) & (ratio < 1.5)).any()
