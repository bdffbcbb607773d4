"""Set abstraction and feature propagation, against loops, and their variants against each other."""

import pytest
import torch
import torch.nn.functional as F

from posecore.nets.pointnet2 import (
    Abstraction,
    FeaturePropagation,
    Link,
    PointNorm,
    SetAbstraction,
    fused,
    shared_mlp,
)
from posecore.nets.pointnet2.layers import _MANY
from posecore.randomness import seeded
from tests.nets.pointnet2.clouds import SMALL, geometry, network

FORMS = ({"fused": True}, {"fused": False}, {"fused": False, "project_first": True})


def by_hand(layer, points, features, level):
    """One ball after the other, with the statistics that a norm keeps."""
    unit = layer.sizes.radius if layer.normalise else 1
    found = []
    for b in range(len(points)):
        for centre, ball in zip(level.centres[b], level.balls[b], strict=True):
            x = (points[b, ball] - points[b, centre]) / unit
            if features is not None:
                x = torch.cat([x, features[b, ball]], -1)
            for linear, norm, _ in zip(*[iter(layer.mlp)] * 3, strict=True):
                x = x @ linear.weight.T
                x = (x - norm.running_mean) / (norm.running_var + norm.eps).sqrt()
                x = (x * norm.weight + norm.bias).clamp(min=0)
            found.append(x.max(0)[0])
    return torch.stack(found).unflatten(0, (len(points), -1))


def abstraction(features=0, sizes=SMALL[0], **options):
    with seeded(0):
        layer = SetAbstraction(features, sizes, **options).double()
        for norm in layer.mlp[1::3]:
            for value in (norm.weight, norm.bias, norm.running_mean):
                torch.nn.init.normal_(value)
            torch.nn.init.uniform_(norm.running_var, 0.5, 2)
    return layer


@pytest.mark.parametrize("normalise", [True, False])
@pytest.mark.parametrize("features", [0, 4])
@pytest.mark.parametrize("form", FORMS)
def test_a_ball_at_a_time(form, features, normalise):
    layer = abstraction(features, normalise=normalise, **form).eval()
    found = geometry()
    known = torch.randn(2, 60, 4, dtype=torch.float64) if features else None
    expected = by_hand(layer, found.points, known, found.levels[0])
    with torch.no_grad():
        torch.testing.assert_close(layer(found.points, known, found.levels[0]), expected)
    torch.testing.assert_close(layer(found.points, known, found.levels[0]), expected)


@pytest.mark.parametrize("form", FORMS[:2])
def test_norms_are_of_all_neighbours_copies_too(form):
    sizes = Abstraction(20, 0.06, 12, (6,))
    layer, found = abstraction(sizes=sizes, **form), geometry(layers=(sizes,), propagations=0)
    level = found.levels[0]
    assert (level.balls[..., 1:] == level.balls[..., :1]).any()
    given = found.points[torch.arange(2)[:, None, None], level.balls]
    centres = found.points[torch.arange(2)[:, None], level.centres]
    x = F.linear((given - centres[:, :, None]) / 0.06, layer.mlp[0].weight)
    norm = layer.mlp[1]
    before = norm.running_mean.clone()
    with torch.no_grad():
        seen = layer(found.points, None, level)
    mean, variance = x.mean((0, 1, 2)), x.var((0, 1, 2), correction=0)
    torch.testing.assert_close(norm.running_mean, 0.9 * before + 0.1 * mean)
    expected = (x - mean) / (variance + norm.eps).sqrt() * norm.weight + norm.bias
    torch.testing.assert_close(seen, expected.relu().amax(2))


