"""Stacks of the tiny worlds, made once for all tests of this folder, and small views by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from data_tools import batches
from data_tools.batches import Stack
from data_tools.views import Dataset, ObjectView, View
from data_tools.worlds import categories, headset, tabletop

WORLDS = {"categories": categories.WORLD, "headset": headset.WORLD, "tabletop": tabletop.WORLD}
K = np.array([[100, 0, 15.5], [0, 100, 11.5], [0, 0, 1]])


@pytest.fixture(scope="session")
def cache(shared_cache):
    """The cache in which they are. Nothing in it is to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(shared_cache))
        yield shared_cache


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


def make_view(index, count=1, **changes):
    """Squares that overlap, the later ones farther away, so that the first is in front."""
    objects = []
    for row in range(count):
        mask = np.zeros((24, 32), bool)
        mask[4 + row : 14 + row, 5 + row : 20 + row] = True
        t = np.array([0, 0, 1.0 + row])
        objects.append(ObjectView(object_id=row + 1, R=np.eye(3), t=t, mask=mask))
    image = np.random.default_rng(index).integers(0, 256, (24, 32, 3)).astype(np.uint8)
    return View(
        **{"K": K, "scene_id": 3, "image_id": index, "rgb": image, "objects": objects} | changes
    )


class Listed(Dataset):
    """Views in memory, which count how often they are asked for."""

    object_ids = (1, 2)

    def __init__(self, views):
        self.views, self.asked = views, 0

    def __len__(self):
        return len(self.views)

    def __getitem__(self, index):
        self.asked += 1
        return self.views[index]

    def models(self):
        raise ValueError


def load(views):
    return batches.load(Listed(views), progress=False)
