"""A training that is killed at any moment goes on as if nothing had been."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed") / "run"
    script = Path(__file__).with_name("killed_run.py")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path]),
        "OMP_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, script, folder], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder


def test_it_was_killed_at_more_than_ten_moments(killed):
    ends = killed[0]["ends"]
    signals = [end for moment, end in ends.items() if not moment.startswith("timer")]
    assert len(signals) == 15
    assert set(signals) == {-getattr(signal, "SIGKILL", signal.SIGTERM)}


def test_it_came_further_between_kills_and_was_never_done(killed):
    states = [int(name[6:14]) for name in killed[0]["states"] if name]
    assert states == sorted(states)
    named = [moment for moment in killed[0]["ends"] if not moment.startswith("timer")]
    assert states[len(named) - 2] < 80
    assert len(set(states)) >= 8


def test_weights_and_curves_are_those_of_a_run_that_was_not_killed(killed):
    resumed, whole = killed[0]["resumed"], killed[0]["whole"]
    assert len(whole["losses"]) == 2 * 80
    assert whole["measured_at"] == [*range(7, 80, 7), 80]
    assert resumed == whole


def test_nothing_is_left_but_two_checkpoints(killed):
    names = sorted(path.name for path in killed[1].iterdir())
    kinds = [(name.partition("-")[0], name[-3:]) for name in names]
    assert kinds == [("state", ".pt")] * 2 + [("weights", "ors")] * 2
    assert "state-00000080.pt" in names and "weights-00000080.safetensors" in names