@pytest.mark.parametrize("rows", [1, 50, 10_000])
def test_fused_layers_and_their_gradients(rows, monkeypatch):
    monkeypatch.setattr(fused, "ROWS", rows)
    found, nets = geometry(), [network(**form) for form in FORMS]
    for net in nets[1:]:
        net.load_state_dict(nets[0].state_dict())
    weights = torch.randn(2, 10, 8, dtype=torch.float64)
    points = [found.points.clone().requires_grad_() for _ in nets]
    outputs = [net(found.at(p)).features for net, p in zip(nets, points, strict=True)]
    for output in outputs:
        (output * weights).sum().backward()
    for net, own, output in zip(nets[1:], points[1:], outputs[1:], strict=True):
        torch.testing.assert_close(output, outputs[0])
        torch.testing.assert_close(own.grad, points[0].grad)
        for p, q in zip(net.parameters(), nets[0].parameters(), strict=True):
            torch.testing.assert_close(p.grad, q.grad)
        for p, q in zip(net.buffers(), nets[0].buffers(), strict=True):
            torch.testing.assert_close(p, q)
    for net in nets:
        net.eval()
    with torch.no_grad():
        outputs = [net(found).features for net in nets]
    torch.testing.assert_close(outputs[0], outputs[1])
    torch.testing.assert_close(outputs[0], outputs[2])


def test_an_early_maximum_is_that_of_one_rising_layer():
    sizes = Abstraction(20, 0.1, 12, (6,))
    late, early = abstraction(sizes=sizes).eval(), abstraction(sizes=sizes, early_max=True).eval()
    for layer in (late, early):
        layer.mlp[1].weight.data.abs_()
    found = geometry()
    args = found.points, None, found.levels[0]
    torch.testing.assert_close(late(*args), early(*args))
    # Of several layers it is another function, of the same weights.
    late, early = abstraction().eval(), abstraction(early_max=True).eval()
    early.load_state_dict(late.state_dict())
    assert late(*args).shape == early(*args).shape
    assert not torch.allclose(late(*args), early(*args))


def test_order_of_neighbours_and_copies_do_not_matter():
    layer, found = abstraction().eval(), geometry()
    level = found.levels[0]
    expected = layer(found.points, None, level)
    other = level._replace(balls=level.balls.flip(-1))
    torch.testing.assert_close(layer(found.points, None, other), expected)


def test_features_lent_and_own():
    with seeded(0):
        layer = FeaturePropagation(3, 2, (4,)).double().eval()
    coarse, own = torch.rand(1, 5, 3).double(), torch.rand(1, 2, 2).double()
    link = Link(
        torch.tensor([[[0, 1, 2], [4, 4, 3]]]), torch.tensor([[[0.5, 0.3, 0.2], [1, 0, 0]]])
    )
    lent = torch.stack([0.5 * coarse[0, 0] + 0.3 * coarse[0, 1] + 0.2 * coarse[0, 2], coarse[0, 4]])
    expected = layer.mlp(torch.cat([lent[None], own], -1))
    torch.testing.assert_close(layer(coarse, own, link), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("count", [100, _MANY])
def test_norm_as_batch_norm(count):
    x = (3 + torch.randn(count // 4, 4, 3, dtype=torch.float64)).requires_grad_()
    norm, other = PointNorm(3).double(), torch.nn.BatchNorm1d(3).double()
    for n in (norm, other):
        n.weight.data.copy_(torch.tensor([1.0, -2, 0.5]))
        n.bias.data.copy_(torch.tensor([1.0, 2, -0.5]))
    weights = torch.randn_like(x)
    gradients = []
    for n, form in ((norm, lambda v: v), (other, lambda v: v.flatten(0, 1))):
        y = n(form(x))
        inputs = [x, n.weight, n.bias]
        gradients.append(
            [y.reshape(x.shape), *torch.autograd.grad((y * form(weights)).sum(), inputs)]
        )
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two)
    torch.testing.assert_close(norm.state_dict(), other.state_dict())
    norm.eval(), other.eval()
    torch.testing.assert_close(norm(x).flatten(0, 1), other(x.flatten(0, 1)))


def test_what_cannot_be():
    layer, found = abstraction(4), geometry()
    for features in (None, torch.zeros(2, 60, 5), torch.zeros(2, 59, 4)):
        with pytest.raises(ValueError, match=r"^features: expected shape \(2, 60, 4\)"):
            layer(found.points, features, found.levels[0])
    with pytest.raises(ValueError, match="^features: expected None"):
        abstraction()(found.points, torch.zeros(2, 60, 4), found.levels[0])
    with pytest.raises(ValueError, match="^features: expected"):
        SetAbstraction(-1, SMALL[0])
    with pytest.raises(ValueError, match="^sizes: expected at least two"):
        shared_mlp(3)
    with pytest.raises(ValueError, match="^sizes: expected an integer"):
        shared_mlp(3, 0)
