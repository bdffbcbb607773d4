from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from data_tools.shapes import CATEGORIES, Mesh, make_category, make_object
from data_tools.worlds.placing import (
    DIRECTIONS,
    Resting,
    distance_apart,
    extents,
    look_at,
    slide_in,
    turn_z,
)

OBJECTS = [(i, make_object(i), (0, 0, 1)) for i in range(1, 9)]
OBJECTS += [(name, make_category(name, 900), (0, 1, 0)) for name in CATEGORIES]
SEEDS = st.integers(0, 2**32)
resting = cache(lambda row: Resting(OBJECTS[row][1], OBJECTS[row][2]))


def overlap(one, other):
    """Whether two convex hulls of points share a point: an oracle that solves for one."""
    count, weights = len(one), len(one) + len(other)
    equal = np.zeros((5, weights))
    equal[:3, :count], equal[:3, count:] = one.T, -other.T
    equal[3, :count] = equal[4, count:] = 1
    return linprog(np.zeros(weights), A_eq=equal, b_eq=[0, 0, 0, 1, 1], method="highs").success


@pytest.mark.parametrize("row", range(len(OBJECTS)), ids=[str(name) for name, *_ in OBJECTS])
def test_objects_rest(row):
    """Lowered to the table, they touch it; the centre of mass is above what they touch it with."""
    _, mesh, up = OBJECTS[row]
    hull = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).convex_hull
    rests = resting(row)
    total = 0
    for name, (rotations, shares) in rests.poses.items():
        assert shares.sum() == pytest.approx(1)
        assert (shares > 0).all()
        total += len(shares)
        for R in rotations:
            assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(R) > 0
            points = hull.vertices @ R.T
            low = points[points[:, 2] < points[:, 2].min() + 0.0006, :2]
            centre = R @ hull.center_mass
            # Further than any of the points that hold it up, in no direction.
            angle = np.linspace(0, 2 * np.pi, 360)
            ways = np.stack([np.cos(angle), np.sin(angle)])
            assert ((low @ ways).max(0) - centre[:2] @ ways).min() > 0.0029
            upright = R[2] @ up
            if name == "upright":
                assert upright > 0.9
            elif name == "lying":
                assert abs(upright) <= 0.9
            else:
                assert upright <= -0.9
    assert total


def test_common_ways_to_rest():
    for row, (name, *_) in enumerate(OBJECTS):
        standing = name not in ("bowl", "mug", "laptop") or "upright" in resting(row).poses
        assert standing, f"{name} stands"
    rng = np.random.default_rng(0)
    ups = [resting(0).draw(rng)[0][2, 2] for _ in range(300)]
    assert 0.5 < np.mean(np.array(ups) > 0.9) < 0.85, "a duck mostly sits"


@given(row=st.integers(0, len(OBJECTS) - 1), seed=SEEDS)
def test_draw_touches_the_table(row, seed):
    mesh = OBJECTS[row][1]
    R, height = resting(row).draw(np.random.default_rng(seed))
    assert abs((mesh.vertices @ R[2]).min() + height) < 1e-9
    again, _ = resting(row).draw(np.random.default_rng(seed))
    assert np.array_equal(R, again)


def test_directions():
    assert np.allclose(np.linalg.norm(DIRECTIONS, axis=1), 1)
    nearest = (-DIRECTIONS @ DIRECTIONS.T).max(1)
    assert np.allclose(nearest, 1), "each has its opposite"


@given(row=st.integers(0, 7), seed=SEEDS)
def test_extents_are_those_of_the_mesh(row, seed):
    R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    vertices = OBJECTS[row][1].vertices
    brute = [max(vertices @ R.T @ d) for d in DIRECTIONS[::29]]
    assert np.allclose(extents(resting(row).hull, R)[::29], brute, atol=1e-12)


@given(rows=st.tuples(st.integers(0, 7), st.integers(0, 7)), seed=SEEDS)
def test_apart_is_apart(rows, seed):
    """What is said to be apart shares no point; what is far apart is said to be."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(2, rng=rng).as_matrix()
    shift = rng.normal(0, 0.08, 3)
    hulls = [resting(row).hull @ R.T for row, R in zip(rows, turns, strict=True)]
    extent = [extents(resting(row).hull, R) for row, R in zip(rows, turns, strict=True)]
    gap = distance_apart(*extent, shift)
    if gap > 0:
        assert not overlap(hulls[0], hulls[1] + shift)
    if np.linalg.norm(shift) > 0.3:
        assert gap > 0
    assert distance_apart(extent[1], extent[0], -shift) == pytest.approx(gap, abs=1e-12)


@given(seed=SEEDS, count=st.integers(0, 5), gap=st.floats(0, 0.05))
def test_slide_in_finds_the_first_free_place(seed, count, gap):
    rng = np.random.default_rng(seed)

    def thing():
        R, height = resting(int(rng.integers(8))).draw(rng)
        return extents(resting(int(rng.integers(8))).hull, R), height

    others = [
        (e, np.array([*rng.normal(0, 0.1, 2), h])) for e, h in (thing() for _ in range(count))
    ]
    extent, height = thing()
    start = rng.normal(0, 0.05, 2)
    angle = rng.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(angle), np.sin(angle)])
    place = slide_in(extent, height, others, start, direction, gap)

    def free(point):
        return min((distance_apart(e, extent, point - p) - gap for e, p in others), default=1)

    assert free(place) > -1e-9
    assert place[2] == height
    way = (place[:2] - start) @ direction
    assert np.allclose(start + way * direction, place[:2])
    assert way >= 0
    for share in np.linspace(0, 0.999, 30):  # nowhere nearer
        earlier = np.array([*(start + share * way * direction), height])
        assert way == 0 or free(earlier) < 1e-9


@given(seed=SEEDS, roll=st.floats(-3, 3))
def test_look_at(seed, roll):
    rng = np.random.default_rng(seed)
    camera, target = rng.normal(0, 1, (2, 3))
    assume(np.linalg.norm((target - camera)[:2]) > 0.01)
    R, t = look_at(camera, target, roll)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    assert np.allclose(R @ camera + t, 0, atol=1e-12)
    assert np.allclose(R @ target + t, [0, 0, np.linalg.norm(target - camera)], atol=1e-12)
    up = turn_z(-roll) @ R @ [0, 0, 1]
    assert abs(up[0]) < 1e-12, "without roll the horizon is level"
    assert up[1] < 0, "and up is up"


@given(angle=st.floats(-10, 10))
def test_turn_z(angle):
    assert np.allclose(turn_z(angle), Rotation.from_euler("z", angle).as_matrix())


def test_what_never_rests_is_refused():
    """A small ball: nothing that holds it up is further than 3 mm from its centre."""
    ball = trimesh.creation.icosphere(3, 0.005)
    mesh = Mesh(
        name="ball",
        vertices=np.asarray(ball.vertices, np.float64),
        faces=np.asarray(ball.faces, np.int32),
        corner_normals=np.asarray(ball.vertex_normals[ball.faces], np.float32),
        material=np.zeros(len(ball.faces), np.int16),
        materials=make_object(1).materials[:1],
        closed=np.ones(len(ball.faces), bool),
    )
    with pytest.raises(ValueError, match=r"mesh: expected an object that stays .*, got ball"):
        Resting(mesh)
