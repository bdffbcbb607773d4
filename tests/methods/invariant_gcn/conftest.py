"""Clouds of balls, shared by the tests of what is trained."""

import pytest

from posecore.methods.invariant_gcn.seen_clouds import seen_clouds
from tests.methods.invariant_gcn.balls import stack


@pytest.fixture(scope="session")
def balls():
    """Of more points than there are pixels: copies are among them."""
    return seen_clouds(stack(), 512)
