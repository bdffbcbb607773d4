import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import data_tools
from data_tools.batches.identity import identify
from data_tools.bop import BopDataset, RotationWarning, read_results
from data_tools.bop import dataset as module


def test_order_and_lengths(tree):
    dataset = BopDataset(tree.path, "test")
    assert len(dataset) == 3
    assert [(v.scene_id, v.image_id) for v in dataset] == [(1, 4), (1, 10), (12, 0)]
    assert [v.group for v in dataset] == [(1, 4), (1, 10), (12, 0)]
    assert dataset[-1].scene_id == 12
    assert dataset[np.int64(1)].image_id == 10
    assert dataset.object_ids == (1, 2)
    assert repr(dataset).endswith("'test': 3 images)")
    with pytest.raises(IndexError):
        dataset[3]
    with pytest.raises(TypeError):
        dataset[:2]


def test_everything_in_a_view(tree):
    view = BopDataset(tree.path, "test")[0]
    np.testing.assert_array_equal(view.K, np.reshape(tree.K, (3, 3)))
    np.testing.assert_array_equal(view.rgb, tree.rgb[1, 4])
    np.testing.assert_array_equal(view.depth, np.float32(tree.depth[1, 4] * 0.1 / 1000))
    assert view.depth.dtype == np.float32
    assert view.ir is None
    assert view.T_world_cam is None
    assert [item.object_id for item in view.objects] == [1, 2, 2]
    for i, item in enumerate(view.objects):
        np.testing.assert_allclose(item.R, tree.R[i], atol=1e-15)
        np.testing.assert_array_equal(item.t, np.array(tree.t[i]) / 1000)
        stem = f"000004_{i:06d}"
        np.testing.assert_array_equal(item.mask, tree.masks["mask_visib", stem] > 0)
        np.testing.assert_array_equal(item.full_mask, tree.masks["mask", stem] > 0)
        np.testing.assert_array_equal(item.size, [0.1, 0.06, 0.04])
        assert item.category is None
    assert [item.visible_fraction for item in view.objects] == [0.75, 0, 0.75]
    np.testing.assert_array_equal(view.objects[0].box, [3, 4, 5, 6])
    assert view.objects[1].box is None, "nothing of it is seen"
    assert view.objects[0].symmetries.shape == (315, 4, 4)
    np.testing.assert_allclose(view.objects[1].symmetries[1][:3, 3], [0.004, 0, 0])


def test_camera_in_the_world(tree):
    T = BopDataset(tree.path, "test")[1].T_world_cam
    expected = np.eye(4)
    expected[:3, :3] = tree.R[2].T
    expected[:3, 3] = -tree.R[2].T @ [1, 0, -0.5]
    np.testing.assert_allclose(T, expected, atol=1e-15)


def test_grey_images_and_secret_poses(tree):
    view = BopDataset(tree.path, "test")[2]
    np.testing.assert_array_equal(view.ir, tree.grey[12, 0])
    assert view.rgb is None
    assert view.depth is None
    assert view.objects == ()


def test_jpeg_split_without_objects(tree):
    dataset = BopDataset(tree.path, "train_pbr")
    assert np.abs(dataset[0].rgb.astype(int) - tree.rgb[0, 0]).max() <= 3
    assert dataset[0].objects == ()
    assert dataset.object_ids == ()
    assert len(dataset.ground_truth()) == 0


def test_without_infos_masks_and_models(tree):
    for name in ("mask", "mask_visib"):
        for file in (tree.path / "test/000001" / name).iterdir():
            file.unlink()
        (tree.path / "test/000001" / name).rmdir()
    tree.remove("test/000001/scene_gt_info.json")
    (tree.path / "models").rename(tree.path / "elsewhere")
    dataset = BopDataset(tree.path, "test")
    for item in dataset[0].objects:
        for name in ("box", "mask", "full_mask", "visible_fraction", "size", "symmetries"):
            assert getattr(item, name) is None
    with pytest.raises(ValueError, match="no models"):
        dataset.models()
    assert dataset.models("elsewhere").ids == (1, 2, 3)


