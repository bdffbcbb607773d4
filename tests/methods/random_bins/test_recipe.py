"""Pictures, and what the recipe makes of its numbers."""

from dataclasses import replace

import pytest
import torch

from posecore.methods.random_bins.network import pose_numbers
from posecore.methods.random_bins.pictures import Pictures
from posecore.methods.random_bins.recipe import NETS, RECIPES
from posecore.training import fit
from posecore.training.loop import ADAM
from tests.methods.infrared.dots import load

TINY = RECIPES["tiny"]


@pytest.fixture(scope="module")
def data():
    return load()


@pytest.fixture(scope="module")
def pictures(data):
    return Pictures(data, (32, 24))


def test_pictures_and_numbers_of_every_view(data, pictures):
    assert pictures.images.shape == (12, 1, 24, 32) and pictures.images.dtype == torch.uint8
    assert pictures.object_id.tolist() == [1] * 12 and pictures.view.tolist() == list(range(12))
    first = torch.arange(0, 24, 2)  # of two objects in each
    expected = pose_numbers(data.R[first].float(), data.t[first].float())
    assert torch.equal(pictures.values, expected)
    part = pictures.only(torch.tensor([4, 2]))
    assert len(part) == 2 and torch.equal(part.values, expected[[4, 2]])
    with pytest.raises(ValueError, match="^chosen: expected one picture or more"):
        pictures.only(pictures.object_id == 7)


def test_a_batch_belongs_together(pictures):
    batch = pictures.draw(5, generator=torch.Generator().manual_seed(0))
    assert batch["images"].shape == (5, 1, 24, 32) and batch["images"].max() <= 1
    for image, values in zip(batch["images"], batch["values"], strict=True):
        (row,) = (pictures.values == values).all(1).nonzero()[0].tolist()
        assert torch.equal(image * 255, pictures.images[row].float())
    with pytest.raises(ValueError, match="^count: expected"):
        pictures.draw(0, generator=torch.Generator())


def test_data_that_lack_something(data, monkeypatch):
    monkeypatch.setattr(data, "kinds", ("rgb",))
    with pytest.raises(ValueError, match="^data: expected infrared images, got rgb"):
        Pictures(data, (32, 24))


def test_the_papers_numbers():
    paper = RECIPES["paper"]
    assert (paper.sets, paper.bins, paper.trunk, paper.width) == (30, 40, "bottleneck", 64)
    assert paper.blocks == (3, 4, 6, 3) and paper.optimiser is ADAM


@pytest.mark.parametrize("kind", NETS)
@pytest.mark.parametrize("scale", RECIPES)
def test_a_step_at_every_scale(scale, kind, data):
    recipe = replace(RECIPES[scale], kind=kind)
    pictures = recipe.pictures(data)
    assert pictures.images.shape[:1:-1] == recipe.image
    # Angles all over, so that there are as many steps as classes.
    pictures.values = pictures.values * torch.linspace(0.5, 1.5, 12)[:, None]
    net = recipe.new_net(pictures)
    assert torch.equal(net.low, pictures.values.amin(0))
    assert (net.mean.item(), net.std.item()) == pytest.approx(pictures.brightness())
    (batch,) = recipe.batches(pictures, steps=1, batch=2)
    parts = recipe.new_loss()(net, batch)
    assert parts.keys() == {"loss", "angles", "position"}
    parts["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


def test_first_weights_and_classes_follow_from_the_seed(pictures):
    one, same, other = (TINY.new_net(pictures, seed).state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["classes"], other["classes"])
    assert not torch.equal(one["head.weight"], other["head.weight"])
    with pytest.raises(ValueError, match="^kind: expected"):
        replace(TINY, kind="boxes")


@pytest.mark.slow
@pytest.mark.parametrize("kind", NETS)
def test_it_learns_pictures_by_heart(kind, pictures):
    recipe = replace(TINY, kind=kind)
    history = fit(
        recipe.new_net(pictures), recipe.batches(pictures, steps=20), recipe.new_loss(), steps=20,
        show=False, precision="float32", **recipe.fit,
    )  # fmt: skip
    values = history.losses["loss"]
    assert sum(values[-5:]) < 0.9 * sum(values[:5]), values
