import dataclasses
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_tools import batches
from data_tools.batches import Augmentation
from data_tools.batches.files import CHUNK_SIZE
from data_tools.storage import DamageWarning, MakingError, cache_size, clean
from data_tools.views import ObjectView
from tests.data_tools.batches.conftest import K, Listed, load, make_view, open_world


@pytest.mark.slow
def test_triples(stack_of):
    stack = stack_of("headset")
    assert stack.groups.tolist() == np.arange(48).reshape(16, 3).tolist()
    batch = stack.frames(stack.groups[2:4])
    assert batch["ir"].shape == (2, 3, 1, 47, 80)
    assert batch["K"].shape == (2, 3, 3, 3)
    assert batch["view"].tolist() == [[6, 7, 8], [9, 10, 11]]
    flat = stack.frames(torch.arange(6, 12))
    assert torch.equal(batch["ir"].flatten(0, 1), flat["ir"])
    for name in ("object_id", "R", "t", "box", "instance"):
        assert torch.equal(batch[name].flatten(0, 1), flat[name])


@pytest.mark.slow
def test_the_second_time_nothing_is_decoded(stack_of, cache, monkeypatch):
    stack = stack_of("tabletop")

    def refuse(*_):
        raise AssertionError("decoded again")

    monkeypatch.setattr("data_tools.batches.stacking.make_chunk", refuse)
    again = batches.load(open_world("tabletop"), progress=False)
    assert torch.equal(again.R, stack.R)
    a, b = (s.frames(torch.arange(10)) for s in (stack, again))
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_what_nothing_identifies_stays_in_memory(tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path))
    source = Listed([make_view(i) for i in range(CHUNK_SIZE + 3)])
    stack = batches.load(source, progress=False)
    assert source.asked == CHUNK_SIZE + 3
    stack.frames(torch.tensor([0, CHUNK_SIZE + 2]))
    assert source.asked == CHUNK_SIZE + 3
    assert not list(tmp_path.iterdir())


def small_world(folder):
    from data_tools.worlds import headset

    dataset = headset.WORLD.open(split="test", scale="tiny", processes=1, progress=False)
    return batches.load(dataset, folder=folder, progress=False)


