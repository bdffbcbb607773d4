"""The losses against formulas written out, their gradients, and all that has no direction."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional as F

from posecore.methods.vector_field.fields import FieldTargets, unit
from posecore.methods.vector_field.losses import (
    VectorFieldLoss,
    projection_loss,
    projection_weight,
    vector_loss,
)

SEEDS = st.integers(0, 2**32 - 1)


def smooth_l1(x):
    return np.where(np.abs(x) < 1, x**2 / 2, np.abs(x) - 0.5)


@given(seed=SEEDS, scale=st.sampled_from([0.1, 1, 30]))
def test_vector_loss_by_its_formula(seed, scale):
    p, g = scale * np.random.default_rng(seed).normal(size=(2, 3, 4, 2))
    np.testing.assert_allclose(vector_loss(p, g), smooth_l1(p - g).mean())
    assert vector_loss(g, g) == 0


@given(seed=SEEDS, scale=st.sampled_from([0.1, 1, 30]))
def test_projection_loss_is_the_distance_of_the_keypoint_from_the_ray(seed, scale):
    rng = np.random.default_rng(seed)
    p, g = rng.normal(size=(3, 4, 2)), scale * rng.normal(size=(3, 4, 2))
    along = p / np.linalg.norm(p, axis=-1, keepdims=True)
    foot = (g * along).sum(-1, keepdims=True) * along  # nearest point of the line to the keypoint
    distance = np.linalg.norm(g - foot, axis=-1)
    np.testing.assert_allclose(projection_loss(p, g), smooth_l1(distance).mean())
    # Neither the length nor the sign of what is predicted matters.
    factors = rng.choice([-1, 1], (3, 4, 1)) * rng.uniform(0.5, 2, (3, 4, 1))
    np.testing.assert_allclose(projection_loss(factors * p, g), projection_loss(p, g))


def gradient_of_angle(loss, degrees, target):
    """How fast the summed loss of one unit vector falls as its angle goes to that of the target."""
    angle = torch.tensor(math.radians(degrees), dtype=torch.float64, requires_grad=True)
    predicted = torch.stack([angle.cos(), angle.sin()])
    value = loss(predicted, torch.tensor([target, 0.0], dtype=torch.float64))
    return torch.autograd.grad(value, angle)[0].item()


def test_gradients_at_one_degree():
    """A target of length one says what the vector loss says; 50 px away it says 2500 times it."""
    radians = math.radians(1)
    of_vectors = 2 * gradient_of_angle(vector_loss, 1, 1.0)  # a sum over both coordinates
    of_units = gradient_of_angle(projection_loss, 1, 1.0)
    of_pixels = gradient_of_angle(projection_loss, 1, 50.0)
    assert of_vectors == pytest.approx(math.sin(radians))
    assert of_units == pytest.approx(math.sin(radians) * math.cos(radians))
    assert of_pixels == pytest.approx(2500 * of_units)
    assert (round(of_vectors, 4), round(of_pixels, 1)) == (0.0175, 43.6)


def test_reversed_vectors_are_seen_by_the_vector_loss_only():
    g = torch.tensor([[3.0, 4.0], [-20.0, 1.0]])
    assert projection_loss(-unit(g), g) < 1e-10
    assert vector_loss(-unit(g), unit(g)) > 0.5


@given(seed=SEEDS)
def test_forward_only_leaves_out_what_points_away(seed):
    rng = np.random.default_rng(seed)
    p = torch.tensor(rng.normal(size=(40, 2))).requires_grad_()
    g = torch.tensor(rng.normal(0, 30, (40, 2)))
    ahead = (p * g).sum(-1) > 0
    found = projection_loss(p, g, ignore_reversed=True)
    (gradient,) = torch.autograd.grad(found, p)
    (expected,) = torch.autograd.grad(ahead.sum() / 40 * projection_loss(p[ahead], g[ahead]), p)
    assert torch.isclose(found, ahead.sum() / 40 * projection_loss(p[ahead], g[ahead]))
    torch.testing.assert_close(gradient, expected)
    assert not gradient[~ahead].any()


def descend(loss, a, steps=4000):
    """Degrees by which a vector is off in the end, that begins off by `a`."""
    g = torch.tensor([[40.0, 0.0]], dtype=torch.float64)
    p = torch.tensor([[np.cos(np.radians(a)), np.sin(np.radians(a))]]).requires_grad_()
    for _ in range(steps):
        (gradient,) = torch.autograd.grad(loss(p, g), p)
        with torch.no_grad():
            p -= 0.01 * gradient
    p = p.detach()
    return float(torch.atan2(p[0, 1].abs(), p[0, 0]).rad2deg())


@pytest.mark.slow
def test_the_wall_between_reversed_and_right():
    """With Eq 1 as printed a vector that points away stays so; forward only, it comes round."""
    for ignore_reversed in (False, True):
        off = descend(
            lambda p, g, ignore_reversed=ignore_reversed: (
                vector_loss(p, g / g.norm())
                + 0.05 * projection_loss(p, g, ignore_reversed=ignore_reversed)
            ),
            150.0,
        )
        assert off < 1 if ignore_reversed else off > 90


@pytest.mark.parametrize("loss", [vector_loss, projection_loss])
def test_gradients_by_finite_differences(loss):
    torch.manual_seed(0)
    p, g = torch.randn(2, 5, 3, 2, dtype=torch.float64)
    g = 3 * g  # on both sides of the knee of smooth L1
    assert torch.autograd.gradcheck(loss, (p.requires_grad_(), g.requires_grad_()))


@pytest.mark.parametrize("p", [0.0, 1e-30, 1e-12, 1e-4, 1.0, 1e6])
@pytest.mark.parametrize("g", [0.0, 1e-30, 1.0, 500.0])
@pytest.mark.parametrize("loss", [vector_loss, projection_loss])
def test_values_and_gradients_are_finite(loss, p, g):
    predicted = torch.tensor([[p, 0], [p, p], [0, -p]], requires_grad=True)
    target = torch.tensor([[g, 0], [0, g], [g, -g]], requires_grad=True)
    value = loss(predicted, target)
    value.backward()
    assert value.isfinite()
    assert predicted.grad.isfinite().all() and target.grad.isfinite().all()
    if loss is projection_loss:
        assert predicted.grad.norm(dim=-1).max() <= 1.01 * math.sqrt(2) * g / 1e-3 / 3
        assert p or value == 0


def test_short_vectors_fade():
    g = np.array([0.0, 0.5])
    assert projection_loss([2e-3, 0], g) == pytest.approx(0.125)
    assert projection_loss([5e-4, 0], g) == pytest.approx(0.125 / 4)
    assert projection_loss([5e-4, 0], g, eps=1e-4) == pytest.approx(0.125)


@pytest.mark.parametrize("loss", [vector_loss, projection_loss])
def test_no_vectors_no_loss(loss):
    p = torch.zeros(0, 9, 2, requires_grad=True)
    value = loss(p, torch.zeros(0, 9, 2))
    value.backward()
    assert value == 0 and p.grad.shape == p.shape


@given(done=st.floats(0, 1), later=st.floats(0, 1))
def test_the_weight_grows_in_steps(done, later):
    done, later = sorted((done, later))
    weight = projection_weight(done)
    assert 0.01 <= weight <= projection_weight(later) <= 0.05 + 1e-15
    assert abs(weight * 1000 - round(weight * 1000)) < 1e-9
    assert weight == pytest.approx(0.01 + 0.001 * (done * 40 // 1), abs=0.001 + 1e-9)


def test_the_weight_of_every_epoch_of_the_paper():
    weight, expected = 0.01, []
    for epoch in range(201):
        if epoch and epoch % 5 == 0:
            weight += 0.001
        expected.append(weight)
    found = [projection_weight(epoch / 200) for epoch in range(201)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert found[199] == pytest.approx(0.049) and found[200] == pytest.approx(0.05)
    assert projection_weight(0.5, 0.2, 0.1, 2) == pytest.approx(0.15)
    for step in range(101):  # rounding loses none
        assert projection_weight(step / 100, 0, 1, 100) == step / 100


def case(seed=0, pixels=6):
    """What a network says of two images with two objects, and what it should."""
    draw = torch.Generator().manual_seed(seed)
    labels = torch.randint(0, 3, (2, 5, 4), generator=draw)
    numbers = torch.zeros(4, pixels, dtype=torch.int64)
    vectors = 20 * torch.randn(pixels, 9, 2, generator=draw)
    mask = torch.randn(2, 3, 5, 4, generator=draw, requires_grad=True)
    predicted = torch.randn(pixels, 9, 2, generator=draw, requires_grad=True)
    return mask, predicted, FieldTargets(labels, *numbers, vectors)


@pytest.mark.parametrize("projection", ["none", "pixel", "unit"])
@pytest.mark.parametrize("weight", ["dynamic", 0.02, 0])
def test_the_sum(projection, weight):
    mask, predicted, targets = case()
    found = VectorFieldLoss(projection, weight)(mask, predicted, targets, 0.3)
    assert list(found) == ["loss", "mask", "vectors", "projection"]
    assert all(part.ndim == 0 for part in found.values())

    of_mask = -mask.log_softmax(1).gather(1, targets.labels[:, None]).mean()
    aim = F.normalize(targets.vectors, dim=-1)
    of_vectors = F.smooth_l1_loss(predicted, aim)
    of_projection = projection_loss(predicted, aim if projection == "unit" else targets.vectors)
    beta = {"dynamic": 0.022}.get(weight, weight) if projection != "none" else 0
    torch.testing.assert_close(found["mask"], of_mask)
    torch.testing.assert_close(found["vectors"], of_vectors)
    torch.testing.assert_close(found["projection"], of_projection)
    whole = of_mask + of_vectors + beta * of_projection
    torch.testing.assert_close(found["loss"], whole)
    wanted = torch.autograd.grad(whole, (mask, predicted))
    for one, other in zip(
        torch.autograd.grad(found["loss"], (mask, predicted)), wanted, strict=True
    ):
        torch.testing.assert_close(one, other)


@given(done=st.floats(0, 1), warmup=st.floats(0, 1))
def test_it_comes_in_when_it_is_told_to(done, warmup):
    beta = VectorFieldLoss(warmup=warmup).beta(done)
    if done < warmup:
        assert beta == 0
    else:
        assert 0.01 <= beta <= 0.05 + 1e-12
    assert VectorFieldLoss(warmup=warmup).beta(1.0) == pytest.approx(0.05)
    assert VectorFieldLoss(weight=0.3, warmup=warmup).beta(done) == (0.3 if done >= warmup else 0)
    assert VectorFieldLoss("none", 0.3).beta(done) == 0
    assert VectorFieldLoss().beta(done) == projection_weight(done)


@given(seed=SEEDS, pixels=st.integers(0, 4), half=st.booleans())
def test_the_sum_is_finite_whatever_is_seen(seed, pixels, half):
    """No pixel at all, a pixel on its keypoint, a network that says nothing, half precision."""
    mask, predicted, targets = case(seed, pixels)
    with torch.no_grad():
        targets.vectors[:1] = 0
        predicted[1:2] = 0
    said = predicted.bfloat16() if half else predicted
    found = VectorFieldLoss()(mask.bfloat16() if half else mask, said, targets, 1)
    assert all(part.isfinite() and part.dtype == torch.float32 for part in found.values())
    found["loss"].backward()
    assert mask.grad.isfinite().all() and predicted.grad.isfinite().all()


ONES, LOSS = np.ones((4, 2)), VectorFieldLoss()
MASK, PREDICTED, TARGETS = case()


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: vector_loss(ONES, ONES[:1]), "target"),
        (lambda: projection_loss(ONES, ONES[0]), "target"),
        (lambda: projection_loss(ONES, ONES, eps=0), "eps"),
        (lambda: projection_weight(-0.1), "done"),
        (lambda: projection_weight(1.1), "done"),
        (lambda: projection_weight(0.5, steps=0), "steps"),
        (lambda: projection_weight(0.5, start=-1), "start"),
        (lambda: projection_weight(0.5, end=math.nan), "end"),
        (lambda: VectorFieldLoss("pixels"), "projection"),
        (lambda: VectorFieldLoss(weight="constant"), "weight"),
        (lambda: VectorFieldLoss(weight=-0.01), "weight"),
        (lambda: VectorFieldLoss(weight=None), "weight"),
        (lambda: VectorFieldLoss(warmup=-0.1), "warmup"),
        (lambda: VectorFieldLoss(warmup=1.5), "warmup"),
        (lambda: LOSS(MASK[:1], PREDICTED, TARGETS, 0), "mask"),
        (lambda: LOSS(MASK[..., 1:], PREDICTED, TARGETS, 0), "mask"),
        (lambda: LOSS(MASK[0], PREDICTED, TARGETS, 0), "mask"),
        (lambda: LOSS(MASK, PREDICTED[:, :8], TARGETS, 0), "vectors"),
        (lambda: LOSS(MASK, PREDICTED, TARGETS, 2), "done"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}:"):
        call()
