"""From infrared images to point clouds: a cloud estimator that learns from masks in other views."""

from typing import Any

from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
