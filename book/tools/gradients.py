"""The gradient that comes out at the far end of what a student's function made."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["gradient_at_leaf"]


def gradient_at_leaf(value: Tensor) -> Tensor | None:
    """The gradient of a number at the one leaf that it comes from, None if it comes from none.

    A student's function gets copies of its arguments, which only the graph still knows.

    Args:
        value: () or a tensor of one element.
    """
    nodes, seen = [value.grad_fn], set()
    while nodes:
        node = nodes.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        if hasattr(node, "variable"):
            return torch.autograd.grad(value, node.variable)[0]
        nodes += [following for following, _ in node.next_functions]
    return None
