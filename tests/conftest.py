"""What every test shares: reproducible property tests and the road to real data."""

import os
import tempfile
from pathlib import Path

# The cores are shared by the processes of one run; what they start, and torch, must know before.
SHARE = max(1, (os.cpu_count() or 1) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))
os.environ["OMP_NUM_THREADS"] = str(SHARE)
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as make.py has it
# A hundred processes are started: each would compile all of the project anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
import torch  # noqa: E402
from hypothesis import settings  # noqa: E402

settings.register_profile("book", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=15)
settings.load_profile("book")
# Whatever the user's own settings are; the scale of all tests, for the processes they start too.
os.environ["POSECORE_SCALE"] = "tiny"
os.environ.pop("POSECORE_RETRAIN", None)
# One cache for the processes and kernels of a run, where each tiny world is made once, by whoever
# asks for it first; it goes when the run ends.
if "PYTEST_XDIST_WORKER" not in os.environ:
    CACHE = tempfile.TemporaryDirectory(prefix="posecore-", ignore_cleanup_errors=True)
    os.environ["POSECORE_CACHE"] = CACHE.name
SHARED_CACHE = Path(os.environ["POSECORE_CACHE"])
torch.set_num_threads(SHARE)

BESIDE_THE_CHECKOUT = Path(__file__).resolve().parents[2] / "shared" / "real"


def pytest_configure(config: pytest.Config) -> None:
    """`pytest -m "not slow"` is to answer at once, and so tries fewer examples of each property."""
    if config.getoption("markexpr") == "not slow":
        settings.load_profile("quick")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder with the small real data sets; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("POSECORE_DATA", BESIDE_THE_CHECKOUT))
    if not (folder / "bop_results").is_dir():
        pytest.skip(f"no real data: {folder} has no bop_results (set POSECORE_DATA to its folder)")
    return folder


@pytest.fixture(scope="session")
def shared_cache() -> Path:
    """The cache of this run, whatever a test has set: for worlds that are not to be changed."""
    return SHARED_CACHE


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that is the same in every run."""
    return np.random.default_rng(0)
