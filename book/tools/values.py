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
SMALL = 9  # arrays of at most so many entries are printed whole; rotations are
DIGITS = range(6, 18)  # with 17, two numbers that differ look different


def show(value: Any) -> str:
    """A value in a few words on one line.

    Arrays come with their shape, the small ones whole and of the others the first and last entries.
    Numbers have the digits that are meant: no rounding of float32 is seen, and no 1e-17 for 0.
    """
    if isinstance(value, np.ndarray | Tensor) and value.ndim:
        kind = "tensor" if isinstance(value, Tensor) else "array"
        array = _array(value)
        return f"{kind} {tuple(array.shape)} {_short(_entries(array))}"
    if isinstance(value, np.ndarray | Tensor | np.generic):
        value = value.item()
    if isinstance(value, float):
        return f"{value + 0.0:.6g}"  # -0 becomes 0
    if isinstance(value, dict):
        return _short(f"{{{_inside([f'{key!r}: {show(item)}' for key, item in value.items()])}}}")
    if isinstance(value, list):
        return _short(f"[{_inside([show(item) for item in value[:5]])}]")
    if isinstance(value, tuple):
        comma = "," if len(value) == 1 else ""
        return _short(f"({_inside([show(item) for item in value[:5]])}{comma})")
    if inspect.isroutine(value) or inspect.isclass(value):
        return getattr(value, "__name__", type(value).__name__)
    try:
        return _short(repr(value))
    except Exception:
        return f"an instance of {type(value).__name__}"


def _inside(items: list[str]) -> str:
    return ", ".join(items[:4]) + (", ..." if len(items) > 4 else "")


def _entries(array: np.ndarray) -> str:
    """The entries of an array as NumPy has them, but each no longer than it needs."""
    if array.dtype.kind == "f" and array.size:
        largest = np.abs(array[np.isfinite(array)]).max(initial=0.0)
        # What is left where numbers of this size cancel.
        array = np.where(np.abs(array) <= 8 * np.finfo(array.dtype).eps * largest, 0, array)
    return np.array2string(
        array,
        threshold=SMALL,
        edgeitems=1,
        separator=", ",
        formatter={"float_kind": _entry, "int": str, "bool": str},
    )


def _entry(number: float) -> str:
    """Four digits, or four decimals; a whole number ends in a dot, as NumPy has it."""
    if number == 0:
        return "0."
    if not 0.1 <= abs(number) < 1e6:  # also nan and inf
        return f"{number:.4g}"
    return f"{number:.4f}".rstrip("0")


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
    expected, got = (_without_noise(array, tolerance) for array in (expected, got))
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


def _without_noise(array: np.ndarray, tolerance: float) -> np.ndarray:
    """0 for what is 0 as far as anybody looks."""
    if array.dtype.kind != "f":
        return array
    return np.where(np.abs(array) < 1e-3 * tolerance, array.dtype.type(0), array)


def _tell_apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers with as many digits as it takes to see the difference."""
    for digits in DIGITS:
        pair = [f"{x + 0.0:.{digits}g}" if isinstance(x, float) else str(x) for x in (a, b)]
        if pair[0] != pair[1]:
            break
    return pair[0], pair[1]


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
