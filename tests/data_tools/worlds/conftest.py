"""Worlds at `tiny`, made once for all tests of this folder."""

import multiprocessing
from collections.abc import Callable, Iterator
from multiprocessing.pool import Pool
from pathlib import Path

import pytest

from data_tools.views import View
from data_tools.worlds.world import World


@pytest.fixture(scope="session")
def tiny_views(shared_cache: Path) -> Callable[[World, str], list[View]]:
    """`tiny_views(world, split)`: all views of a split."""
    made: dict[tuple[str, str], list[View]] = {}

    def views(world: World, split: str) -> list[View]:
        if (world.name, split) not in made:
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("POSECORE_CACHE", str(shared_cache))
                dataset = world.open(split=split, scale="tiny", processes=1, progress=False)
                made[world.name, split] = list(dataset)
        return made[world.name, split]

    return views


@pytest.fixture(scope="session")
def two_processes() -> Iterator[Pool]:
    """Two other processes."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        yield pool
