"""From a cloud of points to a pose: P2R, which reads a rotation off seeds; P2P, where they vote."""

from typing import Any

from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
