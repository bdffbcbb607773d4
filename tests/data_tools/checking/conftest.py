import shutil
from dataclasses import replace

import numpy as np
import pytest

import data_tools
from data_tools.bop import write_dataset
from data_tools.storage.locks import file_lock
from tests.data_tools.checking import made as making

VIEWS = 6


@pytest.fixture(scope="session")
def made():
    """Nothing in it is to be changed."""
    return making.made()


@pytest.fixture(scope="session")
def sample(made):
    return making.sample_of(made)


@pytest.fixture(scope="session")
def exported(tiny_cache, shared_cache):
    """A few views of `tabletop` in BOP's layout; "tall" has pixels twice as wide as high."""
    folder = shared_cache / "checking"
    folder.mkdir(exist_ok=True)
    with file_lock(folder / "made"), pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(tiny_cache))
        if not (folder / "tall").exists():
            world = data_tools.open("tabletop", split="easy", scale="tiny")
            views, models = [world[i] for i in range(VIEWS)], world.models()
            meshes = {i: models.mesh(i) for i in models.ids}
            write_dataset({"test": views}, folder / "plain", meshes)
            write_dataset({"test": map(tall, views)}, folder / "tall", meshes)
    return folder


@pytest.fixture
def copy(exported, tmp_path):
    """`copy(name)`: a copy to make mistakes in."""
    return lambda name="plain": shutil.copytree(exported / name, tmp_path / "own")


def tall(view):
    """Each row twice."""

    def twice(image):
        return None if image is None else np.repeat(image, 2, axis=0)

    to = np.array([[1, 0, 0], [0, 2, 0.5], [0, 0, 1]])
    objects = [
        replace(
            item,
            mask=twice(item.mask),
            full_mask=twice(item.full_mask),
            box=None if item.box is None else item.box * [1, 2, 1, 2],
        )
        for item in view.objects
    ]
    return replace(
        view, K=to @ view.K, rgb=twice(view.rgb), depth=twice(view.depth), objects=objects
    )
