"""The random numbers of a step follow from the seed and the step, and from nothing else."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

from posecore.arrays import require_integer

__all__ = ["generator_at", "reseed", "seeded"]


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Within it the global random numbers of PyTorch, NumPy and Python start from `seed`.

    Layers take their first weights from there: `with seeded(0): net = Net()`. Afterwards all three
    go on where they were.

    Args:
        seed: 0 or more.

    Raises:
        ValueError: if it is no seed.
    """
    seed = require_integer("seed", seed, 0)
    gpus = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else []
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002
    with torch.random.fork_rng(devices=gpus):
        try:
            reseed(seed)
            yield
        finally:
            random.setstate(python)
            np.random.set_state(numpy)  # noqa: NPY002


def reseed(seed: int, *words: int) -> None:
    """Start the three global generators anew; near seeds and words give unrelated numbers."""
    one, two, _ = _mixed(seed, words)
    torch.default_generator.manual_seed(one)  # torch.manual_seed takes a hundred times as long
    if torch.cuda.is_initialized():
        torch.cuda.manual_seed(one)
    random.seed(two)
    np.random.seed(two % 2**32)  # noqa: NPY002


def generator_at(seed: int, *words: int) -> torch.Generator:
    """A generator of its own; its numbers are not those of `reseed`."""
    return torch.Generator().manual_seed(_mixed(seed, words)[2])


def _mixed(seed: int, words: tuple[int, ...]) -> list[int]:
    # As a spawn key: in a plain list of words zeros at the end would not count.
    mixed = np.random.SeedSequence(seed, spawn_key=words).generate_state(3, np.uint64)
    return [int(word >> np.uint64(1)) for word in mixed]
