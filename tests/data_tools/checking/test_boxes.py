import numpy as np
import pytest

from data_tools.checking import boxes
from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.explaining import scores_of
from data_tools.checking.report import Finding, Report
from tests.data_tools.checking.made import sample_of


def checked(made, function, *findings):
    sample = sample_of(made.items(lambda item: {"box": function(item.box)}))
    scores = scores_of("masks", sample.instances)
    corrections = [AS_GIVEN] * len(sample.instances)
    report = Report(sample, "masks", scores, corrections, scores, list(findings))
    boxes.check(report)
    return report


def test_boxes_that_fit(made):
    report = checked(made, lambda box: box + [-1, 0, 1, 1])
    assert report.fine and report.facts[0].startswith("boxes: overlap by 0.9")


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda box: [*box[:2], *(box[:2] + box[2:])], "left, top, right, bottom"),
        (lambda box: [*(box[:2] + box[2:] / 2), *box[2:]], "x and y of their centres"),
        (lambda box: box / [160, 120, 160, 120], "shares of the image's size"),
        (lambda box: box[[1, 0, 3, 2]], "rows before columns"),
        (lambda box: [0, 0, 5, 5], "not those of the masks"),
    ],
)
def test_boxes_in_another_format(made, function, words):
    report = checked(made, function)
    assert report.keys == ["boxes"] and words in report.findings[0].words


def test_what_else_is_off_explains_boxes(made):
    """They are compared with masks that may be wrong, too."""
    off = Finding("masks of another object", "wrong")
    report = checked(made, lambda box: [0, 0, 5, 5], off)
    assert report.findings == [off] and "models drawn as given" in report.facts[0]


def test_none(made):
    assert checked(made, lambda _: None).facts == []
    assert np.isclose(boxes._iou(np.zeros((1, 4)), np.zeros((1, 4))), 0).all()
