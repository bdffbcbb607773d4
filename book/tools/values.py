"""Results of exercises: told apart in words, and printed short."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["difference", "show"]

LONGEST = 120  # characters of one printed value
SMALL = 8  # arrays of at most so many entries are printed whole


def show(value: Any) -> str:
    """A value in a few words on one line; arrays with their shape and first and last entries."""
    if isinstance(value, np.ndarray | Tensor) and value.ndim:
        array = _array(value)
        kind = "tensor" if isinstance(value, Tensor) else "array"
        text = np.array2string(array, precision=4, threshold=SMALL, edgeitems=1, separator=", ")
        return f"{kind} {tuple(array.shape)} {_short(text)}"
    if isinstance(value, np.ndarray | Tensor | np.generic):
        value = value.item()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        inside = ", ".join(show(item) for item in value[:4]) + (", ..." if len(value) > 4 else "")
        if isinstance(value, list):
            return _short(f"[{inside}]")
        return _short(f"({inside}{',' if len(value) == 1 else ''})")
    if inspect.isroutine(value) or inspect.isclass(value):
        return getattr(value, "__name__", type(value).__name__)
    try:
        return _short(repr(value))
    except Exception:
        return f"an instance of {type(value).__name__}"


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def difference(
    got: Any,
    expected: Any,
    tolerance: float | None,
    compare_as: Callable[[Any], Any] | None = None,
) -> str:
    """In words, how `got` differs from `expected`; empty where it does not.

    The kinds are numbers (also arrays and tensors without dimensions, where the expected one is no
    tensor), arrays, tensors, true or false, text, None, and tuples, lists and dicts of these. An
    expected float may come as a whole number, but not the other way round. NaN agrees with NaN.

    Args:
        got, expected: the two results.
        tolerance: how far numbers may be apart: `tolerance * (1 + |expected|)`; None compares kinds
            and shapes only.
        compare_as: applied to both before values are compared, after kind and shape were.
    """
    words = _differ(got, expected, None)
    if not words:
        if compare_as is not None:
            got, expected = compare_as(got), compare_as(expected)
        words = _differ(got, expected, tolerance)
    return words


def _differ(got: Any, expected: Any, tolerance: float | None) -> str:
    """The first difference in kind, form or, given a tolerance, value."""
    if isinstance(got, Tensor) and got.ndim == 0 and not isinstance(expected, Tensor):
        got = got.item()
    kind = _kind(expected)
    if _kind(got) != kind:
        return f"expected {_noun(expected)}, got {_noun(got)}"
    if kind in ("a tuple", "a list", "a dict"):
        return _items_differ(got, expected, tolerance)
    if kind in ("an array", "a tensor", "a number"):
        a, b = _array(got), _array(expected)
        return _forms_differ(a, b) or ("" if tolerance is None else _values_differ(a, b, tolerance))
    if tolerance is None or bool(got == expected):
        return ""
    return f"expected {show(expected)}, got {show(got)}"


def _items_differ(got: Any, expected: Any, tolerance: float | None) -> str:
    if isinstance(expected, dict):
        if got.keys() != expected.keys():
            return f"expected a dict with {show(list(expected))}, got {show(list(got))}"
        keys = list(expected)
    else:
        if len(got) != len(expected):
            return f"expected {_kind(expected)} of {len(expected)}, got {len(got)}"
        keys = list(range(len(expected)))
    for key in keys:
        if words := _differ(got[key], expected[key], tolerance):
            return f"in result [{key!r}] {words}"
    return ""


def _forms_differ(got: np.ndarray, expected: np.ndarray) -> str:
    if got.shape != expected.shape:
        return f"expected shape {expected.shape}, got shape {got.shape}"
    names = {"b": "true and false", "i": "whole numbers", "f": "real numbers"}
    want, have = (array.dtype.kind.replace("u", "i") for array in (expected, got))
    if want == have or (want, have) == ("f", "i"):
        return ""
    words, came = (
        names.get(kind, f"dtype {a.dtype}") for kind, a in ((want, expected), (have, got))
    )
    return f"expected {words}, got {came}"


def _values_differ(got: np.ndarray, expected: np.ndarray, tolerance: float) -> str:
    if expected.dtype.kind != "f":
        wrong = np.asarray(got != expected)
    else:
        wrong = ~np.isclose(got, expected, rtol=tolerance, atol=tolerance, equal_nan=True)
    if not wrong.any():
        return ""
    want, have = show(expected), show(got)
    if 0 < expected.ndim and expected.size <= SMALL and want != have:
        return f"expected {want}, got {have}"
    first = tuple(np.argwhere(wrong)[0].tolist())
    want, have = _tell_apart(expected[first].item(), got[first].item())
    if not first:
        return f"expected {want}, got {have}"
    place = ", ".join(map(str, first))
    return (
        f"expected {want} at [{place}], got {have} ({wrong.sum()} of {wrong.size} entries differ)"
    )


def _tell_apart(*numbers: float) -> list[str]:
    """Numbers with as many digits as it takes to see the difference."""
    short = [f"{number:.6g}" if isinstance(number, float) else str(number) for number in numbers]
    return short if len(set(short)) > 1 else [repr(number) for number in numbers]


def _array(value: Any) -> np.ndarray:
    if isinstance(value, Tensor):
        value = value.detach().cpu()
        return (value.float() if value.dtype == torch.bfloat16 else value).numpy()
    return np.asarray(value)


def _noun(value: Any) -> str:
    has_shape = isinstance(value, np.ndarray | Tensor) and value.ndim
    return _kind(value) + (f" of shape {tuple(value.shape)}" if has_shape else "")


def _kind(value: Any) -> str:
    if isinstance(value, Tensor):
        return "a tensor"
    if isinstance(value, np.ndarray) and value.ndim:
        return "an array"
    if isinstance(value, np.ndarray | np.generic):
        value = value.item()
    for kind, name in (
        (bool, "true or false"),
        (int | float, "a number"),
        (complex, "a complex number"),
        (str, "text"),
        (tuple, "a tuple"),
        (list, "a list"),
        (dict, "a dict"),
    ):
        if isinstance(value, kind):
            return name
    return "nothing (None)" if value is None else f"an object of type {type(value).__name__}"
