"""Instants that several cameras see: a bright dot tells where everything is."""

import numpy as np
import pytest
import torch

from data_tools import batches
from data_tools.batches import memory
from posecore.cameras import project
from posecore.methods.infrared.masks import object_mask
from posecore.methods.infrared.projection import into_views
from posecore.methods.infrared.triples import Triples, reduced
from tests.methods.infrared.dots import SIZE, Dots, K, centre, load


def drawn(triples, seed=0, count=8, **options):
    generator = torch.Generator().manual_seed(seed)
    return triples.draw(generator=generator, count=count, **options)


def test_what_is_kept_of_each_view(dots, triples):
    views = Dots()
    assert len(triples) == 4 and triples.size == SIZE
    assert triples.images.shape == (4, 3, 1, 48, 64)
    assert triples.masks.shape == triples.shades.shape == (4, 3, 24, 32)
    assert triples.views.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    for g in range(4):
        for j in range(3):
            view = views[3 * g + j]
            glasses = view.objects[0]
            assert np.array_equal(triples.images[g, j, 0], view.ir)
            np.testing.assert_allclose(triples.t[g, j], glasses.t, atol=1e-6)
            np.testing.assert_allclose(triples.R[g, j], glasses.R, atol=1e-6)
            np.testing.assert_allclose(triples.K[g, j], view.K, atol=1e-5)
            np.testing.assert_allclose(triples.T_world_cam[g, j], view.T_world_cam, atol=1e-6)
            halves = glasses.mask.reshape(24, 2, 32, 2).mean((1, 3)) * 255
            assert np.abs(triples.masks[g, j].numpy() - halves).max() <= 0.5
            inside = np.where(glasses.mask, view.ir, 0).reshape(24, 2, 32, 2).mean((1, 3))
            assert np.abs(triples.shades[g, j].numpy() - inside).max() <= 0.5


def test_a_mask_of_ones_own(dots):
    asked = []

    def mask_of(image, K, R, t):
        asked.append((K, R, t))
        return image > 100

    found = Triples(dots, image=SIZE, grid=SIZE, mask_of=mask_of)
    assert torch.equal(found.masks == 255, found.images[:, :, 0] > 100)
    assert len(asked) == 12
    for (camera, R, t), view in zip(asked, Dots(), strict=True):
        assert np.array_equal(camera, view.K)
        assert np.array_equal(R, view.objects[0].R) and np.array_equal(t, view.objects[0].t)


def test_masks_by_the_threshold_need_no_labels():
    found = Triples(load(masks=False), image=SIZE, grid=SIZE)
    for number, view in enumerate(Dots()):
        glasses = view.objects[0]
        expected = object_mask(view.ir, view.K, glasses.R, glasses.t)
        assert 0 < expected.sum() < 100
        assert np.array_equal(found.masks[divmod(number, 3)] == 255, expected)


def test_some_of_the_instants(triples):
    scenes = torch.tensor([0, 1, 0, 1])
    part = triples.only(scenes == 1)
    assert len(part) == 2 and len(triples) == 4
    for name in ("images", "masks", "shades", "K", "T_world_cam", "R", "t", "views"):
        assert torch.equal(getattr(part, name), getattr(triples, name)[[1, 3]])
    assert torch.equal(triples.only(torch.tensor([3])).views, triples.views[3:])
    with pytest.raises(ValueError, match="^chosen: expected one instant or more"):
        triples.only(scenes == 2)


def test_brightness(triples):
    mean, std = triples.brightness()
    values = triples.images.numpy() / 255
    assert (mean, std) == pytest.approx((values.mean(), values.std(ddof=1)), rel=1e-4)
    black = triples.only(torch.tensor([0]))
    black.images = torch.zeros_like(black.images)
    assert black.brightness() == (0, pytest.approx(1e-3))


# Batches ------------------------------------------------------------------------------------------