def damage(kind, path):
    data = bytearray(path.read_bytes())
    if kind == "image":
        data[len(data) // 2] ^= 16
    elif kind == "table":
        data[1000] ^= 16
    path.write_bytes({"empty": b"", "cut": data[:-100], "other": b"x" * 99}.get(kind, bytes(data)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["image", "table", "empty", "cut", "other"])
def test_damage_is_found_named_and_mended(cache, tmp_path, kind):
    whole = small_world(tmp_path).frames(torch.arange(48))
    (path,) = tmp_path.rglob("*.shard")
    before = path.read_bytes()
    damage(kind, path)
    with pytest.warns(DamageWarning, match=f"{path.name}: .*made again"):
        mended = small_world(tmp_path).frames(torch.arange(48))
    assert all(torch.equal(mended[name], whole[name]) for name in whole)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_half_written_files_do_no_harm(cache, tmp_path):
    small_world(tmp_path)
    (path,) = tmp_path.rglob("*.shard")
    path.with_name(f".{path.name}.{'0a' * 8}.tmp").write_bytes(b"half")
    assert len(small_world(tmp_path)) == 48


@pytest.mark.slow
def test_clean_takes_it_away(cache, tmp_path, monkeypatch):
    small_world(tmp_path)
    files = list(tmp_path.rglob("*.shard"))
    name = files[0].parent.relative_to(tmp_path).as_posix()
    assert cache_size(tmp_path) == {name: files[0].stat().st_size}
    assert name.startswith("headset-stack/")
    clean(tmp_path)
    assert not list(tmp_path.rglob("*.shard"))


@pytest.mark.slow
def test_a_full_disk_leaves_nothing_half(cache, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("data_tools.batches.files.write_bytes", full)
        with pytest.raises(MakingError, match=r"000000\.shard: cannot be written: No space"):
            small_world(tmp_path)
    assert not list(tmp_path.rglob("*.shard"))
    assert len(small_world(tmp_path)) == 48


@pytest.mark.slow
def test_pickled(cache, tmp_path):
    stack = small_world(tmp_path)
    again = pickle.loads(pickle.dumps(stack))
    assert len(pickle.dumps(stack)) < 1e5
    assert torch.equal(again.frames(torch.arange(3))["ir"], stack.frames(torch.arange(3))["ir"])


def test_where_masks_overlap_the_nearer_object_is_seen():
    stack = load([make_view(0, 2)])
    batch = stack.frames(torch.tensor([0]))
    first, second = (view.mask for view in make_view(0, 2).objects)
    assert np.array_equal(batch["instance"][0] == 0, first)
    assert np.array_equal(batch["instance"][0] == 1, second & ~first)


def located(item, share=1.0):
    """The object with coordinates, and a visible fraction."""
    changed = {"coordinates": np.float32(item.mask[..., None] * [0.1, 0.1, 0.1]) * item.object_id}
    return dataclasses.replace(item, **changed, visible_fraction=share)


def test_where_masks_overlap_coordinates_are_those_of_the_nearer_object():
    """The nearer one is first in the list, and so written over if the order were the list's."""
    objects = [located(item) for item in make_view(0, 2).objects]
    batch = load([make_view(0, objects=objects)]).frames([0])
    for row, item in enumerate(objects):
        seen = (batch["instance"][0] == row).numpy()
        assert seen.sum() > 10
        z = batch["coordinates"][0][seen][:, 2] + item.t[2]
        assert np.allclose(z, item.coordinates[seen][:, 2] + item.t[2], atol=1e-4)


def test_surfaces_too_far_away_to_be_kept_have_no_coordinates():
    (item,) = make_view(0).objects
    objects = [located(dataclasses.replace(item, t=np.array([0, 0, 7.0])))]
    batch = load([make_view(0, objects=objects)]).frames([0])
    assert (batch["instance"] == 0).any() and not batch["coordinates"].any()


def test_views_without_objects_fit_in_anywhere():
    """Nothing is known of masks and coordinates there, or all."""
    full = make_view(1, objects=[located(item) for item in make_view(1).objects])
    bare = make_view(2, objects=[ObjectView(object_id=1, R=np.eye(3), t=[0, 0, 1.0])])
    empty = [make_view(i, 0) for i in range(CHUNK_SIZE)]
    for views in ([full, empty[0]], [empty[0], full], [*empty, full]):
        stack = load(views)
        assert stack.kinds == ("rgb", "instance", "surface")
        batch = stack.frames([0, len(views) - 1])
        assert batch["coordinates"].any() and (batch["instance"] == 0).sum() == 150
    for views in ([bare, empty[0]], [empty[0], bare], [*empty, bare], [full, bare]):
        assert load(views).kinds == ("rgb",)
    with pytest.raises(ValueError, match=f"^view {CHUNK_SIZE}: "):
        load([*empty, make_view(0, rgb=None, depth=np.ones((24, 32), np.float32))])


def test_a_fraction_of_0_beside_a_mask():
    """Published fractions are rounded; the whole silhouette says more."""
    (item,) = make_view(0).objects
    item = dataclasses.replace(item, full_mask=np.ones_like(item.mask), visible_fraction=0.0)
    batch = load([make_view(0, objects=[item])]).frames([0])
    assert np.isclose(batch["visible_fraction"].item(), item.mask.mean())


def test_what_is_not_known_is_not_there():
    bare = [ObjectView(object_id=1, R=np.eye(3), t=np.array([0, 0, 1.0]), box=[3, 3, 9, 9])]
    stack = load([make_view(0, objects=bare), make_view(1, objects=bare)])
    for name in ("T_world_cam", "visible_fraction", "object_size", "category", "categories"):
        assert getattr(stack, name) is None
    plain = Augmentation(background=0, occluder=0)
    batch = stack.crops(torch.arange(2), 16, augment=plain, generator=torch.Generator())
    assert set(batch) == {"view", "group", "K", "row", "object_id", "R", "t", "rgb"}


def test_images_without_objects():
    stack = load([make_view(0, 0), make_view(1, 1), make_view(2, 0)])
    augment = Augmentation(background=1, occluder=1)
    batch = stack.frames(torch.arange(3), augment=augment, generator=torch.Generator())
    assert batch["object_id"].tolist() == [[-1], [1], [-1]] and batch["R"].shape == (3, 1, 3, 3)
    empty = stack.frames(torch.tensor([0, 2]))
    assert (empty["R"] == -1).all() and (empty["box"] == -1).all()
    nothing = load([make_view(0, 0)]).frames(torch.tensor([0, 0]))
    assert nothing["R"].shape == (2, 0, 3, 3) and (nothing["instance"] == -1).all()


def test_an_image_has_a_place_for_each_object_and_minus_one_beside():
    stack = load([make_view(0, 1), make_view(1, 3), make_view(2, 2)])
    batch = stack.frames(torch.tensor([2, 1, 2]))
    assert batch["object_id"].shape == (3, 3)
    assert [(row >= 0).sum().item() for row in batch["object_id"]] == [2, 3, 2]
    for b, view in enumerate((2, 1, 2)):
        rows = batch["row"][b][batch["row"][b] >= 0]
        assert torch.equal(rows, (stack.view == view).nonzero()[:, 0])
        assert torch.equal(batch["R"][b, : len(rows)].double(), stack.R[rows])
        seen = batch["instance"][b].unique()
        assert set(seen.tolist()) <= {-1, *range(len(rows))}
    assert torch.equal(batch["instance"][0], batch["instance"][2])


@given(st.integers(1, 3), st.integers(1, 30), st.integers(1, 30), st.floats(0.5, 3))
def test_crops_hold_the_box(count, width, height, margin):
    stack = load([make_view(i, count) for i in range(2)])
    rows = stack.rows()
    batch = stack.crops(rows, (width, height), margin=margin)
    assert batch["rgb"].shape == (len(rows), 3, height, width)
    assert batch["mask"].shape == (len(rows), height, width)
    f = batch["K"][:, 0, 0] / 100
    sides = stack.box[rows, 2:].numpy()
    expected = np.minimum(width / sides[:, 0], height / sides[:, 1]) / margin
    assert np.allclose(f, expected, rtol=1e-5)
    middle = (stack.box[rows, :2] + (stack.box[rows, 2:] - 1) / 2).numpy()
    at = (middle - K[:2, 2]) * expected[:, None] + batch["K"][:, :2, 2].numpy()
    assert np.allclose(at, [(width - 1) / 2, (height - 1) / 2], atol=1e-3)


def test_boxes_of_a_detector():
    stack = load([make_view(0)])
    batch = stack.crops(torch.tensor([0]), (10, 8), margin=1, boxes=torch.tensor([[4, 6, 10, 8]]))
    image = make_view(0).rgb[6:14, 4:14].transpose(2, 0, 1) / 255
    assert np.allclose(batch["rgb"][0], image, atol=1e-6)


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 12), st.integers(0, 10)), min_size=1))
def test_windows_are_parts_of_the_whole(corners):
    stack = load([make_view(i, 2) for i in range(3)])
    views = torch.tensor([view for view, _, _ in corners])
    boxes = torch.tensor([[x, y, 16, 12] for _, x, y in corners])
    windows, whole = stack.frames(views, (16, 12), boxes=boxes), stack.frames(views)
    for i, (_, x, y) in enumerate(corners):
        part = slice(y, y + 12), slice(x, x + 16)
        assert np.allclose(windows["rgb"][i], whole["rgb"][i][:, *part], atol=1e-6)
        assert windows["instance"][i].equal(whole["instance"][i][part])
        assert np.allclose(windows["K"][i, :2, 2], whole["K"][i, :2, 2] - torch.tensor([x, y]))
    assert windows["R"].equal(whole["R"])


