"""The batches of a training: a sequence that follows from its seed, and can be taken up again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from posecore.arrays import fail, require_integer
from posecore.randomness import generator_at

__all__ = ["Batches"]


class Batches:
    """Batches, all of whose random numbers follow from seed and step alone.

    So the state is a few integers, and a run that was interrupted goes on bit for bit. A batch is
    either drawn by a function, or of rows that are shuffled, epoch after epoch:

        drawn = Batches(crops.draw, batch_size=32, steps=1000, seed=0)
        shuffled = Batches(data.crops, rows, 64, seed=0, size=128, augment=Augmentation())

    To go through the data once, in order: `for part in rows.split(64): data.crops(part)`.

    Args:
        make: gives a batch: `make(batch_size, generator=..., **options)`, such as
            `RandomCrops.draw`; with rows `make(rows, generator=..., **options)`, such as
            `Stack.crops` or `frames`.
        rows: (N, ...) what is shuffled along its first dimension and cut into batches; None for
            none.
        batch_size: of each batch; of rows those left over at the end of an epoch are not used.
            None, without rows, for a `make` that is told no size.
        steps: batches in all; None for no end. If it is given, a batch that is a dict also has
            "done", (), the part of the training that is behind.
        seed: of order and augmentation.
        options: what `make` takes besides.

    Attributes:
        step: how many batches are behind.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(
        self,
        make: Callable[..., Any],
        rows: Tensor | None = None,
        batch_size: int | None = None,
        *,
        seed: int,
        steps: int | None = None,
        **options: Any,
    ) -> None:
        if not callable(make):
            fail("make", "a function such as Stack.crops", repr(make))
        if rows is None and batch_size is not None:
            batch_size = require_integer("batch_size", batch_size, 1)
        if rows is not None:
            if not isinstance(rows, Tensor) or rows.ndim == 0 or len(rows) == 0:
                fail("rows", "a tensor with at least one row", repr(rows))
            batch_size = require_integer("batch_size", batch_size, 1, len(rows))
        self.seed = require_integer("seed", seed, 0)
        self.steps = None if steps is None else require_integer("steps", steps, 1)
        self.make, self.rows, self.batch_size, self.options = make, rows, batch_size, options
        self.step = 0

    def __len__(self) -> int:
        """Batches in all; of those without end, in an epoch."""
        if self.steps is not None:
            return self.steps
        if self.rows is None:
            raise TypeError("batches without end have no length")
        return len(self.rows) // self.batch_size

    def __iter__(self) -> Iterator[Any]:
        """From the next batch to the last one, after which all begins anew."""
        while self.steps is None or self.step < self.steps:
            batch = self._batch()
            self.step += 1
            yield batch
        self.step = 0

    def _batch(self) -> Any:
        generator = generator_at(self.seed, self.step)
        if self.rows is None:
            size = () if self.batch_size is None else (self.batch_size,)
            batch = self.make(*size, generator=generator, **self.options)
        else:
            epoch, number = divmod(self.step, len(self.rows) // self.batch_size)
            order = torch.randperm(len(self.rows), generator=generator_at(self.seed, epoch, 1))
            chosen = order[number * self.batch_size :][: self.batch_size]
            batch = self.make(self.rows[chosen], generator=generator, **self.options)
        if self.steps is not None and isinstance(batch, dict):
            batch["done"] = torch.tensor(self.step / self.steps)
        return batch

    def state_dict(self) -> dict[str, int | None]:
        """Where the next batch begins, and what that holds for, as plain integers."""
        rows = None if self.rows is None else len(self.rows)
        sizes = {"rows": rows, "batch_size": self.batch_size}
        return {"step": self.step, "steps": self.steps, "seed": self.seed} | sizes

    def load_state_dict(self, state: dict[str, int | None]) -> None:
        """Go on where `state_dict` was called.

        Raises:
            ValueError: if it is the state of other batches: of another seed, length or size, or of
                more or fewer rows.
        """
        own = self.state_dict()
        if not isinstance(state, dict) or state.keys() != own.keys():
            fail("state", "what state_dict gave", repr(state))
        for name in own.keys() - {"step"}:
            if state[name] != own[name]:
                fail("state", f"{name} {own[name]}", state[name])
        self.step = require_integer("state['step']", state["step"], 0, self.steps)
