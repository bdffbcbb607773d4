"""Muon: for convolutions that start from nothing, a step in all directions that a kernel has."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_number

__all__ = ["Muon", "orthogonal"]

QUINTIC = (3.4445, -4.7750, 2.0315)
"""Of the iteration, by Jordan et al.: fast, and singular values end near 1, not at 1."""


class Muon(torch.optim.Optimizer):
    """Muon for the kernels of convolutions, Adam for all else: biases, norms, output layers.

    A kernel is a matrix, outputs by inputs. Its averaged gradient has a few large singular values
    and many small ones; the step has the same singular vectors and all values near one, so that
    what only a faint gradient asks for is learned as fast. Steps have the size of Adam's, so a
    learning rate that suits Adam does here.

    The method is by Jordan et al. ("Muon: an optimizer for hidden layers in neural networks",
    2024), the size of its steps by Liu et al. ("Muon is scalable for LLM training", 2025).
    `torch.optim.Muon` takes plain matrices only, and nothing else beside them.

    Args:
        params: parameters, or groups of them, as every optimiser takes them.
        lr: the learning rate.
        momentum: of the kernels.
        betas, eps: of Adam.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        params: Iterable[Any],
        lr: float = 4e-3,
        momentum: float = 0.95,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        require_number("lr", lr, 0)
        for name, value in (("momentum", momentum), ("betas[0]", betas[0]), ("betas[1]", betas[1])):
            if require_number(name, value, 0, 1) == 1:
                fail(name, "a number below 1", value)
        require_number("eps", eps, above=0)
        super().__init__(params, {"lr": lr, "momentum": momentum, "betas": betas, "eps": eps})

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """One step for all parameters that have a gradient."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    move = _muon if parameter.ndim > 2 else _adam
                    move(parameter, self.state[parameter], group)
        return loss


def _muon(kernel: nn.Parameter, state: dict[str, Any], group: dict[str, Any]) -> None:
    if not state:
        state["mean"] = torch.zeros_like(kernel)
    mean, momentum = state["mean"].lerp_(kernel.grad, 1 - group["momentum"]), group["momentum"]
    ahead = kernel.grad.lerp(mean, momentum).flatten(1)  # Nesterov's
    # The entries of an orthogonal matrix have a root mean square of one over the root of its longer
    # side; Adam's steps have one of about 0.2.
    size = 0.2 * max(ahead.shape) ** 0.5
    kernel.add_(orthogonal(ahead).reshape(kernel.shape), alpha=-group["lr"] * size)


def _adam(parameter: nn.Parameter, state: dict[str, Any], group: dict[str, Any]) -> None:
    if not state:
        state |= {
            "step": 0,
            "mean": torch.zeros_like(parameter),
            "square": torch.zeros_like(parameter),
        }
    state["step"] += 1
    one, two = group["betas"]
    mean = state["mean"].lerp_(parameter.grad, 1 - one)
    square = state["square"].lerp_(parameter.grad.square(), 1 - two)
    root = (square / (1 - two ** state["step"])).sqrt_().add_(group["eps"])
    parameter.addcdiv_(mean, root, value=-group["lr"] / (1 - one ** state["step"]))


def orthogonal(matrix: Tensor, iterations: int = 5) -> Tensor:
    """A matrix with the same singular vectors, and singular values near one: 0.7 to 1.2.

    Newton and Schulz's iteration, of which each round is a few products of matrices. Values far
    below the largest, by a factor of 1000, stay smaller.

    Args:
        matrix: (m, n).
        iterations: rounds.

    Returns:
        (m, n); zeros for zeros.
    """
    a, b, c = QUINTIC
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / (x.norm() + 1e-12)
    for _ in range(iterations):
        gram = x @ x.T
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x.T if tall else x
