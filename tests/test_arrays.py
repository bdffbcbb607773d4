"""The calling convention: what comes in, what goes out, what is refused and in which words."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from torch import Tensor

from posecore.arrays import (
    array_function,
    fail,
    require_choice,
    require_finite,
    require_integer,
    require_number,
    to_numbers,
    trusted,
    values_known,
)


@array_function(a="... N 3", b="... N", c="M 2")
def f(a: Tensor, b: Tensor | None = None, c: Tensor | None = None) -> Tensor:
    """Something that uses whatever it is given."""
    assert all(isinstance(x, Tensor) for x in (a, b, c) if x is not None)
    total = a.sum(-1)
    total = total if b is None else total * b
    return total if c is None else total * c.sum()


class Pair(NamedTuple):
    """A named result."""

    first: object
    second: object


@array_function(x="...")
def double(x: Tensor) -> Tensor:
    """Any shape."""
    return 2 * x


# Kinds of input -------------------------------------------------------------------------------


def test_arrays_give_arrays_and_tensors_tensors() -> None:
    a = np.arange(12.0).reshape(2, 2, 3)
    assert isinstance(f(a), np.ndarray)
    assert np.array_equal(f(a), a.sum(-1))
    out = f(torch.from_numpy(a))
    assert isinstance(out, Tensor)
    assert np.array_equal(out.numpy(), a.sum(-1))
    assert np.array_equal(f(a.tolist()), a.sum(-1))


def test_one_tensor_makes_the_result_a_tensor() -> None:
    assert isinstance(f(np.ones((2, 3)), torch.ones(2)), Tensor)
    assert isinstance(f(torch.ones(2, 3), [1, 2]), Tensor)


def test_a_result_without_dimensions_is_a_numpy_scalar() -> None:
    out = double(3.0)
    assert isinstance(out, np.float64)
    assert out == 6


@pytest.mark.parametrize("kind", [Pair, lambda a, b: (a, b)])
def test_tuples_keep_their_kind(kind: Callable) -> None:
    @array_function(x="N")
    def split(x: Tensor, label: str = "kept") -> tuple:
        return kind((x.sum(), x), label)

    (total, values), label = split([1.0, 2.0])
    assert type(split([1.0])) is type(kind(0, 0))
    assert isinstance(total, np.float64)
    assert isinstance(values, np.ndarray)
    assert label == "kept"
    assert isinstance(split(torch.ones(2))[0][1], Tensor)


@given(
    hnp.arrays(
        st.sampled_from([np.float16, np.float32, np.float64]),
        (4, 3),
        elements=st.floats(-8, 8, width=16),
    ),
    st.sampled_from(["as is", "read only", "big endian", "reversed", "columns", "every other"]),
)
def test_any_memory_layout_is_read_right(a: np.ndarray, layout: str) -> None:
    given = {
        "as is": a,
        "read only": a.copy(),
        "big endian": a.astype(a.dtype.newbyteorder(">")),
        "reversed": a[::-1, ::-1],
        "columns": np.asfortranarray(a),
        "every other": np.repeat(a, 2, axis=0)[::2],
    }[layout]
    given.flags.writeable = layout != "read only"
    kept = given.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        out = double(given)
    assert out.dtype == a.dtype
    assert np.array_equal(out, 2 * given)
    assert np.array_equal(given, kept)
    out[...] = 0
    assert np.array_equal(given, kept)


def test_precision_is_promoted_to_the_widest() -> None:
    a32, b64 = np.ones((2, 3), np.float32), np.ones(2)
    assert f(a32).dtype == np.float32
    assert f(a32, b64).dtype == np.float64
    assert f(torch.ones(2, 3), torch.ones(2)).dtype == torch.float32
    assert f(torch.ones(2, 3), torch.ones(2, dtype=torch.float64)).dtype == torch.float64
    assert f(torch.ones(2, 3, dtype=torch.bfloat16), torch.ones(2)).dtype == torch.float32


def test_lists_and_numbers_take_the_precision_beside_them() -> None:
    single = np.ones((2, 3), np.float32)
    assert f(single, [1.0, 2.0]).dtype == np.float32
    assert f(torch.ones(2, 3), [1, 2]).dtype == torch.float32
    assert f([[1, 2, 3]], np.ones(1, np.float32)).dtype == np.float32
    assert f([[1, 2, 3]], [1]).dtype == np.float64
    assert f(single, np.ones(2)).dtype == np.float64


@pytest.mark.parametrize("dtype", [bool, np.int8, np.uint8, np.int64, np.uint64, np.longdouble])
def test_other_numbers_become_float64(dtype: type) -> None:
    out = double(np.ones(3, dtype))
    assert out.dtype == np.float64
    assert out.tolist() == [2, 2, 2]
    assert double([1, 2]).dtype == np.float64


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.int64])
def test_integer_tensors_become_the_default_float(dtype: torch.dtype) -> None:
    assert double(torch.ones(3, dtype=dtype)).dtype == torch.get_default_dtype()


def test_gradients_flow_through() -> None:
    a = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    b = torch.randn(2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(f, (a, b))
    single = torch.ones(2, 3, requires_grad=True)
    f(single, np.ones(2)).sum().backward()  # also through a change of precision
    assert torch.equal(single.grad, torch.ones(2, 3))


def test_a_gradient_does_not_stop_an_array_result() -> None:
    weight = torch.ones(3, requires_grad=True)

    @array_function(x="3")
    def with_weight(x: Tensor) -> Tensor:
        return x.float() * weight

    assert with_weight([1, 2, 3]).tolist() == [1, 2, 3]


def test_arguments_may_be_named_and_defaults_are_kept() -> None:
    a = np.ones((2, 3))
    assert f(a=a, b=None).tolist() == [3, 3]
    assert f(b=[1, 2], a=a).tolist() == [3, 6]
    assert f(a, c=[[1, 1]]).tolist() == [6, 6]
    assert f.__name__ == "f"
    assert "uses whatever" in f.__doc__


def test_other_arguments_pass_untouched() -> None:
    marker = object()

    @array_function(x="N")
    def second(x: Tensor, other: object) -> object:
        return other

    assert second([1], marker) is marker


def test_a_wrong_declaration_fails_at_once() -> None:
    with pytest.raises(TypeError, match="no argument"):
        array_function(y="N")(lambda x: x)
    with pytest.raises(TypeError):
        f()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_single(dtype: torch.dtype) -> None:
    a = torch.rand(2, 3, generator=torch.Generator().manual_seed(0)).to(dtype).requires_grad_()
    out = f(a)
    assert out.dtype == torch.float32
    assert torch.equal(out, a.float().sum(-1))
    out.sum().backward()
    assert a.grad.dtype == dtype
    assert f(np.ones((2, 3), np.float32), torch.ones(2, dtype=dtype)).dtype == torch.float32

    @array_function(keeps_half=True, a="... 3")
    def moved(a: Tensor) -> Tensor:
        return a.flip(-1)

    assert moved(a).dtype == dtype
    assert to_numbers("a", a).dtype == np.float64


# Values that are trusted ------------------------------------------------------------------------


@array_function(x="N")
def outer(x: Tensor, y: object) -> Tensor:
    return x.sum() + f(y).sum()


def test_what_our_own_functions_call_is_not_looked_at_again() -> None:
    bad, fine = torch.tensor([[np.nan, 0, 0]]), torch.ones(1, 3)
    assert np.isnan(outer([1.0], bad))
    with pytest.raises(ValueError, match="^a: expected shape"):  # shapes are
        outer([1.0], fine[:, :2])
    with pytest.raises(ValueError, match="^x: expected finite"):
        outer([np.nan], fine)
    with pytest.raises(ValueError, match="^a: expected finite"):  # also after one that failed
        f(bad)


def test_trusted_values_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    kept = torch.isfinite
    monkeypatch.setattr(torch, "isfinite", lambda x: seen.append(x) or kept(x))
    f(torch.ones(1, 3), torch.ones(1))
    assert len(seen) == 2
    with trusted():
        f(torch.ones(1, 3), torch.ones(1))
        with trusted():
            pass
        f(torch.ones(1, 3))
        with pytest.raises(ValueError, match="^a: expected shape"):
            f(torch.ones(1, 2))
    assert len(seen) == 2
    f(torch.ones(1, 3))
    assert len(seen) == 3


def test_what_is_computed_is_refused_by_name() -> None:
    require_finite("depth", torch.ones(3))
    with pytest.raises(ValueError, match=r"^depth: expected depths, got 1 of 2 .* inf at index"):
        require_finite("depth", torch.tensor([1, np.inf]), "depths")
    with trusted(), pytest.raises(ValueError, match="^depth: expected finite values"):
        require_finite("depth", torch.tensor(np.nan))


@pytest.mark.slow
def test_transforms_see_no_values() -> None:
    bad = torch.tensor([[np.nan, 0, 0], [1, 2, 3]])
    assert values_known()
    for transformed in (
        torch.func.vmap(lambda x: f(x[None])[0]),
        torch.func.vmap(lambda x: outer(x, x[None])),
        torch.compile(f, fullgraph=True, backend="eager"),
        torch.compile(lambda x: outer(x[0], x), fullgraph=True, backend="eager"),
    ):
        assert torch.isnan(transformed(bad)).any()
    J = torch.func.jacrev(f)(bad[1:])
    assert J.flatten().tolist() == [1, 1, 1]
    for transform in (torch.func.vmap, lambda g: torch.compile(g, fullgraph=True, backend="eager")):
        with pytest.raises(Exception, match="a: expected shape"):  # shapes are known
            transform(lambda x: f(x[None, :2]))(bad if transform is torch.func.vmap else bad[0])
    assert values_known()


# Shapes ---------------------------------------------------------------------------------------


@given(
    st.lists(st.integers(0, 3), max_size=3),
    st.lists(st.integers(0, 3), max_size=3),
    st.integers(1, 4),
)
def test_batches_broadcast_as_numpy_has_it(one: list[int], two: list[int], n: int) -> None:
    a, b = np.ones((*one, n, 3)), np.ones((*two, n))
    try:
        batch = np.broadcast_shapes(one, two)
    except ValueError:
        with pytest.raises(ValueError, match=r"^a and b: expected batch dimensions that broadcast"):
            f(a, b)
    else:
        assert f(a, b).shape == (*batch, n)


def test_empty_batches_pass_and_empty_clouds_do_not() -> None:
    assert f(np.ones((0, 5, 3))).shape == (0, 5)
    assert f(np.ones((0, 5, 3)), np.ones(5)).shape == (0, 5)
    with pytest.raises(
        ValueError, match=r"^a: expected shape \(..., N, 3\) with N of at least 1, got"
    ):
        f(np.ones((4, 0, 3)))


def test_exact_shapes_have_no_batch() -> None:
    @array_function(K="3 3", x="2")
    def exact(K: Tensor, x: Tensor) -> Tensor:
        return K[:2, :2] @ x

    assert exact(np.eye(3), [1, 2]).tolist() == [1, 2]
    for K in (np.ones((1, 3, 3)), np.ones(3), np.ones((3, 2))):
        with pytest.raises(ValueError, match=r"^K: expected shape \(3, 3\), got shape"):
            exact(K, [1, 2])
    with pytest.raises(ValueError, match=r"^x: expected shape \(2,\), got shape \(3,\)"):
        exact(np.eye(3), [1, 2, 3])


def test_autocast_does_not_round() -> None:
    a = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))

    @array_function(a="... N 3")
    def gram(a: Tensor) -> Tensor:
        return a @ a.mT

    with torch.autocast("cpu", dtype=torch.bfloat16):
        rounded = a @ a.mT
        exact = gram(a)
    assert rounded.dtype == torch.bfloat16
    assert exact.dtype == torch.float32
    assert torch.equal(exact, a @ a.mT)


def test_finite_values_whose_sum_is_not_pass() -> None:
    large = np.full((4, 3), np.finfo(np.float64).max / 2)
    assert np.array_equal(double(large), 2 * large)


NAN = np.zeros((2, 2, 3))
NAN[0, 1, 2] = np.nan
NAN[1, 0, 0] = -np.inf

BAD = [
    (lambda: f(np.ones(3)), r"a: expected shape \(..., N, 3\), got shape \(3,\)$"),
    (lambda: f(np.ones((2, 4))), r"a: expected shape \(..., N, 3\), got shape \(2, 4\)$"),
    (lambda: f(5), r"a: .*shape \(\)$"),
    (lambda: f([]), r"a: .*shape \(0,\)$"),
    (lambda: f(np.ones((2, 3)), np.ones(3)), r"b: expected N = 2 as in a, got shape \(3,\)$"),
    (lambda: f(np.ones((2, 3)), c=np.ones((1, 4, 2))), r"c: expected shape \(M, 2\), got"),
    (lambda: f(np.ones((2, 3)), c=np.ones((0, 2))), r"c: expected .*M of at least 1"),
    (lambda: f([[1, 2, 3], [4, 5]]), "a: .* got rows of different lengths$"),
    (lambda: f("points"), "a: expected an array of numbers, got dtype <U6$"),
    (lambda: f([["1", "2", "3"]]), "a: expected an array of numbers, got dtype <U1$"),
    (lambda: f(np.ones((2, 3), complex)), "a: expected an array of numbers, got dtype complex128$"),
    (lambda: f(torch.ones(2, 3, dtype=torch.complex64)), "a: expected real numbers, got"),
    (lambda: f([[1, 2, None]]), "a: expected an array of numbers, got dtype object$"),
    (lambda: f(None), "a: expected an array of numbers, got dtype object$"),
    (lambda: f([torch.ones(3)] * 2), "a: .* got a list of tensors, which torch.stack makes one of"),
    (lambda: f({"x": 1}), "a: expected an array of numbers, got dtype object$"),
    (lambda: f(np.array([["2020-01-01"] * 3], "M8[D]")), "a: .* of numbers, got dtype"),
    (lambda: f(NAN), r"a: .*, got 2 of 12 .* the first nan at index \(0, 1, 2\)$"),
    (lambda: f(torch.from_numpy(NAN)[1]), r"a: .* 1 of 6 .* -inf at index \(0, 0\)$"),
    (lambda: f(np.ones((1, 3)), [np.inf]), r"b: .*the first inf at index \(0,\)$"),
    (lambda: double(np.nan), "x: expected finite values, got 1 of 1 that are not, the first nan$"),
    (lambda: fail("x", "a", "b"), "x: expected a, got b$"),
    (lambda: require_choice("way", "Up", ["up", "out"]), "way: .* one of 'up', 'out', got 'Up'$"),
    (lambda: require_choice("way", None, ["up"]), "way: expected one of 'up', got None$"),
    (lambda: require_integer("k", 2.0), "k: expected an integer, got 2.0$"),
    (lambda: require_integer("k", True), "k: expected an integer, got True$"),
    (lambda: require_integer("k", np.True_), "k: expected an integer, got "),
    (lambda: require_integer("k", "3"), "k: expected an integer, got '3'$"),
    (lambda: require_integer("k", None, 1), "k: expected an integer of at least 1, got None$"),
    (lambda: require_integer("k", 0, 1), "k: expected an integer of at least 1, got 0$"),
    (lambda: require_integer("k", 4, high=3), "k: expected an integer of at most 3, got 4$"),
    (lambda: require_integer("k", 4, 1, 3), "k: expected an integer between 1 and 3, got 4$"),
    (lambda: require_number("s", "wide"), "s: expected a finite number, got 'wide'$"),
    (lambda: require_number("s", "2"), "s: expected a finite number, got '2'$"),
    (lambda: require_number("s", True), "s: expected a finite number, got True$"),
    (lambda: require_number("s", None), "s: expected a finite number, got None$"),
    (lambda: require_number("s", [1, 2]), r"s: expected a finite number, got \[1, 2\]$"),
    (lambda: require_number("s", np.nan), "s: expected a finite number, got nan$"),
    (lambda: require_number("s", np.inf, 0), "s: expected a finite number of at least 0, got inf$"),
    (lambda: require_number("s", 1.5, 0, 1), "s: .* number between 0 and 1, got 1.5$"),
    (lambda: require_number("s", 0, above=0), "s: expected a finite number above 0, got 0.0$"),
    (lambda: require_number("s", 2, high=1, above=0), "s: .* above 0 of at most 1, got 2.0$"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input(call: Callable, message: str) -> None:
    with pytest.raises(ValueError, match=r"^" + message):
        call()


# Single values --------------------------------------------------------------------------------


@given(st.sampled_from("abcde"), st.sets(st.sampled_from("abcde"), min_size=1))
def test_choices_pass_and_others_do_not(value: str, choices: set[str]) -> None:
    if value in choices:
        require_choice("way", value, sorted(choices))
    else:
        with pytest.raises(ValueError, match=f"^way: expected one of .*, got '{value}'$"):
            require_choice("way", value, sorted(choices))


@given(st.text(max_size=9), st.text(max_size=9), st.one_of(st.none(), st.integers(), st.text()))
def test_fail_says_all_it_is_given(name: str, expected: str, got: object) -> None:
    with pytest.raises(ValueError) as caught:
        fail(name, expected, got)
    assert str(caught.value) == f"{name}: expected {expected}, got {got}"


@given(
    hnp.arrays(
        st.sampled_from([np.float32, np.int16, np.float64]), (3, 2), elements=st.integers(-9, 9)
    )
)
def test_numbers_of_any_kind_become_float64(a: np.ndarray) -> None:
    for kind in (a, a.tolist(), torch.from_numpy(a), torch.from_numpy(a).double().requires_grad_()):
        out = to_numbers("a", kind)
        assert out.dtype == np.float64
        assert np.array_equal(out, a)
    for bad in ([[1], [1, 2]], ["1"], [None], np.ones(2, bool), 1j):
        with pytest.raises(ValueError, match="^a: expected an array of numbers"):
            to_numbers("a", bad)


@given(st.integers(-10, 10), st.integers(-10, 10), st.integers(-10, 10))
def test_integers_between_bounds_pass(value: int, low: int, high: int) -> None:
    if low <= value <= high:
        for kind in (int, np.int16, np.int64):
            number = require_integer("k", kind(value), low, high)
            assert number == value
            assert type(number) is int
    else:
        with pytest.raises(ValueError, match=r"^k: "):
            require_integer("k", value, low, high)


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-10, 10))
def test_numbers_between_bounds_pass(value: float, low: float, high: float) -> None:
    if low <= value <= high:
        number = require_number("s", value, low, high)
        assert number == value
        assert type(number) is float
    else:
        with pytest.raises(ValueError, match=r"^s: "):
            require_number("s", value, low, high)
    if value > low:
        assert require_number("s", value, above=low) == value
    else:
        with pytest.raises(ValueError, match=r"^s: "):
            require_number("s", value, above=low)


def test_numbers_of_other_kinds() -> None:
    for value in (2, np.float32(2), torch.tensor(2.0), np.array(2)):
        assert require_number("s", value) == 2


def test_choices() -> None:
    require_choice("way", "up", ("up", "out"))
    require_choice("way", None, (None, 1))
