"""Rounds through a dataset in an order of their own, which can be left and taken up again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import fail, require_integer

__all__ = ["Batches"]


class Batches:
    """Batches in random order, epoch after epoch, without end.

    All that is random in a batch follows from seed, epoch and step alone, so the state is a few
    numbers, and a run that was interrupted goes on bit for bit.

        train = Batches(data.crops, rows, 64, seed=0, size=128, augment=Augmentation())
        for batch in itertools.islice(train, 1000):
            ...

    To go through the data once, in order: `for part in rows.split(64): data.crops(part)`.

    Args:
        make: `make(rows, generator=..., **options)` gives a batch: `Stack.crops` or `frames`.
        rows: (N, ...) what is shuffled along its first dimension and cut into batches.
        batch_size: rows of a batch. What is left over at the end of an epoch is not used in it.
        seed: of order and augmentation.
        options: what `make` takes besides.

    Attributes:
        epoch: the one of the next batch, from 0 on.
        step: how many batches of it are behind.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(
        self, make: Callable[..., Any], rows: Tensor, batch_size: int, *, seed: int, **options: Any
    ) -> None:
        if not callable(make):
            fail("make", "a function such as Stack.crops", repr(make))
        if not isinstance(rows, Tensor) or rows.ndim == 0 or len(rows) == 0:
            fail("rows", "a tensor with at least one row", repr(rows))
        self.batch_size = require_integer("batch_size", batch_size, 1, len(rows))
        self.seed = require_integer("seed", seed, 0)
        self._make, self._rows, self._options = make, rows, options
        self.epoch = self.step = 0

    def __len__(self) -> int:
        """Batches in an epoch."""
        return len(self._rows) // self.batch_size

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        order = torch.randperm(len(self._rows), generator=self._generator(self.epoch))
        chosen = order[self.step * self.batch_size :][: self.batch_size]
        generator = self._generator(self.epoch, self.step + 1)
        batch = self._make(self._rows[chosen], generator=generator, **self._options)
        self.step += 1
        if self.step == len(self):
            self.epoch, self.step = self.epoch + 1, 0
        return batch

    def state_dict(self) -> dict[str, int]:
        """Where in the data the next batch begins, and what that holds for, as plain integers."""
        place = {"epoch": self.epoch, "step": self.step}
        return place | {"rows": len(self._rows), "batch_size": self.batch_size, "seed": self.seed}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on where `state_dict` was called.

        Raises:
            ValueError: if it is the state of other batches: of another seed or batch size, or of
                more or fewer rows.
        """
        own = self.state_dict()
        if not isinstance(state, dict) or state.keys() != own.keys():
            fail("state", "what state_dict gave", repr(state))
        for name in ("rows", "batch_size", "seed"):
            if state[name] != own[name]:
                fail("state", f"{name} {own[name]}", state[name])
        epoch = require_integer("state['epoch']", state["epoch"], 0)
        self.step = require_integer("state['step']", state["step"], 0, len(self) - 1)
        self.epoch = epoch

    def _generator(self, epoch: int, step: int = 0) -> torch.Generator:
        words = np.random.SeedSequence([self.seed, epoch, step]).generate_state(1, np.uint64)
        return torch.Generator().manual_seed(int(words[0] >> np.uint64(1)))
