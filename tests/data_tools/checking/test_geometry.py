"""What belongs to all objects is said once, what belongs to some of them with their numbers."""

from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking import geometry
from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.explaining import scores_of
from data_tools.checking.report import Report
from tests.data_tools.checking.made import MESHES, Made, corner, sample_of


def checked(made, kind="masks"):
    sample = sample_of(made)
    scores = scores_of(kind, sample.instances)
    report = Report(sample, kind, scores, [AS_GIVEN] * len(scores), scores.copy())
    geometry.check(report)
    return report


def test_what_fits(made):
    report = checked(made)
    assert report.fine and report.corrections == [AS_GIVEN] * 16
    assert report.facts == [
        "masks: masks overlap by 1.00 (median IoU), 1.00 or less for a tenth of the objects"
    ]


def test_all_objects(made):
    report = checked(made.items(lambda o: {"t": o.t / 1000}))
    (finding,) = report.findings
    assert finding.objects is None and "once corrected" in report.facts[0]
    assert len(set(map(id, report.corrections))) == 1
    assert report.fixed.min() > 0.97 and np.median(report.scores) < 0.3


@pytest.mark.slow
def test_each_object_has_a_mistake_of_its_own(made):
    def change(item):
        return {"R": item.R.T, "t": -item.R.T @ item.t} if item.object_id == 3 else {}

    meshes = {3: MESHES[3], 8: MESHES[8].copy().apply_scale(0.7)}
    report = checked(Made(made.items(change).views, meshes))
    found = {finding.objects: finding.key for finding in report.findings}
    assert found == {(3,): "inverse poses", (8,): "scaled models"}
    assert np.median(report.fixed) > 0.97


@pytest.mark.slow
def test_objects_with_the_same_mistake_are_named_together(made):
    """Here 3 and 8 have the wrong unit, and twice as many others have none."""
    meshes = {**MESHES, 1: MESHES[3], 2: MESHES[8], 4: MESHES[3], 5: MESHES[8]}

    def six(view):
        left, right = view.objects
        copies = [replace(left, object_id=i) for i in (1, 4)]
        copies += [replace(right, object_id=i) for i in (2, 5)]
        wrong = [replace(item, t=item.t / 1000) for item in (left, right)]
        return replace(view, objects=[*copies, *wrong])

    (finding,) = checked(Made(made.each(six).views, meshes)).findings
    assert finding.key == "scaled translations" and finding.objects == (3, 8)


@pytest.mark.slow
def test_what_nothing_explains(made, rng):
    report = checked(made.items(lambda o: {"t": o.t + rng.uniform(-0.2, 0.2, 3)}))
    assert report.keys == ["models and images do not fit"]
    meshes = {**MESHES, 8: corner(0.02, 0.02, 0.3)}
    report = checked(Made(made.views, meshes))
    assert report.keys == ["an object that does not fit"] and report.findings[0].objects == (8,)


def test_single_images(made):
    views = list(made.views)
    views[2] = Made([views[2]]).items(lambda o: {"t": o.t + [0.2, 0, 0]}).views[0]
    report = checked(Made(views))
    assert report.keys == ["single images"]
    assert report.findings[0].words.endswith("scene 1, image 2: 0.00")