def test_models_of_the_first_folder(tree):
    assert BopDataset(tree.path, "test").models().path.name == "models"
    (tree.path / "models").rename(tree.path / "models_eval")
    dataset = BopDataset(tree.path, "test")
    assert dataset.models().path.name == "models_eval"
    assert dataset.models() is dataset.models()
    np.testing.assert_array_equal(dataset[0].objects[0].size, [0.1, 0.06, 0.04])


def test_objects_without_a_model(tree):
    tree.json["test/000001/scene_gt"]["4"][0]["obj_id"] = 77
    tree.save()
    item = BopDataset(tree.path, "test")[0].objects[0]
    assert item.size is None
    assert item.symmetries is None


def test_ground_truth(tree):
    table = BopDataset(tree.path, "test").ground_truth()
    assert table.scene_id.tolist() == [1, 1, 1, 1]
    assert table.image_id.tolist() == [4, 4, 4, 10]
    assert table.object_id.tolist() == [1, 2, 2, 2]
    np.testing.assert_allclose(table.R, tree.R[[0, 1, 2, 0]], atol=1e-15)
    np.testing.assert_array_equal(table.t, np.array(tree.t)[[0, 1, 2, 0]] / 1000)


@pytest.mark.parametrize("absolute", [True, False])
def test_targets(tree, absolute):
    targets = tree.path / "test_targets.json" if absolute else "test_targets.json"
    dataset = BopDataset(tree.path, "test", targets=targets)
    assert [(v.scene_id, v.image_id) for v in dataset] == [(1, 4), (12, 0)]
    view = dataset[0]
    assert [item.object_id for item in view.objects] == [2, 2]
    # The masks are numbered as in scene_gt, not as in the targets.
    np.testing.assert_array_equal(
        view.objects[1].mask, tree.masks["mask_visib", "000004_000002"] > 0
    )
    assert dataset.ground_truth().object_id.tolist() == [2, 2]


@pytest.mark.slow
@pytest.mark.parametrize("inst_count", [False, True])
def test_targets_that_are_images(tree, inst_count):
    """As in test_targets_bop24.json, which `export` writes too: all objects of these images."""
    tree.json["test_targets_bop24"] = [
        {"scene_id": 1, "im_id": 10} | ({"inst_count": 1} if inst_count else {}),
        {"scene_id": 12, "im_id": 0},
    ]
    tree.save()
    dataset = BopDataset(tree.path, "test", targets="test_targets_bop24.json")
    assert dataset.images == [(1, 10), (12, 0)]
    whole = BopDataset(tree.path, "test")
    for view in dataset:
        same = whole[whole.images.index((view.scene_id, view.image_id))]
        assert [o.object_id for o in view.objects] == [o.object_id for o in same.objects]
    assert dataset.ground_truth().object_id.tolist() == [2]
    assert identify(dataset)[1] != identify(whole)[1]


def with_sensors(tree):
    """Scene 1 as of the sensor cam1, and of cam2 with its first image and no masks."""
    folder = tree.path / "test/000001"
    for name in ("camera", "gt", "gt_info"):
        content = tree.json.pop(f"test/000001/scene_{name}")
        tree.remove(f"test/000001/scene_{name}.json")
        tree.json[f"test/000001/scene_{name}_cam1"] = content
        if name != "gt_info":
            tree.json[f"test/000001/scene_{name}_cam2"] = {"4": content["4"]}
    shutil.copytree(folder / "rgb", folder / "rgb_cam2")
    (folder / "rgb_cam2/000010.png").unlink()
    for kind in ("rgb", "depth", "mask", "mask_visib"):
        (folder / kind).rename(folder / f"{kind}_cam1")
    tree.json["test/000001/scene_camera_cam2"] = {"4": {"cam_K": [50, 0, 7, 0, 50, 5, 0, 0, 1]}}
    tree.save()


