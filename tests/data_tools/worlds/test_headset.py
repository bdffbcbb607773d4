"""The world of the driver with AR glasses."""

from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.shapes import GLASSES
from data_tools.storage.records import encode_record
from data_tools.views import View
from data_tools.worlds import headset
from data_tools.worlds.headset import CAMERAS, HEAD, SUBJECTS, WORLD, draw
from data_tools.worlds.headset_scenes import LIMITS, TOGETHER, who_wears_what
from data_tools.worlds.world import Size
from posecore.cameras import project
from posecore.poses import apply, from_matrix, to_matrix
from posecore.rotations import euler_to_matrix, is_rotation

pytestmark = pytest.mark.slow

FEW = replace(WORLD, sizes={"tiny": Size(80, 47, {"train": 18, "test": 12})})
ANGLES = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


@pytest.fixture(scope="module")
def triples(tiny_views):
    """(left, centre, right) of both splits."""
    views = [*tiny_views(FEW, "train"), *tiny_views(FEW, "test")]
    return [views[i : i + 3] for i in range(0, len(views), 3)]


def test_sizes_of_the_splits(tiny_views):
    for name, size, counts in (
        ("tiny", (80, 47), {"train": 48, "test": 16, "crowd": 32}),
        ("book", (160, 94), {"train": 3000, "test": 400, "crowd": 3000}),
        ("paper", (320, 188), {"train": 40_000, "test": 4000, "crowd": 40_000}),
    ):
        found = WORLD.sizes[name]
        assert ((found.width, found.height), dict(found.counts)) == (size, counts)
    views = tiny_views(FEW, "train")
    assert len(views) == 3 * 18
    assert all(view.ir.shape == view.depth.shape == (47, 80) for view in views)
    assert len({view.image_id for view in views}) == len(views)


def test_no_driver_is_in_two_splits_and_all_wear_all_glasses(tiny_views):
    for scale in ("tiny", "book"):
        drivers = Counter()
        for split in ("train", "test"):
            count = WORLD.sizes[scale].counts[split]
            worn = Counter(who_wears_what(split, index) for index in range(count))
            assert set(worn) == {(s, g) for s in SUBJECTS[split] for g in range(4)}
            assert max(worn.values()) - min(worn.values()) <= 1
            drivers.update({subject for subject, _ in worn})
        assert len(drivers) >= 12
        drivers.update(SUBJECTS["crowd"])
        assert max(drivers.values()) == 1
    for split in FEW.splits:
        for view in tiny_views(FEW, split):
            who = (view.scene_id, view.objects[0].object_id - 1)
            assert who == who_wears_what(split, view.group[1])


