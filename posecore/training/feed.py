"""The three forms in which a training takes its batches, made one: the batch of a step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import torch

from posecore.arrays import fail
from posecore.randomness import generator_at

__all__ = ["Feed"]


class Feed:
    """Gives the batch of each step, in order; its position can be saved and restored.

    Args:
        batches: see `fit`.
        seed: of the generators that a function is given.
        resumable: whether to refuse what cannot go on where it was.

    Raises:
        ValueError: if `batches` is none of the three forms.
    """

    def __init__(self, batches: Any, seed: int, resumable: bool) -> None:
        self.batches, self.seed = batches, seed
        self.stateful = hasattr(batches, "state_dict") and hasattr(batches, "load_state_dict")
        self._iterator: Iterator[Any] | None = None
        self._at: Callable[[int], Any]
        one_batch = isinstance(batches, str | bytes | dict | torch.Tensor)
        if isinstance(batches, Sequence) and len(batches) and not one_batch:
            self._at = lambda step: batches[step % len(batches)]
        elif isinstance(batches, Iterable) and not isinstance(batches, Sequence) and not one_batch:
            if resumable and not self.stateful:
                fail("batches", "state_dict and load_state_dict, to be resumed", repr(batches))
            self._at = self._next
        elif callable(batches) and not one_batch:
            self._at = lambda step: batches(generator_at(seed, step))
        else:
            fail("batches", "a function, a sequence or an iterable of batches", repr(batches)[:80])

    def __call__(self, step: int) -> Any:
        """The batch of this step; of an iterable, the next one."""
        return self._at(step)

    def state_dict(self) -> dict[str, Any]:
        """Where an iterable stands; the others stand at the step."""
        return self.batches.state_dict() if self.stateful else {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        if self.stateful:
            self.batches.load_state_dict(state)
            self._iterator = None

    def _next(self, step: int) -> Any:
        if self._iterator is None:
            self._iterator = iter(self.batches)
        try:
            return next(self._iterator)
        except StopIteration:
            self._iterator = iter(self.batches)  # a round is over
        try:
            return next(self._iterator)
        except StopIteration:
            fail("batches", f"a batch for step {step}", "an iterable that is at its end")