def test_what_is_drawn_follows_from_the_generator(triples):
    options = {"turn": 10.0, "mirror": True, "views": 2, "looks": 1}
    one, same, other = (drawn(triples, seed, **options) for seed in (0, 0, 1))
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["t"], other["t"])
    before = torch.get_rng_state()
    drawn(triples, **options)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize(
    ("own", "views", "looks", "count"),
    [
        (True, None, None, 3), (True, 1, None, 1), (True, 2, None, 2), (False, None, None, 2),
        (False, 2, None, 1), (True, None, 1, 1), (True, None, 2, 2), (False, 3, 1, 1),
        (True, 2, 1, 1),
    ],
)  # fmt: skip
def test_which_views_the_losses_look_in(triples, own, views, looks, count):
    batch = drawn(triples, count=90, own=own, views=views, looks=looks)
    assert batch["images"].shape == (90, 1, 48, 64) and batch["t"].shape == (90, 3)
    assert batch["own"].shape == (90, 4, 4)
    assert batch["masks"].shape == batch["shades"].shape == (90, count, 24, 32)
    assert batch["K"].shape == (90, count, 3, 3)
    assert batch["T_world_cam"].shape == (90, count, 4, 4)
    for name in ("images", "masks", "shades"):
        assert batch[name].dtype == torch.float32
        assert 0 <= batch[name].min() and 0.5 < batch[name].max() <= 1
    known = triples.T_world_cam[0]
    which = (batch["T_world_cam"][:, :, None] == known).flatten(3).all(-1).int().argmax(-1)
    inputs = (batch["own"][:, None] == known).flatten(2).all(-1).int().argmax(-1)
    assert inputs.bincount(minlength=3).min() >= 15  # each view is an input
    assert which.flatten().bincount(minlength=3).min() >= 15
    for row in which.tolist():
        assert len(set(row)) == count  # none is looked in twice
    # Its own is 0, the next camera's is 1, and so on: only these teach, and all of them do.
    turns = (which - inputs[:, None]) % 3
    teaching = range(0 if own else 1, views or 3)
    shares = turns.flatten().bincount(minlength=3)
    assert {turn for turn in range(3) if shares[turn]} == set(teaching)
    assert min(shares[turn] for turn in teaching) >= 0.6 * 90 * count / len(teaching)
    if looks is None:
        assert (turns == torch.tensor(teaching)).all()


def test_all_of_a_batch_is_of_one_instant(triples):
    batch = drawn(triples, count=20)
    for b in range(20):
        instant = int((triples.t == batch["t"][b]).all(-1).any(-1).nonzero())
        for j in range(3):
            view = (triples.T_world_cam[instant] == batch["T_world_cam"][b, j]).flatten(1).all(1)
            (number,) = view.nonzero().flatten().tolist()
            for name, kept in (("masks", triples.masks), ("shades", triples.shades)):
                assert torch.equal(batch[name][b, j], kept[instant, number].float() / 255)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("turn", [0.0, 6.0])
def test_turned_and_mirrored_all_is_where_the_cameras_have_it(triples, turn, mirror):
    """The dot in the input and in each mask is where its place projects to."""
    batch = drawn(triples, count=24, turn=turn, mirror=mirror)
    places = batch["t"][:, None]
    flipped = 0
    for b in range(24):
        # The camera matrix of the input is that of its own view, the first one.
        pixel = project(batch["K"][b, 0].numpy(), batch["t"][b, None].numpy())[0]
        # Bilinear interpolation of bytes in a picture of a few pixels.
        assert np.abs(centre(batch["images"][b, 0]) - pixel).max() < (0.15 if turn else 0.05)
        flipped += batch["K"][b, 0, 0, 2] != torch.tensor(K[0, 2]).float()
    seen = into_views(places, batch["own"], batch["T_world_cam"])[:, :, 0].numpy()
    for b in range(24):
        for j in range(3):
            u, v = project(batch["K"][b, j].numpy(), seen[b, j][None])[0]
            for name in ("masks", "shades"):
                found = centre(batch[name][b, j]) * 2 + 0.5
                assert np.abs(found - [u, v]).max() < 0.3  # a disc of 6 pixels across
    assert 4 < flipped < 20 if mirror else flipped == 0
    rotations = batch["own"][:, :3, :3]
    assert torch.linalg.det(rotations).allclose(torch.ones(24))
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand(24, 3, 3))


