"""The backbone: Table 2's shapes, and the outputs of PointNet++ as it is usually written."""

import pytest
import torch

from posecore.nets.pointnet2 import LAYERS, PROPAGATIONS, PointNet2, build_geometry
from posecore.randomness import seeded
from posecore.rotations import random_rotations
from tests.bench import plain_pointnet2
from tests.nets.pointnet2.clouds import SMALL, cloud, geometry, network

TABLE_2 = {
    "SA1": (1024, 128), "SA2": (512, 256), "SA3": (256, 256), "SA4": (128, 256),
    "FP1": (256, 256), "FP2": (512, 256),
}  # fmt: skip


def head(count=1):
    around = torch.randn(count, 2000, 3, generator=torch.Generator().manual_seed(0))
    around = around / around.norm(dim=-1, keepdim=True) * torch.tensor([0.08, 0.12, 0.1])
    return torch.cat([around[..., :2], -around[..., 2:].abs()], -1)


def exact(a, b):
    return (a[:, :, None] - b[:, None]).square().sum(-1)


@pytest.mark.slow
def test_the_papers_size(monkeypatch):
    """Table 2, and outputs and gradients of a plain PointNet++ with the same weights."""
    monkeypatch.setattr(plain_pointnet2, "squared_distances", exact)  # the same balls
    points = head()
    with seeded(0):
        net = PointNet2()
    plain = plain_pointnet2.PlainPointNet2(LAYERS, PROPAGATIONS).copy_from(net)
    stages = net.stages(build_geometry(points))
    assert stages.keys() == TABLE_2.keys()
    for name, (count, channels) in TABLE_2.items():
        assert stages[name].points.shape == (1, count, 3)
        assert stages[name].features.shape == (1, count, channels)
    assert (net.seeds, net.channels) == (512, 256)
    places, features = plain(points)
    features = features.transpose(1, 2)
    assert torch.equal(stages["FP2"].points, places)
    torch.testing.assert_close(stages["FP2"].features, features, rtol=1e-4, atol=1e-4)
    stages["FP2"].features.square().mean().backward()
    features.square().mean().backward()
    last, other = net.propagations[1].mlp[3].weight, plain.propagations[1].convs[1].weight
    torch.testing.assert_close(last.grad, other.grad[..., 0], rtol=1e-3, atol=1e-5)
    assert all(p.grad.isfinite().all() and p.grad.any() for p in net.parameters())


@pytest.mark.parametrize("training", [True, False])
def test_small_as_a_plain_one(training, monkeypatch):
    monkeypatch.setattr(plain_pointnet2, "squared_distances", exact)
    points = cloud(3)
    net = network(dtype=torch.float64)
    plain = plain_pointnet2.PlainPointNet2(SMALL, ((8,),)).double().copy_from(net)
    net.train(training), plain.train(training)
    net(geometry(points)).features.sum().backward()
    seen = net(geometry(points)).features
    plain(points)[1].sum().backward()
    torch.testing.assert_close(seen, plain(points)[1].transpose(1, 2), rtol=1e-6, atol=1e-6)
    first, other = net.abstractions[0].mlp[0].weight, plain.abstractions[0].convs[0].weight
    torch.testing.assert_close(first.grad, other.grad[..., 0, 0], rtol=1e-6, atol=1e-6)


def test_a_cloud_that_is_moved_and_one_that_is_turned():
    net, found = network().eval(), geometry()
    seen = net(found)
    moved = net(found.at(found.points + 0.5))
    torch.testing.assert_close(moved.features, seen.features)
    torch.testing.assert_close(moved.points, seen.points + 0.5)
    R = random_rotations(2, generator=torch.Generator().manual_seed(1)).double()
    turned = net(found.turned(R)).features
    torch.testing.assert_close(turned, net(geometry(found.points @ R.mT)).features)
    assert not torch.allclose(turned, seen.features)


def test_features_of_points_and_no_propagation():
    net = network(propagations=(), features=2)
    known = torch.rand(2, 60, 2).double()
    seeds = net(geometry(propagations=0), known)
    assert seeds.features.shape == (2, 5, 9) and (net.seeds, net.channels) == (5, 9)


def test_all_forms_have_the_same_weights():
    names = [
        list(network(**form).state_dict()) for form in ({}, {"fused": False}, {"early_max": True})
    ]
    assert names[0] == names[1] == names[2]


@pytest.mark.parametrize("fused", [True, False])
def test_no_clouds(fused):
    found = geometry()
    seeds = network(fused=fused)(found.select(torch.tensor([], dtype=torch.long)))
    assert len(seeds.features) == len(seeds.points) == 0


def test_features_that_are_no_numbers_do_not_reach_the_norms():
    net = network(propagations=(), features=2)
    with pytest.raises(ValueError, match="^features: expected finite"):
        net(geometry(propagations=0), torch.full((2, 60, 2), torch.nan).double())
    assert all(value.isfinite().all() for value in net.buffers())


def test_what_cannot_be():
    net = network()
    with pytest.raises(ValueError, match="^geometry: expected levels of"):
        net(geometry(layers=SMALL[:2]))
    with pytest.raises(ValueError, match="^geometry: expected 1 links"):
        net(geometry(propagations=2))
    with pytest.raises(ValueError, match="^propagations: expected fewer than 3"):
        PointNet2(SMALL, [(8,)] * 3)
