"""Arithmetic of quaternions and the way between rotations: SciPy, RoMa and definitions."""

import math

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from posecore import rotations
from posecore.rotations import (
    geodesic_distance,
    matrix_to_quaternion,
    quaternion_apply,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_slerp,
    quaternion_to_matrix,
    slerp,
    wxyz_to_xyzw,
    xyzw_to_wxyz,
)

seeds = st.integers(0, 10**6)
ONE = np.array([1.0, 0, 0, 0])


def some(seed, *shape):
    return np.random.default_rng(seed).normal(size=(*shape, 4))


# Arithmetic ---------------------------------------------------------------------------------------


@given(seeds, st.floats(-150, 150))
def test_a_quaternion_times_its_inverse_is_one(seed, exponent):
    q = some(seed, 3) * 10.0**exponent
    for product in (
        quaternion_multiply(q, quaternion_inverse(q)),
        quaternion_multiply(quaternion_inverse(q), q),
    ):
        np.testing.assert_allclose(product, np.tile(ONE, (3, 1)), rtol=0, atol=1e-14)


@given(seeds)
def test_the_inverse_of_a_unit_quaternion_is_the_inverse_rotation(seed):
    turn = Rotation.random(4, random_state=seed)
    inverse = quaternion_inverse(turn.as_quat(scalar_first=True))
    np.testing.assert_allclose(inverse, turn.inv().as_quat(scalar_first=True), rtol=0, atol=1e-15)


def test_what_has_no_inverse():
    with pytest.raises(ValueError, match="^q: expected quaternions that are not zero, got zero at"):
        quaternion_inverse([ONE, 0 * ONE])
    with pytest.raises(ValueError, match="^q: expected quaternions whose inverse is finite"):
        quaternion_inverse(1e-310 * ONE)


@given(seeds)
def test_apply_is_the_rotation_and_the_product(seed):
    q, points = some(seed, 2, 1), np.random.default_rng(seed).normal(size=(3, 5, 3))
    rotated = quaternion_apply(q, points)
    assert rotated.shape == (2, 3, 5, 3)
    for i, j in np.ndindex(2, 3):
        turn = Rotation.from_quat(q[i, 0], scalar_first=True)
        np.testing.assert_allclose(rotated[i, j], turn.apply(points[j]), rtol=0, atol=1e-13)
    x, inverse = np.insert(points, 0, 0, -1), quaternion_inverse(q)
    product = quaternion_multiply(quaternion_multiply(q[:, :, None], x), inverse[:, :, None])
    np.testing.assert_allclose(product, np.insert(rotated, 0, 0, -1), rtol=0, atol=1e-13)


def test_apply_refuses_what_overflows():
    turned = Rotation.from_euler("z", 45, degrees=True).as_quat(scalar_first=True)
    with pytest.raises(ValueError, match="^points: expected points that stay finite"):
        quaternion_apply(turned, [[1.7e308, 1.7e308, 0]])
    with pytest.raises(ValueError, match="^q: "):
        quaternion_apply(0 * ONE, [[1.0, 0, 0]])


@given(seeds)
def test_the_two_orders(seed):
    turn = Rotation.random(3, random_state=seed)
    assert np.array_equal(wxyz_to_xyzw(turn.as_quat(scalar_first=True)), turn.as_quat())
    assert np.array_equal(xyzw_to_wxyz(turn.as_quat()), turn.as_quat(scalar_first=True))
    assert wxyz_to_xyzw([1, 2, 3, 4]).tolist() == [2, 3, 4, 1]
    assert xyzw_to_wxyz([1, 2, 3, 4]).tolist() == [4, 1, 2, 3]


# Interpolation ------------------------------------------------------------------------------------

STEPS = np.linspace(0, 1, 13)


@given(seeds)
def test_slerp_like_scipy_and_roma(seed):
    pair = Rotation.random(2, random_state=seed)
    one, two = pair.as_matrix()
    expected = Slerp([0, 1], pair)(STEPS).as_matrix()
    np.testing.assert_allclose(slerp(one, two, STEPS), expected, rtol=0, atol=1e-13)
    p, q = (torch.from_numpy(x) for x in pair.as_quat(canonical=False))
    theirs = roma.unitquat_slerp(p, q, torch.from_numpy(STEPS), shortest_arc=True)
    ours = quaternion_slerp(xyzw_to_wxyz(p), xyzw_to_wxyz(q), torch.from_numpy(STEPS))
    np.testing.assert_allclose(ours, xyzw_to_wxyz(theirs), rtol=0, atol=1e-13)


@given(seeds, st.sampled_from([1e-12, 1e-8, 1e-4, 0.1, 3.0, 3.1415926]))
def test_the_angle_grows_evenly_and_never_beyond(seed, angle):
    first = Rotation.random(random_state=seed)
    axis = np.random.default_rng(seed).normal(size=3)
    second = first * Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    way = slerp(first.as_matrix(), second.as_matrix(), STEPS)
    done = geodesic_distance(first.as_matrix(), way)
    np.testing.assert_allclose(done, angle * STEPS, rtol=0, atol=1e-14)
    assert (rotations.rotation_defect(way) < 1e-14).all()


