"""Vector fields: PVNet, the projection loss, and a refinement that knows when it is needed."""

from typing import Any

from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
