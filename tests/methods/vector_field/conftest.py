"""A small BOP dataset, and a run of `train vector_field` on it that nothing disturbed."""

import pytest

from data_tools.main import main as data_main
from data_tools.storage.locks import file_lock
from posecore.methods.main import main
from tests.methods.vector_field.commands import WEIGHTS, train_words


@pytest.fixture(scope="session")
def folder(shared_cache):
    """Where both are, for all processes of a test run: whoever asks first makes them."""
    folder = shared_cache / "commands"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def source(folder):
    """`tabletop` as a BOP dataset."""
    made, words = folder / "bop", ["--scale", "tiny", "--count", "12"]
    with file_lock(made):
        assert made.exists() or data_main(["export", str(made), *words]) == 0
    return f"bop:{made}"


@pytest.fixture(scope="session")
def run(source, folder):
    """Nothing in it is to be changed."""
    made = folder / "run"
    with file_lock(made):
        assert (made / WEIGHTS[-1]).exists() or main(train_words(source, made)) == 0
    return made
