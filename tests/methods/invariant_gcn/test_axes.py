"""Two axes made a rotation: by hand, sharing the turn, and where they say nothing."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.methods.invariant_gcn.axes import rotation_from_axes
from posecore.rotations import random_rotations

SEEDS = st.integers(0, 10**6)


def angle(a, b):
    return math.acos(max(-1.0, min(1.0, a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


@given(seed=SEEDS)
def test_axes_of_a_rotation_are_that_rotation(seed):
    rng = np.random.default_rng(seed)
    R = random_rotations(generator=rng)
    x, y = R[:, 0] * rng.uniform(0.1, 5), R[:, 1] * rng.uniform(0.1, 5)
    found = rotation_from_axes(x, y, rng.uniform(0, 1), rng.uniform(0, 1))
    np.testing.assert_allclose(found, R, atol=1e-9)


@given(seed=SEEDS, c_x=st.floats(0, 1), c_y=st.floats(0.01, 1))
def test_the_turn_is_shared_by_confidence(seed, c_x, c_y):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 3))
    R = rotation_from_axes(x, y, c_x, c_y)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) > 0
    # Both stay in their plane, and each goes its share of the way.
    normal = np.cross(x, y)
    np.testing.assert_allclose(R[:, :2].T @ normal, 0, atol=1e-9)
    needed = abs(math.pi / 2 - angle(x, y))
    assert angle(R[:, 0], x) == pytest.approx(needed * c_y / (c_x + c_y), abs=1e-6)
    assert angle(R[:, 1], y) == pytest.approx(needed * c_x / (c_x + c_y), abs=1e-6)


def test_alike_without_confidences_or_where_both_are_none():
    x, y = np.random.default_rng(0).normal(size=(2, 3))
    even = rotation_from_axes(x, y)
    np.testing.assert_allclose(rotation_from_axes(x, y, 0.0, 0.0), even)
    np.testing.assert_allclose(rotation_from_axes(x, y, 0.3, 0.3), even)
    assert angle(even[:, 0], x) == pytest.approx(angle(even[:, 1], y))


@pytest.mark.parametrize(
    ("x", "y"),
    [([0, 0, 0], [1, 2, 3]), ([1, 2, 3], [0, 0, 0]), ([0, 0, 0], [0, 0, 0]),
     ([1, 2, 3], [2, 4, 6]), ([1, 2, 3], [-1, -2, -3])],
)  # fmt: skip
def test_axes_that_say_nothing(x, y):
    x, y = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (x, y))
    R = rotation_from_axes(x, y)
    torch.testing.assert_close(R.T @ R, torch.eye(3).double())
    for axis, column in ((x, R[:, 0]), (y, R[:, 1])):
        if axis.any() and not (x.any() and y.any()):  # the only one is kept
            torch.testing.assert_close(column, axis / axis.norm())
    (R * torch.arange(9.0).view(3, 3)).sum().backward()
    assert x.grad.isfinite().all() and y.grad.isfinite().all()


def test_gradients_by_differences():
    generator = torch.Generator().manual_seed(0)
    x, y = torch.randn(2, 4, 3, generator=generator, dtype=torch.float64).unbind()
    c = torch.rand(2, 4, generator=generator, dtype=torch.float64)
    inputs = [value.requires_grad_() for value in (x, y, *c.unbind())]
    assert torch.autograd.gradcheck(rotation_from_axes, inputs)


def test_negative_confidences():
    with pytest.raises(ValueError, match="^y_confidence: expected none negative"):
        rotation_from_axes([1, 0, 0], [0, 1, 0], 0.5, -0.1)
