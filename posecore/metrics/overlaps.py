"""How much boxes and masks in a picture overlap: intersection over union.

A box is (x, y, width, height) in pixels, as in BOP and COCO: its first corner and its extent, no
pixel added. For all pairs give each a dimension of its own: `box_iou_2d(a[:, None], b)` is (A, B),
as `match_by_overlap` takes it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_finite, somewhere

__all__ = ["box_iou_2d", "mask_iou"]


@array_function(box_1="... 4", box_2="... 4")
def box_iou_2d(box_1: Array, box_2: Array) -> Array:
    """Intersection over union of two upright boxes.

    Args:
        box_1, box_2: (..., 4) as (x, y, width, height).

    Returns:
        (...) in [0, 1]; 0 for two boxes without an area. Differentiable.

    Raises:
        ValueError: if a width or a height is negative (BOP's box of what is not seen is -1 -1 -1
            -1), or areas overflow.
    """
    for name, box in (("box_1", box_1), ("box_2", box_2)):
        require_finite(name, box)  # what is no number would be no overlap
        wrong = (box[..., 2:] < 0).any(-1)
        if somewhere(wrong):
            fail(name, "widths and heights of at least 0", box[wrong][0].tolist())
    low = torch.maximum(box_1[..., :2], box_2[..., :2])
    high = torch.minimum(box_1[..., :2] + box_1[..., 2:], box_2[..., :2] + box_2[..., 2:])
    area_1, area_2 = box_1[..., 2:].prod(-1), box_2[..., 2:].prod(-1)
    # Far from the origin, sums round: no more than all of the smaller box is shared.
    shared = torch.minimum((high - low).clamp(min=0).prod(-1), torch.minimum(area_1, area_2))
    union = area_1 + area_2 - shared
    require_finite("box_1 and box_2", union, "boxes whose areas are finite")
    return _share(shared, union)


@array_function(mask_1="... H W", mask_2="... H W")
def mask_iou(mask_1: Array, mask_2: Array) -> Array:
    """Intersection over union of two masks, counted in pixels.

    Args:
        mask_1, mask_2: (..., H, W) true, or not 0, where the object is.

    Returns:
        (...) in [0, 1], float64; 0 for two empty masks, as in COCO. Not differentiable.

    Raises:
        ValueError: if a mask has numbers that are not finite.
    """
    require_finite("mask_1", mask_1)  # what is no number is not 0 either
    require_finite("mask_2", mask_2)
    one, two = ((mask != 0).double().flatten(-2) for mask in (mask_1, mask_2))
    # Of all pairs a matrix product, which keeps no (A, B, H, W) in memory.
    shared = torch.einsum("...p,...p->...", one, two)
    return _share(shared, one.sum(-1) + two.sum(-1) - shared)


def _share(shared: Tensor, union: Tensor) -> Tensor:
    empty = union <= 0
    return torch.where(empty, 0, shared / torch.where(empty, 1, union))