def test_several_sensors(tree):
    """BOP's layout of its industrial datasets: every file's name ends in that of the sensor."""
    before = list(BopDataset(tree.path, "test"))[:2]
    shutil.rmtree(tree.path / "test/000012")
    del tree.json["test/000012/scene_camera"], tree.json["test_targets"]
    with_sensors(tree)
    with pytest.raises(
        ValueError, match="one of cam1, cam2, such as split 'test:cam1' has, got None"
    ):
        BopDataset(tree.path, "test")
    with pytest.raises(ValueError, match="sensor: expected one of cam1, cam2, got 'cam3'"):
        BopDataset(tree.path, "test", sensor="cam3")
    for first in (
        BopDataset(tree.path, "test", sensor="cam1"),
        data_tools.open(f"bop:{tree.path}", split="test:cam1"),
    ):
        assert repr(first).endswith("'test:cam1': 2 images)")
        for view, same in zip(first, before, strict=True):
            np.testing.assert_array_equal(view.rgb, same.rgb)
            np.testing.assert_array_equal(view.depth, same.depth)
            for item, other in zip(view.objects, same.objects, strict=True):
                np.testing.assert_array_equal(item.mask, other.mask)
                np.testing.assert_array_equal(item.full_mask, other.full_mask)
                np.testing.assert_array_equal(item.t, other.t)
                assert item.visible_fraction == other.visible_fraction
    second = BopDataset(tree.path, "test", sensor="cam2")
    assert second.images == [(1, 4)]
    assert second[0].K[0, 0] == 50 and second[0].depth is None
    assert [item.mask for item in second[0].objects] == [None] * 3
    assert identify(first)[1] != identify(second)[1]
    (tree.path / "test/000001/scene_camera_cam2.json").unlink()
    assert BopDataset(tree.path, "test").sensor == "cam1", "the only one"


def test_sensors_beside_files_without_one(tree):
    """Files whose names have no sensor come first; scenes without the sensor are left out."""
    folder = tree.path / "test/000001"
    shutil.copy(folder / "scene_camera.json", folder / "scene_camera_cam1.json")
    shutil.copy(folder / "scene_gt.json", folder / "scene_gt_cam1.json")
    assert BopDataset(tree.path, "test").images == [(1, 4), (1, 10), (12, 0)]
    assert BopDataset(tree.path, "test", sensor="cam1").images == [(1, 4), (1, 10)]
    with pytest.raises(ValueError, match="sensor: expected None, as files name no sensor"):
        BopDataset(tree.path, "train_pbr", sensor="cam1")


def test_sensors_that_are_called_by_what_they_see(tree):
    """HOT3D's: the folder gray1 beside scene_camera_gray1.json and mask_gray1."""
    folder = tree.path / "test/000012"
    (folder / "gray").rename(folder / "gray1")
    (folder / "scene_camera.json").rename(folder / "scene_camera_gray1.json")
    view = BopDataset(tree.path, "test:gray1")[0]
    np.testing.assert_array_equal(view.ir, tree.grey[12, 0])
    tree.image(12, "gray1", 7, tree.grey[12, 0])
    with pytest.raises(ValueError, match=r"scene_camera_gray1\.json: no camera for gray1/000007"):
        BopDataset(tree.path, "test:gray1")


@pytest.mark.parametrize("name", ["²", "٣", "9" * 30])
def test_names_with_digits_that_are_no_numbers(tree, name):
    """A scene's folder or an image of such a name is none; nothing breaks."""
    (tree.path / "test" / name).mkdir()
    (tree.path / "test/000001/rgb" / f"{name}.png").touch()
    assert BopDataset(tree.path, "test").images == [(1, 4), (1, 10), (12, 0)]


def test_targets_count_the_most_visible_instances(tree):
    """Of object 2 in image 4, poses 1 (hidden) and 2 (seen), one is a target."""
    tree.json["test_targets"] = [{"scene_id": 1, "im_id": 4, "obj_id": 2, "inst_count": 1}]
    tree.save()
    dataset = BopDataset(tree.path, "test", targets="test_targets.json")
    assert dataset.images == [(1, 4)]
    (item,) = dataset[0].objects
    assert item.visible_fraction == 0.75
    np.testing.assert_array_equal(item.mask, tree.masks["mask_visib", "000004_000002"] > 0)


