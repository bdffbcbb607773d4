"""Keypoints spread over a surface, and one pose for each picture of a symmetric object."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import poses
from posecore.metrics import add_s
from posecore.models import model_keypoints
from posecore.symmetry import canonical_rotation, turned_to_camera

SEEDS = st.integers(0, 2**32 - 1)


def motions(turns, offset=(0, 0, 0)):
    """(S, 4, 4): rotations about a point."""
    offset = np.asarray(offset, float)
    T = np.tile(np.eye(4), (len(turns), 1, 1))
    T[:, :3, :3] = turns
    T[:, :3, 3] = offset - turns @ offset
    return T


def around(axis, count):
    angles = 2 * np.pi / count * np.arange(count)
    return Rotation.from_rotvec(angles[:, None] * np.asarray(axis, float)).as_matrix()


def can(count):
    """Revolution about z, and the same upside down."""
    turns = around([0, 0, 1], count)
    return np.concatenate([turns, turns @ np.diag([1.0, -1, -1])])


GROUPS = {
    "none": np.eye(3)[None],
    "revolution": around([0, 0, 1], 315),
    "revolution about y": around([0, 1, 0], 315),
    "can": can(90),
    "half a turn": around([0, 0, 1], 2),
    "half a turn about x": around([1, 0, 0], 2),
    **{name: Rotation.create_group(name).as_matrix() for name in ("C6", "D2", "D4", "T", "O")},
}


def pose(rng, batch=()):
    R = Rotation.random(int(np.prod(batch)), random_state=rng).as_matrix()
    return R.reshape(*batch, 3, 3), rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 1.5], (*batch, 3))


def same_pose(found, wanted, atol=1e-9):
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, atol=atol)


@given(seed=SEEDS, count=st.integers(1, 12), kind=st.sampled_from([np.float64, np.float32]))
def test_keypoints_by_brute_force(seed, count, kind):
    points = np.random.default_rng(seed).normal(size=(30, 3)).astype(kind)
    found = model_keypoints(points, count)
    assert found.shape == (count + 1, 3) and found.dtype == kind
    centre = (points.min(0) + points.max(0)) / 2
    np.testing.assert_array_equal(found[-1], centre)
    chosen = [centre]
    for keypoint in found[:-1]:
        distances = np.min([np.linalg.norm(points - c, axis=1) for c in chosen], axis=0)
        farthest = points[distances.argmax()]
        np.testing.assert_array_equal(keypoint, farthest)
        chosen.append(farthest)


def test_keypoints_of_a_box_are_its_corners():
    corners = np.array([[x, y, z] for x in (0, 3) for y in (0, 2.8) for z in (0, 2.6)])
    inside = np.random.default_rng(0).uniform(0.1, 0.9, (500, 3)) * [3, 2.8, 2.6]
    found = model_keypoints(np.concatenate([inside, corners]))
    assert {tuple(point) for point in found[:-1]} == {tuple(corner) for corner in corners}
    np.testing.assert_array_equal(found[-1], [1.5, 1.4, 1.3])


def test_keypoints_of_copies_of_one_point():
    np.testing.assert_array_equal(model_keypoints(np.ones((5, 3)), 3), np.ones((4, 3)))


@given(seed=SEEDS, name=st.sampled_from(sorted(GROUPS)), shifted=st.booleans())
def test_all_symmetric_poses_have_one_answer(seed, name, shifted):
    rng = np.random.default_rng(seed)
    T = motions(GROUPS[name], [0.02, -0.01, 0.03] if shifted else [0, 0, 0])
    R, t = pose(rng)
    answer = canonical_rotation(R, t, T)
    alike = poses.compose(R[None], t[None], *poses.from_matrix(T))  # (S, 3, 3) and (S, 3)
    found = canonical_rotation(*alike, T)
    same_pose(found, [np.broadcast_to(x, y.shape) for x, y in zip(answer, found, strict=True)])
    # It is one of them, and it stays where it is.
    gap = np.abs(alike[0] - answer[0]).max((1, 2)) + np.abs(alike[1] - answer[1]).max(1)
    assert gap.min() < 1e-12
    same_pose(canonical_rotation(*answer, T), answer)


@given(seed=SEEDS, name=st.sampled_from(sorted(GROUPS)))
def test_the_object_looks_the_same(seed, name):
    rng = np.random.default_rng(seed)
    T = motions(GROUPS[name], [0.02, -0.01, 0.03])
    surface = poses.apply(*poses.from_matrix(T), rng.normal(size=(5, 3))).reshape(-1, 3)
    R, t = pose(rng)
    found = canonical_rotation(R, t, T)
    assert add_s(*found, R, t, surface) < 1e-9
    assert np.linalg.norm(found[0] @ found[0].T - np.eye(3)) < 1e-12


@given(seed=SEEDS, name=st.sampled_from(sorted(GROUPS)))
def test_the_rule_by_brute_force(seed, name):
    """Where the camera is in the frame of the object, of all poses that look alike."""
    rng = np.random.default_rng(seed)
    R, t = pose(rng, (2,))
    T = motions(GROUPS[name], [0.02, -0.01, 0.03])
    found = canonical_rotation(R, t, T)
    for i in range(2):
        alike = [np.vstack([np.c_[R[i], t[i]], [0, 0, 0, 1]]) @ S for S in T]
        cameras = [np.linalg.inv(pose)[:3, 3] for pose in alike]
        best = alike[int(np.argmax([camera @ [0.2, -1.0, 0.5] for camera in cameras]))]
        same_pose((found[0][i], found[1][i]), (best[:3, :3], best[:3, 3]), 1e-12)


@given(seed=SEEDS, name=st.sampled_from(sorted(GROUPS)))
def test_a_turned_picture_keeps_its_answer(seed, name):
    rng = np.random.default_rng(seed)
    T = motions(GROUPS[name])
    R, t = pose(rng)
    turn = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    answer = canonical_rotation(R, t, T)
    same_pose(canonical_rotation(turn @ R, turn @ t, T), (turn @ answer[0], turn @ answer[1]))


@given(seed=SEEDS)
def test_a_vase_turned_about_its_axis_stands_still(seed):
    """By any angle, also between two steps; and small motions of the camera cause no jump."""
    rng = np.random.default_rng(seed)
    T = motions(GROUPS["revolution"])
    R, t = pose(rng)
    camera = -R.T @ t
    tilt = np.arctan2(np.hypot(*camera[:2]), abs(camera[2]))
    spin = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    still = canonical_rotation(R, t, T)
    step = 2 * np.pi / 315

    def angle(found):
        return Rotation.from_matrix(found[0] @ still[0].T).magnitude()

    assert angle(canonical_rotation(R @ spin, t, T)) <= step + 1e-9
    nudge = Rotation.from_rotvec(rng.normal(size=3) * 1e-3)
    moved = canonical_rotation(nudge.as_matrix() @ R, t, T)
    # A camera that moves by an angle goes around the axis by more, the more the nearer it is.
    assert angle(moved) <= step + nudge.magnitude() * (1 + 1 / np.sin(tilt) * 1.1) + 1e-9


def test_where_the_rule_jumps():
    """From exactly above any turn is as good; a hair to either side the answers are opposite."""
    T = motions(GROUPS["revolution"])
    down = np.diag([1.0, -1, -1])
    found, _ = canonical_rotation(down, [0, 0, 1.0], T)
    np.testing.assert_allclose(found[2], [0, 0, -1], atol=1e-12)
    answers = []
    for tilt in (-1e-3, 1e-3):
        R = Rotation.from_euler("x", tilt).as_matrix() @ down
        answers.append(canonical_rotation(R, [0, 0, 1.0], T)[0])
    between = Rotation.from_matrix(answers[0] @ answers[1].T).magnitude()
    assert between > np.pi - 2 * 2 * np.pi / 315


def test_no_symmetry_changes_nothing():
    R, t = pose(np.random.default_rng(0), (2, 3))
    found = canonical_rotation(R, t, np.eye(4)[None])
    np.testing.assert_array_equal(found[0], R)
    np.testing.assert_array_equal(found[1], t)


def test_batches_broadcast_and_tensors_keep_their_kind():
    R, t = (torch.tensor(x, dtype=torch.float32) for x in pose(np.random.default_rng(1), (3, 1)))
    T = torch.tensor(motions(GROUPS["can"]), dtype=torch.float32)
    many = canonical_rotation(R, t.expand(3, 5, 3), T)
    assert many[0].shape == (3, 5, 3, 3) and many[1].shape == (3, 5, 3)
    assert many[0].dtype == torch.float32
    one = canonical_rotation(R[1, 0], t[1, 0], T)
    torch.testing.assert_close(many[0][1, 4], one[0])
    torch.testing.assert_close(many[1][1, 4], one[1])


def test_gradients_flow_through_the_chosen_pose():
    R, t = (torch.tensor(x, requires_grad=True) for x in pose(np.random.default_rng(2), (2,)))
    T = torch.tensor(motions(GROUPS["D2"], [0.1, 0, 0]))
    assert torch.autograd.gradcheck(lambda R, t: canonical_rotation(R, t, T), (R, t))


EYE, FRONT = np.eye(3), [0, 0, 1.0]
SCALED = np.diag([2.0, 2, 2, 1])[None]
SHEET = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]])[None]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: model_keypoints(np.ones((5, 3)), 6), "count"),
        (lambda: model_keypoints(np.ones((5, 3)), 0), "count"),
        (lambda: model_keypoints(np.ones((50, 3)), 8.0), "count"),
        (lambda: canonical_rotation(EYE, FRONT, SCALED), "symmetries"),
        (lambda: canonical_rotation(EYE, FRONT, SHEET), "symmetries"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}:"):
        call()


# All turns about an axis --------------------------------------------------------------------------


@given(seed=SEEDS)
def test_a_solid_of_revolution_shows_its_front(seed):
    rng = np.random.default_rng(seed)
    R, t = pose(rng, (4,))
    axis, front = rng.normal(size=(2, 3))
    found = turned_to_camera(R, t, axis, front)
    unit = axis / np.linalg.norm(axis)
    np.testing.assert_allclose(found @ unit, R @ unit, atol=1e-9)  # turned about its axis
    camera = -(found.swapaxes(-1, -2) @ t[..., None])[..., 0]
    flat = camera - (camera @ unit)[:, None] * unit
    ahead = front - (front @ unit) * unit
    cosines = (flat @ ahead) / np.linalg.norm(flat, axis=1) / np.linalg.norm(ahead)
    np.testing.assert_allclose(cosines, 1, atol=1e-9)
    # Whichever turn it came with.
    spin = Rotation.from_rotvec(rng.uniform(0, 7) * unit).as_matrix()
    np.testing.assert_allclose(turned_to_camera(R @ spin, t, axis, front), found, atol=1e-9)
    np.testing.assert_allclose(turned_to_camera(found, t, axis, front), found, atol=1e-9)


def test_a_front_that_is_none():
    R, t = np.eye(3), [0, 0, 1.0]
    for axis, front in (([0, 1, 0], [0, 2, 0]), ([0, 0, 0], [0, 0, 1]), ([0, 1, 0], [0, 0, 0])):
        with pytest.raises(ValueError, match="^axis and front: expected an axis, and a direction"):
            turned_to_camera(R, t, axis, front)
    above = turned_to_camera(R, [0, 1.0, 0], [0, 1, 0], [0, 0, 1])  # the camera on the axis
    np.testing.assert_allclose(above, R)
