"""Classes drawn at random, what their network says, and regression with the same trunk."""

import math

import pytest
import torch

from posecore.methods.random_bins.losses import bins_loss, nearest_bins, regression_loss
from posecore.methods.random_bins.network import (
    STEPS,
    PictureRegression,
    RandomBins,
    draw_bins,
    pose_numbers,
)
from posecore.randomness import seeded
from posecore.rotations import euler_to_matrix

LOW = torch.tensor([-1.2, -0.6, -0.4, -0.3, -0.2, 0.5])
HIGH = torch.tensor([1.2, 0.6, 0.4, 0.3, 0.2, 1.1])
PICTURES = torch.rand(2, 1, 33, 40, generator=torch.Generator().manual_seed(0))


def small(kind=RandomBins, trunk="basic", **options):
    with seeded(0):
        return kind(LOW, HIGH, trunk=trunk, width=4, blocks=(1, 1, 1, 1), **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RandomBins, PictureRegression])
def test_a_step_at_the_papers_size(kind):
    with seeded(0):
        net = kind(LOW, HIGH)
    assert net.features == 2048
    said = net(torch.rand(2, 1, 188, 320))
    assert said.values.shape == (2, 6) and said.R.shape == (2, 3, 3) and said.t.shape == (2, 3)
    loss = regression_loss if kind is PictureRegression else bins_loss
    if kind is RandomBins:
        assert said.logits.shape == (2, 6, 30, 40) and net.classes.shape == (6, 30, 40)
    loss(net, said, (LOW + HIGH).expand(2, 6) / 2)["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


def test_classes_are_values_of_the_range_in_steps():
    generator = torch.Generator().manual_seed(0)
    classes = draw_bins(LOW.double(), HIGH.double(), generator=generator)
    assert classes.shape == (6, 30, 40)
    for i, step in enumerate(STEPS):
        counted = (classes[i] - LOW.double()[i]) / step
        torch.testing.assert_close(counted, counted.round(), rtol=0, atol=1e-6)
        assert (classes[i].diff() > 0.5 * step).all()
        assert classes[i].min() >= LOW[i] and classes[i].max() <= HIGH[i] + 1e-6
        # Spread over the range evenly, each set in another way.
        middle, half = (LOW[i] + HIGH[i]) / 2, (HIGH[i] - LOW[i]) / 2
        assert abs(classes[i].mean() - middle) < 0.1 * half
        assert len({tuple(row.tolist()) for row in classes[i]}) == 30
    assert STEPS[0] == math.radians(0.01) and STEPS[5] == 1e-4
    again = draw_bins(LOW.double(), HIGH.double(), generator=generator.manual_seed(0))
    assert torch.equal(again, classes)


def test_all_values_of_a_small_range():
    classes = draw_bins(torch.tensor([0.1]), torch.tensor([0.4]), sets=3, bins=4, steps=[0.1])
    torch.testing.assert_close(classes, torch.tensor([0.1, 0.2, 0.3, 0.4]).expand(1, 3, 4))
    with pytest.raises(ValueError, match=r"^high\[0\] - low\[0\]: expected at least 4 steps"):
        draw_bins(torch.tensor([0.1]), torch.tensor([0.4]), sets=3, bins=5, steps=[0.1])
    with pytest.raises(ValueError, match="^low, high and steps: expected"):
        draw_bins(LOW, HIGH, steps=[0.1])


@pytest.mark.parametrize("trunk", ["basic", "bottleneck"])
def test_the_answer_is_the_mean_of_what_sets_expect(trunk):
    net = small(trunk=trunk, sets=3, bins=5).eval()
    said = net(PICTURES)
    assert said.logits.shape == (2, 6, 3, 5)
    shares = said.logits.exp() / said.logits.exp().sum(-1, keepdim=True)
    expected = (shares * net.classes).sum(-1).mean(-1)
    torch.testing.assert_close(said.values, expected)
    assert (said.values > LOW).all() and (said.values < HIGH).all()
    torch.testing.assert_close(said.R, euler_to_matrix(said.values[:, :3]))
    assert torch.equal(said.t, said.values[:, 3:])
    torch.testing.assert_close(pose_numbers(said.R, said.t), said.values)


def test_classes_belong_to_the_weights_and_pictures_are_normalised():
    net, other = small(sets=3, bins=5).eval(), small(sets=3, bins=5, seed=1).eval()
    assert not torch.equal(net.classes, other.classes)
    expected = net((PICTURES - 0.3) / 0.2).values
    net.mean.fill_(0.3), net.std.fill_(0.2)
    torch.testing.assert_close(net(PICTURES).values, expected)
    other.load_state_dict(net.state_dict())
    assert torch.equal(other(PICTURES).values, net(PICTURES).values)


def test_the_nearest_class():
    classes = torch.tensor([[[0.0, 1, 3], [0.0, 2, 4]], [[5.0, 6, 7], [1.0, 2, 9]]])
    found = nearest_bins(torch.tensor([[1.9, 9.0], [-5, 4]]), classes)
    assert found.tolist() == [[[1, 1], [2, 2]], [[0, 0], [0, 1]]]
    with pytest.raises(ValueError, match=r"^values: expected shape \(B, 2\)"):
        nearest_bins(torch.zeros(2, 3), classes)


def test_the_losses_by_hand():
    net = small(sets=3, bins=5)
    said = net(PICTURES)
    values = LOW + (HIGH - LOW) * torch.rand(2, 6, generator=torch.Generator().manual_seed(0))
    parts = bins_loss(net, said, values)
    targets = nearest_bins(values, net.classes)
    each = -said.logits.log_softmax(-1).gather(-1, targets[..., None])[..., 0].mean(-1)
    assert parts["loss"].item() == pytest.approx(each.mean().item(), rel=1e-5)
    assert parts["angles"].item() == pytest.approx(each[:, :3].mean().item(), rel=1e-5)
    assert parts["position"].item() == pytest.approx(each[:, 3:].mean().item(), rel=1e-5)
    net = small(PictureRegression)
    said = net(PICTURES)
    off = torch.tensor([0.6, 0, 0, 0.3, 0.2, 0.15])
    parts = regression_loss(net, said, said.values - off)
    assert parts["angles"].item() == pytest.approx(0.5 / 3, rel=1e-5)
    assert parts["position"].item() == pytest.approx(2.5 / 3, rel=1e-5)
    assert parts["loss"].item() == pytest.approx(0.5, rel=1e-5)
    with pytest.raises(ValueError, match="^values: expected"):
        regression_loss(net, said, off)


def test_regression_has_the_range_as_its_unit():
    net = small(PictureRegression).eval()
    torch.nn.init.zeros_(net.head.weight)
    net.head.bias.data.copy_(torch.tensor([0.0, 1, -1, 0, 1, -1]))
    expected = [0, HIGH[1].item(), LOW[2].item(), 0, HIGH[4].item(), LOW[5].item()]
    assert net(PICTURES).values[1].tolist() == pytest.approx(expected, abs=1e-6)
    assert net(PICTURES).logits is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("trunk", "vgg"), ("low", torch.zeros(5)), ("high", LOW), ("sets", 0), ("bins", 0),
        ("width", 0), ("in_channels", 0),
    ],
)  # fmt: skip
def test_what_cannot_be(name, value):
    given = {"low": LOW, "high": HIGH, "width": 4, "blocks": (1, 1, 1, 1)} | {name: value}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        RandomBins(**given)
