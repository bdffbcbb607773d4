"""A dataset of three views in memory."""

import numpy as np
import pytest

from data_tools.main import main as data_main
from data_tools.views import Dataset, ObjectView, View

K = np.array([[60.0, 0, 15.5], [0, 60, 11.5], [0, 0, 1]])


class Three(Dataset):
    """Objects 4 and 7 in views of the numbers (2, 0), (2, 1) and (2, 2)."""

    object_ids = (4, 7)
    kind = "rgb"

    def __len__(self):
        return 3

    def __getitem__(self, index):
        images = {
            "rgb": np.full((24, 32, 3), [10 * index, 100, 255], np.uint8),
            "ir": np.full((24, 32), 10 * index, np.uint8),
        }
        camera = K + np.diag([index, index, 0])
        R, t = np.eye(3), np.array([0, 0, 1.0 + index])
        objects = [ObjectView(object_id=i, R=R, t=t) for i in self.object_ids]
        image = {self.kind: images[self.kind]}
        return View(K=camera, scene_id=2, image_id=index, objects=objects, **image)

    def models(self):
        raise ValueError("there are no models")


@pytest.fixture(scope="session")
def recording(tmp_path_factory, shared_cache):
    """Two instants of `headset` as a recording on disk."""
    path = tmp_path_factory.mktemp("recordings") / "headset"
    words = ["export", str(path), "--world", "headset", "--scale", "tiny", "--count", "2"]
    assert data_main(words) == 0
    return f"hmdpose:{path}"


@pytest.fixture
def three():
    return Three()
