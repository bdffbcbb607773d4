"""What is written beside the poses of pictures."""

import argparse
import csv
import io
import json

import cv2
import numpy as np
import pytest

from data_tools.pictures import PictureFolder
from posecore.methods import overlays
from posecore.methods.overlays import Beside, beside, draw_poses, name_table
from posecore.metrics.pose_table import PoseTable
from posecore.models import ObjectModel
from tests.methods.conftest import K

MODEL = ObjectModel(4, np.array([[-0.2, -0.1, -0.3], [0.2, 0.1, 0.3]]), 0.75)


def table_of(images, score=1.0, scene=0):
    count = len(images)
    return PoseTable(
        scene_id=np.full(count, scene),
        image_id=np.array(images, np.int64),
        object_id=np.full(count, 4),
        R=np.tile(np.eye(3), (count, 1, 1)),
        t=np.tile([0, 0, 2.0], (count, 1)),
        score=np.full(count, score),
        time=np.full(count, -1.0),
    )


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a_7.png", "a_7.jpg", 'b, "c"_8.png'):
        cv2.imwrite(str(folder / name), np.full((24, 32, 3), 120, np.uint8))
    (folder / "camera.json").write_text(json.dumps(K.tolist()))
    return folder


def options(data, output, pictures=None):
    return argparse.Namespace(data=data, output=str(output), pictures=pictures)


@pytest.mark.slow
def test_of_pictures_both_are_written(photos, tmp_path):
    found = beside(options(f"pictures:{photos}", tmp_path / "poses.csv"))
    assert found == Beside(tmp_path / "poses_pictures", tmp_path / "poses_images.csv")
    dataset = PictureFolder(photos)
    lines = list(found.write(dataset, table_of([0, 2]), [MODEL]))
    assert [line.split(":")[0] for line in lines] == [str(found.names), str(found.folder)]
    names = sorted(path.name for path in found.folder.iterdir())
    assert names == ["poses_a_7.jpg.png", "poses_a_7.png.png", 'poses_b, "c"_8.png']
    rows = list(csv.DictReader(io.StringIO(found.names.read_text())))
    assert [(int(r["scene_id"]), int(r["im_id"]), r["file"]) for r in rows] == [
        (0, 0, "a_7.jpg"),
        (0, 1, "a_7.png"),
        (0, 2, 'b, "c"_8.png'),
    ]
    assert name_table(dataset) == found.names.read_text()
    again = list(found.write(dataset, table_of([0]), []))
    assert again == lines, "what is there is written over"


@pytest.mark.slow
def test_of_others_only_what_was_asked_for(three, tmp_path):
    assert beside(options("bop:x", tmp_path / "p.csv")) == Beside(None, None)
    assert list(Beside(None, None).write(three, table_of([]), [])) == []
    found = beside(options("bop:x", tmp_path / "p.csv", str(tmp_path / "drawn")))
    (line,) = found.write(three, table_of([1], scene=2), [MODEL])
    assert line == f"{tmp_path}/drawn: 3 of 3 images with their poses"
    assert len(list((tmp_path / "drawn").glob("poses_000002_00000[0-2].png"))) == 3


def test_a_stream_has_nothing_beside_it(photos):
    assert beside(options(f"pictures:{photos}", "/dev/null")) == Beside(None, None)


@pytest.mark.slow
def test_not_all_of_many_are_drawn(three, tmp_path, monkeypatch):
    monkeypatch.setattr(overlays, "MOST", 2)
    (line,) = Beside(tmp_path / "drawn", None).write(three, table_of([]), [])
    assert "2 of 3 images" in line
    assert [p.name[-5] for p in sorted((tmp_path / "drawn").iterdir())] == ["0", "2"]


def test_what_is_refused(photos, tmp_path):
    source = f"pictures:{photos}"
    for wrong in (photos / "a_7.png", tmp_path / "no" / "folder"):
        with pytest.raises(ValueError, match="^--pictures: expected a folder, new or in one"):
            beside(options(source, tmp_path / "p.csv", str(wrong)))
    with pytest.raises(ValueError, match="^--pictures: expected a folder that the command does"):
        beside(options(source, tmp_path / "p.csv", str(photos)))
    (tmp_path / "p_images.csv").mkdir()
    with pytest.raises(ValueError, match="^--output: expected a file, got the folder"):
        beside(options(source, tmp_path / "p.csv"))


def strokes(png):
    """How many pixels are coloured, over a grey picture."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)
    return int((np.ptp(image, axis=2) > 60).sum())


@pytest.mark.slow
def test_poses_are_drawn(three):
    view = three[1]
    grey = type(view)(**{**vars(view), "rgb": np.full((24, 32, 3), 90, np.uint8)})
    nothing = strokes(draw_poses(grey, table_of([]), {}))
    assert nothing == strokes(draw_poses(grey, table_of([0, 2], scene=2), {})) < 50
    axes = strokes(draw_poses(grey, table_of([1], scene=2), {}))
    box = strokes(draw_poses(grey, table_of([1], scene=2), {4: MODEL}))
    assert nothing + 200 < axes < box
    guess = strokes(draw_poses(grey, table_of([1], score=0.0, scene=2), {4: MODEL}))
    assert guess == nothing
