"""Views and clouds of the headset world."""

import pytest

import data_tools
from data_tools import batches
from posecore.methods.points_to_pose.pose_clouds import visible_clouds


@pytest.fixture(scope="session")
def views(shared_cache):
    return data_tools.open("headset", split="test", scale="tiny")


@pytest.fixture(scope="session")
def data(views):
    return batches.load(views, progress=False)


@pytest.fixture(scope="session")
def seen(data):
    """Of 64 points, as the recipe at `tiny` has them."""
    return visible_clouds(data, 64)
