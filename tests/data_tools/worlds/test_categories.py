"""The world of the six categories."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer import prepare, render_labels
from data_tools.shapes import CATEGORIES, make_category, make_floor
from data_tools.shapes.building import turn
from data_tools.storage.records import encode_record
from data_tools.views import ObjectView, View
from data_tools.worlds import categories, category_scenes
from data_tools.worlds.categories import (
    INSTANCES,
    WORLD,
    handle_visible,
    nocs_map,
    object_coordinates,
    object_id,
)
from data_tools.worlds.world import Size
from posecore.cameras import project
from posecore.poses import apply

pytestmark = pytest.mark.slow

FEW = replace(WORLD, sizes={"tiny": Size(64, 64, {"train": 18, "synthetic": 6, "shifted": 12})})


def mesh_of(item):
    """The mesh of an object; not from the models, of which there are hundreds to make."""
    return make_category(*categories._ALL[item.object_id])


@pytest.fixture(scope="module")
def splits(tiny_views):
    return {split: tiny_views(FEW, split) for split in FEW.splits}


@pytest.fixture(scope="module")
def views(splits):
    return [view for each in splits.values() for view in each]


def test_sizes_of_the_splits():
    tiny, book = WORLD.sizes["tiny"], WORLD.sizes["book"]
    assert (tiny.width, tiny.height) == (64, 64)
    assert dict(tiny.counts) == {"train": 72, "synthetic": 24, "shifted": 24}
    assert (book.width, book.height) == (128, 128)
    assert dict(book.counts) == {"train": 3600, "synthetic": 360, "shifted": 360}


def test_a_view_is_about_one_object_and_categories_come_in_turns(views):
    for view in views:
        assert view.rgb.shape == (64, 64, 3)
        assert view.depth.shape == (64, 64)
        assert len(view.objects) == 1
        assert view.objects[0].category == CATEGORIES[view.image_id % 6]


def test_no_instance_is_in_two_splits(splits):
    ids = [{view.objects[0].object_id for view in each} for each in splits.values()]
    assert all(len(each) == len(views) for each, views in zip(ids, splits.values(), strict=True))
    assert sum(map(len, ids)) == len(set.union(*ids))
    seeds = [set(instances) for instances in INSTANCES.values()]
    assert sum(map(len, seeds)) == len(set.union(*seeds))


def test_coordinates_land_on_their_pixels(views):
    for view in views:
        item = view.objects[0]
        rows, columns = np.nonzero(item.mask)
        points = object_coordinates(view)[item.mask].astype(np.float64)
        pixels = project(view.K, apply(item.R, item.t, points))
        assert np.abs(pixels - np.stack([columns, rows], -1)).max() < 0.01
        assert not object_coordinates(view)[~item.mask].any()


def test_coordinates_lie_on_the_object(views):
    """As the renderer finds them anew, and within the object's box."""
    for view in views[::5]:
        item = view.objects[0]
        mesh = mesh_of(item)
        seen = render_labels([prepare(mesh)], [(item.R, item.t)], view.K, (64, 64))
        found, expected = object_coordinates(view)[item.mask], seen.coordinates[item.mask]
        # Depth is kept in 65535 steps of what the object spans along the axis, 5 mm to 0.5 m.
        assert np.abs(found - expected).max() < 1e-5
        assert (np.abs(found) <= mesh.size / 2 + 1e-5).all()


def test_sizes_are_the_bounding_boxes(views):
    for view in views:
        item = view.objects[0]
        mesh = mesh_of(item)
        assert mesh.name == item.category
        assert np.array_equal(item.size, mesh.size)
        assert np.allclose(mesh.bounds[0], -mesh.bounds[1], atol=1e-12)


def test_solids_of_revolution_have_symmetries(views):
    for view in views:
        item = view.objects[0]
        count = 36 if item.category in ("bottle", "bowl", "can") else 1
        assert item.symmetries.shape == (count, 4, 4)


def test_masks_boxes_and_shares_agree(views):
    shares = []
    for view in views:
        item = view.objects[0]
        assert not (item.mask & ~item.full_mask).any()
        rows, columns = np.nonzero(item.mask)
        assert item.box[0] == columns.min()
        assert item.box[1] == rows.min()
        assert item.box[0] + item.box[2] == columns.max() + 1
        assert item.box[1] + item.box[3] == rows.max() + 1
        assert 0.4 <= item.visible_fraction <= item.mask.sum() / item.full_mask.sum()
        shares.append(item.visible_fraction)
    assert min(shares) < 0.9  # something stands before some
    assert np.median(shares) > 0.9


