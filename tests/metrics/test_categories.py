"""Symmetry of instances, similarity transforms and the error of a rotation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics

seeds = st.integers(0, 2**32 - 1)
Y = [0, 1, 0]


@given(seeds)
def test_a_similarity_comes_apart_as_it_was_put_together(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(4, random_state=rng).as_matrix()
    t, scale, size = rng.normal(size=(4, 3)), 10 ** rng.uniform(-3, 1, 4), rng.uniform(0, 1, (4, 3))
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = scale[:, None, None] * R, t
    apart = metrics.split_similarity(T, size)
    np.testing.assert_allclose(apart.R, R, atol=1e-12)
    np.testing.assert_array_equal(apart.t, t)
    np.testing.assert_allclose(apart.scale, scale, rtol=1e-12)
    np.testing.assert_allclose(apart.size, scale[:, None] * size, rtol=1e-12)


@given(seeds)
def test_the_box_of_a_similarity_stays_where_it_is(seed):
    """NOCS places a normalised box with the whole matrix; here the box has metres."""
    rng = np.random.default_rng(seed)
    T, size = np.eye(4), rng.uniform(0.1, 1, 3)
    T[:3, :3], T[:3, 3] = 0.3 * Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3, indexing="ij")).reshape(3, -1).T
    there = signs * size / 2 @ T[:3, :3].T + T[:3, 3]
    apart = metrics.split_similarity(T, size)
    np.testing.assert_allclose(metrics.box_corners(apart.R, apart.t, apart.size), there, atol=1e-12)


@pytest.mark.parametrize(
    ("block", "row", "message"),
    [
        (np.diag([1, 1, -1]), [0, 0, 0, 1], "T"),
        (np.diag([1, 1, 1.01]), [0, 0, 0, 1], "T"),
        (np.zeros((3, 3)), [0, 0, 0, 1], "T.*scale above 0"),
        (np.eye(3), [0, 0, 0, 2], "T.*last row"),
    ],
)
def test_what_is_no_similarity_is_refused(block, row, message):
    T = np.eye(4)
    T[:3, :3], T[3] = block, row
    with pytest.raises(ValueError, match=message):
        metrics.split_similarity(T, np.ones(3))


def test_symmetry_is_of_the_instance():
    names = ["bottle", "bowl", "camera", "can", "laptop", "mug", "mug", "spoon"]
    seen = [True] * 5 + [True, False, False]
    axes = metrics.nocs_axes(names, seen)
    assert axes.tolist() == [Y, Y, [0] * 3, Y, [0] * 3, [0] * 3, Y, [0] * 3]
    assert metrics.nocs_axes(["mug"]).tolist() == [[0, 0, 0]]
    assert metrics.nocs_axes([]).shape == (0, 3)
    assert metrics.nocs_axes(["mug"], np.array([0])).tolist() == [Y]  # 0 and 1 as in NOCS's files


@pytest.mark.parametrize("seen", [[True], [True, 2], [True, np.nan]])
def test_visibility_fits_the_names(seen):
    with pytest.raises(ValueError, match="handle_visible"):
        metrics.nocs_axes(["mug", "can"], seen)


@given(seeds)
def test_rotation_errors_are_those_of_their_own_functions(seed):
    rng = np.random.default_rng(seed)
    R, other = (Rotation.random(3, random_state=rng).as_matrix() for _ in "ab")
    axis = np.stack([np.zeros(3), np.array(Y) * 1e-200, rng.normal(size=3)])
    errors = metrics.instance_rotation_error(R, other, axis)
    assert errors[0] == pytest.approx(metrics.rotation_error(R[0], other[0]))
    for row in (1, 2):
        assert errors[row] == pytest.approx(metrics.axis_error(R[row], other[row], axis[row]))


@given(seeds, st.floats(-10, 10))
def test_turns_about_the_axis_cost_nothing(seed, angle):
    rng = np.random.default_rng(seed)
    R, axis = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    assert metrics.instance_rotation_error(R @ turn, R, axis) == pytest.approx(0, abs=1e-7)
    w = 0.3 * np.cross(axis, [1, 0.3, 0.2])  # a tilt across the axis is seen in full
    tilt = Rotation.from_rotvec(0.4 * w / np.linalg.norm(w)).as_matrix()
    assert metrics.instance_rotation_error(R @ tilt @ turn, R, axis) == pytest.approx(0.4)
