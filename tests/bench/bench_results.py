"""Reading a results file of usual size."""

import numpy as np
from scipy.spatial.transform import Rotation

from data_tools.bop import read_results, write_results
from posecore.metrics import PoseTable


def test_read_results(benchmark, tmp_path):
    """1600 rows, as LM-O's 200 test images have them."""
    rng, n = np.random.default_rng(0), 1600
    ids = np.arange(n)
    R = Rotation.random(n, random_state=rng).as_matrix()
    table = PoseTable(ids, ids, ids, R, rng.normal(size=(n, 3)), np.ones(n), np.ones(n))
    write_results(tmp_path / "results.csv", table)
    benchmark.group = "results file of 1600 rows"
    assert len(benchmark(read_results, tmp_path / "results.csv")) == n
