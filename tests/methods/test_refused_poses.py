"""Numbers that methods on head poses refuse: a wrong shape must not broadcast, a nan not go on."""

import math

import numpy as np
import pytest
import torch

from posecore.methods.cloudpose.network import CloudPose, CloudPoseOutput, cloudpose_loss
from posecore.methods.cloudpose.recipe import RECIPES as CLOUDPOSE
from posecore.methods.points_to_pose.constant import ConstantPose
from posecore.methods.points_to_pose.evaluation import PoseErrors, pose_errors
from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.network import Prediction
from posecore.methods.points_to_pose.pose_clouds import visible_points
from posecore.methods.points_to_pose.recipe import RECIPES
from posecore.methods.points_to_pose.voting import robust_mean
from posecore.methods.random_bins.losses import nearest_bins
from posecore.methods.random_bins.network import PictureRegression, draw_bins
from posecore.nets.pointnet2 import PointNorm

EYE, ZERO = torch.eye(3).expand(3, 3, 3), torch.zeros(3, 3)
NAN = torch.full((3, 3), math.nan)
SIX = torch.arange(6.0)
ERRORS = pose_errors(EYE, ZERO, EYE, ZERO)


def picture_net():
    return PictureRegression(SIX, SIX + 1, trunk="basic", width=8, blocks=(1, 1, 1, 1)).eval()


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: pose_errors(EYE[:, None], ZERO, EYE, ZERO), "R_est"),
        (lambda: pose_errors(EYE * math.nan, ZERO, EYE, ZERO), "R_est"),
        (lambda: pose_errors(EYE.numpy(), ZERO, EYE, ZERO), "R_est"),
        (lambda: ERRORS.only(1), "chosen"),
        (lambda: ERRORS.only(np.array([[0, 1]])), "chosen"),
        (lambda: ERRORS.only([True, False]), "chosen"),
        (lambda: ERRORS.bins("yaw", 1e-30), "width"),
        (lambda: PoseLoss()(Prediction(torch.randn(5, 4)), torch.eye(3)[None]), "R"),
        (lambda: PoseLoss()(Prediction(torch.zeros(0, 4)), torch.zeros(0, 3, 3)), "R"),
        (lambda: PoseLoss()(Prediction(torch.ones(3, 4), ZERO[:1]), EYE, ZERO), "said.t"),
        (lambda: cloudpose_loss(CloudPoseOutput(ZERO, ZERO), EYE[:, None], ZERO), "R"),
        (lambda: CloudPose((4,), (4,)).eval()(NAN[None]), "points"),
        (lambda: picture_net()(torch.full((1, 1, 47, 80), math.nan)), "images"),
        (lambda: nearest_bins(NAN, torch.zeros(3, 2, 4)), "values"),
        (lambda: draw_bins(SIX * math.nan, SIX + 1), "low"),
        (lambda: draw_bins(SIX, SIX / 0), "high"),
        (lambda: robust_mean(torch.full((1, 2, 1, 3), math.inf)), "votes"),
        (lambda: ConstantPose.fit(EYE, NAN), "t"),
        (lambda: visible_points(np.ones((4, 4), "f4"), np.ones((1, 4), bool), np.eye(3), 2,
                                np.random.default_rng(0)), "mask"),
        (lambda: visible_points(np.ones((4, 4), "f4"), np.ones((4, 4), bool), np.eye(3), 0,
                                np.random.default_rng(0)), "count"),
    ],
)  # fmt: skip
def test_what_is_refused(call, name):
    with pytest.raises(ValueError, match=name):
        call()


@pytest.mark.parametrize("recipe", [RECIPES["tiny"], CLOUDPOSE["tiny"]], ids=["p2p", "cloudpose"])
@pytest.mark.parametrize("numbers", [{"steps": 0}, {"batch": 0}])
def test_no_steps_are_not_the_recipes(recipe, numbers):
    class Nothing:
        def draw(self, count, *, generator, turn):
            raise AssertionError

    with pytest.raises(ValueError, match=next(iter(numbers)) if "steps" in numbers else "."):
        list(recipe.batches(Nothing(), **numbers))


def test_a_turn_of_half_a_circle_is_in_the_last_bin():
    true = np.zeros((3, 3))
    true[:, 0] = np.pi, -np.pi, np.pi - 0.05
    found = PoseErrors(np.full((3, 3), 0.1), true, np.full(3, 0.1), np.zeros((3, 3)))
    assert [(one.low, one.count) for one in found.bins()] == [(175.0, 3)]


@pytest.mark.parametrize("options", [{"momentum": None}, {"affine": False},
                                     {"track_running_stats": False}])  # fmt: skip
def test_norms_of_many_rows_take_the_options_of_batch_norm(options):
    x = torch.randn(2**14, 3, generator=torch.Generator().manual_seed(0))
    expected = torch.nn.BatchNorm1d(3, **options)(x)
    assert torch.equal(PointNorm(3, **options)(x), expected)


def test_norms_of_many_rows_in_half_precision():
    x = (300 * torch.randn(2**14, 3, generator=torch.Generator().manual_seed(0))).half()
    found = PointNorm(3)(x)
    assert found.dtype == torch.nn.BatchNorm1d(3)(x).dtype
    assert found.float().std().item() == pytest.approx(1, abs=0.02)
