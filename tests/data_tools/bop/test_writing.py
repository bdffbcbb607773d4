"""A written dataset: field by field against the published format, and read back as it was."""

import errno
import json
import multiprocessing
import os
import signal
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

import data_tools
from data_tools import ObjectView, View
from data_tools.bop import BopDataset, write_dataset
from data_tools.bop import writing as module
from data_tools.bop.models import Models
from data_tools.renderer.labels import render_labels
from data_tools.renderer.prepared import prepare
from data_tools.shapes.tabletop import make_object

WIDTH, HEIGHT, SCALE = 48, 36, 0.1
K = np.array([[60.0, 0, 23.5], [0, 61, 17.5], [0, 0, 1]])
IDS = (2, 3, 4)  # a can, a vase that is round, an egg box that is the same after half a turn


class World:
    """Six small views of three objects: cut by the border, hidden, twice in one image."""

    def __init__(self):
        rng = np.random.default_rng(3)
        self.models = {i: make_object(i) for i in IDS}
        prepared = {i: prepare(mesh) for i, mesh in self.models.items()}
        self.views, self.labels, self.wide = [], {}, {}
        for number, ids in enumerate([(2, 3, 4), (2, 2, 3), (4,), (), (3, 4, 2, 2), (2, 3)]):
            key = (1 + number % 2, 10 - number)
            R = Rotation.random(len(ids), random_state=number).as_matrix() if ids else []
            t = [[*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.5, 0.8)] for _ in ids]
            if number == 5:
                t = [[0, 0, 0.5], [0, 0, 1.5]]  # the second behind the first
            poses = list(zip(R, np.array(t), strict=True))
            objects = [prepared[i] for i in ids]
            labels = render_labels(objects, poses, K, (WIDTH, HEIGHT))
            # The same on the canvas of the toolkit's script, three times as wide and high.
            shifted = K + [[0, 0, WIDTH], [0, 0, HEIGHT], [0, 0, 0]]
            self.wide[key] = render_labels(objects, poses, shifted, (3 * WIDTH, 3 * HEIGHT))
            self.labels[key] = labels
            T = np.eye(4)
            T[:3, :3] = Rotation.random(random_state=50 + number).as_matrix()
            T[:3, 3] = rng.normal(size=3)
            depth = labels.depth * (rng.random(labels.depth.shape) < 0.9)  # holes, as sensors have
            self.views.append(
                View(
                    K=K,
                    scene_id=key[0],
                    image_id=key[1],
                    rgb=rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8),
                    depth=depth.astype(np.float32),
                    T_world_cam=T,
                    objects=tuple(
                        ObjectView(
                            object_id=i,
                            R=poses[k][0],
                            t=poses[k][1],
                            box=labels.visible_boxes[k],
                            mask=labels.visible_masks[k],
                            full_mask=labels.full_masks[k],
                            visible_fraction=labels.visible_fraction[k],
                            size=self.models[i].size,
                            symmetries=self.models[i].symmetries,
                        )
                        for k, i in enumerate(ids)
                    ),
                )
            )

    def silhouettes(self, view):
        labels = self.labels[view.scene_id, view.image_id]
        return labels.full_pixels, labels.full_boxes


@pytest.fixture(scope="module")
def world():
    return World()


@pytest.fixture(scope="module")
def written(world, tmp_path_factory):
    path = tmp_path_factory.mktemp("written") / "tabletop"
    splits = {"train_pbr": world.views[:1], "test": iter(world.views)}
    write_dataset(splits, path, world.models, silhouettes=world.silhouettes)
    return path


def load(path):
    return json.loads(path.read_text())


def test_the_files(world, written):
    found = sorted(p.relative_to(written).as_posix() for p in written.rglob("*") if p.is_file())
    expected = ["camera.json", "dataset_info.md"]
    expected += ["test_targets_bop19.json", "test_targets_bop24.json"]
    for folder in ("models", "models_eval"):
        expected += [f"{folder}/obj_{i:06d}.ply" for i in IDS] + [f"{folder}/models_info.json"]
    for split, views in (("train_pbr", world.views[:1]), ("test", world.views)):
        for view in views:
            scene, image = f"{split}/{view.scene_id:06d}", f"{view.image_id:06d}"
            expected += [f"{scene}/scene_{name}.json" for name in ("camera", "gt", "gt_info")]
            expected += [f"{scene}/{kind}/{image}.png" for kind in ("rgb", "depth")]
            for k in range(len(view.objects)):
                expected += [
                    f"{scene}/{kind}/{image}_{k:06d}.png" for kind in ("mask", "mask_visib")
                ]
    assert found == sorted(set(expected))
    assert [p.name for p in written.parent.iterdir()] == ["tabletop"]


