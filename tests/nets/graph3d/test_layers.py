"""The layers against loops and each other, their gradients, and what turns and copies do."""

import pytest
import torch

from posecore.clouds import neighbour_directions
from posecore.nets.graph3d import (
    GraphConv,
    PointLinear,
    SurfaceConv,
    fused,
    other_neighbours,
    pool_maximum,
)
from posecore.randomness import seeded
from posecore.rotations import random_rotations
from posecore.training.muon import Muon
from tests.bench.plain_graph3d import PlainConv
from tests.nets.graph3d.clouds import cloud, graph

FORMS = [{"fused": True}, {"fused": False}]


def made(kind, *sizes, **options):
    with seeded(0):
        return kind(*sizes, **options).double()


def given(points=None, k=6):
    points = cloud() if points is None else points
    index = other_neighbours(points, k)
    return neighbour_directions(points, index), index


def features(channels=5):
    return torch.randn(2, 40, channels, generator=torch.Generator().manual_seed(1)).double()


def by_hand(layer, points, known, index):
    """Eq. 3: point by point, channel by channel, support by support, neighbour by neighbour."""
    s, c = layer.supports, layer.outputs
    supports = (layer.directions / layer.directions.norm(dim=0)).view(3, s, c)
    if known is not None:
        w = layer.weights.kernel.view(s + 1, c, -1)
        b = layer.weights.bias.view(s + 1, c)
    found = torch.zeros(*points.shape[:2], c, dtype=points.dtype)
    for at in torch.cartesian_prod(*map(torch.arange, found.shape)).tolist():
        cloud, i, channel = at
        total = 0.0 if known is None else float(w[0, channel] @ known[cloud, i] + b[0, channel])
        for support in range(s):
            best = -torch.inf
            for j in index[cloud, i].tolist():
                offset = points[cloud, j] - points[cloud, i]
                length = float(offset.norm())
                cosine = float(offset @ supports[:, support, channel]) / length if length else 0.0
                lent = 1.0
                if known is not None:
                    lent = w[support + 1, channel] @ known[cloud, j] + b[support + 1, channel]
                best = max(best, max(cosine, 0.0) * float(lent))
            total += best
        found[tuple(at)] = total
    return found


@pytest.mark.parametrize("form", FORMS)
def test_as_a_loop_says_it(form):
    points = cloud(2, 10)
    points[0, 4] = points[0, 2]
    directions, index = given(points, 3)
    surface = made(SurfaceConv, 3, 2, **form)
    with torch.no_grad():
        expected = by_hand(surface, points, None, index)
        torch.testing.assert_close(surface(directions), expected)
    layer, known = made(GraphConv, 5, 3, 2, **form), features()[:, :10]
    with torch.no_grad():
        expected = by_hand(layer, points, known, index)
    torch.testing.assert_close(layer(known, directions, index), expected)
    torch.testing.assert_close(layer(known, directions, index.int()), expected)


def test_as_it_is_usually_written():
    points, known = cloud(), features()
    directions, index = given(points)
    layer = made(GraphConv, 5, 4, 3)
    plain = PlainConv(5, 4, 3).double().copy_from(layer)
    torch.testing.assert_close(layer(known, directions, index), plain(points, known, index))


@pytest.mark.parametrize("cells", [1, 30, 10_000])
def test_a_few_points_at_a_time_are_all_at_once(cells, monkeypatch):
    monkeypatch.setattr(fused, "CELLS", cells)
    directions, index = given()
    weights = torch.randn(2, 40, 4).double()
    surfaces = [made(SurfaceConv, 4, 3, **form) for form in FORMS]
    layers = [made(GraphConv, 5, 4, 3, **form) for form in FORMS]
    inputs = [(features().requires_grad_(), directions.clone().requires_grad_()) for _ in FORMS]
    outputs = []
    for surface, layer, (known, toward) in zip(surfaces, layers, inputs, strict=True):
        outputs.append([surface(toward), layer(known, toward, index)])
        sum((output * weights).sum() for output in outputs[-1]).backward()
    torch.testing.assert_close(*outputs)
    for a, b in zip(*inputs, strict=True):
        torch.testing.assert_close(a.grad, b.grad)
    for pair in (surfaces, layers):
        for a, b in zip(*(one.parameters() for one in pair), strict=True):
            torch.testing.assert_close(a.grad, b.grad)
    with torch.no_grad():
        torch.testing.assert_close(layers[0](features(), directions, index), outputs[0][1])


def test_gradients_by_differences():
    points = cloud(1, 7).requires_grad_()
    index = other_neighbours(points, 3)
    surface, layer = made(SurfaceConv, 2, 2), made(GraphConv, 3, 2, 2)
    known = features(3)[:1, :7].requires_grad_()

    def both(points, known, *_):
        toward = neighbour_directions(points, index)
        return surface(toward), layer(known, toward, index)

    everything = (points, known, *surface.parameters(), *layer.parameters())
    assert torch.autograd.gradcheck(both, everything)


