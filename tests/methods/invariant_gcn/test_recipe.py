"""The recipe: what is made of its numbers, and a few steps of each kind."""

from dataclasses import replace
from itertools import product

import pytest
import torch

from posecore.methods.invariant_gcn.category_clouds import turned_clouds
from posecore.methods.invariant_gcn.invariants import LocalFeatures
from posecore.methods.invariant_gcn.network import BRANCHES, Cloud
from posecore.methods.invariant_gcn.poses import estimated_pose, predict_poses
from posecore.methods.invariant_gcn.recipe import NETS, RECIPES, ROADS_OF, flat_then_cosine
from posecore.rotations import random_rotations
from posecore.training import fit

TINY = RECIPES["tiny"]
SLOW = {"book": [], "tiny": [], "paper": [pytest.mark.slow]}


def test_the_papers_numbers():
    paper = RECIPES["paper"]
    assert (paper.points, paper.batch, paper.lr, paper.clip) == (512, 16, 1e-3, None)
    net = paper.new_net(torch.full((6, 3), 0.1))
    layers = net.backbone.layers
    assert [layer.outputs for layer in layers] == [128, 128, 256, 256, 512]
    assert {layer.supports for layer in layers} == {7}
    assert net.backbone.neighbours == 10 and net.backbone.f1 == LocalFeatures()
    loss = paper.new_loss().loss
    assert (loss.basic, loss.bb, loss.pc, loss.rotation, loss.translation, loss.size) == (
        8, 1, 1, 1, 1, 1,
    )  # fmt: skip
    assert (loss.a, loss.b, loss.unit) == (1 / 303.5, 13.7, 1)
    factors = [flat_then_cosine(done) for done in (0, 0.49, 0.5, 0.75, 1)]
    assert factors == pytest.approx([1, 1, 1, 0.5, 0])


def test_what_the_kinds_differ_in():
    nets = {kind: replace(TINY, kind=kind).new_net(torch.full((3, 3), 0.1)) for kind in NETS}
    assert {kind: net.branches for kind, net in nets.items()} == {
        "printed": BRANCHES, "a1": BRANCHES, "gpv": ("axes", "faces"), "nocs": ("canonical",),
        "invariant": ("canonical",),
    }  # fmt: skip
    assert nets["printed"].backbone.f1 is not None
    assert all(nets[kind].backbone.f1 is None for kind in ("a1", "gpv", "nocs"))
    assert nets["invariant"].backbone.form == "handed"
    weights = {kind: replace(TINY, kind=kind).new_loss().loss.pc for kind in NETS}
    assert weights == {"printed": 1, "a1": 1, "gpv": 0, "nocs": 1, "invariant": 1}
    assert ROADS_OF.keys() == NETS.keys()
    blind = replace(TINY, kind="invariant", net_options={"form": "oriented"})
    assert blind.new_net(torch.full((3, 3), 0.1)).backbone.form == "oriented"
    with pytest.raises(ValueError, match="^kind: expected one of 'printed'"):
        replace(TINY, kind="ours")


@pytest.mark.parametrize(
    ("scale", "kind"),
    [pytest.param(*case, marks=SLOW[case[0]]) for case in product(RECIPES, NETS)],
)
def test_a_step_at_every_scale(scale, kind, balls):
    recipe = replace(RECIPES[scale], kind=kind)
    clouds = recipe.prepared(balls.only(torch.arange(3)))
    net = recipe.new_net(balls.mean_size())
    (batch,) = recipe.batches(clouds, steps=1, batch=2)
    parts = recipe.new_loss()(net, batch)
    parts["loss"].backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
    found = predict_poses(net.eval(), clouds, ROADS_OF[kind])
    assert found.R.shape == (3, 3, 3) and found.found.dtype == torch.bool
    assert all(part.isfinite().all() for part in found)


def test_batches_are_as_many_and_as_large_as_it_says(balls):
    clouds = TINY.prepared(balls)
    found = list(replace(TINY, steps=3, batch=5).batches(clouds))
    assert [float(batch["done"]) for batch in found] == pytest.approx([0, 1 / 3, 2 / 3])
    assert all(batch["points"].shape == (5, 64, 3) for batch in found)
    (short,) = TINY.batches(clouds, steps=1, batch=2)
    (other,) = TINY.batches(clouds, steps=1, batch=2, seed=1)
    assert short["t"].shape == (2, 3) and not torch.equal(short["t"], other["t"])


def arms(balls):
    """Points on three arms of different length, in the poses of the balls: nothing symmetric."""
    g = torch.Generator().manual_seed(0)
    along = torch.rand(8, 512, generator=g)
    axis = torch.randint(3, (8, 512), generator=g)
    canonical = 0.01 * torch.randn(8, 512, 3, generator=g)
    length = torch.tensor([0.06, 0.12, 0.18])[axis]
    canonical.scatter_add_(2, axis[..., None], (along * length)[..., None])
    points = canonical @ balls.R.mT + balls.t[:, None]
    return replace(balls, points=points, canonical=canonical)


@pytest.mark.slow
def test_invariant_coordinates_are_learned_and_hold_for_any_rotation(balls):
    recipe = replace(TINY, kind="invariant", steps=120)
    clouds = recipe.prepared(arms(balls))
    net = recipe.new_net(balls.mean_size())
    history = fit(
        net, recipe.batches(clouds), recipe.new_loss(), steps=120, **recipe.fit, show=False
    )
    curve = history.losses["reconstruction"]
    assert sum(curve[-10:]) < 0.75 * sum(curve[:10])
    given = clouds.batch(torch.arange(8))
    Q = random_rotations(8, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        one, other = net(Cloud.of(given)), net(Cloud.of(turned_clouds(given, Q)))
    torch.testing.assert_close(other.canonical, one.canonical, rtol=0, atol=1e-4)
    found = estimated_pose(other, given["points"] @ Q.mT, "weighted")
    known = estimated_pose(one, given["points"], "weighted")
    torch.testing.assert_close(found.R, Q @ known.R, rtol=0, atol=1e-3)
