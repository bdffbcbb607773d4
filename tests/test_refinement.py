"""Corrections, the loss of a pose, and poses that are made wrong."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.refinement import correct_pose, perturb, pose_loss

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(40, 3)) * [0.05, 0.03, 0.04]
CENTRE = np.array([0.01, -0.02, 0.005])
HALF_TURN = np.diag([-1.0, -1, 1])
EVEN = np.concatenate([POINTS, POINTS @ HALF_TURN])
seeds = st.integers(0, 2**31)


def pose(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.9])
    return Rotation.random(random_state=rng).as_matrix(), t


def some_poses(seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    R, t = zip(*(pose(seed + 1000 * i) for i in range(count)), strict=True)
    return torch.from_numpy(np.stack(R)), torch.from_numpy(np.stack(t))


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_corrections_are_about_the_centre(seed: int) -> None:
    R, t = pose(seed)
    turn, _ = pose(seed + 1)
    rng = np.random.default_rng(seed)
    centre, diameter, s = rng.normal(size=3) * 0.02, 0.17, rng.normal() * 0.3
    across = rng.normal(size=2) * 0.1

    def middle(R: np.ndarray, t: np.ndarray) -> np.ndarray:
        return R @ centre + t

    still = correct_pose(R, t, centre, diameter, np.eye(3), np.zeros(3))
    assert np.array_equal(still[0], R) and np.allclose(still[1], t, rtol=0, atol=1e-15)
    turned = correct_pose(R, t, centre, diameter, turn, np.zeros(3))
    assert np.allclose(turned[0], turn @ R, rtol=0, atol=1e-15)
    assert np.allclose(middle(*turned), middle(R, t), rtol=0, atol=1e-15)
    shifted = correct_pose(R, t, centre, diameter, turn, [*across, 0])
    step = np.array([*across, 0]) * diameter
    assert np.allclose(middle(*shifted) - middle(R, t), step, rtol=0, atol=1e-15)
    farther = correct_pose(R, t, centre, diameter, turn, [0, 0, s])
    assert np.allclose(middle(*farther), np.exp(s) * middle(R, t), rtol=1e-14, atol=0)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.2, 5), st.floats(0.3, 3))
def test_size_and_distance_do_not_change_the_correction(
    seed: int, size: float, distance: float
) -> None:
    """The same correction makes the same difference, relative to the object, in the picture."""
    R, t = pose(seed)
    turn = Rotation.from_rotvec(np.random.default_rng(seed).normal(size=3) * 0.1).as_matrix()
    shift = np.array([0.05, -0.02, 0.1])
    centre, zero = CENTRE, np.zeros(3)
    _, one = correct_pose(R, t, centre, 0.2, turn, shift)
    _, other = correct_pose(R, size * t, size * centre, size * 0.2, turn, shift)
    assert np.allclose(other, size * one, rtol=1e-13, atol=0)  # a larger one, as much farther
    for away in (1.0, distance):
        R_2, t_2 = correct_pose(R, away * t, zero, 0.2, turn, [0, 0, 0.1])
        assert np.allclose(t_2 / (away * t), np.exp(0.1), rtol=1e-14)
        assert np.allclose(R_2, turn @ R, rtol=0, atol=1e-15)


def test_derivatives_are_those_of_finite_differences() -> None:
    R, t = (torch.from_numpy(value) for value in pose(0))
    turn = torch.from_numpy(pose(1)[0]).requires_grad_()
    shift = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64, requires_grad=True)
    centre, diameter = torch.from_numpy(CENTRE), torch.tensor(0.2, dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda turn, shift: correct_pose(R, t, centre, diameter, turn, shift), (turn, shift)
    )


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_the_loss_is_the_metric_in_diameters(seed: int) -> None:
    (R, t), (R_gt, t_gt) = some_poses(seed, 4), some_poses(seed + 1, 4)
    points, diameter = torch.from_numpy(EVEN), torch.tensor([0.2, 0.1, 0.3, 0.2]).double()
    symmetric = torch.tensor([True, False, True, False])
    found = pose_loss(points, R, t, R_gt, t_gt, diameter, symmetric)
    pair = [metrics.add_s, metrics.add]
    for i in range(4):
        metric = pair[i % 2](R[i], t[i], R_gt[i], t_gt[i], points)
        assert torch.allclose(found[i], metric / diameter[i], rtol=1e-12)
    turned = R_gt @ torch.from_numpy(HALF_TURN)
    assert pose_loss(points, turned, t_gt, R_gt, t_gt, diameter, True).max() < 1e-12


@pytest.mark.parametrize("symmetric", [False, True])
def test_the_gradient_of_the_loss(symmetric: bool) -> None:
    points, diameter = torch.from_numpy(EVEN[::8]), torch.tensor(0.2).double()
    (R, t), (R_gt, t_gt) = some_poses(0, 2), some_poses(1, 2)
    t.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda t: pose_loss(points, R, t, R_gt, t_gt, diameter, symmetric), t
    )
    exact = t_gt.clone().requires_grad_()
    pose_loss(points, R_gt, exact, R_gt, t_gt, diameter, symmetric).sum().backward()
    assert torch.isfinite(exact.grad).all()


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_perturbed_poses_are_within_their_bounds(seed: int) -> None:
    R, t = some_poses(seed, 50)
    centre, diameter = torch.zeros(50, 3).double(), torch.full((50,), 0.2).double()
    generator = torch.Generator().manual_seed(seed)
    R_new, t_new = perturb(R, t, centre, diameter, generator, rotation=0.3)
    angle = torch.from_numpy(Rotation.from_matrix(R_new @ R.mT).magnitude())
    assert angle.max() <= 0.3 + 1e-9 and angle.max() > 0.05
    assert (t_new[:, 2] > 0).all()
    same = perturb(R, t, centre, diameter, generator, rotation=0, lateral=0, depth=0)
    assert torch.allclose(same[0], R, atol=1e-14) and torch.allclose(same[1], t, atol=1e-14)


def test_the_sizes_of_perturbations() -> None:
    R, t = some_poses(0, 1)
    R, t = R.expand(20000, 3, 3), torch.tensor([0, 0, 2.0]).double().expand(20000, 3)
    centre, diameter = torch.zeros(20000, 3).double(), torch.full((20000,), 0.2).double()
    _, moved = perturb(R, t, centre, diameter, torch.Generator().manual_seed(0))
    spread = (moved - t).std(0) / 0.2
    # A part drawn evenly has a mean square of one third.
    expected = torch.tensor([0.08, 0.08, 0.2]).double() / 3**0.5
    assert torch.allclose(spread, expected, rtol=0.03)