def test_camera(written):
    assert load(written / "camera.json") == {
        "cx": 23.5, "cy": 17.5, "depth_scale": 0.1, "fx": 60.0, "fy": 61.0,
        "height": HEIGHT, "width": WIDTH,
    }  # fmt: skip


def test_scene_camera(world, written):
    for view in world.views:
        entries = load(written / f"test/{view.scene_id:06d}/scene_camera.json")
        assert list(entries) == sorted(entries, key=int)
        entry = entries[str(view.image_id)]
        assert entry.keys() == {"cam_K", "depth_scale", "cam_R_w2c", "cam_t_w2c"}
        assert entry["cam_K"] == [60, 0, 23.5, 0, 61, 17.5, 0, 0, 1]
        assert entry["depth_scale"] == SCALE
        # A point of the world in millimetres goes into the camera as the format says.
        x_cam = np.array([0.1, -0.2, 0.7])
        x_world = (view.T_world_cam @ [*x_cam, 1])[:3] * 1000
        R, t = np.reshape(entry["cam_R_w2c"], (3, 3)), np.array(entry["cam_t_w2c"])
        np.testing.assert_allclose(R @ x_world + t, x_cam * 1000, atol=1e-10)


def test_scene_gt(world, written):
    for view in world.views:
        entries = load(written / f"test/{view.scene_id:06d}/scene_gt.json")
        assert {int(i) for i in entries} == {
            v.image_id for v in world.views if v.scene_id == view.scene_id
        }
        poses = entries[str(view.image_id)]
        assert [pose["obj_id"] for pose in poses] == [item.object_id for item in view.objects]
        for pose, item in zip(poses, view.objects, strict=True):
            assert pose.keys() == {"obj_id", "cam_R_m2c", "cam_t_m2c"}
            assert np.array_equal(np.reshape(pose["cam_R_m2c"], (3, 3)), item.R), "row-wise"
            np.testing.assert_allclose(pose["cam_t_m2c"], item.t * 1000, rtol=1e-15)


def test_scene_gt_info(world, written):
    """Counted as the toolkit's script does, on a canvas three times as wide and high."""
    cut = hidden = 0
    for view in world.views:
        entries = load(written / f"test/{view.scene_id:06d}/scene_gt_info.json")
        infos = entries[str(view.image_id)]
        assert len(infos) == len(view.objects)
        wide = world.wide[view.scene_id, view.image_id]
        for k, (info, item) in enumerate(zip(infos, view.objects, strict=True)):
            silhouette = wide.full_masks[k]
            assert info["px_count_all"] == silhouette.sum()
            inside = silhouette[HEIGHT : 2 * HEIGHT, WIDTH : 2 * WIDTH]
            assert info["px_count_valid"] == (view.depth[inside] > 0).sum()
            assert info["px_count_visib"] == item.mask.sum()
            np.testing.assert_allclose(
                info["visib_fract"], item.mask.sum() / silhouette.sum(), rtol=1e-14
            )
            if not item.mask.any():
                assert info["bbox_obj"] == info["bbox_visib"] == [-1] * 4
                hidden += 1
                continue
            for name, mask, offset in (
                ("bbox_obj", silhouette, (WIDTH, HEIGHT)),
                ("bbox_visib", item.mask, (0, 0)),
            ):
                y, x = np.nonzero(mask)
                low = np.array([x.min(), y.min()]) - offset
                extent = np.array([x.max(), y.max()]) + 1 - [x.min(), y.min()]
                assert info[name] == [*low.tolist(), *extent.tolist()]
                assert all(type(number) is int for number in info[name])
            cut += silhouette.sum() > inside.sum()
            keys = {"bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib"}
            assert info.keys() == keys | {"visib_fract"}
    assert cut >= 3
    assert hidden >= 1


