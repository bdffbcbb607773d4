import pickle
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import data_tools
from data_tools import batches
from data_tools.bop import RotationWarning
from data_tools.linemod import LinemodDataset
from data_tools.linemod import dataset as module
from posecore.rotations import is_rotation

LINEMOD_K = [[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]]


def everything(path, split=None, **options):
    """Read all there is."""
    dataset = LinemodDataset(path, split, **options)
    list(dataset)
    for object_id in dataset.models().ids:
        dataset.models().mesh(object_id)
        dataset.models().info(object_id)
    return dataset


def check_view(made, view, object_id, image):
    assert (view.scene_id, view.image_id) == (object_id, image)
    assert view.group == (object_id, image)
    (item,) = view.objects
    assert item.object_id == object_id
    np.testing.assert_allclose(item.R, made.R[image], atol=1e-15)
    np.testing.assert_allclose(item.t, made.t[image], rtol=1e-15)
    assert item.category is None and item.full_mask is None and item.visible_fraction is None
    return item


def test_everything_in_a_view_of_pvnet(pvnet):
    dataset = data_tools.open(f"linemod:{pvnet.path}", split="train")
    assert isinstance(dataset, LinemodDataset)
    assert dataset.images == [(6, 0), (6, 12), (10, 0), (10, 12)]
    assert len(dataset) == 4 and dataset.object_ids == (6, 10)
    assert repr(dataset).endswith("'train' of cat, eggbox: 4 images)")
    for view, (object_id, image) in zip(dataset, dataset.images, strict=True):
        item = check_view(pvnet, view, object_id, image)
        np.testing.assert_array_equal(view.K, LINEMOD_K)
        assert np.abs(view.rgb.astype(int) - pvnet.rgb[object_id, image]).max() <= 4  # JPEG
        np.testing.assert_array_equal(item.mask, pvnet.mask[object_id, image])
        assert view.depth is None and view.ir is None and item.box is None
        sides = {6: [0.05, 0.07, 0.03], 10: [0.04, 0.03, 0.02]}[object_id]
        np.testing.assert_allclose(item.size, sides, atol=1e-9)
        assert len(item.symmetries) == {6: 1, 10: 2}[object_id]
    assert dataset[-1].image_id == 12 and dataset[np.int64(0)].image_id == 0
    with pytest.raises(IndexError):
        dataset[4]
    with pytest.raises(TypeError):
        dataset[:2]


def test_everything_in_a_view_of_densefusion(densefusion):
    dataset = data_tools.open(f"linemod:{densefusion.path}", split="test")
    assert dataset.images == [(1, 3), (1, 7), (2, 3), (2, 7)]
    for view, (object_id, image) in zip(dataset, dataset.images, strict=True):
        item = check_view(densefusion, view, object_id, image)
        np.testing.assert_array_equal(view.K, np.reshape(densefusion.K[image], (3, 3)))
        np.testing.assert_array_equal(view.rgb, densefusion.rgb[object_id, image])
        depth = np.float32(densefusion.depth[object_id, image] / 1000)
        np.testing.assert_array_equal(view.depth, depth)
        np.testing.assert_array_equal(item.mask, densefusion.mask[object_id, image])
        np.testing.assert_array_equal(item.box, [image, 2, 5, 6])
        sides = {1: [0.09, 0.06, 0.04], 2: [0.06, 0.08, 0.02]}[object_id]
        np.testing.assert_allclose(item.size, sides, atol=1e-9)
        np.testing.assert_array_equal(item.symmetries, np.eye(4)[None])


def test_everything_in_a_view_of_an_own_object(own):
    dataset = data_tools.open(f"linemod:{own.path}")
    assert dataset.images == [(1, 0), (1, 2), (1, 10)] and dataset.split is None
    assert repr(dataset).endswith("all images of mug: 3 images)")
    for view, (object_id, image) in zip(dataset, dataset.images, strict=True):
        item = check_view(own, view, object_id, image)
        np.testing.assert_array_equal(view.K, [[600, 0, 7.5], [0, 601.5, 5.5], [0, 0, 1]])
        np.testing.assert_array_equal(item.mask, own.mask[object_id, image])
        np.testing.assert_allclose(item.size, [0.09, 0.06, 0.04], atol=1e-9)


