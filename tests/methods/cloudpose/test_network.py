"""CloudPose: its sizes, what its answers depend on, and its loss by hand."""

import math

import pytest
import torch

from posecore.methods.cloudpose.network import (
    POINTS,
    BaseNet,
    CloudPose,
    CloudPoseOutput,
    cloudpose_loss,
)
from posecore.randomness import seeded
from posecore.rotations import axis_angle_to_matrix, random_rotations


def small(**options):
    with seeded(0):
        return CloudPose((6, 8), (7,), **options)


CLOUDS = torch.randn(3, 20, 3, generator=torch.Generator().manual_seed(0))


def test_a_step_at_the_papers_size():
    generator = torch.Generator().manual_seed(0)
    with seeded(0):
        net = CloudPose()
    for base in (net.rotation, net.translation):
        layers = [*base.each[::3], *base.whole[::3], base.last]
        sizes = [layer.out_features for layer in layers]
        assert sizes == [64, 64, 64, 128, 1024, 512, 256, 3]
    said = net(torch.randn(4, POINTS, 3, generator=generator))
    R, t = random_rotations(4, generator=generator).float(), torch.zeros(4, 3)
    cloudpose_loss(said, R, t)["loss"].backward()
    assert said.R.shape == (4, 3, 3) and said.t.shape == (4, 3)
    assert all(p.grad.isfinite().all() for p in net.parameters())


def test_order_and_place_of_the_points():
    net = small().eval()
    said = net(CLOUDS)
    torch.testing.assert_close(net(CLOUDS.flip(1)), said)
    moved = net(CLOUDS + torch.tensor([1.0, -2, 0.5]))
    torch.testing.assert_close(moved.axis_angle, said.axis_angle, rtol=1e-4, atol=1e-5)
    expected = said.t + torch.tensor([1.0, -2, 0.5])
    torch.testing.assert_close(moved.t, expected, rtol=1e-4, atol=1e-5)


def test_the_translation_is_relative_to_the_mean():
    net = small().eval()
    mean = CLOUDS.mean(1)
    expected = mean + net.translation(CLOUDS - mean[:, None])
    torch.testing.assert_close(net(CLOUDS).t, expected)
    scaled = small(unit=0.5).eval()(CLOUDS)
    expected = mean + 0.5 * net.translation((CLOUDS - mean[:, None]) / 0.5)
    torch.testing.assert_close(scaled.t, expected)


def test_two_networks_that_share_nothing():
    net = small()
    (gradient,) = torch.autograd.grad(
        net(CLOUDS).axis_angle.sum(), [net.translation.last.weight], allow_unused=True
    )
    assert gradient is None


def test_the_loss_by_hand():
    turn = torch.tensor([[0.0, 0.5, 0], [0.1, 0, 0]]).double()
    true = torch.tensor([[0.0, 0.2, 0], [0, 0, 0]]).double()
    said = CloudPoseOutput(turn, torch.tensor([[0.0, 0.03, 0.04], [0, 0, 0]]).double())
    parts = cloudpose_loss(said, axis_angle_to_matrix(true), torch.zeros(2, 3).double())
    expected = {"rotation": 0.2, "translation": 0.025, "loss": 0.45}
    assert {k: v.item() for k, v in parts.items()} == pytest.approx(expected)
    whole = cloudpose_loss(
        CloudPoseOutput(torch.tensor([[0.0, 0, math.pi]]), torch.zeros(1, 3)),
        torch.eye(3)[None], torch.zeros(1, 3), weight=0,
    )  # fmt: skip
    assert whole["loss"].item() == pytest.approx(math.pi)


def test_what_cannot_be():
    for shape in ((3, 0, 3), (20, 3), (3, 20, 2)):
        with pytest.raises(ValueError, match=r"^points: expected shape \(B, N, 3\)"):
            small()(torch.zeros(shape))
    with pytest.raises(ValueError, match="^unit: expected"):
        small(unit=0)
    with pytest.raises(ValueError, match="^widths and dense: expected"):
        BaseNet(())
    said = CloudPoseOutput(torch.zeros(2, 3), torch.zeros(2, 3))
    with pytest.raises(ValueError, match="^t: expected"):
        cloudpose_loss(said, torch.eye(3).expand(2, 3, 3), torch.zeros(3, 3))
    with pytest.raises(ValueError, match="^weight: expected"):
        cloudpose_loss(said, torch.eye(3).expand(2, 3, 3), torch.zeros(2, 3), -1)
