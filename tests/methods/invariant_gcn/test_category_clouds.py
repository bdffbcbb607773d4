"""Prepared clouds: centred, varied with all that belongs to them."""

import math
from functools import partial

import pytest
import torch

from posecore.methods.invariant_gcn.category_clouds import (
    TURNS,
    CategoryClouds,
    Variation,
    normals_and_view,
    turned_clouds,
)
from posecore.methods.invariant_gcn.seen_clouds import seen_clouds
from posecore.nets.graph3d import build_graph
from posecore.rotations import geodesic_distance, random_rotations
from tests.methods.invariant_gcn.balls import stack

BUILD = partial(build_graph, sizes=(12, 5), neighbours=4)


@pytest.fixture(scope="module")
def clouds():
    return CategoryClouds(seen_clouds(stack(), 40), BUILD)


def drawn(clouds, seed=0, count=6, **vary):
    generator = torch.Generator().manual_seed(seed)
    return clouds.draw(count, generator=generator, vary=Variation(**vary))


def close(one, other, atol=1e-5):
    torch.testing.assert_close(one, other, rtol=0, atol=atol)


def check_consistent(batch, atol=1e-3):
    """Points are where pose and canonical points say."""
    place = batch["canonical"] @ batch["R"].mT + batch["t"][:, None]
    close(batch["points"], place, atol)


def test_clouds_about_their_means(clouds):
    assert len(clouds) == 8
    close(clouds.graph.points.mean(1), torch.zeros(8, 3))
    close(clouds.graph.points + clouds.centre[:, None], clouds.seen.points)
    close(clouds.t + clouds.centre, clouds.seen.t)
    everyone = clouds.batch(torch.arange(8))
    check_consistent(everyone)
    normals, view = normals_and_view(clouds.seen.points)
    assert torch.equal(everyone["normals"], normals) and torch.equal(everyone["view"], view)
    close(view, -torch.nn.functional.normalize(clouds.centre, dim=-1))
    toward = -(clouds.seen.points * normals).sum(-1)
    assert (toward > -1e-6).all()
    built = BUILD(clouds.graph.points)
    for name, value in built.tensors().items():
        assert torch.equal(value, everyone[name])


@pytest.mark.parametrize("about", TURNS)
def test_turned_with_all_that_belongs_to_it(clouds, about):
    before = drawn(clouds)
    after = drawn(clouds, turn=20, about=about)
    check_consistent(after)
    Q = after["R"] @ before["R"].mT
    angles = geodesic_distance(after["R"], before["R"])
    if about == "all":
        assert angles.max() > 1
    else:
        assert 0.01 < angles.max() <= math.radians(20) + 1e-4
    for name in ("points", "normals"):
        close(after[name], before[name] @ Q.mT)
    close(after["view"], (Q @ before["view"][..., None])[..., 0])
    if about == "roll":
        close(after["view"], before["view"])
    for name in ("size", "canonical", "category", "symmetric", "neighbours"):
        assert torch.equal(after[name], before[name])


def test_rolls_go_to_both_sides(clouds):
    before, after = drawn(clouds, count=40), drawn(clouds, count=40, turn=90, about="roll")
    Q = after["R"] @ before["R"].mT
    axial = torch.stack([Q[:, 2, 1] - Q[:, 1, 2], Q[:, 0, 2] - Q[:, 2, 0],
                         Q[:, 1, 0] - Q[:, 0, 1]], -1)  # fmt: skip
    sides = (axial * before["view"]).sum(-1)
    assert 8 < (sides > 0).sum() < 32


def test_scaled_with_its_thing(clouds):
    before, after = drawn(clouds), drawn(clouds, scale=0.2)
    check_consistent(after)
    factor = after["size"] / before["size"]
    close(factor, factor[:, :1].expand(-1, 3))
    assert factor.min() > 0.8 and factor.max() < 1.2 and factor.std() > 0.02
    close(after["points"], factor[:, :1, None] * before["points"])


def test_noise_on_points_alone(clouds):
    before, after = drawn(clouds, count=40), drawn(clouds, count=40, noise=0.002)
    off = after["points"] - before["points"]
    assert abs(float(off.std()) / 0.002 - 1) < 0.1
    assert torch.equal(after["canonical"], before["canonical"])


def test_all_at_once_and_again(clouds):
    vary = {"turn": 30, "scale": 0.1, "noise": 0.001}
    one, same, other = (drawn(clouds, seed, **vary) for seed in (1, 1, 2))
    check_consistent(one, 6e-3)
    for name, value in one.items():
        assert torch.equal(value, same[name])
    assert not torch.equal(one["points"], other["points"])
    plain = clouds.draw(3, generator=torch.Generator().manual_seed(0))
    check_consistent(plain)


def test_some_of_the_clouds(clouds):
    chosen = clouds.seen.category == 2
    rows = chosen.nonzero()[:, 0]
    everyone = clouds.batch(rows)
    for some in (clouds.only(chosen), clouds.only(rows)):
        assert len(some) == 4
        for name, value in some.batch(torch.arange(4)).items():
            assert torch.equal(value, everyone[name])
    cloud = clouds.clouds(rows)
    assert torch.equal(cloud.category, everyone["category"])
    assert torch.equal(cloud.graph.points, everyone["points"])


@pytest.mark.parametrize(
    ("name", "value"), [("turn", 181), ("about", "x"), ("scale", 1), ("noise", -1)]
)
def test_variations_that_cannot_be(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        Variation(**{name: value})


def test_what_cannot_be(clouds):
    with pytest.raises(ValueError, match="^count: expected"):
        drawn(clouds, count=0)
    with pytest.raises(ValueError, match=r"^Q: expected shape \(6, 3, 3\)"):
        turned_clouds(drawn(clouds), random_rotations(generator=torch.Generator()))
    with pytest.raises(ValueError, match="^neighbours of 40 points"):
        CategoryClouds(clouds.seen, partial(build_graph, sizes=(12, 5), neighbours=40))
