"""What functions compute and hand on is refused by name, or shown, where it is no number.

Functions that are called by others take values as finite (`posecore.arrays`). So none may make a
plain number of what is none.
"""

import math

import numpy as np
import pytest
import torch
from torch import nn

from posecore import cameras, clouds, metrics, registration, rotations
from posecore.arrays import trusted
from posecore.methods.vector_field.refinement import overlap
from posecore.nets.rotation_heads.codec import RotationCodec

EYE, ZERO = np.eye(3), np.zeros(3)
R_1, R_2 = rotations.random_rotations(2, generator=np.random.default_rng(0))
CLOUD = np.random.default_rng(1).normal(size=(9, 3))
FAR, HUGE = 1e160, 1.5e308
TURNED = np.array([[1.0, 1, 0], [1, -1, 0], [0, 0, 1]])
CORNER = np.array([[1.0], [-1], [1]])
MOVED = "R_est, t_est, R_gt, t_gt and points"
UP = np.eye(4)[None]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.add_s(HUGE * TURNED, ZERO, EYE, ZERO, CLOUD), MOVED),
        (lambda: metrics.add_s(EYE, ZERO, HUGE * TURNED, ZERO, CLOUD), MOVED),
        (lambda: metrics.add_s(EYE, [HUGE, 0, 0], EYE, [-HUGE, 0, 0], CLOUD), MOVED),
        (lambda: metrics.add_s(R_1, [HUGE, HUGE, 0], R_2, [0, -HUGE, 0], CLOUD), MOVED),
        (lambda: metrics.add_s(EYE, ZERO, HUGE * EYE, ZERO, CLOUD[None]), MOVED),
        (
            lambda: metrics.closest_symmetry(FAR * CORNER * EYE, FAR * TURNED, ZERO, UP),
            "R_est and R_gt",
        ),
        (
            lambda: metrics.projection_2d(EYE, HUGE * EYE, ZERO, EYE, [0, 0, 9], CLOUD),
            "R_est, t_est and points",
        ),
        (
            lambda: metrics.mspd(EYE, EYE, [0, 0, 9], EYE, [0, 0, HUGE], HUGE * abs(CLOUD) / 9),
            "R_est, t_est and points|R_gt, t_gt and points|points",
        ),
        (
            lambda: metrics.oriented_iou_3d(EYE, ZERO, [FAR] * 3, EYE, ZERO, [1] * 3),
            "size_1 and size_2",
        ),
        (lambda: clouds.nearest_neighbours(FAR * CLOUD, CLOUD), "points and queries"),
        (lambda: clouds.ball_query(FAR * CLOUD, CLOUD, 1.0, 2), "points and queries"),
        (lambda: clouds.chamfer_distance(FAR * CLOUD, CLOUD), "a and b"),
        (lambda: clouds.diameter(FAR * CLOUD), "points"),
        (lambda: clouds.estimate_normals(FAR * CLOUD, 4), "points"),
        (lambda: clouds.farthest_point_sampling(FAR * CLOUD, 3), "points"),
        (
            lambda: registration.icp(HUGE / 9 * CLOUD, CLOUD, R_1, [HUGE, HUGE, HUGE]),
            "R and t|source",
        ),
        (
            lambda: overlap(HUGE / 3 * abs(CLOUD), EYE, [0, 0, HUGE], EYE, np.ones((4, 5))),
            "R, t and points",
        ),
    ],
)  # fmt: skip
def test_finite_arguments_of_which_something_else_is_made(call, name):
    with pytest.raises(ValueError, match=f"^({name}): expected "), np.errstate(all="ignore"):
        call()


def test_a_large_matrix_is_no_rotation_to_add_s():
    # The off-diagonal entries of R R^T are infinity minus infinity: neither within 1e-5 nor not.
    wide = FAR * TURNED
    near = metrics.add_s(EYE, ZERO, wide, ZERO, CLOUD, direction="est_to_gt")
    assert not near < FAR / 1e3


def test_a_codec_whose_weights_are_no_numbers():
    codec = RotationCodec(1, 4)
    nn.init.constant_(codec.mlp[2].bias, math.nan)
    for call in (codec, codec.spectrum):
        with pytest.raises(ValueError, match="^codec: expected weights that give finite codes"):
            call(R_1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_estimates_that_are_no_numbers_are_seen_by_those_who_trust(bad):
    """As where a network calls: nothing is looked at, so nothing may vanish."""
    points, poses = torch.from_numpy(CLOUD), [torch.from_numpy(x) for x in (R_1, ZERO, R_2, ZERO)]
    up, size = torch.from_numpy(UP), torch.ones(3, dtype=torch.float64)
    for i, name in enumerate(["R_est", "t_est", "R_gt", "t_gt"]):
        wrong = [x.clone() for x in poses]
        wrong[i].view(-1)[2] = bad
        with trusted():
            for direction in ("gt_to_est", "est_to_gt"):
                with pytest.raises(ValueError, match=f"^{name}: "):
                    metrics.add_s(*wrong, points, direction)
            with pytest.raises(ValueError, match=f"^{name}: "):
                metrics.add_s(*wrong, points[None])
            assert not metrics.add(*wrong, points).isfinite()
            assert not metrics.mssd(*wrong, points).isfinite()
            K = torch.eye(3, dtype=torch.float64)
            with pytest.raises(ValueError, match=f"^{name[0]}_{name[2:]}|^R_|^t_"):
                metrics.projection_2d(K, *wrong, points.abs() + 1)
            if name[0] == "R":
                with pytest.raises(ValueError, match="^R_est and R_gt: "):
                    metrics.closest_symmetry(wrong[0], wrong[2], ZERO, up)
            boxes = (*wrong[:2], size, *wrong[2:], size)
            with pytest.raises(ValueError, match="^[Rt]_[12]: "):
                metrics.oriented_iou_3d(*boxes)
    wrong = points.clone()
    wrong[1, 1] = bad
    with trusted():
        for call in (
            lambda: clouds.nearest_neighbours(wrong, points),
            lambda: clouds.nearest_neighbours(points, wrong),
            lambda: clouds.ball_query(points, wrong, 1.0, 2),
            lambda: clouds.diameter(wrong),
            lambda: clouds.chamfer_distance(points, wrong),
            lambda: clouds.estimate_normals(wrong, 4),
            lambda: clouds.farthest_point_sampling(wrong, 3),
        ):
            with pytest.raises(ValueError, match="^(points|points and queries|a and b): "):
                call()
        depth = torch.ones(3, 4, dtype=torch.float64)
        depth[1, 1] = bad
        if not bad > 0:
            with pytest.raises(ValueError, match="^depth: "):
                cameras.depth_to_points(depth, torch.eye(3, dtype=torch.float64))


def test_a_depth_that_overflowed_has_no_pixel():
    points = torch.tensor([[1.0, 2, math.inf], [1, 2, 1]])
    for behind in ("refuse", "inf"):
        with trusted():
            pixels = cameras.project(torch.eye(3), points, behind)
        assert pixels[0].isnan().all() and pixels[1].tolist() == [1, 2]