def test_every_image_has_its_camera(tree):
    dataset = BopDataset(tree.path, "test")
    for view, image in zip(dataset, dataset.images, strict=True):
        assert (view.scene_id, view.image_id) == image
        np.testing.assert_array_equal(dataset.camera(*image).K, view.K)
    for image in ((1, 5), (3, 4)):
        with pytest.raises(ValueError, match="image_id: expected an image of scene"):
            dataset.camera(*image)


def test_images_and_poses_are_read_when_asked_for(tree, monkeypatch):
    read = []

    def spy(name):
        real = getattr(module, name)

        def reader(path, *rest):
            read.append(Path(path).name)
            return real(path, *rest)

        monkeypatch.setattr(module, name, reader)

    for name in ("read_rgb", "read_grey", "read_depth", "read_mask", "read_annotations"):
        spy(name)
    dataset = BopDataset(tree.path, "test")
    assert read == []
    dataset.ground_truth()
    assert read == ["scene_gt.json"]
    dataset[1]
    assert sorted(read[1:]) == ["000010.png"] * 2 + ["000010_000000.png"] * 2


def test_a_data_set_goes_to_other_processes(tree):
    dataset = BopDataset(tree.path, "test")
    for copy in (pickle.loads(pickle.dumps(dataset)), dataset):
        np.testing.assert_array_equal(copy[0].rgb, tree.rgb[1, 4])
    np.testing.assert_array_equal(
        pickle.loads(pickle.dumps(dataset))[0].objects[0].mask, dataset[0].objects[0].mask
    )


def test_rotations_are_projected_or_left(tree):
    off = 1.002 * tree.R[0]
    tree.json["test/000001/scene_gt"]["4"][0]["cam_R_m2c"] = off.ravel().tolist()
    tree.save()
    with pytest.warns(RotationWarning, match=r"scene_gt\.json: 1 of 4") as record:
        views = list(BopDataset(tree.path, "test"))
    assert len(record) == 1
    np.testing.assert_allclose(views[0].objects[0].R, tree.R[0], atol=1e-15)
    view = BopDataset(tree.path, "test", rotations="as_read")[0]
    np.testing.assert_array_equal(view.objects[0].R, off)


@given(data=st.data())
def test_any_tree_comes_back(tmp_path_factory, data):
    """Images named in any order, with any number of objects, come back in order and complete."""
    images = data.draw(st.lists(st.integers(0, 10**6), min_size=1, max_size=6, unique=True))
    counts = [data.draw(st.integers(0, 3)) for _ in images]
    path = tmp_path_factory.mktemp("any")
    folder = path / "val" / "000009"
    folder.mkdir(parents=True)
    K = [5, 0, 1, 0, 5, 1, 0, 0, 1]
    eye = [1, 0, 0, 0, 1, 0, 0, 0, 1]
    cameras = {str(i): {"cam_K": K} for i in images}
    poses = {
        str(image): [{"obj_id": k, "cam_R_m2c": eye, "cam_t_m2c": [image, k, 1]} for k in range(n)]
        for image, n in zip(images, counts, strict=True)
    }
    (folder / "scene_camera.json").write_text(repr(cameras).replace("'", '"'))
    (folder / "scene_gt.json").write_text(repr(poses).replace("'", '"'))
    dataset = BopDataset(path)
    assert dataset.split == "val"
    assert [(v.image_id, len(v.objects)) for v in dataset] == sorted(
        zip(images, counts, strict=True)
    )
    for view in dataset:
        assert [item.t.tolist() for item in view.objects] == [
            [view.image_id / 1000, k / 1000, 0.001] for k in range(len(view.objects))
        ]


def everything(tree, **options):
    """Read all that a data set has."""
    dataset = BopDataset(tree.path, "test", **options)
    dataset.ground_truth()
    return list(dataset)


