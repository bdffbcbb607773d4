"""Muon against PyTorch's two optimisers, each where it does the same."""

import pytest
import torch
from torch import nn

from posecore.training import fit, seeded
from posecore.training.muon import Muon, orthogonal


def gradients(shape, count=5):
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(shape, generator=generator) for _ in range(count)]


def moved(make, shape, view=lambda tensor: tensor):
    """Where an optimiser takes a parameter by given gradients."""
    start = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    parameter = nn.Parameter(view(start).clone())
    descent = make([parameter])
    for gradient in gradients(shape):
        parameter.grad = view(gradient).clone()
        descent.step()
    return parameter.detach().flatten() - start.flatten()


@pytest.mark.parametrize("shape", [(6, 4, 3, 3), (32, 2, 1, 1), (5, 7, 3)])
def test_kernels_move_as_by_torch_muon(shape):
    ours = moved(lambda p: Muon(p, lr=0.01), shape)
    options = {"lr": 0.01, "weight_decay": 0, "adjust_lr_fn": "match_rms_adamw"}
    theirs = moved(lambda p: torch.optim.Muon(p, **options), shape, lambda t: t.flatten(1))
    # Theirs iterates in bfloat16.
    assert (ours - theirs).norm() < 0.03 * theirs.norm()
    assert theirs.norm() > 0.01


@pytest.mark.parametrize("shape", [(7,), (4, 5), ()])
def test_all_else_moves_as_by_adam(shape):
    ours = moved(lambda p: Muon(p, lr=0.01), shape)
    torch.testing.assert_close(ours, moved(lambda p: torch.optim.Adam(p, lr=0.01), shape))


@pytest.mark.parametrize("shape", [(8, 20), (20, 8), (8, 8)])
def test_singular_values_end_near_one(shape):
    with seeded(0):
        u, _, v = torch.linalg.svd(torch.randn(shape, dtype=torch.float64), full_matrices=False)
    values = torch.logspace(-2, 0, u.shape[1], dtype=torch.float64)
    result = orthogonal(100 * u @ values.diag() @ v)
    inner = u.T @ result @ v.T
    assert float((inner - inner.diagonal().diag()).abs().max()) < 1e-9  # the same vectors
    assert 0.65 < float(inner.diagonal().min()) <= float(inner.diagonal().max()) < 1.25
    assert torch.equal(orthogonal(torch.zeros(shape)), torch.zeros(shape))


def test_a_training_that_is_stopped_goes_on_the_same(tmp_path):
    def net():
        with seeded(0):
            return nn.Sequential(
                nn.Conv2d(1, 4, 3), nn.BatchNorm2d(4), nn.Flatten(), nn.Linear(36, 1)
            )

    def batches(generator):
        return torch.randn(8, 1, 5, 5, generator=generator)

    def loss(model, x):
        if not left:
            raise KeyboardInterrupt
        left.pop()
        return (model(x)[:, 0] - x.mean((1, 2, 3))).square().mean()

    options = {"steps": 12, "lr": 0.02, "optimiser": Muon, "device": "cpu", "save_seconds": 0}
    left = [1] * 12  # steps before it is stopped
    whole = net()
    history = fit(whole, batches, loss, **options)
    assert history.losses["loss"][-1] < 0.5 * history.losses["loss"][0]
    left = [1] * 6
    with pytest.raises(KeyboardInterrupt):
        fit(net(), batches, loss, resume=tmp_path, **options)
    left, again = [1] * 12, net()
    fit(again, batches, loss, resume=tmp_path, **options)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


def test_what_has_no_gradient_stays():
    one, two = nn.Parameter(torch.ones(2, 2, 3, 3)), nn.Parameter(torch.ones(2, 2, 3, 3))
    descent = Muon([one, two], lr=0.1)
    value = descent.step(lambda: (one.square().sum()).backward() or 5)
    assert value == 5
    assert not torch.equal(one, torch.ones_like(one)) and torch.equal(two, torch.ones_like(two))


@pytest.mark.parametrize(
    "options, name",
    [
        ({"lr": -1}, "lr"),
        ({"lr": float("nan")}, "lr"),
        ({"momentum": 1.0}, "momentum"),
        ({"betas": (1.0, 0.9)}, r"betas\[0\]"),
        ({"betas": (0.9, -0.1)}, r"betas\[1\]"),
        ({"eps": 0}, "eps"),
    ],
)
def test_bad_input(options, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        Muon([nn.Parameter(torch.zeros(1))], **options)