def test_images(world, written):
    for view in world.views:
        folder, stem = written / f"test/{view.scene_id:06d}", f"{view.image_id:06d}"
        rgb = Image.open(folder / f"rgb/{stem}.png")
        assert rgb.mode == "RGB"
        assert np.array_equal(np.array(rgb), view.rgb)
        depth = Image.open(folder / f"depth/{stem}.png")
        assert depth.mode == "I;16"
        units = np.array(depth)
        assert np.abs(units * SCALE - view.depth.astype(np.float64) * 1000).max() <= SCALE / 2
        assert np.array_equal(units == 0, view.depth == 0)
        for k, item in enumerate(view.objects):
            for kind, mask in (("mask", item.full_mask), ("mask_visib", item.mask)):
                image = Image.open(folder / f"{kind}/{stem}_{k:06d}.png")
                assert image.mode == "L"
                assert np.array_equal(np.array(image), mask * np.uint8(255))


def test_targets(world, written):
    """Every object that is at least 10 % visible, and how often the image has it so."""
    expected = []
    for view in sorted(world.views, key=lambda view: (view.scene_id, view.image_id)):
        counts = Counter(i.object_id for i in view.objects if i.visible_fraction >= 0.1)
        expected += [
            {
                "scene_id": view.scene_id,
                "im_id": view.image_id,
                "obj_id": i,
                "inst_count": counts[i],
            }
            for i in sorted(counts)
        ]
    assert load(written / "test_targets_bop19.json") == expected
    assert max(target["inst_count"] for target in expected) == 2
    assert any(i.visible_fraction < 0.1 for view in world.views for i in view.objects)
    dataset = data_tools.open(f"bop:{written}", split="test", targets="test_targets_bop19.json")
    assert sum(len(v.objects) for v in dataset) == sum(t["inst_count"] for t in expected)


def test_images_in_which_to_detect(world, written):
    """All of the split, also those in which nothing is visible enough."""
    expected = sorted((view.scene_id, view.image_id) for view in world.views)
    listed = load(written / "test_targets_bop24.json")
    assert listed == [{"scene_id": scene, "im_id": image} for scene, image in expected]


def test_what_the_dataset_says_of_itself(written):
    lines = (written / "dataset_info.md").read_text().splitlines()
    assert lines[0] == "# tabletop"
    assert lines[-2:] == ["| train_pbr | 1 | 1 |", "| test | 2 | 6 |"]


def test_models(world, written):
    """In millimetres, with unit normals, the box's middle in the origin; as the toolkit counts."""
    infos = load(written / "models/models_info.json")
    assert list(infos) == [str(i) for i in IDS]
    for i in IDS:
        info = infos[str(i)]
        data = (written / f"models/obj_{i:06d}.ply").read_bytes()
        assert data == (written / f"models_eval/obj_{i:06d}.ply").read_bytes()
        assert data.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex ")
        mesh = trimesh.load(written / f"models/obj_{i:06d}.ply", process=False)
        vertices = mesh.vertices
        # What is written are 32-bit floats: half a step of 0.0000153 mm at 250 mm, on both sides.
        near = {"rtol": 0, "atol": 1.6e-5}
        np.testing.assert_allclose([info[f"min_{a}"] for a in "xyz"], vertices.min(0), **near)
        np.testing.assert_allclose([info[f"size_{a}"] for a in "xyz"], np.ptp(vertices, 0), **near)
        np.testing.assert_allclose(info["diameter"], pdist(vertices).max(), **near)
        np.testing.assert_allclose(vertices.min(0), -vertices.max(0), **near)
        lengths = np.linalg.norm(mesh.vertex_normals, axis=1)
        np.testing.assert_allclose(lengths, 1, rtol=0, atol=1e-6)
    assert infos.keys() == load(written / "models_eval/models_info.json").keys()
    keys = {"diameter", *(f"{name}_{a}" for name in ("min", "size") for a in "xyz")}
    assert infos["2"].keys() == keys
    assert infos["3"].keys() == keys | {"symmetries_continuous"}
    assert infos["3"]["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
    assert infos["4"].keys() == keys | {"symmetries_discrete"}
    (half_a_turn,) = infos["4"]["symmetries_discrete"]
    np.testing.assert_allclose(np.reshape(half_a_turn, (4, 4)), np.diag([-1, -1, 1, 1]), atol=1e-15)


def test_a_full_disk_is_named(world, tmp_path, monkeypatch):
    """The system's error for it names no file."""
    stop_after(monkeypatch, 9, OSError(errno.ENOSPC, "No space left on device"))
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path / 'a.unfinished'}/"):
        write_dataset({"test": world.views[:4]}, tmp_path / "a", world.models)
    assert list(tmp_path.iterdir()) == []