@given(seeds, st.booleans(), st.floats(0.1, 10))
def test_the_ends_are_exact_and_signs_and_lengths_do_not_matter(seed, flip, length):
    p, q = some(seed), some(seed + 1)
    unit_p, unit_q = quaternion_slerp([p, q], [p, q], 0.0)
    way = quaternion_slerp(p, q, STEPS)
    assert np.array_equal(way[0], unit_p)
    assert np.array_equal(way[-1], unit_q) or np.array_equal(way[-1], -unit_q)
    assert way[-1] @ unit_p >= 0
    np.testing.assert_allclose(np.linalg.norm(way, axis=-1), 1, rtol=0, atol=1e-15)
    sign = -1 if flip else 1
    assert np.array_equal(quaternion_slerp(p, sign * q, STEPS), way)
    other = quaternion_slerp(length * p, q / length, STEPS)
    np.testing.assert_allclose(other, way, rtol=0, atol=1e-14)
    R_1, R_2 = quaternion_to_matrix(some(seed, 2))
    assert np.array_equal(slerp(R_1, R_2, [0, 1, 0]), [R_1, R_2, R_1])


def test_antipodal_quaternions_are_one_rotation():
    p = quaternion_slerp(some(3), some(3), 0.0)
    np.testing.assert_allclose(quaternion_slerp(p, -p, STEPS), np.tile(p, (13, 1)), atol=1e-15)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0.6, -0.8, 0]])
def test_of_half_turns_the_way_is_the_one_that_is_written_down(axis):
    """About the axis whose first entry that is not zero is positive, whatever the signs."""
    q = np.array([0, *axis])
    quarter = Rotation.from_rotvec(np.pi / 2 * np.array(axis)).as_matrix()
    for other in (q, -q):
        found = quaternion_to_matrix(quaternion_slerp(ONE, other, 0.5))
        np.testing.assert_allclose(found, quarter, rtol=0, atol=1e-15)
    half = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(slerp(np.eye(3), half, 0.5), quarter, rtol=0, atol=1e-15)


def test_batches_broadcast():
    R_1, R_2 = quaternion_to_matrix(some(0, 2, 1)), quaternion_to_matrix(some(1, 3))
    way = slerp(R_1[:, :, None], R_2[:, None], STEPS)
    assert way.shape == (2, 3, 13, 3, 3)
    np.testing.assert_allclose(way[1, 2, 4], slerp(R_1[1, 0], R_2[2], STEPS[4]), rtol=0, atol=1e-14)


def test_gradients():
    p, q = (torch.from_numpy(some(seed, 2)).requires_grad_() for seed in (0, 1))
    f = torch.tensor([0.3, 0.9], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(quaternion_slerp, (p, q, f))
    assert torch.autograd.gradcheck(quaternion_inverse, p)
    points = torch.randn(2, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(quaternion_apply, (p, points))


@pytest.mark.parametrize("angle", [0, 1e-9, 1e-3, math.pi - 1e-9, math.pi])
@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_gradients_are_finite_at_the_same_rotation_and_at_half_turns(angle, fraction):
    turn = Rotation.from_rotvec([angle, 0, 0])
    R_1 = torch.eye(3, dtype=torch.float64, requires_grad=True)
    R_2 = torch.tensor(turn.as_matrix(), requires_grad=True)
    f = torch.tensor(fraction, dtype=torch.float64, requires_grad=True)
    for gradient in torch.autograd.grad(slerp(R_1, R_2, f).square().sum(), (R_1, R_2, f)):
        assert gradient.isfinite().all()
    p = torch.tensor(ONE, requires_grad=True)
    q = torch.tensor(matrix_to_quaternion(turn.as_matrix()), requires_grad=True)
    way = quaternion_slerp(p, q, f)
    for gradient in torch.autograd.grad(way[0] + way[1], (p, q, f)):
        assert gradient.isfinite().all()
    # The speed is half the angle, in the direction of the axis.
    speed = torch.autograd.functional.jacobian(lambda f: quaternion_slerp(p, q, f), f)
    assert speed.norm() == pytest.approx(angle / 2, abs=1e-12)


@pytest.mark.parametrize("fraction", [-0.001, 1.001, [0.5, 2]])
def test_beyond_the_ends_there_is_no_way(fraction):
    for call in (
        lambda: slerp(np.eye(3), np.eye(3), fraction),
        lambda: quaternion_slerp(ONE, ONE, fraction),
    ):
        with pytest.raises(ValueError, match="^fraction: expected numbers from 0 to 1, got from"):
            call()


def test_what_is_no_rotation():
    with pytest.raises(ValueError, match="^q: expected quaternions that are not zero"):
        quaternion_slerp(ONE, 0 * ONE, 0.5)
    with pytest.raises(ValueError, match=r"^R_2: expected rotation matrices"):
        slerp(np.eye(3), 2 * np.eye(3), 0.5)
