"""P2R and P2P: what they say, what it depends on, and a step of each at the paper's size."""

import pytest
import torch

from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.network import PointsToPose, PointsToRotation
from posecore.methods.points_to_pose.voting import robust_mean
from posecore.nets.pointnet2 import PointNorm, build_geometry
from posecore.randomness import seeded
from posecore.rotations import random_rotations
from tests.methods.points_to_pose.small import geometry, small


def shapes(said):
    return [None if value is None else tuple(value.shape) for value in said]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [PointsToRotation, PointsToPose])
def test_a_step_at_the_papers_size(kind):
    generator = torch.Generator().manual_seed(0)
    points = 0.1 * torch.randn(2, 2000, 3, generator=generator)
    R, t = random_rotations(2, generator=generator), torch.zeros(2, 3)
    with seeded(0):
        net = kind()
    said = net(build_geometry(points))
    if kind is PointsToRotation:
        assert shapes(said) == [(2, 4), None, None, None]
        sizes = [layer.weight.shape for layer in net.convolutions[::3]]
        assert sizes == [(256, 256), (256, 256), (4, 256)]
        assert [net.dense[0].weight.shape, net.dense[2].weight.shape] == [(512, 2048), (4, 512)]
    else:
        assert shapes(said) == [(2, 4), (2, 3), (2, 512, 9, 3), (2, 9, 3)]
    keypoints = torch.randn(9, 3, generator=generator)
    PoseLoss()(said, R, t, keypoints)["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())
    assert net.decode(said).shape == (2, 3, 3)


def test_variants_of_p2r():
    found = geometry()
    assert shapes(small(PointsToRotation, translation=True)(found))[:2] == [(3, 4), (3, 3)]
    assert small(PointsToRotation, representation="6d")(found).rotation.shape == (3, 6)
    pooled = small(PointsToRotation, pooling="max", widths=(8, 12), dense=7)
    assert pooled.dense[0].in_features == 12 and shapes(pooled(found))[0] == (3, 4)
    printed = small(PointsToRotation, activate_last=True)
    assert isinstance(printed.convolutions[-2], PointNorm)
    assert (printed.convolutions(torch.randn(3, 8, 10)) >= 0).all()
    assert (small(PointsToRotation).convolutions(torch.randn(3, 8, 10)) < 0).any()
    assert small(PointsToRotation, early_max=True, project_first=True)(found).rotation.shape


def test_a_cloud_that_is_moved():
    found = geometry()
    moved = found.at(found.points + torch.tensor([0.3, 0.1, -0.2]))
    blind, seeing = (small(PointsToRotation, places=p).eval() for p in (False, True))
    torch.testing.assert_close(blind(moved), blind(found), rtol=1e-4, atol=1e-5)
    assert not torch.allclose(seeing(moved).rotation, seeing(found).rotation, atol=1e-4)
    net = small(PointsToPose, keypoints=5).eval()
    shift = net(moved).votes - net(found).votes
    expected = torch.tensor([0.3, 0.1, -0.2]).expand_as(shift)
    torch.testing.assert_close(shift, expected, rtol=1e-4, atol=1e-5)


def test_the_order_of_seeds_counts_only_when_flattened():
    features = torch.randn(2, 8, 10)
    for pooling, same in (("flatten", False), ("max", True)):
        net = small(PointsToRotation, pooling=pooling).eval()
        answers = []
        for order in (torch.arange(8), torch.arange(8).flip(0)):
            x = net.convolutions(features[:, order])
            answers.append(net.dense(x.flatten(1) if pooling == "flatten" else x.amax(1)))
        assert torch.allclose(*answers, atol=1e-6) == same


def test_p2p_says_its_pose_from_its_keypoints():
    net, found = small(PointsToPose, keypoints=5, vote_features=0).eval(), geometry()
    said = net(found)
    assert shapes(said) == [(3, 4), (3, 3), (3, 8, 5, 3), (3, 5, 3)]
    torch.testing.assert_close(said.keypoints, robust_mean(said.votes))
    torch.testing.assert_close(said.rotation, net.rotation(10 * said.keypoints.flatten(1)))
    torch.testing.assert_close(said.t, 0.1 * net.translation(10 * said.keypoints.flatten(1)))
    mean = small(PointsToPose, keypoints=5, iterations=0).eval()(found)
    torch.testing.assert_close(mean.keypoints, said.votes.mean(1))
    net = small(PointsToPose, keypoints=5, vote_features=4)
    assert net.rotation[0].in_features == 5 * (3 + 4)
    assert shapes(net(found)) == shapes(said)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (PointsToRotation, "pooling", "mean"), (PointsToRotation, "widths", (4,)),
        (PointsToRotation, "widths", (4, 0)), (PointsToRotation, "dense", 0),
        (PointsToRotation, "representation", "lie"), (PointsToRotation, "unit", 0),
        (PointsToPose, "keypoints", 0), (PointsToPose, "vote_features", -1),
        (PointsToPose, "iterations", -1), (PointsToPose, "hidden", (0,)),
    ],
)  # fmt: skip
def test_what_cannot_be(kind, name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        small(kind, **{name: value})
