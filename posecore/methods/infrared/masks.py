"""Masks of head and glasses without labels of them: a cuboid at the pose, and Li's threshold in it.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.1.1.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.cameras import require_intrinsics
from posecore.rotations import require_rotation

__all__ = ["CUBOID", "CUBOID_CENTRE", "cuboid_mask", "li_threshold", "object_mask"]

CUBOID = (0.178, 0.264, 0.257)
"""Width, height and depth of the paper's cuboid in metres."""
CUBOID_CENTRE = (0.0, 0.0, 0.1)
"""Its centre in the frame of the glasses, of which the paper says nothing: a head behind them."""
NEAR = 0.01  # metres; a cuboid that reaches behind the camera has no outline


def cuboid_mask(
    K: np.ndarray,
    R: np.ndarray,
    t: np.ndarray,
    size: tuple[int, int],
    *,
    sides: tuple[float, float, float] = CUBOID,
    centre: tuple[float, float, float] = CUBOID_CENTRE,
) -> np.ndarray:
    """The silhouette of a cuboid: the region of interest.

    Args:
        K: (3, 3) camera matrix.
        R, t: (3, 3) and (3,) metres, the pose of the object.
        size: (width, height) of the image in pixels.
        sides: width (x), height (y) and depth (z) in metres.
        centre: in the object's frame, metres.

    Returns:
        (H, W) bool, the pixels whose centres it covers.

    Raises:
        ValueError: if the cuboid reaches behind the camera, or an argument does not fit.
    """
    camera, R, t = to_numbers("K", K), to_numbers("R", R), to_numbers("t", t)
    require_intrinsics("K", camera)
    for name, value, shape in (("R", R, (3, 3)), ("t", t, (3,))):
        if value.shape != shape:
            fail(name, f"shape {shape}", f"shape {value.shape}")
    require_rotation("R", R)
    if not isinstance(size, tuple | list) or len(size) != 2:
        fail("size", "a pair (width, height)", repr(size))
    for side in size:
        require_integer("size", side, 1)
    half, middle = to_numbers("sides", sides) / 2, to_numbers("centre", centre)
    if half.shape != (3,) or not ((half > 0) & np.isfinite(half)).all():
        fail("sides", "three finite lengths above 0", sides)
    if middle.shape != (3,):
        fail("centre", "shape (3,)", f"shape {middle.shape}")
    if not np.isfinite(middle).all():
        fail("centre", "finite numbers", middle.tolist())
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), -1).reshape(8, 3)
    corners = (middle + signs * half) @ R.T + t
    if not np.isfinite(corners).all() or (corners[:, 2] < NEAR).any():
        fail("t", "a cuboid in front of the camera", t.tolist())
    pixels = corners @ camera.T
    pixels = (pixels[:, :2] / pixels[:, 2:]).astype(np.float32)
    outline = cv2.convexHull(pixels)[:, 0]  # in one direction all around
    if len(outline) < 3:  # in float32 it is a line or a point, which has no inside
        fail("t", "a cuboid with an outline in the image, neither a line nor a point", t.tolist())
    sides_x, sides_y = (np.roll(outline, -1, axis=0) - outline).T[:, :, None, None]
    x, y = np.arange(size[0]), np.arange(size[1])[:, None]
    start_x, start_y = outline.T[:, :, None, None]
    turns = sides_x * (y - start_y) - sides_y * (x - start_x)  # (edges, H, W)
    return (turns >= 0).all(0) | (turns <= 0).all(0)


def li_threshold(values: np.ndarray, *, tolerance: float | None = None) -> float:
    """Li's threshold, which makes the cross-entropy between an image and its two means smallest.

    From one threshold to the next, until it stays:

        t <- (m_1 - m_0) / (log m_1 - log m_0)

    with m_0 and m_1 the means of what lies at or below it, and above (Li and Tam, "An iterative
    algorithm for minimum cross entropy thresholding", 1998, Eq 8).

    Args:
        values: numbers of at least 0 of any shape, such as the pixels of an image.
        tolerance: a step that is smaller ends it; None for half of the smallest step between two
            values.

    Returns:
        The threshold: above it is foreground. Of values that are all the same it is that value.
        Where nothing but the lowest value is at or below it, it stays as it is then.

    Raises:
        ValueError: if there are no values, or one is negative or not finite.
    """
    flat = to_numbers("values", values).reshape(-1)
    if not flat.size or not np.isfinite(flat).all() or (flat < 0).any():
        fail("values", "finite numbers of at least 0, one or more", f"{flat.size} of them")
    if not math.isfinite(float(flat.max()) * flat.size):
        fail("values", "numbers whose sum is finite", f"{flat.size} up to {flat.max()}")
    levels, counts = np.unique(flat, return_counts=True)
    if len(levels) == 1:
        return float(levels[0])
    if tolerance is None:
        tolerance = float(np.diff(levels).min()) / 2
    tolerance = require_number("tolerance", tolerance, above=0)
    # Cross-entropy is defined for ratios: values are shifted to begin at 0.
    shift = levels[0]
    levels = levels - shift
    below, total = np.cumsum(counts), np.cumsum(counts * levels)
    threshold, last = float(total[-1] / below[-1]), np.inf
    while abs(threshold - last) > tolerance:
        last = threshold
        k = np.searchsorted(levels, threshold, side="right") - 1
        k = min(k, len(levels) - 2)
        dark = total[k] / below[k]
        bright = (total[-1] - total[k]) / (below[-1] - below[k])
        if dark == 0:  # only the lowest value is below, and a mean of 0 has no logarithm
            break
        threshold = float((bright - dark) / (np.log(bright) - np.log(dark)))
    return threshold + float(shift)


def object_mask(
    image: np.ndarray,
    K: np.ndarray,
    R: np.ndarray,
    t: np.ndarray,
    *,
    sides: tuple[float, float, float] | None = CUBOID,
    centre: tuple[float, float, float] = CUBOID_CENTRE,
) -> np.ndarray:
    """The paper's mask: what is brighter than Li's threshold within the cuboid at the true pose.

    Args:
        image: (H, W) infrared.
        K, R, t: as for `cuboid_mask`.
        sides, centre: of the cuboid; `sides` None for the whole image.

    Returns:
        (H, W) bool; all False where the cuboid is outside the image.

    Raises:
        ValueError: as `cuboid_mask`, and for an image of another shape.
    """
    values = to_numbers("image", image)
    if values.ndim != 2:
        fail("image", "shape (H, W)", f"shape {values.shape}")
    if not (np.isfinite(values) & (values >= 0)).all():
        fail("image", "finite numbers of at least 0", "others")
    region = np.ones(values.shape, bool)
    if sides is not None:
        region = cuboid_mask(K, R, t, values.shape[::-1], sides=sides, centre=centre)
    if not region.any():
        return region
    # What is outside is black, and takes part: of the cuboid's pixels alone half a head is dark.
    return region & (values > li_threshold(np.where(region, values, 0)))