def bare_view(**changes):
    fields = {"K": K, "scene_id": 1, "image_id": 0, "ir": np.full((4, 6), 7, np.uint16)}
    return View(**fields | changes)


@pytest.mark.parametrize(("targets", "number"), [(None, 1), ("val", 0), ("test_hard", 2)])
def test_targets_of_one_split(world, tmp_path, targets, number):
    splits = {"val": world.views[:1], "test": world.views[1:2], "test_hard": world.views[5:]}
    write_dataset(splits, tmp_path / "a", world.models, targets=targets)
    view = list(splits.values())[number][0]
    listed = load(tmp_path / "a/test_targets_bop19.json")
    assert {(t["scene_id"], t["im_id"]) for t in listed} == {(view.scene_id, view.image_id)}


def assert_same_view(read, view, depth_scale=SCALE):
    assert (read.scene_id, read.image_id) == (view.scene_id, view.image_id)
    assert np.array_equal(read.K, view.K)
    for name in ("rgb", "ir"):
        image, expected = getattr(read, name), getattr(view, name)
        assert (image is None) == (expected is None)
        assert image is None or (np.array_equal(image, expected) and image.dtype == expected.dtype)
    assert (read.depth is None) == (view.depth is None)
    if view.depth is not None:
        error = np.abs(read.depth.astype(np.float64) - view.depth.astype(np.float64))
        # Half a unit, and the rounding of metres to float32.
        assert (error <= depth_scale / 2000 + np.spacing(view.depth)).all()
    if view.T_world_cam is None:
        assert read.T_world_cam is None
    else:
        np.testing.assert_allclose(read.T_world_cam, view.T_world_cam, atol=1e-14)
    assert len(read.objects) == len(view.objects)
    for got, item in zip(read.objects, view.objects, strict=True):
        assert got.object_id == item.object_id
        np.testing.assert_allclose(got.R, item.R, atol=1e-15)
        np.testing.assert_allclose(got.t, item.t, rtol=1e-15)
        assert np.array_equal(got.mask, item.mask)
        assert np.array_equal(got.full_mask, item.full_mask)
        assert got.visible_fraction == item.visible_fraction
        if item.mask.any():
            assert np.array_equal(got.box, item.box)
        else:
            assert got.box is None


def test_round_trip(world, written):
    dataset = data_tools.open(f"bop:{written}", split="test")
    views = sorted(world.views, key=lambda view: (view.scene_id, view.image_id))
    assert len(dataset) == len(views)
    for read, view in zip(dataset, views, strict=True):
        assert_same_view(read, view)
        for got, item in zip(read.objects, view.objects, strict=True):
            np.testing.assert_allclose(got.size, item.size, rtol=1e-6)
            if item.object_id != 3:
                np.testing.assert_allclose(got.symmetries, item.symmetries, atol=1e-12)
                continue
            # A round object is written with its axis and read with finer steps.
            away = np.abs(got.symmetries[:, None] - item.symmetries).max((2, 3)).min(0)
            assert len(got.symmetries) == 315
            assert away.max() < np.pi / 315
    assert len(data_tools.open(f"bop:{written}", split="train_pbr")) == 1


def test_a_dataset_written_again_is_the_same(written, tmp_path):
    """What the reader yields can be written, with the models and infos that it has."""
    dataset = BopDataset(written, "test")
    models = {i: dataset.models().mesh(i) for i in IDS}
    infos = {i: dataset.models().info(i) for i in IDS}
    write_dataset({"test": dataset}, tmp_path / "again", models, infos=infos)
    again = BopDataset(tmp_path / "again", "test")
    for read, view in zip(again, dataset, strict=True):
        assert_same_view(read, view)
    for name in ("camera.json", "test_targets_bop19.json"):
        assert load(tmp_path / "again" / name) == load(written / name)
    for i in IDS:
        info, expected = again.models().info(i), infos[i]
        np.testing.assert_allclose(info.symmetries(), expected.symmetries(), atol=1e-12)
        np.testing.assert_allclose(info.diameter, expected.diameter, rtol=1e-15)
        for folder in ("models", "models_eval"):
            old, new = (Models(path / folder).mesh(i) for path in (written, tmp_path / "again"))
            assert np.array_equal(new.faces, old.faces)
            assert np.array_equal(new.visual.vertex_colors, old.visual.vertex_colors)
            for name in ("vertices", "vertex_normals"):
                np.testing.assert_allclose(getattr(new, name), getattr(old, name), atol=1e-7)


