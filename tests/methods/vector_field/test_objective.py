"""The loss of a step: gathered at some pixels it is that of whole images, and it can be learnt."""

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.batches import Batches, CropPool, RandomCrops
from posecore.methods.objects import object_models
from posecore.methods.vector_field.fields import field_targets
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.objective import Objective
from posecore.training import fit, seeded

pytestmark = pytest.mark.slow

IDS = (1, 3)


@pytest.fixture(scope="module")
def crops():
    easy = data_tools.open("tabletop", split="easy", scale="tiny")
    return RandomCrops(batches.load(easy, progress=False), IDS, size=48)


@pytest.fixture(scope="module")
def models():
    return object_models(data_tools.open("tabletop", split="easy", scale="tiny").models(), IDS)


@pytest.mark.parametrize("projection", ["none", "pixel", "unit"])
def test_gathered_first_the_loss_is_that_of_whole_images(crops, models, projection):
    with seeded(0):
        net = VectorFieldNet(2, width=8).eval()
    batch = next(iter(Batches(crops.draw, steps=4, seed=0, batch_size=3)))
    objective = Objective(models, VectorFieldLoss(projection, 0.3), pixels_per_object=None)
    gathered = objective(net, batch)
    fields = net(batch["rgb"])
    targets = field_targets(
        batch,
        torch.stack([torch.from_numpy(model.keypoints).float() for model in models]),
        IDS,
        [model.symmetries if model.symmetric else None for model in models],
        None,
    )
    chosen = fields.vectors[targets.image, targets.object, :, :, targets.y, targets.x]
    whole = VectorFieldLoss(projection, 0.3)(fields.mask, chosen, targets, 0.0)
    for name, value in whole.items():
        torch.testing.assert_close(gathered[name], value, rtol=1e-4, atol=1e-5)


def test_training_lowers_the_loss(crops, models):
    with seeded(0):
        net = VectorFieldNet(2, width=8)
    steps = Batches(crops.draw, steps=30, seed=0, batch_size=4)
    history = fit(net, steps, Objective(models), steps=30, lr=3e-3, show=False, device="cpu")
    mask = np.asarray(history.losses["mask"])
    assert mask[-5:].mean() < 0.7 * mask[:5].mean()


def test_a_pool_teaches_what_its_crops_teach(crops, models):
    (crop,) = Batches(crops.draw, steps=1, seed=0, batch_size=1)
    (drawn,) = Batches(CropPool(crops, batches=1, count=1).draw, steps=1, seed=0, count=1)
    with seeded(0):
        net = VectorFieldNet(len(models), width=8).eval()
    objective = Objective(models, pixels_per_object=None)
    for name, value in objective(net, crop).items():
        torch.testing.assert_close(objective(net, drawn)[name], value, rtol=0.01, atol=1e-4)


def test_crops_without_an_object_of_the_network(models):
    """They have a mask to learn, and no vectors."""
    batch = {
        "rgb": torch.rand(2, 3, 16, 16),
        "K": torch.eye(3).expand(2, 3, 3),
        "instance": torch.full((2, 16, 16), -1),
        "object_id": torch.full((2, 1), 7),
        "R": torch.eye(3).expand(2, 1, 3, 3),
        "t": torch.ones(2, 1, 3),
        "done": torch.tensor(0.5),
    }
    with seeded(0):
        net = VectorFieldNet(2, width=8)
    losses = Objective(models)(net, batch)
    losses["loss"].backward()
    assert losses["vectors"] == losses["projection"] == 0 and losses["mask"] > 0
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


def test_bad_models(models):
    with pytest.raises(ValueError, match="^models"):
        Objective([models[0], models[0]])