def edit(name, change):
    def damage(tree):
        change(tree.json[name])
        tree.save()

    return damage


CAMERA, GT, INFO = (f"test/000001/scene_{name}" for name in ("camera", "gt", "gt_info"))
DAMAGE = [
    (lambda tree: tree.cut(f"{CAMERA}.json", 0.9), r"scene_camera\.json: damaged JSON"),
    (lambda tree: tree.cut(f"{GT}.json", 0.5), r"scene_gt\.json: damaged JSON"),
    (lambda tree: tree.cut(f"{INFO}.json", 0.1), r"scene_gt_info\.json: damaged JSON"),
    (lambda tree: tree.cut(f"{GT}.json", 0), r"scene_gt\.json: empty file"),
    (lambda tree: tree.cut("test/000001/rgb/000004.png", 0.7), r"rgb/000004\.png: PNG"),
    (lambda tree: tree.cut("test/000001/depth/000010.png", 0.99), r"depth/000010\.png: PNG"),
    (lambda tree: tree.cut("test/000001/mask/000004_000002.png", 0.8), r"mask/000004_000002\.png"),
    (lambda tree: tree.cut("test/000012/gray/000000.tif", 0.5), r"gray/000000\.tif"),
    (edit(CAMERA, lambda c: c.pop("10")), r"scene_camera\.json: no camera for rgb/000010\.png"),
    (edit(CAMERA, lambda c: c["4"].pop("cam_K")), r"scene_camera\.json: image 4: cam_K is missing"),
    (edit(CAMERA, lambda c: c["4"].pop("depth_scale")), "image 000004: depth_scale is missing"),
    (
        edit(CAMERA, lambda c: c["4"].update(cam_K=[0] * 9)),
        "000001: image 4: K: expected fx s cx / 0 fy cy / 0 0 1",
    ),
    (edit(GT, lambda c: c["4"].pop()), r"scene_gt_info\.json: image 4: expected 2 entries"),
    (edit(GT, lambda c: c["4"][1].pop("cam_t_m2c")), "image 4, pose 1: cam_t_m2c is missing"),
    (edit(GT, lambda c: c["4"][1].pop("obj_id")), "image 4, pose 1: obj_id is missing"),
    (
        edit(GT, lambda c: c["4"][1].update(cam_R_m2c=[1] * 9)),
        "image 4, pose 1: expected a rotation",
    ),
    (edit(INFO, lambda c: c.pop("4")), r"scene_gt_info\.json: image 4 is not in both"),
    (lambda tree: tree.cut("models/models_info.json", 0.5), r"models_info\.json: damaged JSON"),
    (
        lambda tree: tree.image(1, "mask", "000004_000000", np.zeros((5, 5), np.uint8)),
        r"image 4: objects\[0\].full_mask: expected height and width \(12, 16\)",
    ),
    (
        lambda tree: tree.image(1, "depth", 4, np.zeros((12, 15), np.uint16)),
        r"image 4: depth: expected height and width \(12, 16\)",
    ),
    (
        lambda tree: tree.image(1, "depth", 4, np.zeros((12, 16), np.uint8)),
        r"depth/000004\.png: expected one channel of 16 bits",
    ),
    (
        lambda tree: tree.image(1, "rgb", 4, np.zeros((12, 16), np.uint16)),
        r"rgb/000004\.png: expected three channels",
    ),
    (
        lambda tree: tree.image(1, "rgb", 99, np.zeros((12, 16, 3), np.uint8)),
        r"scene_camera\.json: no camera for rgb/000099\.png",
    ),
    (
        lambda tree: tree.image(1, "depth", 5, np.zeros((12, 16), np.uint16)),
        r"scene_camera\.json: no camera for depth/000005\.png",
    ),
    (lambda tree: (tree.path / "test/1").mkdir(), "test: two folders of one scene"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGE)
def test_damage_is_refused(tree, damage, message):
    everything(tree)
    damage(tree)
    with pytest.raises(ValueError, match=message):
        everything(tree)


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.data())
def test_any_byte_of_any_file_may_be_wrong(toy, data):
    """What has no checksum cannot always be seen, but only errors that name a file come of it."""
    file = data.draw(st.sampled_from(sorted(p for p in toy.path.rglob("*") if p.is_file())))
    whole = file.read_bytes()
    position = data.draw(st.integers(0, len(whole) - 1))
    byte = data.draw(st.integers(0, 255))
    damaged = whole[:position] + bytes([byte]) + whole[position + 1 :]
    file.write_bytes(damaged)
    try:
        dataset = BopDataset(toy.path, "test", rotations="as_read")
        list(dataset)
        [dataset.models().mesh(i) for i in dataset.models().ids]
        assert damaged == whole or file.suffix != ".png"
    except (ValueError, FileNotFoundError) as error:
        assert str(toy.path) in str(error)
    finally:
        file.write_bytes(whole)


