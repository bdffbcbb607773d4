"""Which rows of the data one asks for."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import fail

__all__ = ["to_indices", "to_integers"]


def to_integers(name: str, values: Any) -> np.ndarray:
    """One or several integers as an int64 array; a ValueError for others.

    Raises:
        ValueError: if it is none, or ragged.
    """
    whole = isinstance(values, int | np.integer | np.ndarray | Tensor)
    try:
        array = np.asarray(values if whole else list(values))
    except (TypeError, ValueError):  # one that is no sequence, or rows of different lengths
        fail(name, "integers", repr(values))
    if array.dtype.kind not in "iu" and array.size:
        fail(name, "integers", f"dtype {array.dtype}")
    return array.astype(np.int64)


def to_indices(name: str, values: Any, count: int) -> Tensor:
    """At least one index below `count` as an int64 tensor; a ValueError for others.

    Raises:
        ValueError: if there is none, or one is no integer from 0 to `count` - 1.
    """
    array = to_integers(name, values)
    if array.ndim == 0 or array.size == 0:
        fail(name, "at least one, in a row", f"shape {array.shape}")
    if array.min() < 0 or array.max() >= count:
        fail(name, f"0 to {count - 1}", f"{array.min()} to {array.max()}")
    return torch.from_numpy(array)
