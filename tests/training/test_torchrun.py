"""Two processes under torchrun train as one does."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).with_name("shared_run.py")
TORCHRUN = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """What one process wrote, and what each of two did; and the folder of the two."""
    folder = tmp_path_factory.mktemp("torchrun")
    environment = {name: value for name, value in os.environ.items() if "proxy" not in name.lower()}
    environment["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])
    environment["OMP_NUM_THREADS"] = "1"
    words = [*TORCHRUN, SCRIPT, folder / "two", folder / "checkpoints of two"]
    done = subprocess.run(
        [sys.executable, *words], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    runpy.run_path(str(SCRIPT))["write"](folder / "one", folder / "checkpoints of one")
    read = {path.name: json.loads(path.read_text()) for path in folder.glob("*.[01]")}
    return read, folder / "checkpoints of two"


def test_the_batch_is_divided(runs):
    found, _ = runs
    assert found["one.0"]["plain"]["rows"] == [12] * 8
    assert found["two.0"]["plain"]["rows"] == found["two.1"]["plain"]["rows"] == [6] * 8


@pytest.mark.parametrize("name", ["loss", "error"])
def test_two_train_to_the_losses_of_one(runs, name):
    found, _ = runs
    one, two = (found[run]["plain"]["losses"][name] for run in ("one.0", "two.0"))
    assert len(set(one)) == 8
    # Sums in another order, float32: a few roundings (6e-8) for each step and layer.
    np.testing.assert_allclose(two, one, rtol=3e-6)


def test_both_have_the_same_weights_and_curves(runs):
    found, _ = runs
    for run in ("plain", "dropout", "resumed"):
        assert found["two.0"][run]["weights"] == found["two.1"][run]["weights"]
        assert found["two.0"][run]["losses"] == found["two.1"][run]["losses"]
    one, two = (found[run]["plain"]["weights"] for run in ("one.0", "two.0"))
    one, two = (np.array([float.fromhex(value) for value in w]) for w in (one, two))
    np.testing.assert_allclose(two, one, atol=2e-6)


def test_each_has_random_numbers_of_its_own(runs):
    found, _ = runs
    one, first, second = (found[run]["plain"]["noise"] for run in ("one.0", "two.0", "two.1"))
    assert first == one
    assert len({*first, *second}) == 16


def test_two_go_on_bit_for_bit(runs):
    found, folder = runs
    for run in ("one.0", "two.0", "two.1"):
        assert len(found[run]["resumed"]["rows"]) == 3
        assert found[run]["resumed"]["weights"] == found[run]["dropout"]["weights"]
        assert found[run]["resumed"]["losses"] == found[run]["dropout"]["losses"]
    assert sorted(path.suffix for path in folder.iterdir()) == [".pt"] * 2 + [".safetensors"] * 2
