"""Chapter 4's exercises: plausible wrong solutions are caught, other right ones are accepted."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from book.ch04_points_to_pose import checks
from posecore import metrics, rotations
from posecore.methods.points_to_pose.voting import robust_mean
from posecore.nets.pointnet2 import Abstraction, build_geometry
from posecore.nets.rotation_heads import RotationHead
from tests.book.ch04_points_to_pose import solutions
from tests.book.exercises import ExerciseTests

seeds = st.integers(0, 2**31 - 1)


class TestExercises(ExerciseTests):
    checks = checks
    solutions = solutions.SOLUTIONS


def test_only_yaws_that_nobody_knows_are_ever_refused() -> None:
    """Where a reference fails, a check would ask the student to fail, too."""
    for name in (name for name in vars(checks) if name.startswith("check_")):
        exercise = getattr(checks, name)
        for words, *arguments in exercise.inputs(np.random.default_rng(exercise.seed)):
            if words.startswith("no yaw that is known"):
                with pytest.raises(ValueError, match="yaw: expected one that is known"):
                    exercise.reference(*arguments)
            else:
                exercise.reference(*arguments)


def test_no_ball_is_a_matter_of_rounding() -> None:
    for words, points, centres, radius, count in checks._balls(np.random.default_rng(0)):
        if "exactly on the radius" in words:
            continue
        found = [checks.ball_query(points, centres, k * radius, count) for k in (0.9999, 1.0001)]
        assert torch.equal(*found), words


def test_no_yaw_is_a_matter_of_rounding() -> None:
    for words, yaw in checks._yaws(np.random.default_rng(0)):
        known = np.abs(yaw[np.isfinite(yaw)])
        assert (np.abs(known - checks.EXTREME) > 1e-3).all(), words


# What the references say, against the library and others ------------------------------------------


@given(seeds)
@settings(max_examples=10)
def test_the_balls_are_those_of_the_network(seed: int) -> None:
    points = torch.from_numpy(np.random.default_rng(seed).normal(size=(1, 40, 3)))
    geometry = build_geometry(points, [Abstraction(12, 0.8, 6, (4,))], 0)
    balls = checks.ball_query(points[0], geometry.coordinates()[1][0], 0.8, 6)
    assert torch.equal(balls, geometry.levels[0].balls[0].long())


@given(seeds)
@settings(max_examples=15)
def test_pooling_knows_neither_order_nor_repeats(seed: int) -> None:
    rng = np.random.default_rng(seed)
    features = torch.from_numpy(rng.normal(size=(7, 3)))
    balls = torch.from_numpy(rng.integers(-1, 7, size=(4, 5)))
    one = checks.pool_balls(features, balls)
    order = torch.from_numpy(rng.permutation(5))
    padded = torch.cat([balls[:, order], balls[:, :2], torch.full((4, 3), -1)], 1)
    for a, b in zip(one, checks.pool_balls(features, padded), strict=True):
        assert torch.allclose(a, b, atol=1e-12)
    # Points that come in another order are the same points.
    rows = torch.from_numpy(rng.permutation(7))
    places = torch.cat([rows.argsort(), torch.tensor([-1])])
    for a, b in zip(one, checks.pool_balls(features[rows], places[balls]), strict=True):
        assert torch.allclose(a, b, atol=1e-12)


@given(seeds)
@settings(max_examples=15)
def test_the_loss_is_the_heads_and_sees_no_sign_of_the_label(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outputs, q = (torch.from_numpy(rng.normal(size=(6, 4))) for _ in range(2))
    p, q = (torch.nn.functional.normalize(x, dim=-1) for x in (outputs, q))
    loss = checks.quaternion_loss(outputs, q)
    head = RotationHead("quaternion", "sign_free")
    assert torch.allclose(loss, head.loss(p, rotations.quaternion_to_matrix(q)).mean())
    assert torch.allclose(loss, checks.quaternion_loss(-3 * outputs, -q))
    angle = rotations.geodesic_distance(*map(rotations.quaternion_to_matrix, (p, q)))
    assert torch.allclose(loss, (2 * (angle / 4).sin()).mean(), atol=1e-6)


@given(seeds, st.integers(1, 4))
@settings(max_examples=10)
def test_wild_votes_that_are_few_do_not_move_the_pose(seed: int, wild: int) -> None:
    rng = np.random.default_rng(seed)
    model = torch.from_numpy(rng.normal(scale=0.1, size=(5, 3)))
    R = torch.from_numpy(rotations.random_rotations(generator=rng))
    votes = (model @ R.mT + 0.3).repeat(11, 1, 1)
    votes[:wild] += torch.from_numpy(rng.normal(size=(wild, 5, 3)))
    for got, true in zip(
        checks.pose_of_votes(votes, model), (R, torch.full((3,), 0.3)), strict=True
    ):
        assert torch.allclose(got, true.double(), atol=1e-6)
    assert torch.allclose(robust_mean(votes[None])[0], model @ R.mT + 0.3)


@given(seeds, st.floats(0.02, 2.0))
@settings(max_examples=20)
def test_bins_hold_all_poses_and_their_mean_is_the_librarys(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    true = rng.uniform(-np.pi, np.pi, size=50)
    estimated = true + rng.normal(scale=0.3, size=50)
    counts, means, bmae = checks.error_bins(estimated, true, width)
    errors = np.abs(metrics.angle_difference(estimated, true))
    assert counts.sum() == 50 and len(counts) == int(np.ceil(np.pi / width - 1e-9))
    assert np.array_equal(np.isnan(means), counts == 0)
    assert np.nansum(counts * means) == pytest.approx(errors.sum())
    assert bmae == pytest.approx(np.nanmean(means))


@given(seeds)
@settings(max_examples=20)
def test_the_weights_teach_extremes_on_any_drive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 60))
    yaw = rng.normal(scale=rng.uniform(0.05, 1), size=size)
    yaw[1:][rng.random(size - 1) < 0.1] = np.nan
    assert checks._teach_extremes(checks.training_weights(yaw), yaw) == ""
