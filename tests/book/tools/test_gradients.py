"""The gradient that a check looks at is that of the argument, which it does not have."""

import copy

import torch

from book.tools.gradients import gradient_at_leaf


def test_the_gradient_is_that_of_a_copy_nobody_kept():
    x = torch.tensor([1.0, 2, 3], requires_grad=True)
    value = (copy.deepcopy(x) ** 2).sum() + 0
    assert gradient_at_leaf(value).tolist() == [2, 4, 6]
    assert x.grad is None


def test_what_comes_twice_counts_twice():
    x = torch.tensor([1.0, 2], requires_grad=True)
    assert gradient_at_leaf((x * x.flip(0)).sum() + x[0]).tolist() == [5, 2]


def test_without_a_way_back_there_is_none():
    x = torch.tensor(2.0, requires_grad=True)
    assert gradient_at_leaf(x.detach() ** 2) is None
    assert gradient_at_leaf(torch.tensor(1.0)) is None