def test_models_for_measuring(world, tmp_path):
    """The models that errors are measured with may be others."""
    coarse = {i: trimesh.creation.box(mesh.size) for i, mesh in world.models.items()}
    path = tmp_path / "a"
    write_dataset({"test": world.views[:1]}, path, world.models, models_eval=coarse)
    dataset = BopDataset(path, "test")
    for i, mesh in world.models.items():
        assert len(dataset.models().mesh(i).vertices) == len(mesh.vertices)
        assert len(dataset.models("models_eval").mesh(i).vertices) == 8


def test_without_silhouettes(world, tmp_path):
    """The size follows from the visible fraction; the box is cut at the border."""
    write_dataset({"test": world.views}, tmp_path / "a", world.models)
    for view in world.views:
        infos = load(tmp_path / f"a/test/{view.scene_id:06d}/scene_gt_info.json")
        labels = world.labels[view.scene_id, view.image_id]
        for k, info in enumerate(infos[str(view.image_id)]):
            item = view.objects[k]
            if not item.mask.any():
                assert info["px_count_all"] == item.full_mask.sum()
                continue
            assert info["px_count_all"] == labels.full_pixels[k]
            x, y, w, h = info["bbox_obj"]
            mask = np.zeros_like(item.full_mask)
            mask[y : y + h, x : x + w] = True
            assert not (item.full_mask & ~mask).any()
            assert item.full_mask[[y, y + h - 1]].any(1).all()
            assert item.full_mask[:, [x, x + w - 1]].any(0).all()


def test_what_is_not_known_is_counted(world, tmp_path):
    """Without box and visible fraction they come from the masks."""
    item = replace(world.views[0].objects[0], box=None, visible_fraction=None)
    view = replace(world.views[0], objects=(item,), depth=None)
    write_dataset({"test": [view]}, tmp_path / "a", world.models)
    (info,) = load(tmp_path / f"a/test/{view.scene_id:06d}/scene_gt_info.json").popitem()[1]
    visible, whole = int(item.mask.sum()), int(item.full_mask.sum())
    assert info["visib_fract"] == visible / whole
    assert info["px_count_all"] == whole
    assert info["px_count_valid"] == 0
    assert info["bbox_visib"] == world.views[0].objects[0].box.tolist()


