"""data_tools: one record type and one door for every dataset of the field.

`data_tools.open("bop:PATH", split="test")` returns a dataset of `View`s. The names are imported on
first use, so that `import data_tools` itself costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import posecore.loaded  # noqa: F401 - before all others of this package

if TYPE_CHECKING:
    from data_tools.views import Dataset, ModelSet, ObjectView, View, open

__all__ = ["Dataset", "ModelSet", "ObjectView", "View", "open"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("data_tools.views"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
