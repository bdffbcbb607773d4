from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from data_tools.renderer import prepare, render_labels
from data_tools.shapes import make_object
from data_tools.worlds.tabletop import KINDS, WORLD, intrinsics, record, silhouettes, views
from data_tools.worlds.world import Size
from posecore.cameras import project

pytestmark = pytest.mark.slow

MESHES = {i: make_object(i) for i in range(1, 9)}
PREPARED = {i: prepare(mesh) for i, mesh in MESHES.items()}
HULLS = {i: ConvexHull(mesh.vertices) for i, mesh in MESHES.items()}
SPLITS = ("train", "easy", "occluded")


@pytest.fixture(scope="module")
def made(tiny_cache):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(tiny_cache))
        return {split: list(WORLD.open(split=split, scale="tiny")) for split in SPLITS}


@pytest.fixture(scope="module")
def every(made):
    return [view for split in SPLITS for view in made[split]]


@pytest.fixture(scope="module")
def tables(made):
    """The views of objects that stand on a table."""
    return made["easy"] + made["occluded"] + made["train"][KINDS.index("table") :: len(KINDS)]


def alone(view):
    """The labels of the view's objects as if nothing else were there, one after the other."""
    size = view.shape[::-1]
    return [
        render_labels([PREPARED[o.object_id]], [(o.R, o.t)], view.K, size) for o in view.objects
    ]


def test_sizes():
    assert WORLD.sizes == {
        "tiny": Size(96, 72, {"train": 40, "easy": 10, "occluded": 10}),
        "book": Size(320, 240, {"train": 2000, "easy": 150, "occluded": 150}),
        "paper": Size(640, 480, {"train": 20_000, "easy": 1000, "occluded": 1000}),
    }


def test_views(made):
    for number, split in enumerate(SPLITS):
        assert len(made[split]) == WORLD.sizes["tiny"].counts[split]
        for index, view in enumerate(made[split]):
            assert (view.scene_id, view.image_id) == (number + 1, index)
            assert view.shape == (72, 96)
            assert np.array_equal(view.K, intrinsics(96, 72))
            assert view.rgb.dtype == np.uint8
            assert view.depth.dtype == np.float32
            ids = [item.object_id for item in view.objects]
            assert len(set(ids)) == len(ids) > 0
            for item in view.objects:
                mesh = MESHES[item.object_id]
                assert np.allclose(item.size, mesh.size, atol=1e-12)
                assert np.allclose(item.R @ item.R.T, np.eye(3), atol=1e-9)
    assert {i for view in made["train"] for i in (o.object_id for o in view.objects)} == set(MESHES)


def test_the_camera_is_linemods():
    assert np.allclose(
        intrinsics(640, 480), [[572.4114, 0, 325.2611], [0, 573.5704, 242.049], [0, 0, 1]]
    )
    # The same ray through the same point of the sensor, whose corner is at (-1/2, -1/2).
    ray = np.array([0.1, -0.2, 1])
    whole, half = (intrinsics(*size) @ ray for size in ((640, 480), (320, 240)))
    assert np.allclose((whole + 0.5)[:2], 2 * (half + 0.5)[:2])


def test_masks_boxes_and_fractions(every):
    for view in every:
        seen = np.zeros(view.shape, int)
        for item, labels in zip(view.objects, alone(view), strict=True):
            seen += item.mask
            assert not (item.mask & ~item.full_mask).any()
            assert np.array_equal(item.full_mask, labels.full_masks[0])
            assert item.visible_fraction == item.mask.sum() / max(1, labels.full_pixels[0])
            if item.box is None:
                assert not item.mask.any()
                continue
            y, x = np.nonzero(item.mask)
            low, high = (x.min(), y.min()), (x.max() + 1, y.max() + 1)
            assert item.box.tolist() == [*low, high[0] - low[0], high[1] - low[1]]
        assert seen.max() <= 1, "a pixel sees one object"


def test_silhouettes(every):
    for view in every[::7]:
        pixels, boxes = silhouettes(view)
        for row, labels in enumerate(alone(view)):
            assert pixels[row] == labels.full_pixels[0]
            assert boxes[row].tolist() == labels.full_boxes[0].tolist()


def test_where_an_object_is_seen_it_is_the_nearest(every):
    """Masks against a brute search over the depths of the objects alone."""
    for view in every:
        depths = np.array([np.where(a.depth > 0, a.depth, np.inf) for a in alone(view)])
        for row, item in enumerate(view.objects):
            assert (depths[row][item.mask] <= depths.min(0)[item.mask] + 1e-6).all()