@pytest.mark.parametrize(
    "name",
    [
        "test/000001/rgb/000004.png",
        "test/000001/depth/000010.png",
        "test/000001/mask_visib/000004_000001.png",
        "test/000001/scene_camera.json",
        "test/000001/scene_gt.json",
        "test/000012/gray/000000.tif",
        "test/000012/scene_camera.json",
    ],
)
def test_lost_files_are_named(tree, name):
    tree.remove(name)
    with pytest.raises(FileNotFoundError, match=name.rsplit(".", 1)[0]):
        everything(tree)


def test_only_test_splits_may_keep_poses_secret(tree):
    tree.remove("train_pbr/000000/scene_gt.json")
    with pytest.raises(FileNotFoundError, match=r"scene_gt\.json"):
        BopDataset(tree.path, "train_pbr")[0]


def test_poses_of_an_image_without_a_camera(tree):
    tree.json[GT]["11"] = []
    tree.json[INFO]["11"] = []
    tree.save()
    with pytest.raises(ValueError, match=r"scene_gt\.json: image 11 has poses, but no camera"):
        everything(tree)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ({}, "expected a list of targets, got a dict"),
        ([[]], "target 0: expected a JSON object"),
        (
            [{"scene_id": 1, "im_id": 4, "obj_id": 1}, {"scene_id": 1, "im_id": 4}],
            "target 1: obj_id is missing",
        ),
        ([{"scene_id": 1, "im_id": 5}], "target 0: scene 1, image 5 is not in test"),
        ([{"scene_id": 1}], "target 0: im_id is missing"),
        ([{"scene_id": 1, "im_id": "4", "obj_id": 1}], "target 0: im_id: expected an integer"),
        ([{"scene_id": 3, "im_id": 4, "obj_id": 1}], "target 0: scene 3, image 4 is not in test"),
        ([{"scene_id": 1, "im_id": 5, "obj_id": 1}], "target 0: scene 1, image 5 is not in test"),
        (
            [{"scene_id": 1, "im_id": 10, "obj_id": 1}],
            r"image 10 has too few of the target .*\[1\]",
        ),
        ([{"scene_id": 1, "im_id": 4, "obj_id": 2, "inst_count": 3}], r"too few .* \[2\]"),
        ([{"scene_id": 1, "im_id": 4, "obj_id": 2, "inst_count": 0}], "inst_count: .* at least 1"),
    ],
)
def test_targets_that_do_not_fit(tree, targets, message):
    tree.json["test_targets"] = targets
    tree.save()
    with pytest.raises(ValueError, match=message):
        everything(tree, targets="test_targets.json")


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda p: BopDataset(p / "nowhere", "test"), "path: expected the folder of a BOP dataset"),
        (lambda p: BopDataset(None, "test"), "path: .* got None"),
        (lambda p: BopDataset(p, "val"), "split: expected one of test, train_pbr in .*got 'val'"),
        (lambda p: BopDataset(p), r"split: expected one of .* got None"),
        (lambda p: BopDataset(p, "models"), "split"),
        (lambda p: BopDataset(p / "models", "test"), "path: expected a folder with splits"),
        (lambda p: BopDataset(p, "test", rotations="round"), "rotations"),
        (lambda p: BopDataset(p, "test").models("nowhere"), "path: expected a folder of models"),
    ],
)
def test_bad_input_is_refused(tree, call, argument):
    with pytest.raises(ValueError, match=argument):
        call(tree.path)


