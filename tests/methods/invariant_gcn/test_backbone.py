"""Shapes, what a turn does to features, where f1 goes in, and what each form can tell apart."""

import pytest
import torch

from posecore.methods.invariant_gcn.backbone import (
    EdgeConv,
    GraphBackbone,
    InvariantBackbone,
)
from posecore.methods.invariant_gcn.category_clouds import turned_clouds
from posecore.methods.invariant_gcn.invariants import FORMS, LocalFeatures
from posecore.nets.graph3d import Graph, build_graph
from posecore.randomness import seeded
from posecore.rotations import random_rotations
from tests.methods.invariant_gcn.small import batch

WIDTHS = (6, 6, 8, 8, 10)
F1 = LocalFeatures("oriented", pairs=4)


def made(kind, **options):
    with seeded(0):
        return kind(WIDTHS, neighbours=4, **options).double().eval()


def features(net, given):
    with torch.no_grad():
        return net(Graph.of(given), given["normals"], given["view"])


def turned(given, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return turned_clouds(given, random_rotations(3, generator=generator, dtype=torch.float64))


def test_shapes():
    given = batch(dtype=torch.float64)
    for net, channels in (
        (made(GraphBackbone, supports=2), 38), (made(GraphBackbone, supports=2, f1=F1), 41),
        (made(InvariantBackbone), 38),
    ):  # fmt: skip
        assert net.channels == channels
        assert features(net, given).shape == (3, 40, channels)


@pytest.mark.slow
def test_the_papers_size():
    """1286 numbers of a point, with the kinds; f1 adds three."""
    given = batch(2, 512)
    graph = build_graph(given["points"], (128, 32), 10)
    with seeded(0):
        net = GraphBackbone(norm="batch", f1=LocalFeatures())
    assert net.channels == 1280 + 3
    found = net(graph, given["normals"], given["view"])
    assert found.shape == (2, 512, 1283)
    found.square().mean().backward()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in net.parameters())


@pytest.mark.parametrize("form", FORMS)
def test_an_invariant_backbone_does_not_see_a_turn(form):
    given = batch(dtype=torch.float64)
    net = made(InvariantBackbone, form=form)
    torch.testing.assert_close(features(net, turned(given)), features(net, given))


def test_graph_convolution_does():
    given = batch(dtype=torch.float64)
    net = made(GraphBackbone, supports=2, f1=F1)
    one, other = features(net, given), features(net, turned(given))
    torch.testing.assert_close(other[..., -3:], one[..., -3:])  # f1
    assert (other - one)[..., :-3].norm() > 0.1 * one[..., :-3].norm()


@pytest.mark.parametrize("form", ["order_free", "oriented", "handed"])
def test_a_mirror_image_is_seen_by_determinants_alone(form):
    given = batch(dtype=torch.float64)
    net, mirror = made(InvariantBackbone, form=form), torch.tensor([-1.0, 1, 1]).double()
    names = ("points", "normals", "view")
    mirrored = {**given, **{name: given[name] * mirror for name in names}}
    one, other = features(net, given), features(net, mirrored)
    assert torch.equal(one, other) == (form != "handed")
    if form == "handed":
        assert (one - other).norm() > 0.05 * one.norm()


def test_where_f1_goes_in():
    given = batch(dtype=torch.float64)
    plain = made(GraphBackbone, supports=2)
    early = made(GraphBackbone, supports=2, f1=F1)
    everywhere = made(GraphBackbone, supports=2, f1=F1, f1_layers=(1, 2, 3, 4))

    def inputs(net):
        return [layer.weights.kernel.shape[1] for layer in net.layers[1:]]

    assert inputs(plain) == [6, 6, 8, 8]
    assert inputs(early) == [9, 6, 8, 8]
    assert inputs(everywhere) == [9, 9, 11, 11]
    assert features(everywhere, given).shape == (3, 40, 41)
    with pytest.raises(ValueError, match="^f1_layers: expected"):
        GraphBackbone(WIDTHS, f1=F1, f1_layers=(0,))


def test_f1_by_features_depends_on_what_the_layer_knows():
    given = batch(dtype=torch.float64)
    local = LocalFeatures("oriented", nearest=8, pairs=4, by_features=True)
    net, other = made(GraphBackbone, supports=2, f1=local), made(GraphBackbone, supports=2, f1=F1)
    other.load_state_dict(net.state_dict())
    one = features(net, given)
    assert torch.isfinite(one).all()
    assert not torch.allclose(one[..., -3:], features(other, given)[..., -3:])


def test_edges_by_a_loop():
    with seeded(0):
        layer = EdgeConv(3, 4, 2).double()
    known, edges = torch.randn(1, 5, 3).double(), torch.randn(1, 5, 2, 2).double()
    near = torch.tensor([[[1, 2], [0, 4], [0, 1], [4, 2], [3, 0]]])
    found = layer(known, edges, near)
    for i in range(5):
        pairs = [
            (layer.other(known[0, j]) + layer.edge(edges[0, i, k])).clamp(min=0)
            for k, j in enumerate(near[0, i].tolist())
        ]
        expected = torch.maximum(*pairs) + layer.own(known[0, i])
        torch.testing.assert_close(found[0, i], expected)


def test_what_cannot_be():
    given = batch(dtype=torch.float64)
    for options, name in (
        ({"levels": (0, 0, 1)}, "levels"), ({"levels": (0, 0, 2, 2, 2)}, "levels"),
        ({"levels": (1, 1, 1, 2, 2)}, "levels"), ({"norm": "none"}, "norm"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            made(GraphBackbone, **options)
    with pytest.raises(ValueError, match="^form: expected"):
        made(InvariantBackbone, form="left")
    deep = made(InvariantBackbone, levels=(0, 1, 2, 3, 3))
    with pytest.raises(ValueError, match="^graph: expected 3 coarser clouds"):
        features(deep, given)
    with seeded(0):
        wide = InvariantBackbone(WIDTHS, neighbours=9).double()
    with pytest.raises(ValueError, match="^graph: expected 9 neighbours or more, got 8"):
        features(wide, given)
