"""The recipe: what is made of its numbers."""

from dataclasses import replace

import pytest
import torch

from posecore.methods.infrared.losses import CloudLoss
from posecore.methods.infrared.recipe import RECIPES
from posecore.training.loop import ADAM
from tests.methods.infrared.dots import SIZE

SMALL = replace(RECIPES["tiny"], image=SIZE, grid=(32, 24, 16), points=40, width=4, blocks=3)


def test_the_papers_numbers():
    paper = RECIPES["paper"]
    assert (paper.image, paper.grid, paper.points) == ((320, 188), (160, 94, 160), 2000)
    assert (paper.optimiser, paper.lr, paper.schedule, paper.masks) == (
        ADAM, 1e-4, "constant", "threshold",
    )  # fmt: skip
    loss = paper.new_loss((1280, 752))
    assert loss.weights == (0.2, 0.2, 0.6) and loss.mask_blur == (0.2, 1.0)
    assert loss.box_units and loss.by_resolution and loss.use_scale and loss.relative
    assert loss.projector.image == (1280, 752) and loss.projector.size == paper.grid
    assert paper.max_channels is None and not paper.mirror and paper.turn == 0


@pytest.mark.parametrize("scale", RECIPES)
def test_grids_have_the_field_of_view_of_images(scale):
    """And voxels that are about cubes where heads are."""
    recipe = RECIPES[scale]
    (width, height), (columns, rows, slices) = recipe.image, recipe.grid
    assert width == 2 * columns and abs(height / rows - 2) < 0.05
    across = 0.75 / (1.17 * columns)  # metres at 0.75 m, by the focal length of headset's cameras
    assert 0.7 < recipe.extent / slices / across < 1.4


@pytest.mark.parametrize("scale", RECIPES)
def test_a_run_goes_from_few_points_and_much_blur_to_all_and_little(scale):
    loss = RECIPES[scale].new_loss((80, 47))
    assert isinstance(loss, CloudLoss)
    assert loss.keep[0] < loss.keep[1] == 1 and loss.blur[0] > loss.blur[1]


def test_triples_are_of_its_sizes_and_masks(dots):
    found = SMALL.triples(dots)
    assert found.images.shape == (4, 3, 1, 48, 64) and found.masks.shape == (4, 3, 24, 32)
    threshold = replace(SMALL, masks="threshold").triples(dots)
    assert not torch.equal(found.masks, threshold.masks)
    own = SMALL.triples(dots, lambda image, *_: image > 300)
    assert not own.masks.any()


def test_a_new_network_knows_its_data(triples):
    net = SMALL.new_net(triples)
    t = triples.t.reshape(-1, 3)
    assert torch.equal(net.low, t.min(0).values) and torch.equal(net.high, t.max(0).values)
    assert (net.mean.item(), net.std.item()) == pytest.approx(triples.brightness())
    plain = replace(SMALL, normalised=False).new_net(triples)
    assert (plain.mean.item(), plain.std.item()) == (0, 1)
    cloud = net(triples.images[0].float() / 255)
    assert cloud.points.shape == (3, 40, 3)


def test_first_weights_follow_from_the_seed(triples):
    before = torch.get_rng_state()
    one, same, other = (SMALL.new_net(triples, seed) for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(one.points.weight, same.points.weight)
    assert not torch.equal(one.points.weight, other.points.weight)


def test_batches_are_as_many_and_as_large_as_it_says(triples):
    recipe = replace(SMALL, looks=2, own_view=False, steps=3, batch=5)
    found = list(recipe.batches(triples))
    assert [float(batch["done"]) for batch in found] == pytest.approx([0, 1 / 3, 2 / 3])
    assert all(batch["images"].shape == (5, 1, 48, 64) for batch in found)
    assert all(batch["masks"].shape == (5, 2, 24, 32) for batch in found)
    (short,) = recipe.batches(triples, steps=1, batch=2)
    assert short["t"].shape == (2, 3)
    (other,) = recipe.batches(triples, steps=1, batch=2, seed=1)
    assert not torch.equal(short["t"], other["t"])
    lots = replace(SMALL, turn=20.0, mirror=True, batch=40)
    (varied,) = lots.batches(triples, steps=1)
    signs = torch.linalg.det(varied["own"][:, :3, :3] @ triples.T_world_cam[0, 0, :3, :3].mT)
    torch.testing.assert_close(signs, torch.ones(40))
    assert not (varied["own"][:, None] == triples.T_world_cam[0]).flatten(2).all(-1).any()
    cx = varied["K"][:, 0, 0, 2]
    assert 10 < (cx == triples.K[0, 0, 0, 2]).sum() < 30


def test_what_fit_is_told():
    assert SMALL.fit.keys() == {"lr", "schedule", "optimiser", "clip"}
    assert SMALL.fit["lr"] == SMALL.lr and SMALL.fit["optimiser"] is SMALL.optimiser
