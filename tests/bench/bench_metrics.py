"""ADD-S of many poses beside the loop that evaluation scripts write, on one core."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from posecore import metrics


@pytest.fixture(scope="module", params=["near", "far"])
def case(request):
    """1000 estimates of a surface of 2000 points: 5 degrees and 1 cm off, or anywhere."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(2000, 3))
    points = direction / np.linalg.norm(direction, axis=1, keepdims=True) * (0.05, 0.07, 0.1)
    angle, shift = {"near": (0.05, 0.01), "far": (3.0, 0.05)}[request.param]
    R_gt = Rotation.random(1000, random_state=rng)
    R_est = Rotation.from_rotvec(rng.normal(0, angle, (1000, 3))) * R_gt
    t_gt = rng.uniform(-0.2, 0.2, (1000, 3)) + (0, 0, 1)
    return R_est.as_matrix(), t_gt + rng.normal(0, shift, (1000, 3)), R_gt.as_matrix(), t_gt, points


def loop(R_est, t_est, R_gt, t_gt, points):
    errors = []
    for R_1, t_1, R_2, t_2 in zip(R_est, t_est, R_gt, t_gt, strict=True):
        distance, _ = cKDTree(points @ R_1.T + t_1).query(points @ R_2.T + t_2)
        errors.append(distance.mean())
    return np.array(errors)


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("function", [metrics.add_s, loop], ids=["posecore", "scipy loop"])
def test_add_s(benchmark, request, case, function):
    spread = request.node.callspec.params["case"]
    benchmark.group = f"ADD-S, 1000 poses, 2000 points, {spread}"
    errors = benchmark.pedantic(function, args=case, rounds=3, warmup_rounds=1)
    np.testing.assert_allclose(errors[:5], loop(*(x[:5] for x in case[:4]), case[4]), rtol=1e-9)
