"""Clouds of balls: where points are, on the thing too; which are symmetric; what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from data_tools.batches import load
from posecore.methods.invariant_gcn.seen_clouds import (
    masked_points,
    seen_clouds,
    spread_points,
)
from tests.methods.invariant_gcn.balls import RADIUS, Balls, stack


@pytest.fixture(scope="module")
def data():
    return stack()


def test_points_lie_on_the_thing(data):
    found = seen_clouds(data, 50)
    assert len(found) == 8 and found.categories == ("bottle", "laptop", "mug")
    assert found.category.tolist() == [0, 1, 2, 2] * 2
    radius = (found.points - found.t[:, None]).norm(dim=-1)
    torch.testing.assert_close(radius, torch.full_like(radius, RADIUS), rtol=0, atol=2e-4)
    back = (found.points - found.t[:, None]) @ found.R
    torch.testing.assert_close(found.canonical, back, rtol=0, atol=3e-4)
    for i in range(8):
        assert len(found.points[i].unique(dim=0)) == 50  # more pixels are seen


def test_of_noisy_depth_canonical_points_are_those_of_the_exact_surface():
    found = seen_clouds(stack(noise=0.004), 50)
    exact = found.canonical.norm(dim=-1)
    torch.testing.assert_close(exact, torch.full_like(exact, RADIUS), rtol=0, atol=2e-4)
    seen = (found.points - found.t[:, None]).norm(dim=-1)
    assert 0.001 < (seen - RADIUS).abs().mean() < 0.01


def test_symmetric_things_show_the_camera_their_front(data):
    found = seen_clouds(data, 20)
    assert found.revolution.tolist() == [True, False, False, False] * 2
    rows = data.R[found.row].float()
    other = ~found.revolution
    torch.testing.assert_close(found.R[other], rows[other])
    turned = found.R[found.revolution]
    torch.testing.assert_close(turned[:, :, 1], rows[found.revolution][:, :, 1])
    camera = -(turned.mT @ found.t[found.revolution][..., None])[..., 0]
    assert camera[:, 0].abs().max() < 1e-6 and (camera[:, 2] > 0).all()
    as_it_is = seen_clouds(data, 20, symmetric=())
    torch.testing.assert_close(as_it_is.R, rows)
    assert not as_it_is.revolution.any()


def test_a_mug_without_a_handle_in_sight_is_symmetric(data):
    """By the size of its view the first has half of the ball for a handle, the second nothing."""
    found = seen_clouds(data, 20)
    sees = [bool((found.canonical[i, :, 0] > 0.004).any()) for i in (2, 6)]
    assert found.symmetric.tolist() == [
        True, False, not sees[0], True, True, False, not sees[1], True,
    ]  # fmt: skip
    assert any(sees)


def test_a_prefix_is_spread_over_the_cloud(data):
    found = seen_clouds(data, 60)
    few = found.thinned(10)
    assert torch.equal(few.points, found.points[:, :10])
    assert torch.equal(few.canonical, found.canonical[:, :10])
    far = [
        torch.cdist(part, part).fill_diagonal_(1).min()
        for part in (few.points[0], found.points[0, -10:])
    ]
    assert far[0] > 2 * torch.cdist(found.points[0], found.points[0]).fill_diagonal_(1).min()
    middle = (found.points - found.points.mean(1, keepdim=True)).norm(dim=-1)
    assert (middle[:, 0] < middle.median(1).values).all()


def test_spreading_by_a_loop():
    points = torch.randn(3, 12, 3, generator=torch.Generator().manual_seed(0))
    found = spread_points(points, 5)
    for cloud, chosen in zip(points, found.tolist(), strict=True):
        assert chosen[0] == int((cloud - cloud.mean(0)).norm(dim=-1).argmin())
        for k in range(1, 5):
            far = torch.cdist(cloud, cloud[chosen[:k]]).amin(1)
            assert chosen[k] == int(far.argmax())


def test_what_is_of_something_else_is_left_out():
    depth = np.full((20, 20), 0.5, np.float32)
    depth[:, 15:], depth[0, 0] = 1.0, 0
    mask = np.ones((20, 20), bool)
    mask[10:] = False
    K, rng = np.diag([50.0, 50, 1]), np.random.default_rng(0)
    points, (rows, columns) = masked_points(depth, mask, K, 149, rng)
    assert (points[:, 2] == 0.5).all() and (rows < 10).all() and (columns < 15).all()
    assert len({*zip(rows.tolist(), columns.tolist(), strict=True)}) == 149  # all that there are
    both, _ = masked_points(depth, mask, K, 300, rng, reach=0.6)
    assert len(both) == 300 and set(both[:, 2].tolist()) == {0.5, 1.0}
    assert masked_points(depth, mask, K, 10, rng, least=150) is None
    assert masked_points(0 * depth, mask, K, 10, rng) is None
    assert masked_points(depth, ~mask & False, K, 10, rng) is None


def test_things_that_nobody_sees_have_no_cloud():
    holes = [None, np.s_[:, :], None]

    class Some(Balls):
        def __getitem__(self, index):
            self.hole = holes[index]
            return super().__getitem__(index)

    found = seen_clouds(load(Some(count=3), progress=False), 20)
    assert found.view.tolist() == [0, 2] == found.row.tolist()
    assert found.object_id.tolist() == [1, 3]
    with pytest.raises(ValueError, match="^data: expected an object of which something is seen"):
        seen_clouds(stack(count=2, hole=np.s_[:, :]), 20)


def test_some_of_the_clouds_and_mean_sizes(data):
    found = seen_clouds(data, 20)
    some = found.only(found.category == 2)
    assert len(some) == 4 and torch.equal(some.points, found.points[found.category == 2])
    torch.testing.assert_close(found.mean_size()[0], torch.tensor([0.2, 0.12, 0.25]))
    torch.testing.assert_close(found.mean_size()[2], torch.tensor([0.2, 0.12, 0.175]))
    torch.testing.assert_close(some.mean_size()[0], some.mean_size()[2])  # of all
    with pytest.raises(ValueError, match="^chosen: expected one cloud or more"):
        found.only(found.category == 9)
    with pytest.raises(ValueError, match="^count: expected an integer between 1 and 20"):
        found.thinned(21)


def test_the_same_seed_gives_the_same(data):
    one, same, other = (seen_clouds(data, 20, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(one.points, same.points)
    assert not torch.equal(one.points, other.points)
    part = seen_clouds(data, 20, rows=torch.tensor([4, 1]))
    assert part.row.tolist() == [4, 1]


def test_data_that_lack_something():
    bare = SimpleNamespace(kinds=("depth",), categories=None, object_size=None)
    with pytest.raises(ValueError, match="^data: expected images of instance"):
        seen_clouds(bare, 20)
    bare.kinds = ("depth", "instance")
    with pytest.raises(ValueError, match="^data: expected objects with category and size"):
        seen_clouds(bare, 20)
    depth, mask = np.ones((4, 4), np.float32), np.ones((4, 5), bool)
    with pytest.raises(ValueError, match=r"^mask: expected shape \(4, 4\)"):
        masked_points(depth, mask, np.eye(3), 3, np.random.default_rng(0))