def test_the_folder_of_one_object(pvnet, densefusion, monkeypatch):
    cat = data_tools.open(f"linemod:{pvnet.path / 'cat'}", split="test")
    assert cat.images == [(6, 3), (6, 7)]
    assert cat.models().ids == (6,)
    second = LinemodDataset(densefusion.path / "data" / "02", "test")
    assert second.images == [(2, 3), (2, 7)]
    np.testing.assert_allclose(second[0].objects[0].size, [0.06, 0.08, 0.02], atol=1e-9)
    assert LinemodDataset(densefusion.path / "data", "test").object_ids == (1, 2)
    monkeypatch.chdir(pvnet.path / "cat")
    here = LinemodDataset(".", "test")
    monkeypatch.chdir("/")
    assert here.images == [(6, 3), (6, 7)] and here[0].objects[0].size is not None


def test_objects_are_chosen(pvnet, densefusion):
    def ids(path, **options):
        return data_tools.open(f"linemod:{path}", split="train", **options).object_ids

    assert ids(pvnet.path) == (6, 10)
    assert ids(pvnet.path, object_id=10) == ids(pvnet.path, cls="eggbox") == (10,)
    assert ids(pvnet.path, cls=["eggbox", "cat"]) == ids(pvnet.path, object_id=(10, 6)) == (6, 10)
    assert ids(densefusion.path, object_id=np.int64(2)) == (2,)
    assert ids(densefusion.path, object_id=np.array([2, 1])) == (1, 2)
    assert ids(densefusion.path, cls="ape") == (1,)


def test_own_objects_by_name_and_lists(own):
    own.write("train.txt", "2.jpg\n")
    assert LinemodDataset(own.path).images == [(1, 2)]
    assert LinemodDataset(own.path, "train", object_id=1).split == "train"
    assert LinemodDataset(own.path, cls="mug").images == [(1, 2)]


@pytest.mark.parametrize(
    "colour", [(0, 255, 0), (0, 0, 255), (255, 0, 0), (0, 0, 1), (128, 0, 128)]
)
def test_masks_of_any_colour(pvnet, colour):
    """Whatever is not black is object, with an alpha channel and without."""
    wanted = pvnet.mask[6, 12]
    pixels = wanted[..., None] * np.uint8(colour)
    opaque = np.full((*wanted.shape, 1), 255, np.uint8)
    for image in (pixels, np.concatenate([opaque, pixels], -1)):
        pvnet.image("cat/mask/0012.png", image)
        view = LinemodDataset(pvnet.path / "cat", "train")[1]
        np.testing.assert_array_equal(view.objects[0].mask, wanted)


def test_masks_of_16_bits_and_grey_pictures(pvnet):
    wanted = pvnet.mask[6, 12]
    pvnet.image("cat/mask/0012.png", wanted * np.uint16(256))
    pvnet.image("cat/JPEGImages/000012.jpg", np.full(wanted.shape, 90, np.uint8))
    view = LinemodDataset(pvnet.path / "cat", "train")[1]
    np.testing.assert_array_equal(view.objects[0].mask, wanted)
    np.testing.assert_array_equal(view.rgb, np.full((*wanted.shape, 3), 90))


def test_pictures_of_other_formats(own):
    """In capitals, as BMP, with bytes behind a JPEG's end; lists and cameras with marks."""
    (own.path / "rgb/0.jpg").rename(own.path / "rgb/0.JPG")
    own.image("rgb/2.bmp", own.rgb[1, 2])
    own.remove("rgb/2.jpg")
    own.image("mask/2.bmp", own.mask[1, 2] * np.uint8(255))
    own.remove("mask/2.png")
    own.write("rgb/10.jpg", (own.path / "rgb/10.jpg").read_bytes() + b"made by a phone")
    text = (own.path / "camera.txt").read_text()
    own.write("camera.txt", text.encode("utf-8-sig"))
    own.write("train.txt", "rgb/0.JPG\r\nK\u00e4se/2.bmp\r\n10.jpg".encode("utf-8-sig"))
    dataset = LinemodDataset(own.path, "train")
    assert dataset.images == [(1, 0), (1, 2), (1, 10)]
    for view in dataset:
        rgb, mask = own.rgb[1, view.image_id], own.mask[1, view.image_id]
        assert np.abs(view.rgb.astype(int) - rgb).max() <= 4
        np.testing.assert_array_equal(view.objects[0].mask, mask)
        assert view.K[0, 0] == 600


