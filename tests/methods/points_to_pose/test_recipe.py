"""The recipe: what is made of its numbers."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from posecore.methods.points_to_pose.centred_clouds import predict_poses
from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.recipe import NETS, RECIPES
from posecore.nets.pointnet2 import LAYERS, PROPAGATIONS
from posecore.rotations import geodesic_distance
from posecore.training import fit
from posecore.training.loop import ADAM

TINY = RECIPES["tiny"]


def test_the_papers_numbers():
    paper = RECIPES["paper"]
    assert paper.points == 2000 and paper.optimiser is ADAM and paper.turn == 0
    assert (paper.layers, paper.propagations) == (LAYERS, PROPAGATIONS)
    loss = paper.new_loss()
    assert loss.loss.weights == (0.2, 0.2, 0.6) and loss.keypoints.shape == (9, 3)
    assert replace(paper, kind="p2r").net["widths"] == (256, 256, 4)


@pytest.mark.parametrize("kind", NETS)
@pytest.mark.parametrize("scale", RECIPES)
def test_a_step_at_every_scale(scale, kind, seen):
    """Clouds of a few, of as many points as the scale has."""
    recipe = replace(RECIPES[scale], kind=kind)
    few = seen.only(torch.arange(2))
    index = torch.arange(recipe.points) % few.points.shape[1]
    noise = 0.002 * torch.randn(2, recipe.points, 3, generator=torch.Generator().manual_seed(0))
    clouds = recipe.prepared(replace(few, points=few.points[:, index] + noise, worn=None))
    net = recipe.new_net()
    (batch,) = recipe.batches(clouds, steps=1, batch=2)
    parts = recipe.new_loss()(net, batch)
    votes = {"votes"} if kind == "p2p" else set()
    assert parts.keys() == {"loss", "rotation", "translation"} | votes
    parts["loss"].backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
    R, t = predict_poses(net.eval(), clouds)
    assert R.shape == (2, 3, 3) and t.shape == (2, 3)


def test_batches_are_as_many_and_as_large_as_it_says(seen):
    clouds = TINY.prepared(seen)
    found = list(replace(TINY, steps=3, batch=5).batches(clouds))
    assert [float(batch["done"]) for batch in found] == pytest.approx([0, 1 / 3, 2 / 3])
    assert all(batch["points"].shape == (5, 64, 3) for batch in found)
    (short,) = TINY.batches(clouds, steps=1, batch=2)
    (other,) = TINY.batches(clouds, steps=1, batch=2, seed=1)
    assert short["t"].shape == (2, 3) and not torch.equal(short["t"], other["t"])


@pytest.mark.parametrize("kind", NETS)
def test_first_weights_follow_from_the_seed(kind):
    recipe, before = replace(TINY, kind=kind), torch.get_rng_state()
    one, same, other = (list(recipe.new_net(seed).parameters()) for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(map(torch.equal, one, same)) and not all(map(torch.equal, one, other))


def test_what_a_chapter_changes():
    recipe = replace(
        TINY, options={"places": True, "representation": "6d"},
        loss=partial(PoseLoss, representation="6d", squared=True),
    )  # fmt: skip
    net = recipe.new_net()
    assert net.places and net.head.size == 6 and recipe.new_loss().loss.squared
    with pytest.raises(ValueError, match="^kind: expected"):
        replace(TINY, kind="p2q")


@pytest.mark.slow
def test_it_learns(seen):
    """In a few seconds poses of clouds that it has seen are better than the first ones."""
    recipe = replace(TINY, steps=40)
    clouds, net = recipe.prepared(seen), recipe.new_net()
    net.eval()
    first = geodesic_distance(predict_poses(net, clouds)[0], seen.R).mean()
    fit(net, recipe.batches(clouds), recipe.new_loss(), steps=40, show=False, **recipe.fit)
    R, t = predict_poses(net, clouds)
    assert geodesic_distance(R, seen.R).mean() < 0.7 * first
    assert (t - seen.t).norm(dim=1).median() < 0.06