@pytest.mark.parametrize("form", FORMS)
def test_where_all_is_zero_nothing_is_lost(form):
    """All neighbours in one place, and features of zero: the first of equal ones is taken."""
    points = torch.zeros(1, 5, 3).double()
    directions, index = given(points, 3)
    layer, known = made(GraphConv, 2, 3, 2, **form), torch.zeros(1, 5, 2).double()
    found = layer(known, directions, index)
    found.sum().backward()
    torch.testing.assert_close(found, layer.weights.bias[:3].expand(1, 5, 3))
    assert all(p.grad.isfinite().all() for p in layer.parameters())
    assert not made(SurfaceConv, 3, 2, **form)(directions).any()


def test_what_it_knows_of_a_cloud():
    """Neither place nor size; but how it is turned, and no more than who is whose neighbour."""
    surface, layer = made(SurfaceConv, 6, 3), made(GraphConv, 6, 6, 3)

    def seen(points, order=None):
        directions, index = given(points)
        if order is not None:
            directions, index = directions[:, :, order], index[:, :, order]
        return layer(surface(directions), directions, index)

    points = cloud()
    expected = seen(points)
    torch.testing.assert_close(seen(3 * points + 0.4), expected)
    torch.testing.assert_close(seen(points, torch.randperm(6)), expected)
    R = random_rotations(2, generator=torch.Generator().manual_seed(1)).double()
    turned = seen(points @ R.mT)
    assert (turned - expected).norm() > 0.05 * expected.norm()


def test_maximum_over_the_nearest_of_a_finer_cloud():
    found, known = graph(), features()
    pooled = pool_maximum(known, found.coarser[0].pool)
    for b in range(2):
        for m in range(12):
            assert torch.equal(pooled[b, m], known[b, found.coarser[0].pool[b, m]].amax(0))


def test_muon_takes_weights_for_kernels_and_directions_for_none():
    layer = made(GraphConv, 5, 4, 3)
    assert [(name, p.ndim) for name, p in layer.named_parameters()] == [
        ("directions", 2), ("weights.kernel", 3), ("weights.bias", 1),
    ]  # fmt: skip
    directions, index = given()
    layer(features(), directions, index).square().mean().backward()
    before = layer.weights.kernel.clone()
    Muon(layer.parameters(), lr=0.1).step()
    step = (layer.weights.kernel - before).detach()[..., 0]
    values = torch.linalg.svdvals(step)
    assert values.min() > 0.4 * values.max()  # all directions of the kernel alike


def test_linear_of_points():
    layer = made(PointLinear, 5, 3, bias=False)
    torch.testing.assert_close(layer(features()), features() @ layer.kernel[..., 0].T)
    spread = float(made(PointLinear, 400, 300, gain=0.5).kernel.detach().std())
    assert abs(spread / (0.5 * (2 / 400) ** 0.5) - 1) < 0.02
    assert repr(layer) == "PointLinear(5, 3, bias=False)"


@pytest.mark.slow
def test_the_papers_size_keeps_a_few_bytes():
    """A step at the paper's size, and what of it waits for the backward pass."""
    kept = {}

    def keep(tensor):
        kept[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
        return tensor

    points = cloud(2, 512, torch.float32)
    directions, index = given(points, 10)
    with seeded(0):
        surface, layer = SurfaceConv(128), GraphConv(128, 128)
    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        found = layer(surface(directions), directions, index)
    assert found.shape == (2, 512, 128)
    usual = 2 * 2 * 512 * 10 * 7 * 128 * 4  # cosines and copies of features of one layer
    assert sum(kept.values()) < usual / 6
    found.square().mean().backward()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in layer.parameters())


def test_what_cannot_be():
    directions, index = given()
    layer, surface = made(GraphConv, 5, 4, 3), made(SurfaceConv, 4, 3)
    with pytest.raises(ValueError, match=r"^directions: expected shape \(B, N, K, 3\)"):
        surface(directions[0])
    with pytest.raises(ValueError, match=r"^features: expected shape \(2, 40, 5\)"):
        layer(features(6), directions, index)
    with pytest.raises(ValueError, match=r"^neighbours: expected shape \(2, 40, 6\)"):
        layer(features(), directions, index[..., :5])
    with pytest.raises(ValueError, match="^neighbours: expected indices from 0 to 39"):
        layer(features(), directions, index + 1)
    with pytest.raises(ValueError, match="^neighbours: expected at most 255"):
        surface(torch.zeros(1, 1, 256, 3).double())
    for sizes in ((0, 4, 3), (5, 0, 3), (5, 4, 0)):
        with pytest.raises(ValueError, match="^(inputs|outputs|supports): expected"):
            GraphConv(*sizes)