STACK = load([make_view(i, 2) for i in range(3)])
SEVERAL = [make_view(0), make_view(1, rgb=np.zeros((24, 33, 3), np.uint8), objects=[])]
KINDS = [make_view(0), make_view(1, rgb=None, ir=np.zeros((24, 32), np.uint8))]
UNSEEN = load([make_view(0, objects=[ObjectView(object_id=1, R=np.eye(3), t=[0, 0, 1.0])])])
ROWS = torch.arange(2)
BAD = [
    (lambda: batches.load("tabletop"), "dataset"),
    (lambda: load([]), "dataset"),
    (lambda: batches.load(Listed([make_view(0)]), depth_step=0), "depth_step"),
    (lambda: load(SEVERAL), "view 1"),
    (lambda: load(KINDS), "view 1"),
    (lambda: load([make_view(0, rgb=None, objects=[])]), "view 0"),
    (lambda: STACK.frames(torch.tensor([3])), "views"),
    (lambda: STACK.frames(torch.tensor([-1])), "views"),
    (lambda: STACK.frames([]), "views"),
    (lambda: STACK.frames([0.5]), "views"),
    (lambda: STACK.frames(ROWS, 0), "size"),
    (lambda: STACK.frames(ROWS, boxes=torch.ones(3, 4)), "boxes"),
    (lambda: STACK.frames(ROWS, boxes=torch.zeros(2, 4)), "boxes"),
    (lambda: STACK.frames(ROWS, augment=Augmentation()), "generator"),
    (lambda: STACK.frames(ROWS, augment=0.5), "augment"),
    (lambda: STACK.crops(torch.tensor([6])), "rows"),
    (lambda: STACK.crops(ROWS[:, None]), "rows"),
    (lambda: STACK.crops(ROWS, 128.0), "size"),
    (lambda: STACK.crops(ROWS, margin=0), "margin"),
    (lambda: STACK.crops(ROWS, boxes=np.ones((3, 4))), "boxes"),
    (lambda: STACK.crops(ROWS, boxes=np.full((2, 4), np.nan)), "boxes"),
    (lambda: STACK.crops(ROWS, boxes=np.zeros((2, 4))), "boxes"),
    (lambda: STACK.crops(ROWS, boxes=[1, 2, 3, 4]), "boxes"),
    (lambda: STACK.crops(ROWS, boxes="all"), "boxes"),
    (lambda: batches.load(Listed([make_view(0)]), folder=3), "folder"),
    (lambda: UNSEEN.crops(torch.tensor([0])), "rows"),
    (
        lambda: UNSEEN.frames(ROWS[:1], augment=Augmentation(), generator=torch.Generator()),
        "augment",
    ),
]


@pytest.mark.parametrize("call, name", BAD)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