def test_objects_beyond_the_fifteenth(densefusion):
    shutil.move(densefusion.path / "data/02", densefusion.path / "data/16")
    shutil.move(densefusion.path / "models/obj_02.ply", densefusion.path / "models/obj_16.ply")
    text = (densefusion.path / "data/16/gt.yml").read_text()
    densefusion.write("data/16/gt.yml", text.replace("obj_id: 2", "obj_id: 16"))
    infos = (densefusion.path / "models/models_info.yml").read_text()
    densefusion.write("models/models_info.yml", infos.replace("\n2:", "\n16:"))
    dataset = everything(densefusion.path, "test")
    assert dataset.object_ids == (1, 16)
    assert [item.object_id for view in dataset for item in view.objects] == [1, 1, 16, 16]
    assert LinemodDataset(densefusion.path, "test", cls="16").images == [(16, 3), (16, 7)]


def test_segmentations(densefusion):
    dataset = LinemodDataset(densefusion.path, "test", masks="segnet")
    for view, key in zip(dataset, dataset.images, strict=True):
        np.testing.assert_array_equal(view.objects[0].mask, ~densefusion.mask[key])
    shutil.rmtree(densefusion.path / "segnet_results/02_label")
    with pytest.raises(ValueError, match="02_label: no such folder"):
        list(LinemodDataset(densefusion.path, "test", masks="segnet"))


def test_without_depth_masks_models_and_infos(densefusion):
    for name in ("data/01/depth", "data/01/mask", "models"):
        shutil.rmtree(densefusion.path / name)
    densefusion.remove("data/01/info.yml")
    dataset = LinemodDataset(densefusion.path, "test", object_id=1)
    view = dataset[0]
    np.testing.assert_array_equal(view.K, LINEMOD_K)
    assert view.depth is None
    assert all(getattr(view.objects[0], name) is None for name in ("mask", "size", "symmetries"))
    with pytest.raises(ValueError, match=r"Linemod_preprocessed: no models of the objects \[1\]"):
        dataset.models()


def test_depth_has_a_scale(densefusion):
    text = (densefusion.path / "data/01/info.yml").read_text()
    densefusion.write("data/01/info.yml", text.replace("depth_scale: 1.0", "depth_scale: 0.5"))
    view = LinemodDataset(densefusion.path, "test", object_id=1)[0]
    np.testing.assert_array_equal(view.depth, np.float32(densefusion.depth[1, 3] / 2000))


def test_lists_images_and_poses_are_read_when_asked_for(densefusion, monkeypatch):
    read = []
    for name in ("read_numbers_of", "read_frames", "read_depth", "_read_mask"):
        real = getattr(module, name)

        def spy(first, *rest, name=name, real=real):
            read.append(name)
            return real(first, *rest)

        monkeypatch.setattr(module, name, spy)
    dataset = LinemodDataset(densefusion.path, "test")
    assert read == ["read_numbers_of"] * 2
    dataset[0]
    assert read[2:] == ["read_frames", "read_depth", "_read_mask"]
    dataset[1]
    assert read[5:] == ["read_depth", "_read_mask"]


def test_rotations_are_projected_and_said_once_per_object(pvnet):
    pvnet.R = pvnet.R * 1.01
    for image in (0, 12):
        pvnet.pose(f"cat/pose/pose{image}.npy", image)
    dataset = LinemodDataset(pvnet.path / "cat", "train")
    with pytest.warns(RotationWarning, match=r"cat/pose: 2 of 2 rotations") as said:
        views = list(dataset)
    assert len(said) == 1
    for view in views:
        R = pvnet.R[view.image_id] / 1.01
        np.testing.assert_allclose(view.objects[0].R, R, atol=1e-14)
    for view in LinemodDataset(pvnet.path / "cat", "train", rotations="as_read"):
        np.testing.assert_array_equal(view.objects[0].R, pvnet.R[view.image_id])


def test_it_can_be_pickled(pvnet):
    dataset = LinemodDataset(pvnet.path, "train")
    dataset[0]
    again = pickle.loads(pickle.dumps(dataset))
    np.testing.assert_array_equal(again[2].rgb, dataset[2].rgb)


