"""CloudPose: two PointNets, one for the rotation and one for the translation."""

from typing import Any

from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
