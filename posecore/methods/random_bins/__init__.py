"""RandomizedBins: a pose from the picture itself, by classes whose borders are drawn at random."""

from typing import Any

from posecore.lazy import submodule, submodules


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return submodules(__name__)
