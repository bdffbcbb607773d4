"""`evaluate` on tables of T-LESS's size: 30 objects, 6721 poses, 12 of the objects turn freely."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.metrics import PoseTable, evaluation
from posecore.models import ObjectModel

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
    return ObjectModel(
        1, x, 0.122, symmetries=T if turning else None, centre=np.zeros(3), size=np.ptp(x, 0)
    )


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


@pytest.mark.parametrize("threads", [1, 2])
def test_evaluate(benchmark, case, threads):
    """A minute is meant on a machine with nothing else to do."""
    benchmark.group = f"evaluate, {POSES} poses of {OBJECTS} objects"
    estimates, truth, models = case
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        call = lambda: evaluation.evaluate(estimates, truth, models, K)  # noqa: E731
        errors = benchmark.pedantic(call, rounds=1)
    finally:
        torch.set_num_threads(before)
    assert benchmark.stats.stats.max < 60, "more than a minute"
    assert sum(len(one.found) for one in errors.values()) == POSES


def loop(error, R_est, t_est, R_gt, t_gt, points, symmetries):
    """One motion after the other."""
    return np.min(
        [error(R_est, t_est, R_gt @ S[:3, :3], t_gt + R_gt @ S[:3, 3], points) for S in symmetries],
        axis=0,
    )


ERRORS = {"MSSD": metrics.mssd, "MSPD": lambda *arguments: metrics.mspd(K, *arguments)}


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("how", ["posecore", "loop over motions"])
@pytest.mark.parametrize("name", ERRORS)
def test_errors_of_a_turning_object(benchmark, case, name, how):
    estimates, truth, models = case
    rows = np.flatnonzero(truth.object_id == 1)[:50]
    pair = (estimates.R[rows], estimates.t[rows], truth.R[rows], truth.t[rows])
    arguments = (*pair, models[1].points, models[1].symmetries)
    benchmark.group = f"{name}, 50 poses, 3000 points, {MOTIONS} motions"
    error = ERRORS[name]
    function = error if how == "posecore" else lambda *arguments: loop(error, *arguments)
    errors = benchmark.pedantic(function, arguments, rounds=2)
    np.testing.assert_allclose(errors[:2], loop(error, *(x[:2] for x in pair), *arguments[4:]))
