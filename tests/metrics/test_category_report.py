"""The table of category-level metrics."""

import numpy as np
import pytest

from posecore.metrics import CategoryErrors, report_categories
from posecore.metrics.report import to_text


def errors(count, pairs, box, pose):
    zeros = np.full(pairs, 0.1)
    return CategoryErrors(
        count=count, estimated=count, iou={0.5: box}, pose={(5, 2): pose},
        pose_of_all={(5, 2): pose / 2}, pairs=np.zeros((pairs, 2), int),
        rotation=zeros, translation=zeros, overlap=zeros, scale=zeros + 0.85,
    )  # fmt: skip


def test_a_line_for_each_metric_and_the_mean_over_categories():
    """A category of one object weighs as much as one of nine."""
    lines = report_categories({"can": errors(9, 9, 1.0, 0.5), "mug": errors(1, 0, 0.0, 0.0)})
    values = {line.label: line for line in lines}
    assert values["3D IoU > 0.5"].objects == {"can": 100, "mug": 0}
    assert values["3D IoU > 0.5"].mean == 50 and values["3D IoU > 0.5"].pooled is None
    assert [line.mean for line in lines if line.label == "5 deg 2 cm"] == [25, 12.5]
    assert values["ground truth"].mean is None
    assert values["translation, mm"].objects == {"can": pytest.approx(100), "mug": None}
    assert values["scale, % off"].mean == pytest.approx(5)
    assert values["rotation, deg"].mean == pytest.approx(np.degrees(0.1))


def test_it_is_printed_with_the_names_of_categories():
    text = to_text(report_categories({"can": errors(9, 9, 1.0, 0.5), "mug": errors(1, 0, 0, 0)}))
    assert text.splitlines()[0].split() == ["can", "mug", "mean"]
    row = next(line for line in text.splitlines() if "3D IoU > 0.5" in line)
    assert row.split()[-3:] == ["100.0", "0.0", "50.0"]
    assert "every pose has the same weight" not in text
    alone = to_text(report_categories({"can": errors(9, 9, 1.0, 0.5)}))
    assert alone.splitlines()[0].split() == ["can"]


def test_nothing_is_no_table():
    with pytest.raises(ValueError, match="errors"):
        report_categories({})