@pytest.mark.parametrize("layout", ["pvnet", "densefusion", "own"])
def test_as_batches(layout, request):
    made = request.getfixturevalue(layout)
    dataset = LinemodDataset(made.path, None if layout == "own" else "train")
    stack = batches.load(dataset, progress=False)
    assert len(stack) == len(dataset) and stack.size == (16, 12)
    depth = ("depth",) if layout == "densefusion" else ()
    assert set(stack.kinds) == {"rgb", "instance", *depth}
    assert stack.object_id.tolist() == [object_id for object_id, _ in dataset.images]
    batch = stack.frames(torch.arange(len(stack)))
    for row, view in enumerate(dataset):
        (item,) = view.objects
        np.testing.assert_array_equal(batch["instance"][row] == 0, item.mask)
        np.testing.assert_allclose(batch["R"][row, 0], item.R, atol=1e-7)
        np.testing.assert_allclose(batch["t"][row, 0], item.t, atol=1e-7)
        np.testing.assert_allclose(batch["size"][row, 0], item.size, atol=1e-7)
        np.testing.assert_allclose(batch["K"][row], view.K, rtol=1e-6)
        pixels = batch["rgb"][row].permute(1, 2, 0).numpy() * 255
        np.testing.assert_allclose(pixels, view.rgb, atol=1e-3)
    crops = stack.crops(stack.rows(object_id=dataset.object_ids[0]), 32)
    assert crops["rgb"].shape[1:] == (3, 32, 32) and crops["mask"].any()


PVNET_DAMAGE = [
    (lambda m: m.remove("cat/mask/0012.png"), "cat/mask: no file of image 12"),
    (lambda m: m.remove("cat/JPEGImages/000012.jpg"), "cat/JPEGImages: no file of image 12"),
    (lambda m: m.remove("cat/pose/pose0.npy"), "cat/pose: no file of image 0"),
    (lambda m: m.remove("cat/train.txt"), r"cat/train\.txt: no such file"),
    (lambda m: m.cut("cat/mask/0000.png", 0.7), r"mask/0000\.png: PNG"),
    (lambda m: m.cut("cat/mask/0000.png", 0), r"mask/0000\.png: empty file"),
    (lambda m: m.cut("cat/JPEGImages/000000.jpg", 0.9), r"000000\.jpg: JPEG without its end"),
    (lambda m: m.cut("cat/pose/pose12.npy", 0.9), r"pose12\.npy: damaged \.npy file"),
    (lambda m: m.cut("cat/pose/pose12.npy", 0.1), r"pose12\.npy: damaged \.npy file"),
    (lambda m: m.cut("cat/pose/pose12.npy", 0), r"pose12\.npy: empty file"),
    (lambda m: m.cut("cat/cat.ply", 0.9), r"cat\.ply: damaged PLY"),
    (lambda m: m.cut("cat/train.txt", 0), r"train\.txt: empty file"),
    (lambda m: m.write("cat/train.txt", "\n \n"), r"train\.txt: no images in this list"),
    (lambda m: m.write("cat/train.txt", "12\n0012\n"), "line 2: image 0012 is on line 1 already"),
    (lambda m: m.write("cat/train.txt", "12\n\n0\n"), r"line 2: expected an image, got ''"),
    (lambda m: m.write("cat/train.txt", "12\ncat\n"), r"line 2: expected an image, got 'cat'"),
    (lambda m: m.write("cat/train.txt", b"\xff\xfe1"), r"train\.txt: no list of images"),
    (lambda m: m.write("cat/train.txt", "99\n"), "cat/pose: no file of image 99"),
    (lambda m: m.write("cat/mask/12.png", b"x"), "mask: two files .* 0012.png and 12.png"),
    (lambda m: shutil.rmtree(m.path / "cat/pose"), "cat/pose: no such folder"),
    (
        lambda m: m.image("cat/mask/0012.png", np.zeros((5, 6), np.uint8)),
        r"cat: image 12: objects\[0\]\.mask: expected height and width \(12, 16\)",
    ),
    (
        lambda m: m.write(
            "cat/JPEGImages/000012.jpg",
            cv2.imencode(".png", np.zeros((12, 16), np.uint16))[1].tobytes(),
        ),
        r"000012\.jpg: expected three channels of 8 bits",
    ),
]


