"""Keypoints, votes brought together, and a pose from them."""

import pytest
import torch

from data_tools.shapes.glasses import GLASSES, make_glasses
from data_tools.shapes.heads import make_subject
from posecore.methods.points_to_pose.voting import fused_keypoints, keypoint_pose, robust_mean
from posecore.rotations import random_rotations


@pytest.mark.slow
def test_keypoints_are_spread_over_head_and_glasses():
    keypoints = fused_keypoints()
    meshes = make_subject(0).head, make_glasses(GLASSES[0])
    points = torch.cat([torch.from_numpy(mesh.vertices) for mesh in meshes]).float()
    assert keypoints.shape == (9, 3)
    assert torch.cdist(keypoints[:8], points).amin(1).max() < 1e-6
    middle = (points.amin(0) + points.amax(0)) / 2
    torch.testing.assert_close(keypoints[8], middle)
    apart = torch.cdist(keypoints[:8], keypoints[:8]) + torch.eye(8)
    assert apart.min() > 0.08
    assert torch.equal(keypoints, fused_keypoints())
    assert fused_keypoints(4, GLASSES, subject=1).shape == (5, 3)


@pytest.mark.parametrize("glasses", [(), "classic", ("monocle",)])
def test_glasses_that_cannot_be(glasses):
    with pytest.raises(ValueError, match="^glasses: expected"):
        fused_keypoints(8, glasses)


def test_a_few_wrong_votes_count_little():
    generator = torch.Generator().manual_seed(0)
    true = torch.randn(2, 1, 4, 3, generator=generator)
    votes = true + 0.01 * torch.randn(2, 50, 4, 3, generator=generator)
    votes[:, :10] += 1
    robust, plain = robust_mean(votes, 3), robust_mean(votes, 0)
    torch.testing.assert_close(plain, votes.mean(1))
    assert (robust - true[:, 0]).norm(dim=-1).max() < 0.01
    assert (plain - true[:, 0]).norm(dim=-1).min() > 0.3


def test_the_robust_mean_by_hand():
    votes = torch.tensor([0.0, 1.0, 2.0, 10.0, 3.0])[None, :, None, None] * torch.eye(3)[0]
    # The median is 2, distances 2, 1, 0, 8, 1 of median 1.
    weights = torch.tensor([1 / 5, 1 / 2, 1, 1 / 65, 1 / 2])
    expected = (weights * torch.tensor([0.0, 1, 2, 10, 3])).sum() / weights.sum()
    torch.testing.assert_close(robust_mean(votes)[0, 0], expected * torch.eye(3)[0])


def test_gradients_go_to_all_votes_and_are_finite_where_all_agree():
    votes = torch.ones(1, 5, 2, 3)
    votes[:, 4] = 7
    votes.requires_grad_()
    found = robust_mean(votes, 2)
    assert torch.equal(found, torch.ones(1, 2, 3))
    (gradient,) = torch.autograd.grad(found.sum(), votes)
    assert gradient.isfinite().all() and (gradient[:, :4] > 0).all()


@pytest.mark.parametrize("shape", [(2, 0, 4, 3), (2, 5, 3), (2, 5, 4, 2)])
def test_votes_that_cannot_be(shape):
    with pytest.raises(ValueError, match=r"^votes: expected shape \(B, S, K, 3\)"):
        robust_mean(torch.zeros(shape))
    with pytest.raises(ValueError, match="^iterations: expected"):
        robust_mean(torch.zeros(1, 2, 3, 3), -1)


def test_a_pose_from_keypoints():
    generator = torch.Generator().manual_seed(0)
    model = torch.randn(9, 3, generator=generator)
    R, t = random_rotations(5, generator=generator).float(), torch.randn(5, 3, generator=generator)
    found_R, found_t = keypoint_pose(model @ R.mT + t[:, None], model)
    torch.testing.assert_close(found_R, R, rtol=0, atol=1e-5)
    torch.testing.assert_close(found_t, t, rtol=0, atol=1e-5)