def test_measured_depth_is_that_of_the_surface_but_for_noise_and_holes(splits):
    """Disparity in pixels of the camera has a noise of 0.08 and steps of 0.125, a deviation of 0.04
    if even: 0.09 together at a product of focal length and baseline of 43 pixel metres."""
    spreads = []
    for split, noise in (("train", 0.088), ("shifted", 0.18)):
        errors = []
        for view in splits[split]:
            item = view.objects[0]
            exact = apply(item.R, item.t, object_coordinates(view)[item.mask])[:, 2]
            measured = view.depth[item.mask]
            there = measured > 0
            assert there.mean() > 0.3
            errors.append(43.3 * (1 / measured[there] - 1 / exact[there]))
        errors = np.concatenate(errors)
        assert abs(np.median(errors)) < 0.02
        spreads.append(np.median(np.abs(errors)) * 1.4826)
        assert 0.8 * noise < spreads[-1] < 1.2 * noise
    assert spreads[1] > 1.5 * spreads[0]


def test_shifted_views_have_other_floors_and_other_light(rng):
    recipe = WORLD.recipe("train", "tiny")
    scene = category_scenes.draw_scene(recipe, 0, rng)
    kinds, colours, heights = {}, {}, {}
    for split in WORLD.splits:
        look = category_scenes._LOOKS[split]
        kinds[split] = {make_floor(floor).name for floor in look.floors}
        lamps = [category_scenes._lights(scene, look, rng)[0] for _ in range(300)]
        colours[split] = np.std([np.log(lamp.power[0] / lamp.power[2]) for lamp in lamps])
        towards = np.array([lamp.position for lamp in lamps]) - scene.poses[0][1]
        heights[split] = (towards @ scene.camera[0].T)[:, 2] / np.linalg.norm(towards, axis=1)
        assert np.sin(np.radians(look.height[0])) - 1e-9 <= heights[split].min()
    assert kinds["train"] == kinds["synthetic"]
    assert not kinds["train"] & kinds["shifted"]
    assert len(kinds["train"]) == len(kinds["shifted"]) == 3
    # Tints are drawn evenly from +-0.06 and +-0.3: log((1 + w) / (1 - w)) spreads 2 w / sqrt(3).
    assert colours["train"] < 0.08 < 0.3 < colours["shifted"]
    assert np.median(heights["shifted"]) < np.median(heights["train"]) - 0.1


def test_objects_rest_on_the_floor(views):
    for view in views[::4]:
        item = view.objects[0]
        vertices = mesh_of(item).vertices
        in_camera = apply(item.R, item.t, vertices)
        R, t = view.T_world_cam[:3, :3], view.T_world_cam[:3, 3]
        height = apply(R, t, in_camera)[:, 2]
        assert abs(height.min()) < 1e-9


@given(st.data())
def test_nocs_map_is_the_scaled_box(views, data):
    view = data.draw(st.sampled_from(views))
    item = view.objects[0]
    values = nocs_map(view)
    assert ((values >= 0) & (values <= 1)).all()
    assert not values[~item.mask].any()
    back = (values[item.mask] - 0.5) * np.linalg.norm(item.size)
    # float32 next to 1/2 has steps of 6e-8, a few of which come together over half a metre.
    assert np.allclose(back, object_coordinates(view)[item.mask], atol=2e-7)


def mug_seen(instance, azimuth, elevation=20.0):
    """A mug before the camera, its handle (+x) `azimuth` degrees from the camera's right."""
    mesh = make_category("mug", instance)
    R = turn("x", 180 + elevation) @ turn("y", azimuth)
    t, K = np.array([0, 0, 0.5]), np.array([[400.0, 0, 63.5], [0, 400, 63.5], [0, 0, 1]])
    labels = render_labels([prepare(mesh)], [(R, t)], K, (128, 128))
    mask = labels.visible_masks[0]
    coordinates = np.where(mask[..., None], labels.coordinates, 0)
    item = ObjectView(
        object_id=object_id("mug", instance), category="mug", R=R, t=t, mask=mask,
        size=mesh.size, coordinates=coordinates,
    )  # fmt: skip
    handle = coordinates[mask][:, 0] > mesh.size[0] / 2 - 0.01  # its outermost centimetre
    return View(K=K, scene_id=0, image_id=0, objects=(item,)), bool(handle.any())


