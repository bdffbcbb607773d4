"""The numbers of the three scales, and a step with the largest of them."""

import math

import pytest
import torch
from posecore.methods.vector_field.learning import Objective
from posecore.methods.vector_field.plans import PLANS, halved

from book.ch08_vector_fields import field_training
from data_tools.batches import Augmentation
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.models import ObjectModel
from posecore.training import fit, seeded
from posecore.training.loop import ADAM
from posecore.training.muon import Muon


def test_the_papers_numbers():
    paper, varied = PLANS["paper"], Augmentation()
    assert (paper.width, paper.max_channels) == (64, None)
    assert (paper.window, paper.batch) == ((640, 480), 32)
    assert (paper.lr, paper.epochs, paper.steps) == (1e-4, 200, None)
    assert (paper.optimiser, paper.looks, paper.pixels, paper.augment) == (ADAM, None, None, varied)
    assert (paper.warmup, paper.ignore_reversed) == (0, False)
    assert varied.turn == pytest.approx(math.radians(30))
    assert 1 / varied.zoom <= 0.8 and varied.zoom >= 1.2 and varied.blur > 0
    epochs = [0, 19, 20, 39, 40, 58, 60, 199]  # 58 / 200 * 10 is a little below 2.9
    assert [paper.schedule(epoch / 200) for epoch in epochs] == [
        0.5 ** (epoch // 20) for epoch in epochs
    ]
    assert [halved(step / 100) for step in range(100)] == [0.5 ** (s // 10) for s in range(100)]


def test_the_books_numbers_are_those_of_its_experiments(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "book")
    book, chapter = PLANS["book"], field_training
    sizes = chapter.width(), chapter.max_channels()
    assert (book.width, book.max_channels, book.augment) == (*sizes, chapter.VARIED)
    assert (book.window, book.batch, book.steps, book.looks) == ((96, 96), 32, 9000, 8)
    assert (book.visible, book.shift, book.pixels) == (0.15, 0.22, 256)
    assert (book.optimiser, book.lr, book.schedule) == (Muon, 8e-3, "cosine")
    assert (book.warmup, book.ignore_reversed) == (0.15, True)


@pytest.mark.slow
def test_a_step_at_paper_scale(rng):
    """Shapes, and one step of the whole network on two whole images."""
    paper = PLANS["paper"]
    (width, height), K = paper.window, [[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]]
    points = rng.uniform(-0.05, 0.05, (300, 3))
    model = ObjectModel(6, points, 0.15, points[:9])
    instance = torch.full((2, height, width), -1)
    instance[:, 200:260, 300:380] = 0
    batch = {
        "rgb": torch.rand(2, 3, height, width),
        "instance": instance,
        "K": torch.tensor([K, K]),
        "object_id": torch.full((2, 1), 6),
        "R": torch.eye(3).expand(2, 1, 3, 3),
        "t": torch.tensor([0.0, 0, 1]).expand(2, 1, 3),
        "done": torch.tensor(0.0),
    }
    seen = {}

    def loss(net, batch):
        seen["features"] = net.features(batch["rgb"])
        net.features = lambda images: seen["features"]
        parts = Objective([model], VectorFieldLoss(), paper.pixels)(net, batch)
        seen["mask"] = net.mask(seen["features"])
        del net.features
        return parts

    with seeded(0):
        net = VectorFieldNet(1, 9, paper.width)
    before = {name: value.clone() for name, value in net.named_parameters()}
    history = fit(net, [batch], loss, steps=1, lr=paper.lr, schedule=paper.schedule, device="cpu")
    assert seen["features"].shape == (2, 32, height, width)
    assert seen["mask"].shape == (2, 2, height, width)
    assert math.isfinite(history.losses["loss"][0])
    same = [name for name, value in net.named_parameters() if torch.equal(value, before[name])]
    assert same == []