def test_turns_are_no_larger_than_was_asked_for(triples):
    plain = drawn(triples, count=50)
    batch = drawn(triples, count=50, turn=5.0)
    between = plain["own"][:, :3, :3].mT @ batch["own"][:, :3, :3]
    angles = torch.acos(((torch.einsum("bii->b", between) - 1) / 2).clamp(max=1)).rad2deg()
    assert 3 < angles.max() < 5 * 3**0.5 and angles.min() > 0
    for name in ("masks", "shades", "K", "T_world_cam"):  # where losses look nothing is turned
        assert torch.equal(plain[name], batch[name])


def test_the_world_is_mirrored_with_the_cameras(triples):
    plain, batch = drawn(triples, count=20), drawn(triples, count=20, mirror=True)
    flip = batch["t"][:, 0] != plain["t"][:, 0]
    assert 3 < flip.sum() < 17
    for name in plain:
        assert torch.equal(plain[name][~flip], batch[name][~flip])
    for name in ("images", "masks", "shades"):
        assert torch.equal(plain[name][flip], batch[name][flip].flip(-1))
    signs = torch.tensor([-1.0, 1, 1])
    places = []
    for one in (plain, batch):
        places.append((one["own"][:, :3, :3] @ one["t"][..., None])[..., 0] + one["own"][:, :3, 3])
    torch.testing.assert_close(places[0][flip] * signs, places[1][flip])


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"views": 4}, "views"), ({"views": 0}, "views"), ({"views": 1, "own": False}, "views"),
        ({"looks": 0}, "looks"), ({"looks": 4}, "looks"), ({"looks": 2, "views": 1}, "looks"),
        ({"looks": 3, "own": False}, "looks"),
    ],
)  # fmt: skip
def test_more_views_than_there_are(triples, options, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        drawn(triples, **options)


# What cannot be -----------------------------------------------------------------------------------

NO_OBJECTS = {"objects": []}


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"ir": None, "rgb": np.zeros((48, 64, 3), np.uint8)}, {}, "data: expected infrared"),
        ({"T_world_cam": None}, {}, "data: expected calibrated"),
        ({"masks": False}, {"masks": "exact"}, "data: expected masks"),
        (NO_OBJECTS, {"masks": "threshold"}, "data: expected objects"),
        ({}, {"masks": "guessed"}, "masks: expected"),
    ],
)
def test_data_that_lack_something(changes, options, message):
    with pytest.raises(ValueError, match=message):
        Triples(load(**changes), image=SIZE, grid=(32, 24), **options)


def test_a_view_without_an_object_and_instants_of_different_sizes():
    class Some(Dots):
        def __getitem__(self, index):
            self.changes = NO_OBJECTS if index == 4 else {}
            return super().__getitem__(index)

        def __len__(self):
            return self.length

    some = Some()
    for length, message in ((12, "in every view, got view 4"), (11, "groups: expected")):
        some.length = length
        with pytest.raises(ValueError, match=message):
            Triples(batches.load(some, progress=False), image=SIZE, grid=(32, 24))


def test_data_that_do_not_fit_into_memory(dots, monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 12 * (64 * 48 + 2 * 32 * 24))
    Triples(dots, image=SIZE, grid=(32, 24), masks="exact")
    with pytest.raises(ValueError, match="^data: expected images that fit into"):
        Triples(dots, image=SIZE, grid=(33, 24), masks="exact")


def test_images_are_reduced_by_means():
    image = np.arange(48, dtype=np.float32).reshape(6, 8)
    assert np.array_equal(reduced(image, (8, 6)), image)
    found = reduced(image, (4, 3)).numpy()
    assert np.abs(found - image.reshape(3, 2, 4, 2).mean((1, 3))).max() <= 0.5
    assert reduced(image, (16, 12)).shape == (12, 16)
