"""One calling convention for the whole library, and errors that name the argument.

Every numeric function of posecore is written once, in PyTorch, and is called with NumPy arrays,
nested lists or tensors:

- tensors in, tensors out (same device, gradients flow);
- arrays or lists in, arrays out (a result without dimensions comes back as a NumPy scalar);
- arguments of different precision are promoted to the widest; integers become floats; Python's own
  numbers and lists take the precision of the arrays beside them.

A function states the shapes it expects, `@array_function(R="... 3 3", points="... N 3")`, and may
then rely on them: wrong shapes, empty clouds and values that are not finite have been refused with
a `ValueError` that names the argument, what was expected and what came.

What came in finite is not looked at again: functions called by one of these check shapes, not
values, which on a GPU would each time wait for all that goes before. So a function that computes
what may be no number, a quotient, a square, says so itself (`require_finite`). While PyTorch
compiles, and under `torch.func`, there are no values to look at, and nothing is refused for them.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any, NoReturn, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

__all__ = [
    "Array",
    "array_function",
    "fail",
    "input_precision",
    "require_choice",
    "require_finite",
    "require_integer",
    "require_number",
    "somewhere",
    "to_numbers",
    "trusted",
    "values_known",
]

Array = Tensor | np.ndarray
"""What the functions of posecore take and return: a tensor or a NumPy array."""

F = TypeVar("F", bound=Callable[..., Any])
_TRUSTED = ContextVar("trusted", default=False)
_PRECISION = ContextVar("precision", default=0.0)
_HALF = (torch.float16, torch.bfloat16)
_AS_IS = contextlib.nullcontext()


def fail(name: str, expected: str, got: object) -> NoReturn:
    """Raise the library's one kind of error: which argument, what was expected, what came.

    Raises:
        ValueError: always.
    """
    raise ValueError(f"{name}: expected {expected}, got {got}")


def require_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Refuse a `value` that is not one of `choices`.

    Raises:
        ValueError: if it is not one of them.
    """
    if value not in choices:
        fail(name, "one of " + ", ".join(map(repr, choices)), repr(value))


def require_integer(
    name: str, value: object, low: int | None = None, high: int | None = None
) -> int:
    """Return `value` as an int, or refuse what is not an integer in [`low`, `high`].

    Raises:
        ValueError: if it is no integer, a bool among these, or out of bounds.
    """
    expected = "an integer" + _bounds(low, high)
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        fail(name, expected, repr(value))
    number = int(cast(int, value))
    if (low is not None and number < low) or (high is not None and number > high):
        fail(name, expected, number)
    return number


def require_number(
    name: str,
    value: object,
    low: float | None = None,
    high: float | None = None,
    *,
    above: float | None = None,
) -> float:
    """Return `value` as a float, or refuse what is not a finite number in [`low`, `high`].

    `above` is a lower bound that the value may not touch: `above=0` asks for a positive number.

    Raises:
        ValueError: if it is no number, not finite, or out of bounds.
    """
    expected = "a finite number" + _bounds(low, high)
    if above is not None:
        expected = f"a finite number above {above}" + _bounds(None, high)
    try:
        if isinstance(value, str | bytes | bool | np.bool_):
            raise TypeError
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        fail(name, expected, repr(value))
    if (
        not math.isfinite(number)
        or (low is not None and number < low)
        or (high is not None and number > high)
        or (above is not None and number <= above)
    ):
        fail(name, expected, number)
    return number