POSE_DAMAGE = [
    (lambda pose: np.vstack([pose, [0, 0, 0, 1]]), r"shape \(3, 4\), got float64 \(4, 4\)"),
    (lambda pose: pose[:, :3], r"shape \(3, 4\), got float64 \(3, 3\)"),
    (lambda pose: pose[None], r"shape \(3, 4\), got float64 \(1, 3, 4\)"),
    (lambda pose: pose.astype(str), r"expected numbers of shape"),
    (lambda pose: pose + 0j, r"expected numbers of shape"),
    (lambda pose: pose.astype(object), r"damaged \.npy file"),
    (lambda pose: np.where(pose == pose[0, 3], np.nan, pose), "expected finite numbers"),
    (lambda pose: np.where(pose == pose[0, 0], np.inf, pose), "expected finite numbers"),
    (lambda pose: pose * [-1, 1, 1, 1], r"expected a rotation, .* determinant -1"),
    (lambda pose: pose * 1.2, "expected a rotation"),
]


@pytest.mark.parametrize(("damage", "message"), PVNET_DAMAGE)
def test_damage_to_pvnet_is_refused(pvnet, damage, message):
    everything(pvnet.path, "train")
    damage(pvnet)
    with pytest.raises(ValueError, match=message):
        everything(pvnet.path, "train")


@pytest.mark.parametrize(("change", "message"), POSE_DAMAGE)
def test_damaged_poses_are_refused(pvnet, change, message):
    pose = change(np.column_stack([pvnet.R[12], pvnet.t[12]]))
    np.save(pvnet.path / "cat/pose/pose12.npy", pose, allow_pickle=True)
    with pytest.raises(ValueError, match=rf"pose12\.npy: .*{message}"):
        everything(pvnet.path, "train")


def test_an_archive_is_no_pose(pvnet):
    with open(pvnet.path / "cat/pose/pose12.npy", "wb") as file:
        np.savez(file, pose=np.eye(3, 4))
    with pytest.raises(ValueError, match=r"pose12\.npy: .* got an archive"):
        everything(pvnet.path, "train")


GT, INFO = "data/01/gt.yml", "data/01/info.yml"
DENSEFUSION_DAMAGE = [
    (lambda m: m.remove(GT), r"01/gt\.yml: no such file"),
    (lambda m: m.cut(GT, 0), r"gt\.yml: empty file"),
    (lambda m: m.write(GT, "\n"), r"gt\.yml: expected ids .*got None"),
    (lambda m: m.write(GT, "- 1\n"), r"gt\.yml: expected ids .*got \[1\]"),
    (lambda m: m.write(GT, "0: [{]"), r"gt\.yml: damaged YAML"),
    (lambda m: m.write(GT, b"\xff\xfe\x00"), r"gt\.yml: damaged YAML"),
    (lambda m: m.write(GT, "[" * 100000), r"gt\.yml: damaged YAML: nested"),
    (lambda m: m.write(GT, "0: []\n0: []\n"), r"gt\.yml: damaged YAML: a key is there twice"),
    (lambda m: m.write(GT, "x: []\n"), r"gt\.yml: expected ids as keys, got 'x'"),
    (lambda m: m.write(GT, "-1: []\n"), r"gt\.yml: expected ids as keys, got -1"),
    (lambda m: m.write(GT, "0: {}\n"), r"gt\.yml: 0: expected a list, got {}"),
    (lambda m: m.write(GT, "0: [3]\n"), r"gt\.yml: image 0: expected entries .* got \[3\]"),
    (lambda m: m.write(GT, "12: []\n"), "image 0: expected one pose of object 1, got 0"),
    (lambda m: m.write(GT, "!!python/object:os.system {}"), r"gt\.yml: damaged YAML"),
    (lambda m: m.write(GT, (m.path / "data/02/gt.yml").read_text().replace("id: 2", "id: 1")),
     "image 0: expected one pose of object 1, got 2"),
    (lambda m: m.write(INFO, "0: 3\n"), r"info\.yml: 0: expected a dict, got 3"),
    (lambda m: m.write(INFO, "3: {}\n"), r"info\.yml: image 0: cam_K is missing"),
    (lambda m: m.write(INFO, "0: {cam_K: [1, 2]}\n"), r"image 0: cam_K: expected 9 finite"),
    (lambda m: m.write(INFO, "0: {cam_K: [1, 0, 0, 0, 1, 0, 0, 0, 1], depth_scale: 0}\n"),
     r"info\.yml: image 0: depth_scale: expected above 0, got 0"),
    (lambda m: m.write(INFO, (m.path / INFO).read_text().replace("- 600.0", "- -600.0")),
     "01: image 0: K: expected"),
    (lambda m: m.remove("data/01/depth/0000.png"), "01/depth: no file of image 0"),
    (lambda m: m.cut("data/01/depth/0000.png", 0.5), r"depth/0000\.png: PNG"),
    (lambda m: m.cut("data/01/rgb/0012.png", 0.5), r"rgb/0012\.png: PNG"),
    (lambda m: m.remove("data/01/mask/0000.png"), "01/mask: no file of image 0"),
    (lambda m: m.image("data/01/depth/0000.png", np.zeros((12, 16), np.uint8)),
     r"depth/0000\.png: expected one channel of 16 bits"),
    (lambda m: m.image("data/01/depth/0000.png", np.zeros((6, 8), np.uint16)),
     r"01: image 0: depth: expected height and width"),
    (lambda m: m.cut("models/obj_01.ply", 0.9), r"obj_01\.ply: damaged PLY"),
    (lambda m: m.cut("models/models_info.yml", 0.5), r"models_info\.yml: damaged YAML"),
    (lambda m: m.edit("models/models_info.yml", "diameter: 115.5", "diameter: 0"),
     r"models_info\.yml: object 1: diameter: expected a finite number above 0"),
    (lambda m: m.edit("models/models_info.yml", "size_x: 90.0", "size_x: .nan"),
     r"models_info\.yml: object 1: size_x: expected a finite number"),
    (lambda m: m.edit("models/models_info.yml", "min_x: -45.0, ", ""), "min_x is missing"),
    (lambda m: m.edit("models/models_info.yml", "size_x: 90.0", "size_x: -1"),
     r"models_info\.yml: object 1: size: expected lengths"),
]  # fmt: skip


