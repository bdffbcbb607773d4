"""What tests of data share: a world that is made once."""

from pathlib import Path

import pytest

from data_tools.worlds import tabletop


@pytest.fixture(scope="session")
def tiny_cache(shared_cache) -> Path:
    """A cache that holds all of tabletop at tiny. Point POSECORE_CACHE at it, and leave it so."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(shared_cache))
        for split in tabletop.WORLD.splits:
            tabletop.WORLD.store(split, "tiny").make(1, progress=False)
    return shared_cache