def _bounds(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f" between {low} and {high}"
    if low is not None:
        return f" of at least {low}"
    return f" of at most {high}" if high is not None else ""


@contextlib.contextmanager
def trusted() -> Iterator[None]:
    """Within it, values are taken to be finite; shapes are checked all the same.

    For what calls many functions with numbers of its own, such as the forward pass of a network.
    """
    token = _TRUSTED.set(True)
    try:
        yield
    finally:
        _TRUSTED.reset(token)


def values_known() -> bool:
    """Whether tensors have values to look at: not while compiling, nor under `torch.func`."""
    if torch.compiler.is_compiling():
        return False
    return torch._C._functorch.peek_interpreter_stack() is None


def input_precision() -> float:
    """The relative precision of what came in, where that was of half precision; else 0.

    Within a decorated function, which computes with it in float32: what can only be so exact is
    not to be refused for it.
    """
    return _PRECISION.get() if values_known() else 0.0  # a ContextVar breaks a compiled graph


def somewhere(condition: Tensor) -> bool:
    """Whether booleans hold anywhere; False where there are no values to look at."""
    return values_known() and bool(condition.any())


def require_finite(name: str, values: Tensor, expected: str = "finite values") -> None:
    """Refuse values that are not finite, where there are any to look at.

    Raises:
        ValueError: if one is not, `expected` saying what was.
    """
    if values_known():
        _check_finite(name, values, expected)


def to_numbers(name: str, values: object) -> np.ndarray:
    """Numbers of any kind as a float64 array, for functions that work in NumPy; may be infinite.

    Raises:
        ValueError: if it is no array of real numbers, is ragged, or has masked values.
    """
    if isinstance(values, Tensor):
        values = values.detach().cpu()
        values = (values.float() if values.dtype == torch.bfloat16 else values).numpy()
    _require_unmasked(name, values)
    try:
        array = np.asarray(values)
    except ValueError:  # a ragged list
        fail(name, "an array of numbers", "rows of different lengths")
    if array.dtype.kind not in "fiu" and array.size:
        fail(name, "an array of numbers", f"dtype {array.dtype}")
    return array.astype(np.float64)


def _require_unmasked(name: str, values: object) -> None:
    """Refuse masked values, of which NumPy makes numbers where it makes an array of a list."""
    for value in values if isinstance(values, list | tuple) else [values]:
        if isinstance(value, list | tuple):
            _require_unmasked(name, value)
        elif np.ma.is_masked(value):
            fail(name, "an array without masked values", f"{np.ma.count_masked(value)} masked")


def array_function(*, keeps_half: bool = False, **shapes: str) -> Callable[[F], F]:
    """Make a function written in PyTorch take NumPy arrays as well, and check its input.

    Args:
        keeps_half: whether tensors of half precision are passed as they are, for what only moves
            features of a network about; else they become float32, as then does the result: half
            precision has three digits (`input_precision`), too few to compute with rotations.
        shapes: for each array argument its shape, dimensions separated by blanks: a number is that
            size; a name is any size of at least one, the same wherever the name appears; a leading
            `...` stands for any number of batch dimensions, which must broadcast over the arguments
            that have them. An argument whose default is `None` may be `None`.

    Raises (when the decorated function is called):
        ValueError: if an array is not numeric, does not have its shape, is not finite, or has
            masked values.
    """
    specs = {name: tuple(spec.split()) for name, spec in shapes.items()}

    def decorate(function: F) -> F:
        signature = inspect.signature(function)
        unknown = set(specs) - set(signature.parameters)
        if unknown:
            raise TypeError(f"{function.__name__} has no argument {sorted(unknown)}")
        optional = {n for n in specs if signature.parameters[n].default is None}

        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            given = {n: bound.arguments[n] for n in specs if n in bound.arguments}
            given = {n: v for n, v in given.items() if v is not None or n not in optional}
            tensors = _to_tensors(given, keeps_half)
            _check_shapes(tensors, specs)
            checks = values_known()
            if checks and not _TRUSTED.get():
                for name, tensor in tensors.items():
                    _check_finite(name, tensor)
            bound.arguments.update(tensors)
            device = next((tensor.device.type for tensor in tensors.values()), "cpu")
            # The matrix products of autocast have three digits: geometry needs all of them.
            inside = _Inside(0.0 if keeps_half else _half_precision(given)) if checks else _AS_IS
            with inside, torch.autocast(device, enabled=False):
                result = function(*bound.args, **bound.kwargs)
            came_as_tensor = any(isinstance(value, Tensor) for value in given.values())
            return result if came_as_tensor else _to_numpy(result)

        # Code of its own: PyTorch's compiler keeps only a few versions of one code.
        wrapper.__code__ = wrapper.__code__.replace(co_name=function.__name__)
        return cast(F, wrapper)

    return decorate


class _Inside:
    """Within a decorated function values are trusted, and half precision is not forgotten.

    A class, as every call passes here: a generator takes several times as long.
    """

    def __init__(self, precision: float) -> None:
        self.precision = precision

    def __enter__(self) -> None:
        self.trusted = _TRUSTED.set(True)
        self.before = _PRECISION.set(self.precision) if self.precision else None

    def __exit__(self, *_: object) -> None:
        _TRUSTED.reset(self.trusted)
        if self.before is not None:
            _PRECISION.reset(self.before)


def _half_precision(given: dict[str, Any]) -> float:
    """The worst of the arguments that are tensors of half precision; 0 without any."""
    halves = [v.dtype for v in given.values() if isinstance(v, Tensor) and v.dtype in _HALF]
    return max((torch.finfo(dtype).eps for dtype in halves), default=0.0)


def _to_tensors(given: dict[str, Any], keeps_half: bool) -> dict[str, Tensor]:
    """Tensors of one floating type and on one device; tensors keep their graph."""
    device = next((v.device for v in given.values() if isinstance(v, Tensor)), None)
    tensors = {name: _to_tensor(name, value, device) for name, value in given.items()}
    typed = [n for n, value in given.items() if isinstance(value, Tensor | np.ndarray | np.generic)]
    dtypes = {tensors[name].dtype for name in typed or tensors}
    widest = functools.reduce(torch.promote_types, dtypes) if dtypes else None
    if widest in _HALF and not keeps_half and any(isinstance(v, Tensor) for v in given.values()):
        widest = torch.float32
    return {name: tensor.to(widest) for name, tensor in tensors.items()}


def _to_tensor(name: str, value: Any, device: torch.device | None) -> Tensor:
    if isinstance(value, Tensor):
        if value.is_complex():
            fail(name, "real numbers", value.dtype)
        return value if value.is_floating_point() else value.to(torch.get_default_dtype())
    if isinstance(value, list | tuple) and any(isinstance(item, Tensor) for item in value):
        fail(name, "an array or a tensor", "a list of tensors, which torch.stack makes one of")
    _require_unmasked(name, value)
    try:
        array = np.asarray(value)
    except ValueError:  # a ragged list
        fail(name, "an array of numbers", "rows of different lengths")
    if array.dtype.kind not in "fiub":
        fail(name, "an array of numbers", f"dtype {array.dtype}")
    if array.dtype.kind != "f" or array.dtype.itemsize not in (2, 4, 8):
        array = array.astype(np.float64)
    # PyTorch cannot share memory that is read-only, reversed, or in the other byte order.
    if not array.flags.writeable or not array.dtype.isnative or min(array.strides, default=0) < 0:
        array = array.astype(array.dtype.newbyteorder("="), order="C", copy=True)
    return torch.from_numpy(array).to(device)


def _to_numpy(result: Any) -> Any:
    if isinstance(result, Tensor):
        array = result.detach().cpu().numpy()
        return array if array.ndim else array[()]
    if isinstance(result, tuple):
        values = [_to_numpy(item) for item in result]
        return type(result)(*values) if hasattr(result, "_fields") else tuple(values)
    return result


def _check_shapes(tensors: dict[str, Tensor], specs: dict[str, tuple[str, ...]]) -> None:
    sizes: dict[str, tuple[int, str]] = {}  # dimension name -> its size and who set it
    batches: dict[str, tuple[int, ...]] = {}
    for name, tensor in tensors.items():
        spec = specs[name]
        shape = tuple(tensor.shape)
        batched = spec[:1] == ("...",)
        core = spec[1:] if batched else spec
        head = len(shape) - len(core)
        if head < 0 or (head > 0 and not batched):
            fail(name, f"shape {_show(spec)}", f"shape {shape}")
        for dimension, size in zip(core, shape[head:], strict=True):
            if dimension.isdigit():
                if size != int(dimension):
                    fail(name, f"shape {_show(spec)}", f"shape {shape}")
            elif size == 0:
                fail(name, f"shape {_show(spec)} with {dimension} of at least 1", f"shape {shape}")
            elif size != sizes.setdefault(dimension, (size, name))[0]:
                there, other = sizes[dimension]
                fail(name, f"{dimension} = {there} as in {other}", f"shape {shape}")
        if batched:
            batches[name] = shape[:head]
    if len(set(batches.values())) > 1:
        try:
            np.broadcast_shapes(*batches.values())
        except ValueError:
            listing = ", ".join(f"{name} {batch}" for name, batch in batches.items())
            fail(" and ".join(batches), "batch dimensions that broadcast", listing)


def _check_finite(name: str, tensor: Tensor, expected: str = "finite values") -> None:
    # The sum is fast and settles almost all cases; it may overflow where no entry does.
    if bool(torch.isfinite(tensor.detach().sum())) or bool(torch.isfinite(tensor).all()):
        return
    bad = ~torch.isfinite(tensor)
    first = tuple(bad.nonzero()[0].tolist())
    fail(
        name,
        expected,
        f"{int(bad.sum())} of {tensor.numel()} that are not, the first {tensor[first].item()}"
        + (f" at index {first}" if first else ""),
    )


def _show(spec: tuple[str, ...]) -> str:
    return "(" + ", ".join(spec) + ("," if len(spec) == 1 else "") + ")"
