"""What an estimator on clouds says of a view does not depend on what it has seen before."""

import numpy as np
import pytest
import torch

from posecore.methods.points_to_pose.estimating import CloudEstimator


def test_a_view_has_draws_of_its_own(views):
    net = torch.nn.Identity()
    first, second = (CloudEstimator(net, 32, [1, 2, 3, 4]) for _ in range(2))
    one, other = views[0], views[1]
    first.look(other)
    seen = first.look(one)
    assert np.array_equal(seen.points, second.look(one).points)
    assert not np.array_equal(seen.points, CloudEstimator(net, 32, [1], seed=1).look(one).points)
    assert seen.points.shape == (32, 3)


@pytest.mark.parametrize("seed", [-1, 0.5])
def test_a_seed_that_cannot_be(seed):
    with pytest.raises(ValueError, match="seed"):
        CloudEstimator(torch.nn.Identity(), 32, [1], seed=seed)
