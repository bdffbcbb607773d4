"""What each branch says and in which shape, what turns with a cloud and what does not."""

import pytest
import torch

from posecore.methods.invariant_gcn.category_clouds import turned_clouds
from posecore.methods.invariant_gcn.network import BRANCHES, Cloud, InvariantGCN
from posecore.methods.invariant_gcn.total_loss import TotalLoss
from posecore.nets.graph3d import build_graph
from posecore.randomness import seeded
from posecore.rotations import random_rotations
from tests.methods.invariant_gcn.small import MEAN_SIZE, SMALL, batch, network, say

SHAPES = {
    "axes": {
        "x": (3, 3), "y": (3, 3), "x_confidence": (3,), "y_confidence": (3,), "t": (3, 3),
        "size": (3, 3),
    },
    "canonical": {
        "canonical": (3, 40, 3), "canonical_confidence": (3, 40), "proportions": (3, 3),
    },
    "faces": {
        "face_normals": (3, 40, 6, 3), "face_distances": (3, 40, 6),
        "face_confidences": (3, 40, 6),
    },
}  # fmt: skip


@pytest.mark.parametrize("branch", [*BRANCHES, None])
def test_what_is_said(branch):
    branches = BRANCHES if branch is None else (branch,)
    said = say(network(branches=branches), batch())
    expected = {name: shape for b in branches for name, shape in SHAPES[b].items()}
    found = {k: tuple(v.shape) for k, v in said._asdict().items() if v is not None}
    assert found == expected
    if "faces" in branches:
        torch.testing.assert_close(said.face_normals.norm(dim=-1), torch.ones(3, 40, 6))
        assert (said.face_confidences > 0).all() and (said.face_confidences < 1).all()


def test_at_first_sizes_are_near_those_of_the_category():
    given = batch()
    said = say(network(), given)
    usual = torch.tensor(MEAN_SIZE)[given["category"]]
    assert (said.size - usual).abs().max() < 0.1
    assert (said.proportions - usual / usual.norm(dim=-1, keepdim=True)).abs().max() < 0.5
    other = say(network(), {**given, "category": 1 - given["category"]})
    assert not torch.allclose(other.canonical, said.canonical)


@pytest.mark.parametrize("context", [0, 7])
def test_invariant_features_say_canonical_points_that_do_not_turn(context):
    given = batch(dtype=torch.float64)
    options = {"backbone": "invariant", "places": True, "context": context}
    net = network(torch.float64, **options)
    Q = random_rotations(3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    one, other = say(net, given), say(net, turned_clouds(given, Q))
    for name in SHAPES["canonical"]:
        torch.testing.assert_close(getattr(other, name), getattr(one, name))
    assert not torch.allclose(other.y, one.y)  # an axis that did not change would be wrong
    graph = network(torch.float64, context=context)
    one, other = say(graph, given), say(graph, turned_clouds(given, Q))
    assert not torch.allclose(other.canonical, one.canonical)


def test_heads_that_do_not_see_places_know_them_by_features_only():
    given = batch(dtype=torch.float64)
    Q = random_rotations(3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for places in (False, True):
        net = network(torch.float64, backbone="invariant", places=places)
        one, other = say(net, given).x, say(net, turned_clouds(given, Q)).x
        assert torch.allclose(other, one) != places


@pytest.mark.slow
def test_the_papers_size_and_a_step():
    given = batch(2, 512)
    given |= build_graph(given["points"], (128, 32), (20, 10, 10)).tensors()
    with seeded(0):
        net = InvariantGCN([[0.1, 0.2, 0.1]] * 6, f1={})
    assert net.backbone.channels == 1283
    assert net.axes["x"].before[0].kernel.shape == (1024, 1286 + 3, 1)
    descent = torch.optim.Adam(net.parameters(), lr=1e-3)
    before = [p.detach().clone() for p in net.parameters()]
    parts = TotalLoss()(net(Cloud.of(given)), given)
    parts["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())
    descent.step()
    assert all(p.isfinite().all() for p in net.parameters())
    moved = [not torch.equal(p, q) for p, q in zip(net.parameters(), before, strict=True)]
    assert sum(moved) > 0.95 * len(moved)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("backbone", {"backbone": "pointnet"}), ("branches", {"branches": ("pose",)}),
        ("branches", {"branches": ()}), ("mean_size", {"mean_size": [[1.0, 2]]}),
        ("mean_size", {"mean_size": [[1.0, 2, 0]]}), ("mean_size", {"mean_size": "large"}),
        ("unit", {"unit": 0}), ("context", {"context": -1}), ("norm", {"norm": "none"}),
    ],
)  # fmt: skip
def test_what_cannot_be(name, options):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        InvariantGCN(**SMALL | options)


def test_categories_of_other_clouds():
    given = batch()
    with pytest.raises(ValueError, match=r"^category: expected shape \(3,\)"):
        network()(Cloud.of(given)._replace(category=torch.zeros(2, dtype=torch.int64)))
