"""Units that were taken for others are told of, and plausible ones are not."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_tools.bop.scenes import UnitWarning, read_cameras
from data_tools.units import of_dataset, of_tables
from data_tools.views import ObjectView, View
from posecore.metrics import PoseTable


def table(distance, n=3):
    R = Rotation.identity(n).as_matrix()
    t = np.tile([0, 0, distance], (n, 1))
    ids = np.ones(n, int)
    return PoseTable(ids, np.arange(n), ids, R, t, np.ones(n), np.ones(n))


def odd(distances, diameter):
    names = ("estimates", "ground truth")
    tables = dict(zip(names, map(table, distances), strict=True))
    return list(of_tables(tables, {1: diameter}))


@pytest.mark.parametrize(
    ("distance", "diameter"), [(0.7, 0.1), (0.3, 0.25), (2, 0.02), (8, 4), (0.1, 0.005)]
)
def test_what_belongs_together(distance, diameter):
    assert odd((distance, distance), diameter) == []


def test_both_files_in_metres():
    first, second = odd((0.001, 0.00111), 0.1)
    assert first.startswith("the estimates: half of the objects are 0.001 m from the camera")
    assert second.startswith("the ground truth: half")


def test_files_that_are_a_little_far():
    """700 mm taken for metres is caught; 0.05 m of an object of 20 cm is within it."""
    assert len(odd((700, 700), 0.1)) == 2
    assert "object 1 is 0.05 m from the camera, but 0.2 m large" in odd((0.05, 0.05), 0.2)[0]
    assert "object 1 is 60 m from the camera, but 0.1 m large" in odd((60, 60), 0.1)[0]


def test_a_mesh_in_metres():
    first, *_ = odd((0.7, 0.7), 0.0001)
    assert first.startswith("object 1 is 0.0001 m large")


def test_one_file_in_metres():
    assert any("both files should be in millimetres" in text for text in odd((0.02, 2), 0.1))
    assert odd((0.0, 0.0), 0.1)  # not even zeros


class Views(list):
    def __getitem__(self, index):
        if isinstance(view := super().__getitem__(index), Exception):
            raise view
        return view


def view(t=0.7, size=0.1, depth=0.7, mask=True):
    seen = np.zeros((4, 5), bool)
    seen[1:3, 1:4] = True
    item = ObjectView(
        object_id=6, R=np.eye(3), t=np.array([0, 0, t]), size=np.full(3, size / np.sqrt(3)),
        mask=seen if mask else None,
    )  # fmt: skip
    image = None if depth is None else np.full((4, 5), depth, np.float32)
    K = np.array([[500.0, 0, 2], [0, 500, 2], [0, 0, 1]])
    return View(K=K, scene_id=6, image_id=3, depth=image, objects=[item])


@pytest.mark.parametrize("good", [view(), view(depth=None), view(mask=False, depth=70.0)])
def test_plausible_views(good):
    assert list(of_dataset(Views([good]))) == []


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (view(t=700, depth=None), ["700 m from the camera, but 0.1 m large", "700 m from the cam"]),
        (view(t=700, size=100, depth=None), ["object 6 is 100 m large", "object 6 is 700 m from"]),
        (view(depth=0.0007), ["the depth image has object 6 at 0.0007 m, its pose at 0.7 m"]),
        (view(depth=700.0), ["the depth image has object 6 at 700 m, its pose at 0.7 m"]),
    ],
)
def test_odd_views(wrong, words):
    found = list(of_dataset(Views([wrong] * 7)))
    assert len(found) == len(words)
    for text, word in zip(found, words, strict=True):
        assert text.startswith("scene 6, image 3: ") and word in text


def test_views_that_cannot_be_read_are_left_to_others():
    views = Views([ValueError("damaged"), view(t=700, depth=None), OSError("gone")])
    assert len(list(of_dataset(views))) == 2
    assert list(of_dataset(Views())) == []


@pytest.mark.parametrize(
    ("scale", "told"), [(0.001, True), (1000, True), (0.05, False), (1, False)]
)
def test_scales_of_depth(tmp_path, recwarn, scale, told):
    path = tmp_path / "scene_camera.json"
    camera = {"cam_K": [500, 0, 2, 0, 500, 2, 0, 0, 1], "depth_scale": scale}
    path.write_text(json.dumps({"0": camera, "1": camera}))
    read_cameras(path, "project")
    found = [str(w.message) for w in recwarn if w.category is UnitWarning]
    assert len(found) == told
    assert all("scene_camera.json: depth_scale" in text for text in found)
