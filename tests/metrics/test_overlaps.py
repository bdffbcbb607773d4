"""Overlap of boxes and masks in a picture, counted pixel by pixel."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from posecore.arrays import trusted
from posecore.metrics import box_iou_2d, mask_iou, match_by_overlap

whole_boxes = hnp.arrays(np.int64, (3, 4), elements=st.integers(0, 9))
masks = hnp.arrays(bool, (3, 4, 5))


def filled(box):
    x, y, width, height = box
    picture = np.zeros((20, 20), bool)
    picture[y : y + height, x : x + width] = True
    return picture


def counted(one, two):
    union = (one | two).sum()
    return (one & two).sum() / union if union else 0.0


@given(whole_boxes, whole_boxes)
def test_boxes_of_whole_pixels_are_like_their_masks(one, two):
    expected = [[counted(filled(a), filled(b)) for b in two] for a in one]
    np.testing.assert_allclose(box_iou_2d(one[:, None], two), expected, rtol=1e-15)
    as_masks = [[filled(box) for box in boxes] for boxes in (one, two)]
    found = mask_iou(np.array(as_masks[0])[:, None], np.array(as_masks[1]))
    np.testing.assert_allclose(found, expected, rtol=1e-15)


@given(masks, masks)
def test_masks_pixel_by_pixel(one, two):
    expected = [counted(a, b) for a, b in zip(one, two, strict=True)]
    for kind in (bool, np.uint8, np.float32):
        found = mask_iou(one.astype(kind), 255 * two.astype(kind))
        np.testing.assert_allclose(found, expected, rtol=1e-15)


@given(hnp.arrays(float, (4, 4), elements=st.floats(0, 1e3)), st.floats(-1e6, 1e6))
def test_a_box_overlaps_itself_entirely_and_no_more(boxes, far):
    boxes = boxes + [far, far, 0, 0]
    overlap = box_iou_2d(boxes, boxes)
    area = boxes[:, 2] * boxes[:, 3]
    assert (overlap <= 1).all() and (overlap[area == 0] == 0).all()
    large = (boxes[:, 2:] > 0.1).all(-1)
    np.testing.assert_allclose(overlap[large], 1, rtol=0, atol=1e-8)


def test_by_hand():
    assert box_iou_2d([0, 0, 2, 2], [1, 1, 2, 2]) == pytest.approx(1 / 7)
    assert box_iou_2d([0, 0, 2, 2], [2, 0, 2, 2]) == 0  # they touch
    assert box_iou_2d([0.5, 0, 1, 1], [0, 0, 2, 1]) == 0.5


def test_who_finds_what(rng):
    boxes = np.array([[0, 0, 10, 10], [20, 0, 10, 10.0]])
    estimates = np.array([[1, 0, 10, 10], [40, 40, 5, 5], [0, 0, 10, 10]])
    found = match_by_overlap(box_iou_2d(estimates[:, None], boxes), [0.5, 0.9, 0.8], 0.5)
    assert found.tolist() == [False, False, True]


def test_gradients():
    one = torch.tensor([0.0, 0, 2, 2], dtype=torch.float64, requires_grad=True)
    two = torch.tensor([1.0, 0.5, 3, 2], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(box_iou_2d, (one, two))
    apart = box_iou_2d(one, two + torch.tensor([9.0, 9, 0, 0]))
    assert torch.autograd.grad(apart, one)[0].isfinite().all()


def test_what_is_no_box():
    with pytest.raises(ValueError, match=r"^box_2: expected widths and heights .*got \[-1.0, -1"):
        box_iou_2d([0, 0, 1, 1], [[0, 0, 1, 1], [-1, -1, -1, -1]])
    with pytest.raises(ValueError, match="^box_1 and box_2: expected boxes whose areas are finite"):
        box_iou_2d([0, 0, 1e200, 1e200], [0, 0, 1, 1])
    with pytest.raises(ValueError, match="W = 5 as in mask_1"):
        mask_iou(np.ones((4, 5)), np.ones((4, 6)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_seen_by_those_who_trust(bad):
    """As where a network calls."""
    for function, good in ((box_iou_2d, torch.ones(2, 4)), (mask_iou, torch.ones(2, 3))):
        wrong = good.clone()
        wrong[1, 0] = bad
        with trusted():
            with pytest.raises(ValueError, match="^(box|mask)_1: expected finite values"):
                function(wrong, good)
            with pytest.raises(ValueError, match="^(box|mask)_2: expected finite values"):
                function(good, wrong)