def test_depth_agrees_but_for_the_sensor(every):
    """Its noise is 0.08 pixels of disparity at 640 pixels, and a step 0.125, whatever the size."""
    errors, measured = [], []
    for view in every:
        for item, labels in zip(view.objects, alone(view), strict=True):
            depth, true = view.depth[item.mask], labels.depth[item.mask]
            errors.append(((depth - true) / true**2)[depth > 0])
            measured.append(depth > 0)
    unit = 0.08 / (572.4114 * 0.075)
    errors = np.concatenate(errors) / unit
    assert 0.7 < errors.std() < 1.5
    assert np.abs(errors).max() < 8
    assert abs(np.median(errors)) < 0.1
    assert 0.5 < np.concatenate(measured).mean() < 0.99, "there are holes, but not many"


def test_the_origin_is_in_the_box(every):
    count = 0
    for view in every:
        for item in view.objects:
            if item.visible_fraction > 0.999:
                count += 1
                x, y, width, height = item.box
                u, v = project(view.K, item.t[None])[0]
                assert x - 0.5 <= u <= x + width - 0.5
                assert y - 0.5 <= v <= y + height - 0.5
    assert count > 50


def test_objects_lie_on_the_table(tables):
    for view in tables:
        for item in view.objects:
            T = view.T_world_cam
            points = (MESHES[item.object_id].vertices @ item.R.T + item.t) @ T[:3, :3].T + T[:3, 3]
            assert abs(points[:, 2].min()) < 1e-6
            assert np.linalg.norm(points[:, :2], axis=1).max() < 1.2


def test_no_object_is_in_another(every):
    for view in every:
        for one, other in combinations(view.objects, 2):
            for a, b in ((one, other), (other, one)):
                points = MESHES[a.object_id].vertices[::4] @ a.R.T + a.t
                equations = HULLS[b.object_id].equations
                inside = (points - b.t) @ b.R @ equations[:, :3].T + equations[:, 3]
                assert inside.max(1).min() > 0, (view, a, b)


def test_cameras(tables, every):
    elevations, rolls, distances = [], [], []
    for view in tables:
        R, place = view.T_world_cam[:3, :3], view.T_world_cam[:3, 3]
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
        elevations.append(np.arcsin(-R[2, 2]))
        up = R[2]
        rolls.append(np.arctan2(up[0], -up[1]))
        middle = np.mean([view.T_world_cam[:3, :3] @ o.t + place for o in view.objects], axis=0)
        distances.append(np.linalg.norm(place - middle))
    assert np.rad2deg(min(elevations)) > 8
    assert np.rad2deg(max(elevations)) > 50
    assert 0.02 < np.std(rolls) < 0.2
    assert 0.4 < min(distances) < 0.75
    assert 0.8 < max(distances) < 1.1


def test_the_splits_differ_as_they_should(made):
    shares = {
        split: np.array([o.visible_fraction for view in made[split] for o in view.objects])
        for split in SPLITS
    }
    assert np.mean(shares["easy"]) > 0.9
    assert np.mean(shares["easy"] < 0.5) < 0.05
    assert np.mean(shares["occluded"]) < 0.8
    assert np.mean(shares["occluded"] < 0.5) > 0.15, "some are hidden by more than half"
    assert np.mean(shares["occluded"] > 0.9) > 0.1, "others are in front"
    counts = {split: [len(view.objects) for view in made[split]] for split in SPLITS}
    assert set(counts["easy"]) <= {3, 4, 5}
    assert set(counts["occluded"]) <= {6, 7, 8}
    for index, count in enumerate(counts["train"]):
        kind = KINDS[index % len(KINDS)]
        assert count == 1 if kind == "single" else count >= 3


def test_pictures_are_neither_dark_nor_white(every):
    means = [view.rgb.mean() for view in every]
    assert 60 < min(means) < max(means) < 190
    for view in every:
        assert (view.rgb == 255).all(2).mean() < 0.1
        assert view.rgb.std() > 8


@settings(max_examples=4)
@given(index=st.integers(0, 10**6), split=st.sampled_from(SPLITS))
def test_a_record_is_the_same_whenever_it_is_made(index, split):
    """And shows the same scene at every scale."""
    recipe = WORLD.recipe(split, "tiny")
    first, again = record(recipe, index), record(recipe, index)
    assert first.keys() == again.keys()
    for key, value in first.items():
        assert np.array_equal(value, again[key]), key
    larger = record(recipe | {"width": 144, "height": 108}, index)
    assert larger["ids"] == first["ids"]
    assert np.array_equal(larger["t"], first["t"])
    [view] = views(recipe, index, first)
    assert view.image_id == index


@pytest.mark.parametrize("size", [(0, 72), (96, -1), (96.5, 72)])
def test_bad_input_is_refused(size):
    recipe = WORLD.recipe("easy", "tiny") | dict(zip(("width", "height"), size, strict=True))
    with pytest.raises(ValueError, match="size|K"):
        record(recipe, 0)
