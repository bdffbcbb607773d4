"""A small BOP dataset, and a run of `train vector_field` on it that nothing disturbed."""

import pytest

from data_tools.main import main as data_main
from posecore.methods.main import main
from tests.methods.vector_field.commands import train_words


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("commands")


@pytest.fixture(scope="session")
def source(folder):
    """`tabletop` as a BOP dataset."""
    assert data_main(["export", str(folder / "bop"), "--scale", "tiny", "--count", "12"]) == 0
    return f"bop:{folder / 'bop'}"


@pytest.fixture(scope="session")
def run(source, folder):
    """Nothing in it is to be changed."""
    assert main(train_words(source, folder / "run")) == 0
    return folder / "run"
