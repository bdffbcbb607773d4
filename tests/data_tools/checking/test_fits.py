"""Fitted sizes are those that were put in."""

import numpy as np
import pytest

from data_tools.checking.agreement import agreement
from data_tools.checking.corrections import AS_GIVEN, pose_corrections
from data_tools.checking.fits import (
    origin_fit,
    rescaled,
    scale_fits,
    snapped,
    with_owner,
)
from tests.data_tools.checking.made import changed, median


@pytest.mark.parametrize("factor", [1e-3, 0.6, 0.9, 1.3, 40.0, 1000.0])
def test_scales(sample, factor):
    instances = list(changed(sample, lambda R, t: (R, t * factor)))
    fitted = scale_fits(instances, AS_GIVEN)
    assert fitted[0].factor == pytest.approx(factor, rel=0.06)
    if snapped(factor):
        assert fitted[0].cost == 0 and fitted[0].factor == pytest.approx(factor)
        assert median(instances, fitted[0]) > 0.97
    else:
        assert fitted[0].cost == 1
        better = fitted[0].vary(factor / fitted[0].factor)
        assert better.factor == pytest.approx(factor) and median(instances, better) > 0.97


def test_units_are_tried_beside(sample):
    instances = list(changed(sample, lambda R, t: (R, t * 900)))
    first, *more = scale_fits(instances, AS_GIVEN)
    assert first.factor == pytest.approx(900, rel=0.06) and [one.factor for one in more] == [1000]


def test_scale_with_another_mistake(sample):
    (flipped,) = (c for c in pose_corrections(sample) if c.key == "flipped axes")
    wrong = np.diag([1.0, -1, -1])
    instances = list(changed(sample, lambda R, t: (wrong @ R, wrong @ t / 1000)))
    assert scale_fits(instances, AS_GIVEN) == [], "all are behind the camera"
    (found,) = scale_fits(instances, flipped)
    assert found.key == "flipped axes and scale" and found.factor == pytest.approx(1 / 1000)
    assert found.cost == 1 and median(instances, found) > 0.97


def test_whoever_is_scaled_the_silhouette_is_the_same(sample):
    instance = sample.instances[0]
    models = rescaled(AS_GIVEN, 1.3, "models")
    translations = rescaled(AS_GIVEN, 1.3, "translations")
    later = with_owner(rescaled(AS_GIVEN, 1.3), "translations")
    for one in (translations, later):
        place = one.place(instance)
        np.testing.assert_allclose(place.t, instance.item.t / 1.3)
        assert place.scale == pytest.approx(1) and one.owner == "translations"
    assert models.place(instance).scale == 1.3 and models.place(instance).t is instance.item.t
    scores = [agreement("masks", instance, c) for c in (models, translations)]
    assert scores[0] == scores[1]


@pytest.mark.parametrize(
    ("value", "unit"),
    [(1000, 1000), (980, 1000), (0.00102, 1e-3), (25, 25.4), (1, None), (1.02, None), (3, None)],
)
def test_units(value, unit):
    assert snapped(value) == unit


def test_origins(sample):
    offset = np.array([0.02, -0.03, 0.04])
    in_model = list(changed(sample, lambda R, t: (R, t + R @ offset)))
    in_camera = list(changed(sample, lambda R, t: (R, t + offset)))
    for instances, key in ((in_model, "moved origin"), (in_camera, "moved camera")):
        (found,) = (c for c in origin_fit(instances) if c.key == key)
        for right, wrong in zip(sample.instances, instances, strict=True):
            place = found.place(wrong)
            np.testing.assert_allclose(place.t, right.item.t, atol=0.008)
    assert origin_fit(in_model[:3]) == []
