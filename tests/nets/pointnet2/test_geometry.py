"""What follows from coordinates alone: centres, balls, links, and what a turn leaves of them."""

import pytest
import torch

from posecore.clouds import ball_query, farthest_point_sampling, gather_points
from posecore.nets.pointnet2 import LAYERS, Abstraction, Geometry, build_geometry
from posecore.rotations import random_rotations
from tests.nets.pointnet2.clouds import SMALL, cloud, geometry


def test_levels_are_those_of_the_cloud_functions():
    points = cloud()
    found = geometry(points)
    places = found.coordinates()
    assert [tuple(p.shape) for p in places] == [(2, 60, 3), (2, 20, 3), (2, 10, 3), (2, 5, 3)]
    for i, (level, layer) in enumerate(zip(found.levels, SMALL, strict=True)):
        centres = farthest_point_sampling(places[i], layer.points)
        assert torch.equal(level.centres.long(), centres)
        assert torch.equal(places[i + 1], gather_points(places[i], centres))
        balls = ball_query(places[i], places[i + 1], layer.radius, layer.neighbours)
        assert torch.equal(level.balls.long(), balls)
        off = gather_points(places[i], level.balls) - places[i + 1][:, :, None]
        assert (off.norm(dim=-1) < layer.radius).all()


def test_links_weigh_the_three_nearest_by_inverse_distance():
    for power in (1.0, 2.0):
        found = geometry(power=power)
        fine, coarse = found.coordinates()[2:]
        (link,) = found.links
        distances, indices = torch.cdist(fine, coarse).sort(-1)
        new = distances[..., 0] > 1e-6  # the others are in both levels
        assert torch.equal(link.indices[new].long(), indices[new][:, :3])
        weights = distances[new][:, :3] ** -power
        expected = weights / weights.sum(-1, keepdim=True)
        torch.testing.assert_close(link.weights[new], expected)
        assert torch.equal(link.weights[~new][:, 0], torch.ones_like(link.weights[~new][:, 0]))


def test_a_turn_changes_coordinates_only():
    found = geometry()
    R = random_rotations(2, generator=torch.Generator().manual_seed(1)).double()
    turned = found.turned(R)
    again = geometry(found.points @ R.mT)
    for name, value in turned.tensors().items():
        torch.testing.assert_close(value, again.tensors()[name])
    one = found.turned(R[0])
    torch.testing.assert_close(one.points[0], turned.points[0])
    moved = found.at(found.points + 0.3)
    assert torch.equal(moved.levels[0].balls, found.levels[0].balls)
    torch.testing.assert_close(moved.coordinates()[2], found.coordinates()[2] + 0.3)


def test_some_of_the_clouds_and_all_tensors_by_name():
    found = geometry(cloud(4))
    some = found.select(torch.tensor([2, 0]))
    assert len(some) == 2
    alone = geometry(cloud(4)[[2, 0]])
    for name, value in some.to("cpu").tensors().items():
        assert torch.equal(value, alone.tensors()[name])
    named = found.tensors()
    others = {"R": torch.eye(3), "levels.of": torch.zeros(1), "link.0": torch.zeros(1)}
    whole = Geometry.of({**named, **others})
    assert whole.tensors().keys() == named.keys()
    assert all(whole.tensors()[name] is value for name, value in named.items())
    with pytest.raises(ValueError, match=r"^tensors: expected 'level1\.balls'"):
        Geometry.of({name: value for name, value in named.items() if name != "level1.balls"})
    with pytest.raises(ValueError, match="^tensors: expected 'points'"):
        Geometry.of({})


@pytest.mark.parametrize("shape", [(2, 19, 3), (60, 3), (2, 60, 4)])
def test_clouds_that_cannot_be(shape):
    with pytest.raises(ValueError, match=r"^points: expected shape \(B, N, 3\) with N of at least"):
        build_geometry(torch.zeros(shape), SMALL, 1)


def test_numbers_that_cannot_be():
    with pytest.raises(ValueError, match="^propagations: expected"):
        geometry(propagations=3)
    with pytest.raises(ValueError, match="^power: expected"):
        geometry(power=0)
    with pytest.raises(ValueError, match="^points: expected shape"):
        geometry().at(cloud(points=59))
    with pytest.raises(ValueError, match="^points: expected a tensor of floating"):
        geometry(cloud().long())
    with pytest.raises(ValueError, match="^points: expected finite"):
        geometry().at(torch.full_like(cloud(), torch.nan))
    with pytest.raises(ValueError, match="^R: expected finite"):
        geometry().turned(torch.full((3, 3), torch.nan))
    with pytest.raises(ValueError, match=r"^R: expected shape \(3, 3\)"):
        geometry().turned(torch.eye(3)[None].expand(3, 3, 3))
    for layer, name in (
        ((61, 0.1, 2, (3,)), "points"), ((5, 0, 2, (3,)), "radius"),
        ((5, 1, 0, (3,)), "neighbours"), ((5, 1, 2, ()), "widths"), ((5, 1, 2, (3, 0)), "widths"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=rf"^layers\[1\]\.{name}: expected"):
            build_geometry(cloud(), [Abstraction(20, 0.1, 12, (6,)), layer], 0)
    with pytest.raises(ValueError, match="^layers: expected at least one"):
        build_geometry(cloud(), (), 0)


def test_table_1():
    assert [layer.points for layer in LAYERS] == [1024, 512, 256, 128]
    assert [layer.radius for layer in LAYERS] == [0.02, 0.04, 0.08, 1.0]
    assert [layer.widths for layer in LAYERS] == [(64, 64, 128), *[(128, 128, 256)] * 3]