def test_targets_file_that_is_not_there(tree):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.json"):
        BopDataset(tree.path, "test", targets="nowhere.json")


def test_the_real_frame(real_data):
    dataset = data_tools.open(f"bop:{real_data / 'lmo'}", split="test")
    assert len(dataset) == 1
    with pytest.warns(RotationWarning, match=r"scene_gt\.json: 1 of 8 .* up to 0.002"):
        view = dataset[0]
    assert (view.scene_id, view.image_id) == (2, 3)
    assert view.rgb.shape == (480, 640, 3)
    np.testing.assert_array_equal(
        view.K, [[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]]
    )
    measured = view.depth[view.depth > 0]
    assert 0.5 < measured.min() < np.median(measured) < 1.5
    assert [item.object_id for item in view.objects] == [1, 5, 6, 8, 9, 10, 11, 12]
    can = view.objects[1]
    np.testing.assert_allclose(can.t, [0.13436598053, 0.04577287271, 0.96478389285], rtol=2.3e-16)
    assert can.R[0, 0] == pytest.approx(0.94893088, abs=1e-3)
    np.testing.assert_allclose(can.size, [0.1007916, 0.1817958, 0.193734], atol=1e-7)
    assert can.symmetries.shape == (1, 4, 4)
    for name in ("box", "mask", "full_mask", "visible_fraction"):
        assert getattr(can, name) is None
    assert view.objects[0].size is None
    # The can's centre lies in front of what the sensor sees there by no more than its radius.
    u, v, z = view.K @ can.t
    seen = view.depth[round(v / z), round(u / z)]
    assert abs(seen - z) < 0.1


def test_the_real_frame_agrees_with_the_real_results(real_data):
    dataset = data_tools.open(f"bop:{real_data / 'lmo'}", rotations="as_read")
    frame = dataset.ground_truth()
    results = read_results(real_data / "bop_results" / "gt_lmo-test.csv", "as_read")
    rows = results[results.image_id == 3]
    assert rows.object_id.tolist() == frame.object_id.tolist()
    np.testing.assert_array_equal(rows.R, frame.R)
    np.testing.assert_allclose(rows.t, frame.t, rtol=2.3e-16)


LINKS = [
    *(f"test/000001/{kind}" for kind in ("rgb", "depth", "mask", "mask_visib")),
    *(f"test/000001/{kind}/000004.png" for kind in ("rgb", "depth")),
    *(f"test/000001/{kind}/000004_000001.png" for kind in ("mask", "mask_visib")),
    *(f"test/000001/scene_{name}.json" for name in ("camera", "gt", "gt_info")),
    *("test", "test/000001", "test_targets.json"),
    *("models", "models/models_info.json", "models/obj_000001.ply"),
]


@pytest.mark.parametrize("target", ["/no/such/disk", "itself"])
@pytest.mark.parametrize("name", LINKS)
def test_a_link_that_leads_nowhere_is_not_taken_for_nothing(tree, name, target):
    link = tree.path / name
    link.rename(tree.path / "away")
    link.symlink_to(link if target == "itself" else target)
    with pytest.raises(ValueError, match=re.escape(f"{link}: ")):
        dataset = BopDataset(tree.path, "test", targets="test_targets.json")
        assert dataset[0].objects
        dataset.models().mesh(1)


def test_a_link_that_leads_somewhere_is_followed(tree):
    link = tree.path / "test/000001/depth"
    link.rename(tree.path / "away")
    link.symlink_to(tree.path / "away")
    assert BopDataset(tree.path, "test")[0].depth is not None
    (tree.path / "notes").symlink_to("/no/such/disk")  # nobody asks for it
    assert BopDataset(tree.path, "test")[0].depth is not None
