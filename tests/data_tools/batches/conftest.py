"""Stacks of the tiny worlds, made once for all tests of this folder."""

from collections.abc import Callable

import pytest

from data_tools import batches
from data_tools.batches import Stack
from data_tools.worlds import categories, headset, tabletop

WORLDS = {"categories": categories.WORLD, "headset": headset.WORLD, "tabletop": tabletop.WORLD}


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory):
    """The cache in which they are. Nothing in it is to be changed."""
    folder = tmp_path_factory.mktemp("batches")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def views_of(cache) -> Callable[[str], list]:
    """`views_of(world)`: all views of its easiest test split."""
    made = {}

    def views(world: str) -> list:
        if world not in made:
            made[world] = open_world(world)
        return list(made[world])

    return views


@pytest.fixture(scope="session")
def stack_of(cache) -> Callable[[str], Stack]:
    """`stack_of(world)`: the same as a stack."""
    made = {}

    def stack(world: str) -> Stack:
        if world not in made:
            made[world] = batches.load(open_world(world), progress=False)
        return made[world]

    return stack


def open_world(world: str):
    split = {"categories": "synthetic", "headset": "test", "tabletop": "easy"}[world]
    return WORLDS[world].open(split=split, scale="tiny", processes=1, progress=False)
