"""The recipe: its numbers, that everybody uses it, and a step with the largest of them."""

import math
from dataclasses import replace

import pytest
import torch

import data_tools
from book.ch08_vector_fields import comparison, field_training
from data_tools import batches
from data_tools.batches import Augmentation, Batches, CropPool, RandomCrops
from posecore import weights
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.objective import Objective
from posecore.methods.vector_field.recipe import MILD, RECIPES, halved, reduced
from posecore.models import ObjectModel
from posecore.scale import SCALES
from posecore.training import fit, seeded
from posecore.training.loop import ADAM
from posecore.training.muon import Muon


def test_the_papers_numbers():
    paper, varied = RECIPES["paper"], Augmentation()
    assert (paper.width, paper.max_channels, paper.image_width) == (64, None, None)
    assert (paper.crop, paper.batch) == ((640, 480), 32)
    assert (paper.lr, paper.epochs, paper.steps) == (1e-4, 200, None)
    assert (paper.optimiser, paper.pool, paper.pixels, paper.augment) == (ADAM, None, None, varied)
    assert (paper.projection, paper.weight, paper.warmup) == ("pixel", "dynamic", 0)
    assert not paper.ignore_reversed
    assert varied.turn == pytest.approx(math.radians(30))
    assert 1 / varied.zoom <= 0.8 and varied.zoom >= 1.2 and varied.blur > 0
    epochs = [0, 19, 20, 39, 40, 58, 60, 199]  # 58 / 200 * 10 is a little below 2.9
    assert [paper.schedule(epoch / 200) for epoch in epochs] == [
        0.5 ** (epoch // 20) for epoch in epochs
    ]
    assert [halved(step / 100) for step in range(100)] == [0.5 ** (s // 10) for s in range(100)]


def test_what_the_book_found_best():
    book = RECIPES["book"]
    assert (book.width, book.max_channels, book.image_width) == (64, 72, 224)
    assert (book.crop, book.pool, book.batch, book.steps) == ((64, 64), (700, 64), 32, 11_000)
    assert (book.visible, book.shift, book.background_fraction) == (0.15, 0.22, 0.15)
    assert (book.projection, book.weight, book.ignore_reversed) == ("pixel", 0.05, True)
    assert (book.optimiser, book.lr, book.schedule, book.augment) == (Muon, 8e-3, "cosine", MILD)
    assert (book.voting.fit, book.threshold) == ("angles", 0.8)


def test_the_chapter_has_no_numbers_of_its_own(monkeypatch):
    """It compares losses after fewer steps; all else is the recipe's."""
    for scale in SCALES:
        monkeypatch.setenv("POSECORE_SCALE", scale)
        assert field_training.recipe() is RECIPES[scale]
        for name in comparison.LOSSES:
            changed = {
                key: value
                for key, value in vars(comparison.recipe_of(name)).items()
                if value != vars(RECIPES[scale])[key]
            }
            loss = {"projection", "weight", "warmup", "ignore_reversed"}
            assert changed.keys() <= loss | {"steps", "background_fraction"}, name


def test_images_are_reduced_and_never_enlarged():
    assert reduced((320, 240), 224) == (224, 168)
    assert reduced((640, 480), 224) == (224, 168)
    assert reduced((200, 150), 224) == (200, 150)
    assert reduced((320, 240), None) == (320, 240)
    assert reduced((1000, 1), 10) == (10, 1)


@pytest.fixture(scope="module")
def stack():
    return batches.load(data_tools.open("tabletop", split="easy", scale="tiny"), progress=False)


@pytest.mark.slow
def test_crops_follow_from_the_recipe(stack):
    models = field_training.models()
    tiny = RECIPES["tiny"]
    pool = tiny.crops(stack, models, seed=5)
    assert isinstance(pool, CropPool) and (len(pool), pool.seed) == (64, 5)
    assert (pool.crops.zoom, pool.crops.size) == (1, (64, 64))
    assert (pool.crops.shift, pool.crops.background_fraction) == (0.22, 0.15)
    for most, count in ((10**6, 64), (64, 64), (9, 12), (3, 3)):
        assert len(tiny.crops(stack, models, most=most)) == count
    reduced_to = replace(tiny, image_width=48, pool=None).crops(stack, models)
    assert isinstance(reduced_to, RandomCrops)
    assert (reduced_to.zoom, reduced_to.size) == (0.5, (48, 36))
    drawn = tiny.batches(pool, seed=2)
    assert isinstance(drawn, Batches) and (len(drawn), drawn.seed) == (20, 2)
    assert next(iter(drawn))["rgb"].shape == (4, 3, 64, 64)
    assert len(tiny.batches(pool, steps=3, batch=2)) == 3


@pytest.mark.slow
def test_data_without_visible_fractions(stack, monkeypatch):
    monkeypatch.setattr(stack, "visible_fraction", None)
    assert len(RECIPES["tiny"].crops(stack, field_training.models())) == 64


@pytest.mark.slow
def test_the_ledger_trains_what_the_recipe_says(stack):
    """The network of a loss, trained by the recipe alone, is that of the chapter bit for bit."""
    models, recipe = field_training.models(), comparison.recipe_of("pixel")
    net = recipe.new_net(models, 1)
    data = batches.load(data_tools.open("tabletop", split="train", scale="tiny"), progress=False)
    crops = recipe.crops(data, models)
    fit(
        net, recipe.batches(crops, seed=1), recipe.objective(models), steps=recipe.steps, seed=1,
        device="cpu", show=False, **recipe.fit_field,
    )  # fmt: skip
    ours, _ = field_training.train_net(recipe, seed=1, keep=False)
    assert weights.digest(net.state_dict()) == weights.digest(ours.state_dict())


def test_the_system_is_told_how_to_vote():
    models = field_training.models()
    net = RECIPES["tiny"].new_net(models)
    system = RECIPES["tiny"].system("OPEPL", net, models)
    assert (system.voting, system.threshold) == (RECIPES["tiny"].voting, 0.8)
    other = RECIPES["tiny"].system("OPEPL", net, models, threshold=0.3)
    assert (other.threshold, other.refine) == (0.3, "never")


@pytest.mark.slow
def test_a_step_at_paper_scale(rng):
    """Shapes, and one step of the whole network on two whole images."""
    paper = RECIPES["paper"]
    (width, height), K = paper.crop, [[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]]
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