@pytest.mark.parametrize(("damage", "message"), DENSEFUSION_DAMAGE)
def test_damage_to_densefusion_is_refused(densefusion, damage, message):
    everything(densefusion.path, "train", object_id=1)
    damage(densefusion)
    with pytest.raises(ValueError, match=message):
        everything(densefusion.path, "train", object_id=1)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("cam_R_m2c", [1, 0, 0], "cam_R_m2c: expected 9 finite numbers"),
        ("cam_R_m2c", [1, 0, 0, 0, 1, 0, 0, 0, "x"], "cam_R_m2c: expected 9 finite numbers"),
        ("cam_R_m2c", [1, 0, 0, 0, 1, 0, 0, 0, ".nan"], "cam_R_m2c: expected 9 finite numbers"),
        ("cam_R_m2c", [1, 0, 0, 0, 1, 0, 0, 0, -1], "image 0: expected a rotation"),
        ("cam_t_m2c", [1, 2, ".inf"], "cam_t_m2c: expected 3 finite numbers"),
        ("cam_t_m2c", [1, 2], "cam_t_m2c: expected 3 finite numbers"),
        ("obj_bb", [1, 2, 3], "obj_bb: expected 4 finite numbers"),
        ("obj_bb", [1, 2, -3, 4], "box: expected a width and a height"),
        ("obj_id", -1, "obj_id: expected an integer of at least 0"),
        ("obj_id", 2.5, "obj_id: expected an integer of at least 0"),
        ("obj_id", 9, "expected one pose of object 1, got 0"),
    ],
)
def test_damaged_entries_are_refused(densefusion, key, value, message):
    entry = {"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 900], "obj_bb": [1] * 4}
    entry = {**entry, "obj_id": 1, key: value}
    text = ", ".join(f"{name}: {value}".replace("'", "") for name, value in entry.items())
    densefusion.write("data/01/train.txt", "0000")
    densefusion.write(GT, f"0: [{{{text}}}]\n")
    with pytest.raises(ValueError, match=message) as refused:
        everything(densefusion.path, "train", object_id=1)
    assert "data/01" in str(refused.value)


OWN_DAMAGE = [
    (lambda m: m.remove("camera.txt"), r"camera\.txt: no such file"),
    (lambda m: m.cut("camera.txt", 0), r"camera\.txt: empty file"),
    (lambda m: m.cut("camera.txt", 0.5), r"camera\.txt: expected numbers of shape \(3, 3\)"),
    (lambda m: m.edit("camera.txt", "7.5", "seven"), r"camera\.txt: expected numbers of shape"),
    (lambda m: m.edit("camera.txt", "7.5", "nan"), r"camera\.txt: expected finite numbers"),
    (lambda m: m.edit("camera.txt", "0 0 1", "0 0 2"), "mug: image 0: K: expected"),
    (lambda m: m.write("diameter.txt", "big"), r"diameter\.txt: expected numbers of shape"),
    (lambda m: m.write("diameter.txt", "1 2"), r"diameter\.txt: expected numbers of shape"),
    (lambda m: m.write("diameter.txt", "115"), r"diameter\.txt: expected 0\.1153 m as in model"),
    (lambda m: m.mesh("model.ply", 1, 1), r"diameter\.txt: expected 115\.3 m as in model\.ply"),
    (lambda m: m.cut("model.ply", 0.9), r"model\.ply: damaged PLY"),
    (lambda m: m.remove("pose/2.npy"), "mug/pose: no file of image 2"),
    (lambda m: m.remove("mask/10.png"), "mug/mask: no file of image 10"),
    (lambda m: m.write("pose/pose2.npy", b"x"), "pose: two files of one image, 2.npy and pose2"),
    (
        lambda m: [m.remove(f"rgb/{image}.jpg") for image in (0, 2, 10)],
        "mug/rgb: no images",
    ),
]


@pytest.mark.parametrize(("damage", "message"), OWN_DAMAGE)
def test_damage_to_own_objects_is_refused(own, damage, message):
    everything(own.path)
    damage(own)
    with pytest.raises(ValueError, match=message):
        everything(own.path)


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda p: LinemodDataset(p / "nowhere", "test"), "path: expected the folder of LINEMOD"),
        (lambda p: LinemodDataset(None, "test"), "path: expected .* got None"),
        (lambda p: LinemodDataset(p / "fuse", "test"), "path: expected the folder of an object"),
        (lambda p: LinemodDataset(p / "cat/mask"), "path: expected the folder of an object"),
        (lambda p: LinemodDataset(p), r"split: expected one of train, test in .*got None"),
        (lambda p: LinemodDataset(p, "val"), "split: expected one of train, test .*got 'val'"),
        (lambda p: LinemodDataset(p, ["train"]), "split: expected one of"),
        (lambda p: LinemodDataset(p, "train", object_id=1), "object_id: .* of 6, 10 in .* got 1"),
        (lambda p: LinemodDataset(p, "train", object_id=True), "object_id: .* got True"),
        (lambda p: LinemodDataset(p, "train", object_id=[6, 1]), "object_id: .* got 1"),
        (lambda p: LinemodDataset(p, "train", object_id=[]), r"object_id: .* got \[\]"),
        (lambda p: LinemodDataset(p, "train", object_id="cat"), "object_id: .* got 'cat'"),
        (lambda p: LinemodDataset(p, "train", cls="dog"), "cls: .* of cat, eggbox in .*'dog'"),
        (lambda p: LinemodDataset(p, "train", cls=6), "cls: .* got 6"),
        (lambda p: LinemodDataset(p, "train", cls=["cat", []]), r"cls: .* got \[\]"),
        (lambda p: LinemodDataset(p, "train", cls="cat", object_id=6), "cls: expected None"),
        (lambda p: LinemodDataset(p, "train", masks="found"), "masks: expected"),
        (lambda p: LinemodDataset(p, "train", masks="segnet"), "masks: expected 'given'"),
        (lambda p: LinemodDataset(p, "train", rotations="round"), "rotations"),
    ],
)
def test_bad_input_is_refused(pvnet, call, argument):
    with pytest.raises(ValueError, match=argument):
        call(pvnet.path)


