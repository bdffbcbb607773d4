"""A rotation of two axes that need not be at right angles, each as good as it says.

Source: Di et al., "GPV-Pose", CVPR 2022, Section 3.3; Chen et al., the rotation-invariant paper,
Sections 3.3.1 and 3.3.3.
"""

from __future__ import annotations

import math

import torch

from posecore.arrays import Array, array_function, fail, somewhere
from posecore.nets.rotation_heads import decode_6d

__all__ = ["rotation_from_axes"]


@array_function(x="... 3", y="... 3", x_confidence="...", y_confidence="...")
def rotation_from_axes(
    x: Array, y: Array, x_confidence: Array | None = None, y_confidence: Array | None = None
) -> Array:
    """The rotation whose first two columns are near to two vectors; the third is their product.

    Both are turned in their plane until they are at right angles, and share the turn by what they
    are not sure of: x takes c_y / (c_x + c_y) of it, y takes the rest.

    A zero vector follows the other one; of parallel ones the plane is one of those that hold them.

    Args:
        x: (..., 3) of any length.
        y: (..., 3) of any length.
        x_confidence: (...) c_x of at least 0; None: both alike.
        y_confidence: (...) c_y of at least 0; None: both alike. Where both are 0, they are alike.

    Returns:
        (..., 3, 3) rotation. Gradients are finite everywhere.

    Raises:
        ValueError: if a confidence is negative.
    """
    one = x.new_ones(())
    c_x = one if x_confidence is None else x_confidence
    c_y = one if y_confidence is None else y_confidence
    batch = torch.broadcast_shapes(x.shape[:-1], y.shape[:-1], c_x.shape, c_y.shape)
    x, y = x.expand(*batch, 3), y.expand(*batch, 3)
    for name, values in (("x_confidence", c_x), ("y_confidence", c_y)):
        if somewhere(values < 0):
            fail(name, "none negative", float(values.min()))
    frame = decode_6d(torch.cat([y, x], -1))  # y, what of x is at right angles to it, and both's
    along, across = frame[..., 0], frame[..., 1]
    # In that plane y is at 0 and x at an angle of 0 to pi.
    ahead, aside = (x * along).sum(-1), (x * across).sum(-1)
    none = (ahead == 0) & (aside == 0)
    angle = torch.atan2(aside.masked_fill(none, 1), ahead)
    total = c_x + c_y
    nobody = total == 0
    share = torch.where(nobody, 0.5, c_x / torch.where(nobody, 1, total))  # that y takes
    zero = ~y.any(-1)
    share = torch.where(zero, 1, torch.where(none, 0, share))
    back = (math.pi / 2 - angle) * share
    cos, sin = back.cos()[..., None], back.sin()[..., None]
    new_y, new_x = cos * along - sin * across, sin * along + cos * across
    return torch.stack([new_x, new_y, torch.linalg.cross(new_x, new_y)], -1)
