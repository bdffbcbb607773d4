"""Errors of angle and position against scipy and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics

seeds = st.integers(0, 2**32 - 1)


def two_rotations(seed, batch=()):
    rng = np.random.default_rng(seed)
    count = int(np.prod(batch, dtype=int))
    return [
        Rotation.random(count, random_state=rng).as_matrix().reshape(*batch, 3, 3) for _ in "12"
    ]


def turn(axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(axis, float) * angle).as_matrix()
    return T


FOURFOLD = np.stack([turn((0, 0, 1), k * np.pi / 2) for k in range(4)])
EYE, ZERO = np.eye(3), np.zeros(3)


@given(seeds, st.floats(0, np.pi))
def test_rotation_error_is_the_angle_between(seed, angle):
    R, other = two_rotations(seed)
    turned = R @ turn(other[0], angle)[:3, :3]
    assert metrics.rotation_error(turned, R) == pytest.approx(angle, abs=1e-7)
    relative = Rotation.from_matrix(other) * Rotation.from_matrix(R).inv()
    assert metrics.rotation_error(other, R) == pytest.approx(relative.magnitude(), abs=1e-9)


@given(seeds)
def test_closest_symmetry_and_rotation_error_agree(seed):
    R_1, R_2 = two_rotations(seed, (3,))
    t = np.random.default_rng(seed).normal(size=(3, 3))
    offset = FOURFOLD.copy()
    offset[1:, :3, 3] = (1, 2, 3)
    closest, moved = metrics.closest_symmetry(R_1, R_2, t, offset)
    which = np.abs(closest[:, None] - R_2[:, None] @ FOURFOLD[:, :3, :3]).max((2, 3)).argmin(1)
    np.testing.assert_allclose(moved, t + (R_2 @ offset[which, :3, 3:])[..., 0], atol=1e-12)
    brute = np.min([metrics.rotation_error(R_1, R_2 @ S[:3, :3]) for S in FOURFOLD], axis=0)
    np.testing.assert_allclose(metrics.rotation_error(R_1, closest), brute, atol=1e-12)
    np.testing.assert_allclose(metrics.rotation_error(R_1, R_2, FOURFOLD), brute, atol=1e-12)


@given(seeds, st.floats(-10, 10))
def test_axis_error_ignores_turns_about_the_axis(seed, angle):
    R_1, R_2 = two_rotations(seed)
    axis = np.array([0, 1.0, 0])
    expected = np.arccos(np.clip(R_1[:, 1] @ R_2[:, 1], -1, 1))
    spun = R_1 @ turn(axis, angle)[:3, :3]
    assert metrics.axis_error(spun, R_2, axis * 1e-200) == pytest.approx(expected, abs=1e-6)
    assert metrics.axis_error(spun, R_1, axis) == pytest.approx(0, abs=1e-12)


@given(seeds)
def test_translation_error(seed):
    t_1, t_2 = np.random.default_rng(seed).normal(size=(2, 5, 3))
    expected = np.sqrt(((t_1 - t_2) ** 2).sum(-1))
    np.testing.assert_allclose(metrics.translation_error(t_1, t_2), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.rotation_error(EYE * 1.01, EYE), "R_est"),
        (lambda: metrics.rotation_error(EYE, -EYE), "R_gt"),
        (lambda: metrics.axis_error(EYE, EYE, ZERO), "axis"),
        (lambda: metrics.closest_symmetry(EYE, EYE, ZERO, FOURFOLD * 2), "symmetries"),
        (lambda: metrics.rotation_error(EYE, EYE, FOURFOLD * [1, 1, 1.1, 1]), "symmetries"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()