def test_own_objects_without_lists_have_no_splits(own):
    with pytest.raises(ValueError, match="split: expected None, as there are no lists .*'train'"):
        LinemodDataset(own.path, "train")


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.data())
def test_any_byte_of_any_file_may_be_wrong(all_layouts, data):
    """What has no checksum cannot always be seen, but only errors that name a file come of it."""
    made = data.draw(st.sampled_from(all_layouts))
    file = data.draw(st.sampled_from(sorted(p for p in made.path.rglob("*") if p.is_file())))
    whole = file.read_bytes()
    position = data.draw(st.integers(0, len(whole) - 1))
    byte = data.draw(st.integers(0, 255))
    damaged = whole[:position] + bytes([byte]) + whole[position + 1 :]
    split = None if (made.path / "camera.txt").exists() else "train"
    file.write_bytes(damaged)
    try:
        everything(made.path, split, rotations="as_read")
        assert damaged == whole or file.suffix != ".png" or file.stem not in ("0000", "0012")
    except ValueError as error:
        assert str(made.path) in str(error)
    finally:
        file.write_bytes(whole)


def make_real_cat(real_data: Path, path: Path) -> Path:
    """The real photograph laid out as PVNet's; keypoints and the corners of the box for a model."""
    source, cat = real_data / "linemod_cat", path / "cat"
    for place in ("JPEGImages", "mask", "pose"):
        (cat / place).mkdir(parents=True)
    shutil.copy(source / "cat.jpg", cat / "JPEGImages" / "000000.jpg")
    shutil.copy(source / "cat_mask.png", cat / "mask" / "0000.png")
    shutil.copy(source / "cat_pose.npy", cat / "pose" / "pose0.npy")
    shutil.copy(source / "cat_points_3d.txt", cat / "farthest.txt")
    (cat / "test.txt").write_text("LINEMOD/cat/JPEGImages/000000.jpg\n")
    rows = (source / "cat_bb8_3d.txt").read_text().split("\n")
    corners = [row for row in rows if row.strip()]
    header = f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (cat / "cat.ply").write_text(header + "\n".join(corners) + "\n")
    return path


