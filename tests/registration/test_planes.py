"""Planes against their points, brute force and finite differences; points that leave them open."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.registration import fit_plane
from posecore.rotations import random_rotations

SEEDS = st.integers(0, 2**32 - 1)


@given(seed=SEEDS, count=st.integers(3, 20), offset=st.sampled_from([0.0, 1.0, 100.0]))
def test_points_on_a_plane_give_it_back(seed, count, offset):
    rng = np.random.default_rng(seed)
    R = random_rotations(generator=rng)
    points = np.c_[rng.normal(size=(count, 2)), np.full(count, offset)] @ R.T
    found = fit_plane(points, rng.uniform(0.1, 1, count), toward=R[:, 2])
    np.testing.assert_allclose(found.normal, R[:, 2], atol=1e-6)
    np.testing.assert_allclose(found.offset, offset, atol=1e-5)
    other = fit_plane(points, toward=-R[:, 2])
    np.testing.assert_allclose([*other.normal, other.offset], -np.r_[R[:, 2], offset], atol=1e-5)
    assert fit_plane(points).offset >= 0


def test_no_other_plane_is_nearer(rng):
    points, weights = rng.normal(size=(9, 3)) * [1, 2, 0.4], rng.uniform(size=9)

    def cost(normal, offset):
        return (weights * np.square(points @ normal - offset)).sum()

    normal, offset = fit_plane(points, weights)
    least = cost(normal, offset)
    for _ in range(200):
        other = normal + 0.1 * rng.normal(size=3)
        assert cost(other / np.linalg.norm(other), offset + 0.1 * rng.normal()) > least
    # A plane through the z axis, which is no z = a x + b y + c.
    points[:, 0] = 0.3
    np.testing.assert_allclose(np.abs(fit_plane(points).normal), [1, 0, 0], atol=1e-9)


def test_what_weighs_nothing_counts_for_nothing(rng):
    points = np.c_[rng.normal(size=(6, 2)), np.ones(6)]
    points[3:] = rng.normal(size=(3, 3))
    weights = np.array([1.0, 2, 3, 0, 0, 0])
    normal, offset = fit_plane(points, weights)
    np.testing.assert_allclose([*normal, offset], [0, 0, 1, 1], atol=1e-9)


def test_gradients_by_differences(rng):
    points = torch.from_numpy(rng.normal(size=(2, 7, 3)) * [1, 2, 0.5]).requires_grad_()
    weights = torch.from_numpy(rng.uniform(0.2, 1, (2, 7))).requires_grad_()
    toward = torch.from_numpy(rng.normal(size=(2, 3)))
    assert torch.autograd.gradcheck(lambda p, w: fit_plane(p, w, toward), (points, weights))


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((4, 3)),  # in one place
        np.outer(np.arange(4), [1.0, 2, 3]),  # on a line
        np.concatenate([np.eye(3), -np.eye(3)]),  # as wide in all directions
    ],
)
def test_points_that_leave_it_open(points):
    points = torch.from_numpy(points).requires_grad_()
    normal, offset = fit_plane(points)
    torch.testing.assert_close(normal.norm(), torch.tensor(1.0).double())
    (normal.sum() + offset).backward()
    assert points.grad.isfinite().all()
    assert float((points.detach() @ normal.detach() - offset.detach()).square().sum()) < 2.01


def test_two_of_equal_width_do_not_matter():
    """PyTorch's own derivative of eigenvectors is no number here."""
    points = torch.tensor([[1.0, 0, 0.1], [-1, 0, 0.1], [0, 1, -0.1], [0, -1, -0.1]]).double()
    points.requires_grad_()
    fit_plane(points).normal[0].backward()
    assert points.grad.isfinite().all() and points.grad.any()


def test_what_cannot_be(rng):
    points = rng.normal(size=(4, 3))
    with pytest.raises(ValueError, match="^weights: expected none negative, got -1"):
        fit_plane(points, [1, 1, -1, 1])
    with pytest.raises(ValueError, match="^weights: expected some above 0"):
        fit_plane(points, np.zeros(4))
    with pytest.raises(ValueError, match="^points: expected points whose squares are finite"):
        fit_plane(1e200 * points)
