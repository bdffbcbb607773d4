"""Seeds decide everything within, and nothing afterwards."""

import random

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.randomness import generator_at, reseed
from posecore.training import seeded

SEEDS = st.integers(0, 2**70)


def numbers():
    return (
        torch.rand(3).tolist(),
        np.random.rand(3).tolist(),  # noqa: NPY002
        [random.random() for _ in range(3)],
    )


@given(SEEDS, st.integers(0, 1000))
def test_within_they_are_those_of_the_seed_and_afterwards_as_before(seed, other):
    torch.manual_seed(other)
    np.random.seed(other)  # noqa: NPY002
    random.seed(other)
    numbers()
    states = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
    after = numbers()
    torch.set_rng_state(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    random.setstate(states[2])
    with seeded(seed):
        first = numbers()
    assert numbers() == after
    with seeded(seed):
        assert numbers() == first
    with seeded(seed + 1):
        assert all(one != two for one, two in zip(numbers(), first, strict=True))


def test_an_error_within_changes_nothing():
    before = torch.get_rng_state(), random.getstate()
    with pytest.raises(KeyError), seeded(0):
        numbers()
        raise KeyError
    assert torch.equal(torch.get_rng_state(), before[0])
    assert random.getstate() == before[1]


@given(SEEDS, st.integers(0, 10**7))
def test_steps_and_processes_have_numbers_of_their_own(seed, step):
    with seeded(0):
        streams = []
        for words in ((seed, step), (seed, step + 1), (seed + 1, step), (seed, step, 1)):
            reseed(*words)
            streams.append(torch.rand(2).tolist())
            streams.append(torch.rand(2, generator=generator_at(*words)).tolist())
        reseed(seed, step)
        assert torch.rand(2).tolist() == streams[0]
    assert len({tuple(numbers) for numbers in streams}) == len(streams)


@pytest.mark.parametrize("seed", [-1, 0.5, "0", None, True])
def test_what_is_no_seed_is_refused(seed):
    with pytest.raises(ValueError, match="^seed: "), seeded(seed):
        pass
