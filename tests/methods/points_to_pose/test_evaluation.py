import math

import numpy as np
import pytest
import torch

from posecore.methods.points_to_pose.evaluation import pose_errors
from posecore.rotations import euler_to_matrix


def angles(*degrees):
    return torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))


TRUE = angles((1, 2, 3), (4, -6, 0), (-42, 0, 11), (12, 3, -1))
OFF = angles((1, 0, 0), (-3, 2, 0), (8, 0, 4), (0, 0, 0))


def four():
    t = torch.zeros(4, 3)
    moved = t + torch.tensor([0.003, -0.004, 0.0])
    return pose_errors(euler_to_matrix(TRUE + OFF), moved, euler_to_matrix(TRUE), t)


def test_a_row_of_table_3():
    table = four().orientation()
    assert table["MAE"]["yaw"] == pytest.approx((1 + 3 + 8 + 0) / 4)
    assert table["MAE"]["average"] == pytest.approx((12 / 4 + 2 / 4 + 4 / 4) / 3)
    assert table["RMSE"]["yaw"] == pytest.approx(math.sqrt((1 + 9 + 64) / 4))
    # Yaws of 1 and 4 share a bin; -42 and 12 have one each.
    assert table["BMAE"]["yaw"] == pytest.approx(((1 + 3) / 2 + 8 + 0) / 3)


def test_a_row_of_table_4():
    assert four().position() == pytest.approx({"x": 3, "y": 4, "z": 0, "L2": 5}, abs=1e-4)


def test_bins_are_those_of_the_metric():
    errors = four()
    bins = errors.bins("yaw")
    assert [(b.low, b.count) for b in bins] == [(0, 2), (10, 1), (40, 1)]
    assert np.mean([b.error for b in bins]) == pytest.approx(errors.orientation()["BMAE"]["yaw"])
    assert [b.count for b in errors.bins("roll", 180)] == [4]


def test_the_short_way_round():
    true, said = angles((179, 0, 0)), angles((-179, 0, 0))
    errors = pose_errors(
        euler_to_matrix(said), torch.zeros(1, 3), euler_to_matrix(true), torch.zeros(1, 3)
    )
    assert np.rad2deg(errors.angles[0, 0]) == pytest.approx(2)
    assert np.rad2deg(errors.rotation) == pytest.approx(2)


def test_some_of_them():
    errors = four()
    part = errors.only(errors.true[:, 0] < 0)
    assert len(part) == 1 and part.orientation()["MAE"]["yaw"] == pytest.approx(8)
    with pytest.raises(ValueError, match="chosen"):
        errors.only(np.zeros(4, bool))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"t_est": torch.zeros(3, 3)}, "t_est"),
        ({"R_gt": torch.zeros(2, 3)}, "R_gt"),
        ({"t_gt": torch.full((2, 3), math.nan)}, "t_gt"),
        ({"R_gt": torch.zeros(2, 3, 3) + 1}, "R"),
        ({"R_est": torch.zeros(0, 3, 3)}, "at least one"),
    ],
)
def test_bad_input(changes, name):
    R = euler_to_matrix(TRUE[:2])
    given = {"R_est": R, "t_est": torch.zeros(2, 3), "R_gt": R, "t_gt": torch.zeros(2, 3)}
    with pytest.raises(ValueError, match=name):
        pose_errors(**given | changes)


@pytest.mark.parametrize(("angle", "width"), [("heading", 5), ("yaw", 0), ("yaw", math.nan)])
def test_bad_bins(angle, width):
    with pytest.raises(ValueError, match="angle|width"):
        four().bins(angle, width)