def test_the_crowd_is_of_many_drivers_a_few_instants_in_a_row():
    """Meshes of a driver are costly, so they are made once for several records."""
    for scale, people in (("tiny", 8), ("book", 750), ("paper", 750)):
        count = WORLD.sizes[scale].counts["crowd"]
        drawn = [who_wears_what("crowd", index) for index in range(count)]
        worn = Counter(drawn)
        assert len({subject for subject, _ in worn}) == people <= len(SUBJECTS["crowd"]) == 750
        assert len(worn) == 4 * people
        assert max(worn.values()) - min(worn.values()) <= TOGETHER // 4
        subjects = np.array([subject for subject, _ in drawn])
        assert (subjects[1:] != subjects[:-1]).sum() == -(-count // TOGETHER) - 1


def test_the_crowd_is_drawn_as_the_others_are():
    views = draw(9, split="crowd", scale="tiny")
    assert [view.scene_id for view in views] == [SUBJECTS["crowd"][2]] * 3
    assert [view.image_id for view in views] == [27, 28, 29]
    assert all(item.object_id == 2 for item in (view.objects[0] for view in views))
    for view in views:
        share = headset.foreground(view).mean()
        assert 0.02 < share < 0.5 and view.ir[headset.foreground(view)].mean() > 20
    other = draw(17, split="crowd", scale="tiny")[1].objects[1].size
    assert not np.allclose(other, views[1].objects[1].size, atol=1e-4)  # of another head


def test_the_views_of_an_instant_agree_on_where_the_glasses_are(triples):
    groups = set()
    for triple in triples:
        assert len({view.group for view in triple}) == 1
        groups.add(triple[0].group)
        in_car = [
            view.T_world_cam @ to_matrix(view.objects[0].R, view.objects[0].t) for view in triple
        ]
        assert np.ptp(in_car, axis=0).max() < 1e-9
        for view in triple:
            glasses, head = view.objects
            assert (glasses.category, head.category) == ("glasses", "head")
            assert head.object_id == HEAD
            assert np.array_equal(glasses.R, head.R)
            assert np.array_equal(glasses.t, head.t)
            assert glasses.t[2] > 0.4
    assert len(groups) == len(triples)


def test_masks_boxes_and_shares_agree(triples):
    for view in (view for triple in triples for view in triple):
        glasses, head = view.objects
        assert not (glasses.mask & head.mask).any()
        assert np.array_equal(headset.foreground(view), glasses.mask | head.mask)
        for item in view.objects:
            assert not (item.mask & ~item.full_mask).any()
            rows, columns = np.nonzero(item.mask)
            x, y, w, h = item.box
            assert (x, x + w) == (columns.min(), columns.max() + 1)
            assert (y, y + h) == (rows.min(), rows.max() + 1)
            # The share counts what is outside the image as hidden.
            assert 0 < item.visible_fraction <= item.mask.sum() / item.full_mask.sum()
        assert (view.depth[headset.foreground(view)] > 0.3).all()


def test_depth_is_that_of_the_masks(triples):
    """The glasses' pixels, lifted by the depth, lie on the glasses."""
    for view in triples[0] + triples[12] + triples[-1]:
        item = view.objects[0]
        rows, columns = np.nonzero(item.mask)
        rays = np.stack([columns, rows, np.ones(len(rows))], -1) @ np.linalg.inv(view.K).T
        points = (rays * view.depth[item.mask][:, None] - item.t) @ item.R
        mesh = WORLD.models.mesh(item.object_id)
        # Depth is kept to half a tenth of a millimetre; obliquely a ray is a little longer.
        assert (points > mesh.bounds[0] - 1e-4).all()
        assert (points < mesh.bounds[1] + 1e-4).all()
        assert np.array_equal(item.size, mesh.size)


def test_skin_is_brighter_than_the_cabin_which_is_not_black(triples):
    for view in (view for triple in triples for view in triple):
        skin = view.ir[view.objects[1].mask].mean()
        assert 20 < skin < 200
        away = view.depth == 0
        assert 0.2 < view.ir[away].mean() < skin


@given(ANGLES)
def test_head_angles_come_back(triples, angles):
    view = triples[0][0]
    R = view.T_world_cam[:3, :3].T @ euler_to_matrix(np.array(angles), "YXZ")
    glasses = replace(view.objects[0], R=R)
    turned = replace(view, objects=(view.objects[1], glasses))
    # Near 90 degrees of pitch the others are known to 1e-15 / cos(pitch).
    assert np.allclose(headset.head_angles(turned), angles, atol=1e-12)
    assert np.allclose(headset.head_angles(view, np.stack([R, R])), [angles, angles], atol=1e-12)


def test_head_angles_are_those_that_were_drawn(triples):
    for left, centre, right in triples:
        angles = headset.head_angles(centre)
        assert np.allclose(headset.head_angles(left), angles, atol=1e-12)
        assert np.allclose(headset.head_angles(right), angles, atol=1e-12)
        assert (np.abs(angles) <= LIMITS + 1e-12).all()


@given(st.integers(8, 1280), st.integers(8, 800))
def test_cameras_see_the_driver(width, height):
    found = headset.cameras(width, height)
    assert len(found) == len(CAMERAS)
    eyes = []
    for K, T in found:
        assert is_rotation(T[:3, :3], 1e-12)
        R, t = from_matrix(np.linalg.inv(T))
        pixel = project(K, apply(R, t, np.array([headset._TARGET])))
        assert np.allclose(pixel, [(width - 1) / 2, (height - 1) / 2], atol=1e-9)
        eyes.append(T[:3, 3])
    left, centre, right = eyes
    assert left[0] < centre[0] < right[0]
    assert max(eye[2] for eye in eyes) < -0.5


def test_same_bytes_in_another_process(two_processes):
    """Whatever was made before: here in the opposite order."""
    recipe, indices = WORLD.recipe("train", "tiny"), [0, 14, 29, 43]
    there = two_processes.starmap(WORLD.record, [(recipe, i) for i in indices], chunksize=1)
    here = [WORLD.record(recipe, i) for i in reversed(indices)]
    assert [encode_record(r) for r in there] == [encode_record(r) for r in reversed(here)]


def differences(views, others):
    """The names of fields in which views differ; bit for bit."""
    found = set()
    for view, other in zip(views, others, strict=True):
        pairs = [(view, other), *zip(view.objects, other.objects, strict=True)]
        for one, two in pairs:
            for field in fields(one):
                a, b = getattr(one, field.name), getattr(two, field.name)
                same = np.array_equal(a, b) and np.asarray(a).dtype == np.asarray(b).dtype
                if field.name != "objects" and not same:
                    found.add(field.name)
    return found


@pytest.mark.parametrize(("split", "index"), [("train", 0), ("train", 17), ("test", 11)])
def test_drawn_again_as_it_was_it_is_the_same(tiny_views, split, index):
    views = tiny_views(FEW, split)[3 * index : 3 * index + 3]
    assert differences(views, draw(index, split=split, scale="tiny")) == set()


def test_a_record_keeps_the_daylight_it_was_drawn_with():
    recipe = WORLD.recipe("train", "tiny")
    kept = [WORLD.record(recipe, index)["daylight"] for index in range(12)]
    assert all(type(value) is float and 0 <= value <= 1 for value in kept)
    assert 0.0 in kept and max(kept) > 0.05
    for index in np.argsort(kept)[[0, -1]].tolist():
        same = draw(index, split="train", scale="tiny", daylight=kept[index])
        assert differences(draw(index, split="train", scale="tiny"), same) == set()
        other = draw(index, split="train", scale="tiny", daylight=1 - kept[index])
        assert differences(other, same) == {"ir"}


def test_other_light_changes_the_pictures_and_nothing_else(triples):
    own = triples[4]
    options = {"split": "train", "scale": "tiny"}
    for conditions in ({"gain": 1.7}, {"lamp": 0.5}, {"daylight": 0.9, "gain": 0.4}):
        assert differences(own, draw(4, **options, **conditions)) == {"ir"}
    visible = draw(4, **options, light="visible")
    assert differences(own, visible) == {"ir", "rgb"}
    assert all(view.ir is None and view.rgb.shape == (47, 80, 3) for view in visible)


def test_glasses_of_another_size_are_worn_by_the_same_driver(triples):
    own, options = triples[4], {"split": "train", "scale": "tiny"}
    small, large = (draw(4, **options, glasses_scale=scale) for scale in (0.7, 1.4))
    for view, less, more in zip(own, small, large, strict=True):
        assert np.allclose(less.objects[0].size, 0.7 * view.objects[0].size)
        assert np.allclose(more.objects[0].size, 1.4 * view.objects[0].size)
        assert np.array_equal(less.objects[0].R, view.objects[0].R)
        assert np.array_equal(less.objects[0].t, view.objects[0].t)
        areas = [found.objects[0].full_mask.sum() for found in (less, view, more)]
        assert areas == sorted(areas) and areas[2] > 1.5 * areas[0]
        heads = [found.objects[1].full_mask for found in (less, view, more)]
        assert np.array_equal(heads[0], heads[1]) and np.array_equal(heads[1], heads[2])
    assert differences(own, draw(4, **options, glasses_scale=1.0)) == set()


def test_gain_and_lamp_make_faces_brighter():
    def face(**conditions):
        view = draw(2, split="train", scale="tiny", daylight=0.0, **conditions)[1]
        return view.ir[view.objects[1].mask].mean()

    normal = face()
    assert 1.9 < face(gain=2.0) / normal < 2.05  # but for what is too bright
    assert 0.45 < face(gain=0.5) / normal < 0.55
    assert 0.45 < face(lamp=0.5) / normal < 0.6  # and what comes from all around
    assert face(lamp=0.0) < 0.1 * normal


def test_infrared_sees_by_night_what_visible_light_does_not():
    means = {}
    for light, kind in (("infrared", "ir"), ("visible", "rgb")):
        for daylight in (0.0, 0.1, 1.0):
            views = draw(2, split="train", scale="tiny", daylight=daylight, light=light)
            faces = [getattr(v, kind)[v.objects[1].mask] for v in views]
            means[light, daylight] = np.concatenate(faces).mean()
            assert (np.concatenate(faces) == 255).mean() < 0.05
    assert means["infrared", 0.0] > 0.8 * means["infrared", 1.0]
    assert means["visible", 0.0] < 10 < means["visible", 0.1] < 60 < means["visible", 1.0]


def test_models_are_the_four_glasses():
    models = WORLD.models
    assert models.ids == (1, 2, 3, 4)
    for number, name in zip(models.ids, GLASSES, strict=True):
        assert models.mesh(number).name == f"{name} glasses"
        assert 0.14 < models.info(number).diameter < 0.35


BARE = View(K=np.eye(3), scene_id=0, image_id=0, T_world_cam=np.eye(4))


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda view: headset.cameras(0, 47), "width"),
        (lambda view: headset.cameras(80, 4.5), "height"),
        (lambda view: headset.head_angles(BARE), "view"),
        (lambda view: headset.head_angles(replace(view, T_world_cam=None)), "T_world_cam"),
        (lambda view: headset.head_angles(view, np.eye(4)), "R"),
        (lambda view: headset.head_angles(view, 2 * np.eye(3)), "R"),
        (lambda view: headset.head_angles(view, np.full((3, 3), np.nan)), "R"),
        (lambda view: headset.head_angles(view, "R"), "R"),
        (lambda view: headset.foreground(BARE), "view"),
        (
            lambda view: headset.foreground(
                replace(view, objects=tuple(replace(o, mask=None) for o in view.objects))
            ),
            "view",
        ),
        (lambda view: WORLD.open(split="val"), "split"),
        (lambda view: WORLD.open(split="train", scale="huge"), "scale"),
        (lambda view: WORLD.models.mesh(HEAD), "object_id"),
        (lambda view: draw(-1, split="train"), "index"),
        (lambda view: draw(48, split="train", scale="tiny"), "index"),
        (lambda view: draw(1.5, split="train"), "index"),
        (lambda view: draw(0, split="val"), "split"),
        (lambda view: draw(0, split="train", scale="huge"), "scale"),
        (lambda view: draw(0, split="train", daylight=1.01), "daylight"),
        (lambda view: draw(0, split="train", daylight=-0.1), "daylight"),
        (lambda view: draw(0, split="train", daylight=float("nan")), "daylight"),
        (lambda view: draw(0, split="train", gain=0), "gain"),
        (lambda view: draw(0, split="train", gain=float("inf")), "gain"),
        (lambda view: draw(0, split="train", lamp=-1), "lamp"),
        (lambda view: draw(0, split="train", light="ultraviolet"), "light"),
        (lambda view: draw(0, split="train", glasses_scale=0.69), "glasses_scale"),
        (lambda view: draw(0, split="train", glasses_scale=float("nan")), "glasses_scale"),
        (lambda view: draw(0, split="train", light="visible", lamp=0.5), "lamp"),
    ],
)
def test_bad_input(triples, call, name):
    with pytest.raises(ValueError, match=name):
        call(triples[0][0])
