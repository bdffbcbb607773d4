from dataclasses import replace

import cv2
import numpy as np
import pytest

from data_tools.checking.blobs import drawn_blob, given_blob, whole_instances
from data_tools.checking.drawing import Placement, draw


def test_of_masks_and_of_models_alike(sample):
    """What is drawn into pixels, and what is computed of its outline."""
    for instance in whole_instances(sample.instances):
        given, drawn = given_blob(instance), drawn_blob(instance, instance.place)
        np.testing.assert_allclose(given.centre, drawn.centre, atol=0.5)  # of a pixel
        np.testing.assert_allclose(given.spread, drawn.spread, rtol=0.06)
        assert given.area == pytest.approx(drawn.area, rel=0.06)
        mask = draw(instance.shape, instance.place, instance.size)[0]
        hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32))
        filled = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), hull, 1)
        y, x = np.nonzero(filled)
        np.testing.assert_allclose(given.centre, [x.mean(), y.mean()])
        np.testing.assert_allclose(given.spread, [x.std(), y.std()])
        assert given.area == len(x)


def test_what_has_none(sample):
    instance = sample.instances[0]
    assert drawn_blob(instance, None) is None
    behind = Placement(instance.K, instance.item.R, -instance.item.t)
    assert drawn_blob(instance, behind) is None


def test_whole_ones_are_taken_if_there_are_some(sample):
    few = [replace(i, whole=i.number < 4) for i in sample.instances]
    assert whole_instances(few) == few[:4]
    fewer = [replace(i, whole=i.number < 3) for i in sample.instances]
    assert whole_instances(fewer) == fewer
    assert whole_instances([replace(few[0], mask=None), few[1]]) == [few[1]]