@pytest.mark.slow
@settings(max_examples=20)
@given(data=st.data())
def test_any_views_come_back(tmp_path_factory, data):
    """Images of any kind and number, in any order, with any number of objects."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    kinds = data.draw(st.sets(st.sampled_from(["rgb", "ir", "depth"]), min_size=1))
    keys = data.draw(
        st.lists(st.tuples(st.integers(0, 3), st.integers(0, 10**6)), min_size=1, unique=True,
                 max_size=5)
    )  # fmt: skip
    depth_scale = data.draw(st.sampled_from([0.05, 0.1, 1.0]))
    grey = data.draw(st.sampled_from([np.uint8, np.uint16]))
    views = []
    for scene_id, image_id in keys:
        objects = []
        for _ in range(data.draw(st.integers(0, 2))):
            full = rng.random(shape) < 0.7
            mask = full & (rng.random(shape) < 0.7)
            R = Rotation.random(random_state=rng.integers(99)).as_matrix()
            box = module._box(mask) if mask.any() else None
            fraction = mask.sum() / max(1, full.sum())
            objects.append(
                ObjectView(object_id=7, R=R, t=rng.normal(size=3), mask=mask, full_mask=full,
                           box=box, visible_fraction=fraction)
            )  # fmt: skip
        T = None
        if data.draw(st.booleans()):
            T = np.eye(4)
            T[:3] = np.column_stack([Rotation.random(random_state=1).as_matrix(), rng.random(3)])
        images = {
            "rgb": rng.integers(0, 256, (*shape, 3), np.uint8),
            "ir": rng.integers(0, np.iinfo(grey).max, shape, grey),
            "depth": np.float32(rng.random(shape) * 65.5 * depth_scale),
        }
        chosen = {kind: images[kind] for kind in kinds}
        views.append(
            View(
                K=K, scene_id=scene_id, image_id=image_id, T_world_cam=T, objects=objects, **chosen
            )
        )
    path = tmp_path_factory.mktemp("any") / "made"
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    write_dataset({"val": views}, path, {7: box}, depth_scale=depth_scale)
    dataset = data_tools.open(f"bop:{path}")
    assert len(dataset) == len(views)
    for read, view in zip(dataset, sorted(views, key=lambda v: (v.scene_id, v.image_id)),
                          strict=True):  # fmt: skip
        assert_same_view(read, view, depth_scale)
    assert not (path / "test_targets_bop19.json").exists()


def stop_after(monkeypatch, count, error):
    real, calls = os.fsync, []

    def fail(descriptor):
        calls.append(1)
        if len(calls) > count:
            raise error
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fail)


@pytest.mark.parametrize("count", [0, 4, 8, 9, 20, 33])
@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_nothing_is_left_after_an_error(world, tmp_path, monkeypatch, count, error):
    stop_after(monkeypatch, count, error)
    with pytest.raises(type(error)):
        write_dataset({"test": world.views[:4]}, tmp_path / "a", world.models)
    assert list(tmp_path.iterdir()) == []


def test_views_that_fail_leave_nothing(world, tmp_path):
    def views():
        yield world.views[0]
        raise RuntimeError("the world ended")

    (tmp_path / "a").mkdir()
    with pytest.raises(RuntimeError, match="the world ended"):
        write_dataset({"test": views()}, tmp_path / "a", world.models)
    assert [p.name for p in tmp_path.rglob("*")] == ["a"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this test forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_after_a_kill_it_is_visibly_unfinished(world, tmp_path):
    def views():
        yield from world.views[:3]
        os.kill(os.getpid(), signal.SIGKILL)

    process = multiprocessing.get_context("fork").Process(
        target=lambda: write_dataset({"test": views()}, tmp_path / "a", world.models)
    )
    process.start()
    process.join(20)
    assert process.exitcode == -signal.SIGKILL
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.unfinished.lock.tmp", "a.unfinished"]
    write_dataset({"test": world.views}, tmp_path / "a", world.models)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert len(data_tools.open(f"bop:{tmp_path / 'a'}")) == 6


def test_a_folder_that_another_one_writes_is_refused(world, tmp_path):
    def views():
        yield world.views[0]
        with pytest.raises(ValueError, match="path: expected one that no other process writes"):
            write_dataset({"test": world.views}, tmp_path / "a", world.models)
        yield world.views[1]

    write_dataset({"test": views()}, tmp_path / "a", world.models)
    assert len(data_tools.open(f"bop:{tmp_path / 'a'}")) == 2


def test_what_only_has_the_name_of_remains_stays(world, tmp_path):
    (tmp_path / "a.unfinished").mkdir()
    (tmp_path / "a.unfinished" / "thesis.tex").write_text("precious")
    with pytest.raises(ValueError, match=r"path: expected no a\.unfinished beside it"):
        write_dataset({"test": world.views}, tmp_path / "a", world.models)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.unfinished", "thesis.tex"]


@pytest.mark.parametrize("name", [".", "../link"])
def test_the_folder_one_stands_in_is_filled(world, tmp_path, monkeypatch, name):
    (tmp_path / "here").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "here")
    before = (tmp_path / "here").stat().st_ino
    monkeypatch.chdir(tmp_path / "here")
    write_dataset({"test": world.views[:1]}, name, world.models)
    assert os.stat(".").st_ino == (tmp_path / "here").stat().st_ino == before
    assert len(data_tools.open("bop:.")) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["here", "link"]


def test_no_name_is_not_the_folder_one_stands_in(world, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="path: expected the name of a file or a folder, got ''"):
        write_dataset({"test": world.views[:1]}, "", world.models)


def test_a_folder_with_something_in_it_is_refused(world, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.tex").write_text("precious")
    for path in (tmp_path / "a", tmp_path / "a" / "thesis.tex"):
        with pytest.raises(ValueError, match="path: expected a new or an empty folder"):
            write_dataset({"test": world.views}, path, world.models)
    assert [p.name for p in tmp_path.rglob("*")] == ["a", "thesis.tex"]
    (tmp_path / "empty").mkdir()
    write_dataset({"test": world.views[:1]}, tmp_path / "empty", world.models)
    assert len(data_tools.open(f"bop:{tmp_path / 'empty'}")) == 1


BOX = {1: trimesh.creation.box((1, 1, 1))}
FLAT = np.zeros((4, 6), np.float32)


def one_object(**changes):
    mask = np.ones((4, 6), bool)
    fields = {"object_id": 1, "R": np.eye(3), "t": [0, 0, 1], "mask": mask, "full_mask": mask}
    return bare_view(objects=[ObjectView(**fields | changes)])


@pytest.mark.parametrize(
    ("splits", "options", "name"),
    [
        ([bare_view()], {}, "splits: expected views by the name"),
        ({}, {}, "splits"),
        ({"testing": [bare_view()]}, {}, "splits: expected names"),
        ({"test/1": [bare_view()]}, {}, "splits: expected names"),
        ({3: [bare_view()]}, {}, "splits: expected names"),
        ({"test": []}, {}, r"splits\['test'\]: expected at least one view"),
        ({"test": [3]}, {}, r"splits\['test'\], view 0: expected a View"),
        ({"test": [bare_view(), bare_view()]}, {}, r"view 1 \(scene 1, image 0\): .* once"),
        ({"test": [bare_view(), bare_view(image_id=1, depth=FLAT)]}, {}, "view 1.*the images"),
        ({"test": [bare_view(), bare_view(image_id=1, ir=np.ones((4, 5), np.uint8))]}, {},
         "view 1.*height and width"),
        ({"test": [bare_view(ir=None)]}, {}, "view 0.*a view with an image"),
        ({"test": [bare_view(depth=FLAT + 6.554)]}, {}, r"view 0.*depth: expected at most 6\.55"),
        ({"test": [one_object(object_id=2)]}, {}, "view 0.*objects: .* in models, got 2"),
        ({"test": [one_object(mask=None)]}, {}, "view 0.*mask of object 1"),
        ({"test": [one_object(full_mask=None)]}, {}, "view 0.*full_mask of object 1"),
        ({"test": [one_object(R=2 * np.eye(3))]}, {}, "view 0.*R of object 1"),
        ({"test": [bare_view(T_world_cam=np.diag([2.0, 1, 1, 1]))]}, {}, "view 0.*T_world_cam"),
        ({"test": [one_object()]}, {"silhouettes": lambda view: (np.ones(2), np.ones((2, 4)))},
         "view 0.*silhouettes"),
        ({"test": [bare_view()]}, {"models": {}}, "models: expected meshes"),
        ({"test": [bare_view()]}, {"models": [BOX[1]]}, "models: expected meshes"),
        ({"test": [bare_view()]}, {"models": {"1": BOX[1]}}, "models: expected an integer"),
        ({"test": [bare_view()]}, {"models": {1: "box.ply"}}, r"models\[1\]: expected a Mesh"),
        ({"test": [bare_view()]}, {"models": {1: trimesh.Trimesh()}}, r"models\[1\].*vertices"),
        ({"test": [bare_view()]}, {"infos": {2: None}}, "infos"),
        ({"test": [bare_view()]}, {"infos": {1: {"diameter": 3}}}, "infos"),
        ({"test": [bare_view()]}, {"depth_scale": 0}, "depth_scale"),
        ({"test": [bare_view()]}, {"depth_scale": "1"}, "depth_scale"),
        ({"test": [bare_view()]}, {"targets": "val"}, "targets"),
        ({"test": [bare_view()]}, {"path": "no/where"}, "path: expected a folder in one"),
    ],
)  # fmt: skip
def test_bad_input(tmp_path, splits, options, name):
    path = tmp_path / options.pop("path", "a")
    models = options.pop("models", BOX)
    with pytest.raises(ValueError, match=name):
        write_dataset(splits, path, models, **options)
    assert list(tmp_path.iterdir()) == []
