"""The data that a command is given: tabletop, bop:PATH or linemod:PATH."""

from __future__ import annotations

import sys
from typing import Any

import data_tools
from data_tools.views import Dataset

__all__ = ["open_source"]


def open_source(
    source: str, split: str | None, scale_name: str, show: bool = True, **options: Any
) -> Dataset:
    """Open a dataset as `data_tools.open` does; of worlds at a scale, with a bar if `show`."""
    if ":" not in source:  # a world, which has scales, and is made on first use
        options |= {"scale": scale_name, "progress": show and sys.stderr.isatty()}
    return data_tools.open(source, split=split, **options)
