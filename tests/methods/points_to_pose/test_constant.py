"""The floor of every table."""

import pytest
import torch

from posecore.methods.points_to_pose.constant import ConstantPose
from posecore.rotations import axis_angle_to_matrix


def test_the_mean_of_a_training_set():
    turns = torch.tensor([[0.0, 0.4, 0], [0, -0.2, 0], [0, 0.4, 0], [0, 0.2, 0]]).double()
    t = torch.arange(12).view(4, 3).double()
    pose = ConstantPose.fit(axis_angle_to_matrix(turns), t)
    sines, cosines = turns[:, 1].sin().sum(), turns[:, 1].cos().sum()
    expected = torch.tensor([0, torch.atan2(sines, cosines).item(), 0]).double()
    torch.testing.assert_close(pose.R, axis_angle_to_matrix(expected))
    assert pose.t.tolist() == [4.5, 5.5, 6.5]
    R, same = pose(3)
    assert R.shape == (3, 3, 3) and torch.equal(same, pose.t.expand(3, 3))


def test_what_cannot_be():
    with pytest.raises(ValueError, match="^t: expected shape"):
        ConstantPose.fit(torch.eye(3)[None], torch.zeros(2, 3))
    with pytest.raises(ValueError, match="^count: expected"):
        ConstantPose(torch.eye(3), torch.zeros(3))(-1)
