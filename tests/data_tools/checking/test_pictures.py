from dataclasses import replace

import cv2
import numpy as np
import pytest

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.drawing import Placement
from data_tools.checking.pictures import write_pictures
from data_tools.checking.report import Report
from tests.data_tools.checking.made import sample_of

pytestmark = pytest.mark.slow


def report_of(sample, scores=None):
    count = len(sample.instances)
    scores = np.ones(count) if scores is None else scores
    moved = replace(AS_GIVEN, place=lambda i: Placement(i.K, i.item.R, i.item.t + [0.1, 0, 0]))
    return Report(sample, "masks", scores, [AS_GIVEN, moved] * (count // 2), scores)


def colours(path):
    """Of a picture, how many pixels are nearly blue, orange and green as outlines are."""
    image = cv2.imread(str(path))[..., ::-1].astype(int)
    return [
        int((np.abs(image - colour).max(-1) < 40).sum())
        for colour in ((0, 114, 178), (213, 94, 0), (0, 158, 115))
    ]


def test_the_worst_are_drawn(sample, tmp_path):
    scores = np.repeat([0.9, 0.2, 0.8, 0.1, 0.7, 1, 1, 1], 2)
    files = write_pictures(report_of(sample, scores), tmp_path / "new", count=2)
    assert [file.name for file in files] == ["check_000001_000001.png", "check_000001_000003.png"]
    assert sorted((tmp_path / "new").iterdir()) == files
    blue, orange, green = colours(files[0])
    assert min(blue, orange, green) > 50


def test_all_kinds_of_images(made, tmp_path):
    changes = [
        lambda view: replace(view, rgb=None),
        lambda view: replace(view, rgb=None, depth=None),
        lambda view: replace(view, rgb=None, ir=view.rgb[..., 0]),
    ]
    for number, change in enumerate(changes):
        report = report_of(sample_of(made.each(change)))
        (file,) = write_pictures(report, tmp_path / str(number), count=1)
        assert colours(file)[1] > 50


def test_without_masks_and_places(made, tmp_path):
    sample = sample_of(made.items(lambda _: {"mask": None, "full_mask": None}))
    report = report_of(sample)
    report.corrections = [replace(AS_GIVEN, place=lambda _: None)] * 16
    (file,) = write_pictures(report, tmp_path, count=1)
    blue, orange, green = colours(file)
    assert orange > 50 and blue < 50 and green < 50
