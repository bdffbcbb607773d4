"""Differences in words: kinds, shapes, values, and how values are printed."""

from collections import namedtuple
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from book.tools.values import difference, show

Pair = namedtuple("Pair", "R t")
finite = st.floats(-1e6, 1e6)
arrays = hnp.arrays(np.float64, hnp.array_shapes(max_dims=3, max_side=4), elements=finite)
results = st.recursive(
    arrays | arrays.map(torch.from_numpy) | finite | st.booleans() | st.none() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.tuples(inner, inner)
        | st.dictionaries(st.text(), inner, max_size=3)
    ),
    max_leaves=4,
)


class Evil:
    def __repr__(self) -> str:
        raise RuntimeError


@given(results)
def test_a_result_agrees_with_itself(value: Any) -> None:
    assert difference(value, value, 0.0) == ""


@given(results, results)
def test_words_are_one_line_and_never_raise(got: Any, expected: Any) -> None:
    words = difference(got, expected, 1e-6)
    assert "\n" not in words and "\n" not in show(got) and len(words) < 400
    assert not words or difference(expected, got, 0.0)


@given(arrays, st.data())
def test_one_wrong_entry_is_found(expected: np.ndarray, data: st.DataObject) -> None:
    index = data.draw(st.tuples(*(st.integers(0, n - 1) for n in expected.shape)))
    got = expected.copy()
    got[index] += 1e-3 * (1 + abs(expected[index]))
    words = difference(got, expected, 1e-4)
    assert words.startswith("expected ")
    if expected.size > 9:
        place = ", ".join(map(str, index))
        assert f" at [{place}], got " in words
        assert words.endswith(f"(1 of {expected.size} entries differ)")
    assert difference(got, expected, 1e-2) == ""


@pytest.mark.parametrize(
    ("got", "expected", "words"),
    [
        (1.0, 2.0, "expected 2, got 1"),
        (1.0 + 1e-8, 1.0, "expected 1, got 1.00000001"),
        (float("nan"), 1.0, "expected 1, got nan"),
        (1.0, float("nan"), "expected nan, got 1"),
        (float("inf"), -float("inf"), "expected -inf, got inf"),
        (3, 4, "expected 4, got 3"),
        (1.0, -3.88578e-16, "expected 0, got 1"),
        (-0.0, 1.0, "expected 1, got 0"),
        (2e-9, -0.0, "expected 0, got 2e-09"),
        (np.float32(0.1), 0.25, "expected 0.25, got 0.1"),
        (np.float32(0.1) + np.float32(1e-7), np.float32(0.1), "expected 0.1, got 0.1000001"),
        (3.0, 3, "expected whole numbers, got real numbers"),
        (3, 3.5, "expected 3.5, got 3"),
        (1j, 1.0, "expected a number, got a complex number"),
        (True, 1.0, "expected a number, got true or false"),
        (True, False, "expected False, got True"),
        ("a", "b", "expected 'b', got 'a'"),
        (None, 1.0, "expected a number, got nothing (None)"),
        (1.0, None, "expected nothing (None), got a number"),
        (np.zeros(1), 0.0, "expected a number, got an array of shape (1,)"),
        ([1.0], np.ones(1), "expected an array of shape (1,), got a list"),
        (torch.ones(2), np.ones(2), "expected an array of shape (2,), got a tensor of shape (2,)"),
        (1.0, torch.tensor(1.0), "expected a tensor, got a number"),
        (torch.ones(1), torch.tensor(1.0), "expected shape (), got shape (1,)"),
        (np.ones((3, 2)), np.ones((2, 3)), "expected shape (2, 3), got shape (3, 2)"),
        (np.ones(2), np.array([True, True]), "expected true and false, got real numbers"),
        (np.ones(2), np.ones(2, int), "expected whole numbers, got real numbers"),
        (np.ones(2) * 1j, np.ones(2), "expected real numbers, got dtype complex128"),
        (np.array([1, "a"], object), np.ones(2), "expected real numbers, got dtype object"),
        (
            np.array([1.0, 2.5]),
            np.array([1.0, 2.0]),
            "expected array (2,) [1., 2.], got array (2,) [1., 2.5]",
        ),
        (
            np.array([1.0, 2 + 1e-6]),
            np.array([1.0, 2.0]),
            "expected 2 at [1], got 2.000001 (1 of 2 entries differ)",
        ),
        (
            np.arange(12).reshape(3, 4) % 11,
            np.arange(12).reshape(3, 4),
            "expected 11 at [2, 3], got 0 (1 of 12 entries differ)",
        ),
        (10**8, 10**8 + 1, "expected 100000001, got 100000000"),
        (2**63 - 1, 2**63 - 2, f"expected {2**63 - 2}, got {2**63 - 1}"),
        (
            np.arange(10) > 4,
            np.arange(10) > 3,
            "expected True at [4], got False (1 of 10 entries differ)",
        ),
        (
            np.eye(3),
            np.array([[-1, 0, 0], [0, -1, 1e-17], [0, 0, 1.0]]),
            "expected array (3, 3) [[-1., 0., 0.], [0., -1., 0.], [0., 0., 1.]], "
            "got array (3, 3) [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]",
        ),
        (
            np.ones((4, 4)),
            np.ones((4, 4)) - np.eye(4) * (1 - 1e-16),
            "expected 0 at [0, 0], got 1 (4 of 16 entries differ)",
        ),
        ((1.0,), (1.0, 2.0), "expected a tuple of 2, got 1"),
        ((1.0, 3.0), (1.0, 2.0), "in result [1] expected 2, got 3"),
        ([1.0, "a"], [1.0, 2.0], "in result [1] expected a number, got text"),
        ({"a": 1}, {"b": 1}, "expected a dict with ['b'], got ['a']"),
        ({"a": (1.0, 2.0)}, {"a": (1.0, 3.0)}, "in result ['a'] in result [1] expected 3, got 2"),
        ({1}, {2}, "expected {2}, got {1}"),
        (iter(()), 1.0, "expected a number, got an object of type tuple_iterator"),
    ],
)
def test_words(got: Any, expected: Any, words: str) -> None:
    assert difference(got, expected, 1e-9) == words


