"""`evaluate` on tables of T-LESS's size: 30 objects, 6721 poses, 12 of the objects turn freely."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.metrics import PoseTable, evaluation

OBJECTS, POSES, IMAGES, TURNING, MOTIONS = 30, 6721, 1000, 12, 315
K = np.array([[1075.0, 0, 360], [0, 1074, 270], [0, 0, 1]])


def surface(rng, count):
    """A can with a rim."""
    turn, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(-0.05, 0.05, count)
    radius = np.where(height > 0.03, 0.035, 0.03)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], -1)


def model(rng, turning, points=3000):
    x = surface(rng, points)
    T = np.tile(np.eye(4), (MOTIONS, 1, 1))
    angles = 2 * np.pi / MOTIONS * np.arange(MOTIONS)
    T[:, :3, :3] = Rotation.from_euler("z", angles[:, None]).as_matrix()
    return evaluation.ObjectModel(x, 0.122, np.zeros(3), np.ptp(x, 0), T if turning else None)


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(0)
    models = {i: model(rng, i <= TURNING) for i in range(1, OBJECTS + 1)}
    object_id = rng.integers(1, OBJECTS + 1, POSES)
    R = Rotation.random(POSES, random_state=1)
    t = rng.uniform(-0.15, 0.15, (POSES, 3)) + (0, 0, 0.75)
    image, ones = rng.integers(0, IMAGES, POSES), np.ones(POSES)
    truth = PoseTable(ones.astype(int), image, object_id, R.as_matrix(), t, ones, -ones)
    near = Rotation.from_rotvec(rng.normal(0, 0.1, (POSES, 3))) * R
    spin = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi, (POSES, 1)))
    turned = np.where((object_id <= TURNING)[:, None, None], (near * spin).as_matrix(),
                      near.as_matrix())  # fmt: skip
    shifted = t + rng.normal(0, 0.01, (POSES, 3))
    scores = rng.random(POSES)
    estimates = PoseTable(ones.astype(int), image, object_id, turned, shifted, scores, ones)
    return estimates, truth, models


def test_evaluate(benchmark, case):
    benchmark.group = "evaluate, 6721 poses of 30 objects"
    estimates, truth, models = case
    call = lambda: evaluation.evaluate(estimates, truth, models, K)  # noqa: E731
    errors = benchmark.pedantic(call, rounds=1)
    assert benchmark.stats.stats.max < 60, "more than a minute"
    assert sum(len(one.found) for one in errors.values()) == POSES


def loop(K, R_est, t_est, R_gt, t_gt, points, symmetries):
    """One motion after the other."""
    return np.min(
        [
            metrics.mspd(K, R_est, t_est, R_gt @ S[:3, :3], t_gt + R_gt @ S[:3, 3], points)
            for S in symmetries
        ],
        axis=0,
    )


@pytest.mark.parametrize("function", [metrics.mspd, loop], ids=["posecore", "loop over motions"])
def test_mspd_of_a_turning_object(benchmark, case, function):
    estimates, truth, models = case
    rows = np.flatnonzero(truth.object_id == 1)[:50]
    arguments = (estimates.R[rows], estimates.t[rows], truth.R[rows], truth.t[rows])
    benchmark.group = "MSPD, 50 poses, 3000 points, 315 motions"
    errors = benchmark.pedantic(
        function, (K, *arguments, models[1].points, models[1].symmetries), rounds=2
    )
    assert errors.max() < 200