@pytest.mark.parametrize("instance", [0, 5, 50])
def test_a_mugs_handle_is_seen_unless_it_is_behind(instance):
    seen = []
    for azimuth in range(0, 360, 30):
        view, there = mug_seen(instance, azimuth, 0.0)
        seen.append(handle_visible(view))
        assert seen[-1] or not there  # what reaches farthest out is missed nowhere
    assert seen[0] and seen[6] and seen.count(False) in range(1, 5)
    behind = mug_seen(instance, 90, 0.0)[0], mug_seen(instance, 270, 0.0)[0]
    assert sorted(map(handle_visible, behind)) == [False, True]


def test_only_mugs_have_handles(views):
    for view in views[:6]:
        if view.objects[0].category != "mug":
            with pytest.raises(ValueError, match="a mug"):
                handle_visible(view)


@given(st.sampled_from(CATEGORIES), st.integers(0, 71))
def test_object_ids_tell_the_instance(category, instance):
    number = object_id(category, instance)
    assert number in WORLD.object_ids
    assert (CATEGORIES[number // 1000 - 1], number % 1000) == (category, instance)


def test_there_is_an_id_for_every_instance_of_every_split():
    assert len(set(WORLD.object_ids)) == len(WORLD.object_ids) == 6 * 72
    instances = {instance for each in INSTANCES.values() for instance in each}
    assert set(categories._ALL.values()) == {(c, i) for c in CATEGORIES for i in instances}


def test_a_scene_at_paper_scale_has_several_objects():
    recipe = WORLD.recipe("train", "paper") | {"width": 128, "height": 96}
    for index in range(3):
        (view,) = WORLD.views(recipe, index, WORLD.record(recipe, index))
        assert 2 <= len(view.objects) <= 6
        for k, item in enumerate(view.objects):
            points = object_coordinates(view, k)[item.mask].astype(np.float64)
            rows, columns = np.nonzero(item.mask)
            pixels = project(view.K, apply(item.R, item.t, points))
            assert np.abs(pixels - np.stack([columns, rows], -1)).max() < 0.01
        assert np.sum([item.mask for item in view.objects], axis=0).max() == 1


def test_same_bytes_in_another_process(two_processes):
    """Whatever was made before: here in the opposite order."""
    recipe, indices = WORLD.recipe("shifted", "tiny"), [0, 3, 8, 11]
    there = two_processes.starmap(WORLD.record, [(recipe, i) for i in indices], chunksize=1)
    here = [WORLD.record(recipe, i) for i in reversed(indices)]
    assert [encode_record(r) for r in there] == [encode_record(r) for r in reversed(here)]


PLAIN = ObjectView(object_id=1, R=np.eye(3), t=np.ones(3))
BARE = View(K=np.eye(3), scene_id=0, image_id=0)


def without(view, name):
    return replace(view, objects=(replace(view.objects[0], **{name: None}),))


POSE = {"object_id": 1, "R": np.eye(3), "t": np.ones(3)}


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda view: object_coordinates(view, 1), "index"),
        (lambda view: object_coordinates(view, 0.5), "index"),
        (lambda view: object_coordinates(BARE), "view"),
        (lambda view: object_coordinates(replace(BARE, objects=(PLAIN,))), "coordinates"),
        (lambda view: nocs_map(view, -1), "index"),
        (lambda view: nocs_map(replace(BARE, objects=(PLAIN,))), "coordinates"),
        (lambda view: nocs_map(without(view, "size")), "size"),
        (lambda view: nocs_map(without(view, "mask")), "mask"),
        (lambda view: object_id("cup", 0), "category"),
        (lambda view: object_id("mug", 72), "instance"),
        (lambda view: object_id("mug", -1), "instance"),
        (lambda view: WORLD.open(split="test"), "split"),
        (lambda view: WORLD.open(split="train", scale="small"), "scale"),
    ],
)
def test_bad_input(views, call, name):
    with pytest.raises(ValueError, match=name):
        call(views[0])