@pytest.mark.parametrize(
    ("got", "expected"),
    [
        (1, 1.0),
        (np.float32(1), 1.0),
        (np.array(1.0), 1.0),
        (torch.tensor(1.0), np.float64(1)),
        (np.ones(2, np.int64), np.ones(2)),
        (np.ones(2, np.float32), np.ones(2)),
        (np.ones(2, np.uint8), np.ones(2, np.int64)),
        (torch.ones(2, dtype=torch.bfloat16), torch.ones(2)),
        (torch.ones(2, requires_grad=True), torch.ones(2)),
        (np.array([np.nan, np.inf]), np.array([np.nan, np.inf])),
        ((np.eye(3), np.ones(3)), Pair(np.eye(3), np.ones(3))),
        (np.bool_(True), True),
        (np.zeros((0, 3)), np.zeros((0, 3))),
    ],
)
def test_these_agree(got: Any, expected: Any) -> None:
    assert difference(got, expected, 1e-9) == ""


def test_tolerance_is_absolute_and_relative() -> None:
    for expected in (0.0, 1.0, 1000.0):
        edge = 1e-3 * (1 + expected)
        assert difference(expected + 0.99 * edge, expected, 1e-3) == ""
        assert difference(expected + 1.01 * edge, expected, 1e-3) != ""


def test_without_a_tolerance_only_kinds_and_shapes_are_compared() -> None:
    assert difference((np.ones(3), 1.0), (np.zeros(3), np.nan), None) == ""
    assert difference("one", "two", None) == ""
    assert difference(np.ones(2), np.zeros(3), None) == "expected shape (3,), got shape (2,)"
    assert difference(1.5, 1, None) == "expected whole numbers, got real numbers"
    assert difference([1], (1,), None) == "expected a tuple, got a list"


def test_compare_as_comes_after_kind_and_shape() -> None:
    q = np.array([0.6, -0.8, 0.0, 0.0])
    assert difference(-q, q, 1e-9) != ""
    assert difference(-q, q, 1e-9, np.abs) == ""
    assert difference(q[:3], q, 1e-9, np.abs) == "expected shape (4,), got shape (3,)"
    assert difference(2 * q, q, 1e-9, np.sum) == "expected -0.2, got -0.4"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1 + 0.2, "0.3"),
        (np.float32(2), "2"),
        (torch.tensor(3), "3"),
        (np.zeros((100, 3)), "array (100, 3) [[0., ..., 0.], ..., [0., ..., 0.]]"),
        (torch.ones(2), "tensor (2,) [1., 1.]"),
        (np.full(2, 0.1, np.float32), "array (2,) [0.1, 0.1]"),
        (torch.tensor([0.1, -0.0]), "tensor (2,) [0.1, 0.]"),
        (
            np.array([640.25, 1e-4, -1e9, np.nan, np.inf]),
            "array (5,) [640.25, 0.0001, -1e+09, nan, inf]",
        ),
        (np.array([1.0, np.cos(np.pi / 2)]), "array (2,) [1., 0.]"),
        (np.array([0.00123456, 0.123456, 12.3456]), "array (3,) [0.001235, 0.1235, 12.3456]"),
        (np.array([1, -20]), "array (2,) [1, -20]"),
        (np.array([True, False]), "array (2,) [True, False]"),
        (np.zeros((0, 3)), "array (0, 3) []"),
        ([np.float32(0.1), -0.0], "[0.1, 0]"),
        ({"t": np.full(2, 0.1, np.float32), 3: 0.1 + 0.2}, "{'t': array (2,) [0.1, 0.1], 3: 0.3}"),
        ((1, 2.5), "(1, 2.5)"),
        ((1,), "(1,)"),
        ([1, 2, 3, 4, 5], "[1, 2, 3, 4, ...]"),
        (np.mean, "mean"),
        (int, "int"),
        ("x" * 200, "'" + "x" * 116 + "..."),
        (Evil(), "an instance of Evil"),
    ],
)
def test_show(value: Any, text: str) -> None:
    assert show(value) == text


def test_a_rotation_is_shown_whole() -> None:
    R = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]) + 1.5e-5
    whole = "[[0.36, 0.48, -0.8], [-0.8, 0.6, 0.], [0.48, 0.64, 0.6]]"
    assert show(R) == "array (3, 3) " + whole.replace("0.]", "1.5e-05]")
    R32 = (R - 1.5e-5).astype(np.float32)
    assert (
        show(R32) == f"array (3, 3) {whole}" and show(torch.tensor(R32)) == f"tensor (3, 3) {whole}"
    )
    assert show(np.full((2, 5), -0.1)) == "array (2, 5) [[-0.1, ..., -0.1], [-0.1, ..., -0.1]]"
