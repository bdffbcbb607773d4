from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.agreement import (
    agreement,
    box_iou,
    depth_fit,
    mask_iou,
    quick_agreement,
)
from data_tools.checking.corrections import AS_GIVEN, Correction
from data_tools.checking.drawing import Placement, draw

NOWHERE = replace(AS_GIVEN, place=lambda _: None)


def moved(x):
    return replace(AS_GIVEN, place=lambda i: Placement(i.K, i.item.R, i.item.t + [x, 0, 0]))


def test_iou_by_a_loop(sample, rng):
    instance = sample.instances[0]
    drawn = rng.random(instance.mask.shape) < 0.3
    unknown = rng.random(instance.mask.shape) < 0.2
    mask = instance.mask & ~unknown
    for others in (None, unknown):
        both = either = 0
        for y, x in np.ndindex(mask.shape):
            if others is None or not others[y, x]:
                both += bool(drawn[y, x] and mask[y, x])
                either += bool(drawn[y, x] or mask[y, x])
        given = replace(instance, mask=mask, others=others)
        assert mask_iou(drawn, given) == pytest.approx(both / either)
    nothing = np.zeros_like(mask)
    assert mask_iou(nothing, replace(instance, mask=nothing)) == 0


def test_what_fits_and_what_does_not(sample):
    for instance in sample.instances:
        bare = replace(instance, mask=None, visible=None)  # depth is looked at where nothing is
        for kind, given in (("masks", instance), ("depth", bare), ("boxes", bare)):
            assert agreement(kind, given, AS_GIVEN) > 0.97
            assert agreement(kind, given, moved(0.15)) < 0.5
            assert agreement(kind, given, NOWHERE) == 0
        assert quick_agreement(instance, AS_GIVEN) > 0.4, "what is in the hull, but not an object"
        assert quick_agreement(instance, moved(0.3)) < 0.1
        assert quick_agreement(instance, NOWHERE) == 0


def test_other_masks_count_if_they_are_better(sample):
    first, second = sample.instances[:2]
    other = replace(AS_GIVEN, targets=lambda _: [second])
    assert agreement("masks", first, other) == quick_agreement(first, other) == 0
    both = replace(AS_GIVEN, targets=lambda _: [second, first])
    assert agreement("masks", first, both) == agreement("masks", first, AS_GIVEN)
    assert agreement("masks", first, replace(AS_GIVEN, targets=lambda _: [])) == 0


def test_a_model_within_the_object_does_not_fit_its_depth(sample):
    """As it would if the models were too small: it agrees wherever it is drawn."""
    small = replace(AS_GIVEN, place=lambda i: replace(i.place, scale=0.2))
    for instance in sample.instances:
        drawn, depth = draw(instance.shape, small.place(instance), instance.size)
        if (drawn & ~instance.mask).any() or drawn.sum() < 25:
            continue
        if depth_fit(instance, depth, instance.depth).share > 0.9:
            assert agreement("depth", instance, small) < 0.5


def test_depth_is_compared_where_it_can_be(sample):
    instance = sample.instances[0]
    drawn, depth = draw(instance.shape, instance.place, instance.size)
    fit = depth_fit(instance, depth, instance.depth)
    assert fit.ratio == pytest.approx(1, abs=1e-6) and fit.share == 1
    assert fit.offset == pytest.approx(0, abs=1e-6)
    measured = np.where(drawn, instance.depth * 1.5 + 0.1, 0).astype(np.float32)
    fit = depth_fit(instance, depth, measured)
    expected = measured[drawn] / depth[drawn]
    assert fit.ratio == pytest.approx(np.median(expected)) and fit.share == 0
    assert fit.offset == pytest.approx(np.median(measured[drawn] - depth[drawn]))
    rays, back = np.ones(depth.shape), np.linalg.inv(instance.K)
    for y, x in np.argwhere(drawn):
        rays[y, x] = np.linalg.norm(back @ [x, y, 1])
    fit = depth_fit(instance, depth, instance.depth * rays)
    assert fit.ray_share == 1 and fit.ray == pytest.approx(np.median(rays[drawn]))
    assert depth_fit(instance, depth, None) is depth_fit(instance, None, instance.depth) is None
    assert depth_fit(instance, depth, np.zeros_like(instance.depth)) is None
    assert depth_fit(instance, depth, instance.depth[:50]) is None


def test_depth_is_divided_as_a_correction_says(sample):
    wrong = replace(sample.instances[0], depth=sample.instances[0].depth * 10)
    assert agreement("depth", wrong, AS_GIVEN) == 0
    ten = Correction("depth unit", "", "", AS_GIVEN.place, depth=10)
    assert agreement("depth", wrong, ten) == 1


def test_boxes(sample):
    instance = sample.instances[0]
    mask = np.zeros((120, 160), bool)
    mask[10:20, 30:50] = True
    given = replace(instance, item=replace(instance.item, box=[35, 10, 20, 10]))
    assert box_iou(given, mask) == pytest.approx(15 * 10 / (25 * 10))
    assert box_iou(given, np.zeros_like(mask)) == 0
