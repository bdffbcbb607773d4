from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.shapes import make_object as make_mesh
from data_tools.textures import PATTERNS
from data_tools.worlds.placing import distance_apart, extents
from data_tools.worlds.tabletop_scenes import (
    IDS,
    LINEMOD,
    draw_floating,
    draw_table,
    make_object,
    prepared,
)
from posecore.cameras import project

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32)
SCENES = settings(max_examples=12)


def points_of(scene, rows, every=1):
    return [
        scene.things[row].mesh.vertices[::every] @ scene.poses[row][0].T + scene.poses[row][1]
        for row in rows
    ]


def gaps(scene):
    """By how much any two things that stand or float there are apart."""
    for a, b in combinations(range(scene.casters), 2):
        reach = [extents(scene.things[k].mesh.vertices, scene.poses[k][0]) for k in (a, b)]
        yield distance_apart(*reach, scene.poses[b][1] - scene.poses[a][1])


@SCENES
@given(seed=SEEDS, packed=st.booleans(), tests=st.booleans())
def test_tables(seed, packed, tests):
    scene = draw_table(np.random.default_rng(seed), packed, tests)
    count = len(scene.ids)
    assert count in ((6, 7, 8) if packed else (3, 4, 5))
    assert len(set(scene.ids)) == count
    assert [thing.mesh.name for thing in scene.things[:count]] == [
        make_object(i).name for i in scene.ids
    ]
    assert len(scene.things) == len(scene.poses) == scene.casters + 2
    standing = points_of(scene, range(scene.casters))
    assert max(abs(points[:, 2].min()) for points in standing) < 1e-6, "all touch the table"
    assert min(gaps(scene), default=1) > 0.0009, "none is in another"

    R, t = scene.camera
    everything = np.concatenate(standing)
    eye = -R.T @ t
    assert np.linalg.norm(everything - eye, axis=1).min() > 0.1, "nothing is in the camera's face"
    assert eye[2] > 0.05, "it is above the table"
    floor, wall = scene.poses[-2:]
    assert np.allclose(floor[0][:, 2], [0, 0, 1])
    inwards = wall[0][:, 2]
    assert abs(inwards[2]) < 1e-12, "the wall is upright"
    assert ((everything - wall[1]) @ inwards).min() > 0.2, "and behind all things"
    assert (eye - wall[1]) @ inwards > 0.2


def test_the_camera_sees_nearly_all_objects():
    inside = []
    for seed in range(16):
        scene = draw_table(np.random.default_rng(seed), bool(seed % 2), True)
        for points in points_of(scene, range(len(scene.ids)), every=7):
            x, y = project(LINEMOD, points @ scene.camera[0].T + scene.camera[1]).T
            inside.append(x.min() > 0 and y.min() > 0 and x.max() < 639 and y.max() < 479)
    assert np.mean(inside) > 0.9


def test_packed_objects_are_near_each_other():
    means = {
        packed: np.mean(
            [
                sorted(gaps(draw_table(np.random.default_rng(seed), packed, True)))[0]
                for seed in range(10)
            ]
        )
        for packed in (True, False)
    }
    assert means[True] < 0.005
    assert means[False] > 0.01


def test_tests_have_their_own_things():
    def seen(tests):
        scenes = [draw_table(np.random.default_rng(seed), True, tests) for seed in range(12)]
        others = {
            thing.mesh.vertices.tobytes()
            for scene in scenes
            for thing in scene.things[len(scene.ids) : scene.casters]
        }
        floors = {
            thing.mesh.materials[0] for scene in scenes for thing in scene.things[scene.casters :]
        }
        return others, floors

    for train, test in zip(seen(False), seen(True), strict=True):
        assert train
        assert test
        assert not train & test


@SCENES
@given(seed=SEEDS, count=st.integers(1, 8))
def test_floating(seed, count):
    scene = draw_floating(np.random.default_rng(seed), count)
    assert max(1, count - 3) <= len(scene.ids) <= count
    assert len(set(scene.ids)) == len(scene.ids)
    assert len(scene.things) == len(scene.poses) == scene.casters + 1
    assert min(gaps(scene), default=1) > 0.0049
    R, t = scene.camera
    for A, b in scene.poses[: len(scene.ids)]:
        place = R @ b + t
        assert 0.45 <= place[2] <= 1.0
        x, y = project(LINEMOD, place[None])[0]
        assert 0 < x < 640
        assert 0 < y < 480
        assert np.allclose(A @ A.T, np.eye(3), atol=1e-9)
    inwards, place = scene.poses[-1][0][:, 2], scene.poses[-1][1]
    for points in points_of(scene, range(scene.casters)):
        assert ((points - place) @ inwards).min() > 0.04, "the backdrop is behind all things"


def test_backdrops_are_full_of_patches():
    """Of many patterns and colours, so that what differs from the ground is not yet an object."""
    patterns, relief = set(), []
    for seed in range(30):
        scene = draw_floating(np.random.default_rng(seed), 1)
        mesh = scene.things[-1].mesh
        assert len(mesh.materials) > 8
        assert len(set(mesh.materials)) == len(mesh.materials)
        assert len({m.pattern for m in mesh.materials}) > 4
        assert np.ptp([m.colour for m in mesh.materials], axis=0).min() > 0.25
        patterns |= {m.pattern for m in mesh.materials}
        # Each patch is flat, faces the camera and lies before the last.
        heights = mesh.vertices[mesh.faces][..., 2]
        assert np.ptp(heights, axis=1).max() == 0
        assert (np.diff(heights[:, 0]) >= 0).all()
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()
        relief.append(np.ptp(heights))
    assert patterns == set(PATTERNS)
    assert max(relief) <= 0.04


@pytest.mark.parametrize("object_id", IDS)
def test_objects_are_made_once(object_id):
    assert make_object(object_id) is make_object(object_id)
    assert prepared(object_id) is prepared(object_id)
    assert prepared(object_id).mesh is make_object(object_id)
    assert np.array_equal(make_object(object_id).vertices, make_mesh(object_id).vertices)


def test_no_such_object():
    for call in (make_object, prepared):
        with pytest.raises(ValueError, match="object_id"):
            call(9)
