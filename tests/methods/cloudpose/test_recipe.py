"""The recipe: what is made of its numbers."""

from dataclasses import replace

import pytest
import torch

from posecore.methods.cloudpose.network import POINTS
from posecore.methods.cloudpose.recipe import RECIPES, CloudPoseLoss
from posecore.methods.points_to_pose.centred_clouds import predict_poses
from posecore.methods.points_to_pose.pose_clouds import PoseClouds
from posecore.rotations import random_rotations
from posecore.training import fit
from posecore.training.loop import ADAM


def clouds(count, points):
    """One cloud, turned and moved."""
    generator = torch.Generator().manual_seed(0)
    own = 0.1 * torch.randn(points, 3, generator=generator) * torch.tensor([1, 0.5, 2.0])
    R = random_rotations(count, generator=generator).float()
    t = torch.rand(count, 3, generator=generator)
    number = torch.arange(count)
    return PoseClouds(own @ R.mT + t[:, None], None, R, t, number, number, number)


def test_the_originals_numbers():
    paper = RECIPES["paper"]
    assert paper.points == POINTS and paper.optimiser is ADAM and paper.turn == 0
    assert paper.net == {
        "widths": (64, 64, 64, 128, 1024), "dense": (512, 256), "unit": 1.0,
    }  # fmt: skip
    assert paper.new_loss() == CloudPoseLoss(10.0)


@pytest.mark.parametrize("scale", RECIPES)
def test_a_step_at_every_scale(scale):
    recipe = RECIPES[scale]
    some = recipe.prepared(clouds(3, recipe.points))
    net = recipe.new_net()
    (batch,) = recipe.batches(some, steps=1, batch=2)
    assert batch.keys() == {"R", "t", "points", "done"}
    parts = recipe.new_loss()(net, batch)
    assert parts.keys() == {"loss", "rotation", "translation"}
    parts["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())
    R, t = predict_poses(net.eval(), some)
    assert R.shape == (3, 3, 3) and t.shape == (3, 3)


def test_what_cannot_be():
    with pytest.raises(ValueError, match="^kind: expected"):
        replace(RECIPES["tiny"], kind="p2p")


def test_first_weights_follow_from_the_seed():
    one, same, other = (list(RECIPES["tiny"].new_net(s).parameters()) for s in (0, 0, 1))
    assert all(map(torch.equal, one, same)) and not all(map(torch.equal, one, other))


def test_it_learns_where_a_cloud_is():
    recipe = RECIPES["tiny"]
    some, net = recipe.prepared(clouds(20, 64)), recipe.new_net()
    history = fit(net, recipe.batches(some), recipe.new_loss(), steps=40, show=False, **recipe.fit)
    values = history.losses["translation"]
    assert sum(values[-5:]) < 0.5 * sum(values[:5])