def test_the_real_cat(real_data, tmp_path):
    dataset = data_tools.open(f"linemod:{make_real_cat(real_data, tmp_path)}", split="test")
    (view,) = dataset
    (item,) = view.objects
    source = real_data / "linemod_cat"
    assert view.rgb.shape == (480, 640, 3) and item.mask.shape == (480, 640)
    np.testing.assert_array_equal(view.K, LINEMOD_K)
    np.testing.assert_array_equal(item.mask, cv2.imread(str(source / "cat_mask.png"))[..., 0] > 0)
    pose = np.load(source / "cat_pose.npy").astype(np.float64)
    np.testing.assert_array_equal(item.t, pose[:, 3])
    np.testing.assert_allclose(item.R, pose[:, :3], atol=1e-6)
    assert is_rotation(item.R, 1e-12)
    # BOP's figures for the cat's box in mm, 67.0107 x 127.633 x 117.4566.
    np.testing.assert_allclose(item.size, [0.0670107, 0.127633, 0.1174566], atol=1e-6)
    # The keypoints lie on the cat: projected they are in its mask, or at most 2 px beside it.
    near = cv2.dilate(item.mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    pixels = (dataset.models().keypoints(6) @ item.R.T + item.t) @ view.K.T
    pixels = np.round(pixels[:, :2] / pixels[:, 2:]).astype(int)
    assert len(pixels) == 9 and near[pixels[:, 1], pixels[:, 0]].all()
    stack = batches.load(dataset, progress=False)
    x, y, width, height = stack.box[0].tolist()
    assert item.mask[int(y) : int(y + height), int(x) : int(x + width)].sum() == item.mask.sum()


LINKS = [
    *(("pvnet", f"cat{end}") for end in ("", "/JPEGImages", "/mask", "/pose", "/test.txt")),
    *(("pvnet", f"cat/{end}") for end in ("cat.ply", "JPEGImages/000003.jpg", "mask/0003.png")),
    *(("own", end) for end in ("rgb", "mask", "pose", "camera.txt", "model.ply", "diameter.txt")),
    *(("own", end) for end in ("rgb/0.jpg", "mask/0.png")),
    *(("densefusion", f"data{end}") for end in ("", "/01", "/01/rgb", "/01/depth", "/01/mask")),
    *(("densefusion", f"data/01/{end}") for end in ("gt.yml", "info.yml", "depth/0003.png")),
    *(("densefusion", f"models/{end}") for end in ("obj_01.ply", "models_info.yml")),
]


@pytest.mark.parametrize("target", ["/no/such/disk", "itself"])
@pytest.mark.parametrize(("layout", "name"), LINKS)
def test_a_link_that_leads_nowhere_is_not_taken_for_nothing(request, layout, name, target):
    made = request.getfixturevalue(layout)
    link = made.path / name
    link.rename(made.path / "away")
    link.symlink_to(link if target == "itself" else target)
    with pytest.raises(ValueError, match=re.escape(f"{link}: ")):
        dataset = LinemodDataset(made.path, None if layout == "own" else "test")
        assert dataset[0].objects
        dataset.models().mesh(dataset[0].objects[0].object_id)
