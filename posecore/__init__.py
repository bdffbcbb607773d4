"""posecore: 6-DoF object pose estimation, from rotations and metrics to networks.

Its modules and packages are imported when they are first named: `posecore.metrics.add`.
"""

__version__ = "0.1.0"

from typing import Any

import posecore.loaded  # noqa: F401 - before all others
from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
