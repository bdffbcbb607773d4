"""Neighbours, coarser clouds and the way back, against loops; copies of points; turned clouds."""

import pytest
import torch

from posecore.nets.graph3d import (
    Graph,
    build_graph,
    feature_neighbours,
    other_neighbours,
)
from posecore.rotations import random_rotations
from tests.nets.graph3d.clouds import cloud, graph


def nearest_others(points, i, k):
    """By index where equally near: one point after the other."""
    distances = (points - points[i]).square().sum(-1).tolist()
    order = sorted(range(len(points)), key=lambda j: (distances[j], j))
    return [j for j in order if j != i][:k]


def test_neighbours_one_point_after_the_other():
    points = cloud()
    found = other_neighbours(points, 6)
    for b in range(2):
        assert found[b].tolist() == [nearest_others(points[b], i, 6) for i in range(40)]


def test_of_copies_each_has_the_others_and_never_itself():
    points = cloud(1, 12)
    points[0, 3:10] = points[0, 2]  # more copies than neighbours
    found = other_neighbours(points, 4)[0]
    assert found.tolist() == [nearest_others(points[0], i, 4) for i in range(12)]
    assert not (found == torch.arange(12)[:, None]).any()
    assert found[9].tolist() == [2, 3, 4, 5]


def test_coarser_clouds_are_of_points_of_finer_ones():
    found = graph()
    clouds = found.clouds()
    assert [tuple(c.shape) for c in clouds] == [(2, 40, 3), (2, 12, 3), (2, 5, 3)]
    assert torch.equal(clouds[1][:, 0], found.points[:, 0])  # the first point is kept
    for b in range(2):
        for i, level in enumerate(found.coarser):
            fine, coarse = clouds[i][b], clouds[i + 1][b]
            assert torch.equal(coarse, fine[level.centres[b]])
            assert len(set(level.centres[b].tolist())) == len(coarse)
            k = level.neighbours.shape[-1]
            for m, centre in enumerate(level.centres[b].tolist()):
                assert level.pool[b, m].tolist() == nearest_others(fine, centre, 4)
                assert level.neighbours[b, m].tolist() == nearest_others(coarse, m, k)
            nearest = torch.cdist(found.points[b], coarse).argmin(-1)
            assert torch.equal(level.nearest[b].long(), nearest)


def test_a_random_choice_is_that_of_its_seed():
    one, same, other = (graph(choice="random", seed=seed) for seed in (3, 3, 4))
    assert torch.equal(one.coarser[1].centres, same.coarser[1].centres)
    assert not torch.equal(one.coarser[0].centres, other.coarser[0].centres)
    assert all(len(set(c.tolist())) == 12 for c in one.coarser[0].centres)
    assert not torch.equal(one.coarser[0].centres, graph().coarser[0].centres)


def test_neighbours_by_features():
    features = torch.randn(2, 30, 7, generator=torch.Generator().manual_seed(1)).double()
    found = feature_neighbours(features, 5)
    for b in range(2):
        assert found[b].tolist() == [nearest_others(features[b], i, 5) for i in range(30)]
    same = torch.zeros(1, 6, 2)
    assert not (feature_neighbours(same, 5)[0] == torch.arange(6)[:, None]).any()


def test_a_turn_changes_coordinates_only():
    found = graph()
    R = random_rotations(2, generator=torch.Generator().manual_seed(1)).double()
    turned, again = found.turned(R), graph(found.points @ R.mT)
    for name, value in turned.tensors().items():
        torch.testing.assert_close(value, again.tensors()[name])
    torch.testing.assert_close(found.turned(R[0]).points[0], turned.points[0])
    moved = found.at(2 * found.points + 0.3)
    torch.testing.assert_close(moved.clouds()[2], 2 * found.clouds()[2] + 0.3)
    assert torch.equal(moved.neighbours, found.neighbours)
    normals = torch.randn(2, 40, 3).double()
    assert torch.equal(found.clouds(normals)[1], normals[[[0], [1]], found.coarser[0].centres])


def test_some_of_the_clouds_and_all_tensors_by_name():
    found = graph(cloud(4))
    some, alone = found.select(torch.tensor([2, 0])), graph(cloud(4)[[2, 0]])
    assert (len(found), len(some)) == (4, 2)
    for name, value in some.to("cpu").tensors().items():
        assert torch.equal(value, alone.tensors()[name])
    named = found.tensors()
    whole = Graph.of({**named, "R": torch.eye(3)})
    assert whole.tensors().keys() == named.keys()
    assert all(whole.tensors()[name] is value for name, value in named.items())
    with pytest.raises(ValueError, match=r"^tensors: expected 'coarser1\.pool'"):
        Graph.of({name: value for name, value in named.items() if name != "coarser1.pool"})
    with pytest.raises(ValueError, match="^tensors: expected 'points'"):
        Graph.of({})


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("points: expected a tensor of floating", {"points": cloud().long()}),
        ("points: expected shape", {"points": cloud()[0]}),
        ("sizes.1.: expected an integer between 1 and 12", {"sizes": (12, 13)}),
        ("neighbours of 5 points: expected .* between 1 and 4", {"neighbours": (8, 4, 5)}),
        ("neighbours: expected one number, or one for each of 3", {"neighbours": (8, 4)}),
        ("pool of 12 points", {"pool": 12}),
        ("choice: expected", {"choice": "first"}),
        ("seed: expected", {"seed": -1}),
    ],
)
def test_what_cannot_be(words, options):
    with pytest.raises(ValueError, match=f"^{words}"):
        graph(**options)


def test_clouds_that_cannot_be():
    with pytest.raises(ValueError, match="^points: expected shape"):
        graph().at(cloud(points=39))
    with pytest.raises(ValueError, match="^points: expected finite"):
        graph().at(torch.full_like(cloud(), torch.nan))
    with pytest.raises(ValueError, match="^R: expected shape"):
        graph().turned(torch.eye(3)[None].expand(3, 3, 3))
    with pytest.raises(ValueError, match="^k: expected"):
        other_neighbours(cloud(), 40)
    with pytest.raises(ValueError, match="^k: expected"):
        feature_neighbours(cloud(), 40)
    with pytest.raises(ValueError, match="^points: expected finite"):
        build_graph(torch.full((1, 40, 3), torch.nan), (12,), 3)
