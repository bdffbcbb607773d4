import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_tools.batches.indices import to_indices, to_integers


@given(st.lists(st.integers(0, 99), min_size=1))
def test_all_kinds_of_integers(values):
    for given_ in (values, torch.tensor(values), np.array(values, np.int32), tuple(values)):
        assert to_integers("rows", given_).tolist() == values
        assert to_indices("rows", given_, 100).tolist() == values
    assert to_indices("rows", values, 100).dtype == torch.int64


@pytest.mark.parametrize("value", [7, np.int64(7), np.uint8(7), torch.tensor(7), np.array(7)])
def test_one_integer(value):
    assert to_integers("rows", value).tolist() == 7


def test_none_at_all():
    assert to_integers("rows", []).tolist() == to_integers("rows", torch.tensor([])).tolist() == []


BAD = [
    lambda: to_integers("rows", "cat"),
    lambda: to_integers("rows", [0.5]),
    lambda: to_integers("rows", 0.5),
    lambda: to_integers("rows", [[1], [2, 3]]),
    lambda: to_integers("rows", torch.ones(3)),
    lambda: to_indices("rows", [], 4),
    lambda: to_indices("rows", 3, 4),
    lambda: to_indices("rows", [4], 4),
    lambda: to_indices("rows", [-1], 4),
    lambda: to_indices("rows", [True], 4),
]


@pytest.mark.parametrize("call", BAD)
def test_bad_input(call):
    with pytest.raises(ValueError, match="^rows"):
        call()
