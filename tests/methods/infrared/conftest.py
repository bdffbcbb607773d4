"""Instants that are exact, and a run of `train infrared` that nothing disturbed."""

import pytest

from posecore.methods.infrared.triples import Triples
from posecore.methods.main import main
from tests.methods.infrared.commands import train_words
from tests.methods.infrared.dots import SIZE, load


@pytest.fixture(scope="session")
def dots():
    """Four instants of two scenes, as they are kept."""
    return load()


@pytest.fixture(scope="session")
def triples(dots):
    """Images at their own size, masks at half of it."""
    return Triples(dots, image=SIZE, grid=(32, 24), masks="exact")


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("infrared")


@pytest.fixture(scope="session")
def run(folder, shared_cache):
    """Two folds. Nothing in it is to be changed."""
    assert main(train_words(folder / "run")) == 0
    return folder / "run"
