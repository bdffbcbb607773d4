"""Random crops: parts of images with all that is known of them; and pools of them."""

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.batches import Batches, CropPool, RandomCrops
from posecore import cameras, poses

pytestmark = pytest.mark.slow

IDS = (1, 3)


@pytest.fixture(scope="module")
def stack():
    return batches.load(data_tools.open("tabletop", split="easy", scale="tiny"), progress=False)


@pytest.fixture(scope="module")
def points():
    """Of the surface of each object, by its number."""
    models = data_tools.open("tabletop", split="easy", scale="tiny").models()
    return {number: models.mesh(number).vertices for number in IDS}


@pytest.fixture
def crops(stack):
    def make(**options):
        return RandomCrops(stack, IDS, **({"size": 48} | options))

    return make


def first(crops, count, seed=0):
    return next(iter(Batches(crops.draw, seed=seed, batch_size=count)))


def same(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


def test_a_crop_shows_what_its_labels_say(crops, points):
    batch = first(crops(shift=0, augment=batches.Augmentation(), visible=0.5), 8)
    assert batch["rgb"].shape == (8, 3, 48, 48) and batch["instance"].shape == (8, 48, 48)
    compared = 0
    for b in range(8):
        shown = batch["instance"][b].unique().tolist()
        assert set(batch["object_id"][b][[i for i in shown if i >= 0]].tolist()) & set(IDS)
        for slot in shown:
            if slot < 0 or int(batch["object_id"][b, slot]) not in points:
                continue
            surface = points[int(batch["object_id"][b, slot])]
            here = poses.apply(batch["R"][b, slot], batch["t"][b, slot], surface)
            pixels = cameras.project(batch["K"][b], here.float())
            y, x = (batch["instance"][b] == slot).nonzero(as_tuple=True)
            low, high = pixels.amin(0), pixels.amax(0)
            seen = torch.stack([x, y], -1)
            assert bool((seen >= low - 1).all() and (seen <= high + 1).all())
            compared += 1
    assert compared >= 8


def test_an_unmoved_crop_is_a_part_of_its_image(stack, crops):
    batch = first(crops(shift=0), 3)
    whole = stack.frames(torch.arange(len(stack)))
    for b in range(3):
        inside = batch["rgb"][b, :, 20:28, 20:28]
        parts = whole["rgb"].unfold(2, 8, 1).unfold(3, 8, 1)  # (V, 3, ..., ..., 8, 8)
        away = (parts - inside[:, None, None]).abs().amax((1, 4, 5)).amin()
        # The box's middle may lie between pixels: then half a pixel is interpolated.
        assert away < 0.35


def test_a_zoomed_crop_shows_more_and_its_camera_knows(crops):
    plain = first(crops(shift=0, visible=0.5), 6)
    zoomed = first(crops(shift=0, visible=0.5, size=24, zoom=0.5), 6)
    assert zoomed["rgb"].shape[2:] == (24, 24)
    torch.testing.assert_close(zoomed["K"][:, 0, 0], plain["K"][:, 0, 0] / 2)
    for one, two in zip(plain["K"], zoomed["K"], strict=True):  # the same corner
        torch.testing.assert_close(2 * (two[:2, 2] + 0.5), one[:2, 2] + 0.5, atol=1e-3, rtol=0)
    for name in ("object_id", "R", "t"):
        assert torch.equal(plain[name], zoomed[name])
    means = plain["rgb"].unfold(2, 2, 2).unfold(3, 2, 2).mean((-2, -1))
    assert float((means - zoomed["rgb"]).abs().mean()) < 0.02


def test_crops_anywhere(crops, stack):
    """None without asking, and then some; what they show is still what their labels say."""

    def shown(**options):
        batch = first(crops(size=24, shift=0, visible=0.5, **options), 32)
        known = torch.isin(batch["object_id"], torch.tensor(IDS)).any(1)
        seen = torch.stack([
            torch.isin(row[labels.clamp(min=0)], torch.tensor(IDS))[labels >= 0].any()
            for row, labels in zip(batch["object_id"], batch["instance"], strict=True)
        ])  # fmt: skip
        return batch, float((known & seen).double().mean())

    without, always = shown()
    again, same_share = shown(background_fraction=0.0)
    assert same(without, again) and always == same_share == 1
    _, some = shown(background_fraction=0.5)
    batch, rare = shown(background_fraction=1.0)
    assert rare < some < always and rare < 0.5
    middles = (torch.tensor([11.5, 11.5]) - batch["K"][:, :2, 2]) / batch["K"][:, [0, 1], [0, 1]]
    whole = stack.frames(torch.tensor([0]))["K"][0]
    pixels = middles * whole[[0, 1], [0, 1]] + whole[:2, 2]
    width, height = stack.size
    assert bool((pixels >= -1).all()) and bool((pixels <= torch.tensor([width, height])).all())
    assert pixels[:, 0].max() - pixels[:, 0].min() > 0.6 * width  # and not only in the middle


def test_a_pool_has_the_crops_that_were_cut(crops):
    augment = batches.Augmentation()
    cut = list(Batches(crops(augment=augment).draw, seed=2, steps=5, batch_size=2))
    pool = CropPool(crops(augment=augment), batches=5, count=2, seed=2)
    assert len(pool) == 10
    seen = set()
    for batch in Batches(pool.draw, seed=0, steps=30, batch_size=3):
        assert batch["rgb"].shape == (3, 3, 48, 48) and batch["rgb"].dtype == torch.float32
        for b in range(3):
            away = [
                float((batch["rgb"][b] - window["rgb"][w]).abs().max())
                for window in cut
                for w in range(2)
            ]
            row = int(np.argmin(away))
            assert away[row] < 0.51 / 255
            for name in batch.keys() - {"rgb", "done"}:
                assert torch.equal(batch[name][b], cut[row // 2][name][row % 2]), name
            seen.add(row)
    assert len(seen) == 10  # of 90 draws


def test_a_pool_is_cut_when_it_is_wanted_and_once(crops, monkeypatch):
    cut, draw = [], RandomCrops.draw

    def counted(self, count, *, generator):
        cut.append(count)
        return draw(self, count, generator=generator)

    monkeypatch.setattr(RandomCrops, "draw", counted)
    pool = CropPool(crops(), batches=3, count=2)
    one, other = (Batches(pool.draw, seed=seed, steps=4, batch_size=2) for seed in (0, 1))
    one.load_state_dict({**one.state_dict(), "step": 4})
    assert list(one) == [] and cut == []  # a training that is finished
    assert len(list(other)) == 4 and cut == [2, 2, 2]  # all of them, whatever was drawn before
    assert len(list(one)) == 4 and len(cut) == 3


def test_all_images_have_as_many_places_as_the_fullest(stack, crops):
    batch = first(crops(), 5)
    assert batch["object_id"].shape == (5, stack.most_objects)
    for name in ("R", "t"):
        assert (batch[name][batch["object_id"] < 0] == -1).all()


def test_other_seeds_have_other_crops(crops):
    assert not torch.equal(first(crops(), 3)["rgb"], first(crops(), 3, seed=1)["rgb"])


BAD = [
    ({"size": 0}, "size"),
    ({"size": (32, 0)}, "size"),
    ({"size": 0.5}, "size"),
    ({"size": (1, 2, 3)}, "size"),
    ({"shift": -0.1}, "shift"),
    ({"shift": np.nan}, "shift"),
    ({"visible": 2}, "visible"),
    ({"zoom": 0}, "zoom"),
    ({"background_fraction": 1.5}, "background_fraction"),
    ({"background_fraction": np.nan}, "background_fraction"),
]


@pytest.mark.parametrize("options, name", BAD)
def test_bad_input(crops, options, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        crops(**options)


def test_bad_objects_counts_and_pools(stack, crops):
    with pytest.raises(ValueError, match=r"^data.*77"):
        RandomCrops(stack, [77])
    with pytest.raises(ValueError, match="^count"):
        crops().draw(0, generator=torch.Generator())
    for options, name in (
        ({"batches": 0}, "batches"),
        ({"count": 0}, "count"),
        ({"seed": -1}, "seed"),
    ):
        with pytest.raises(ValueError, match=f"^{name}"):
            CropPool(crops(), **({"batches": 1, "count": 1} | options))
    with pytest.raises(ValueError, match="^crops: expected a RandomCrops"):
        CropPool([1], batches=1, count=1)
