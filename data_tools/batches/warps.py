"""One affine map for each image: the camera turned about its principal ray, a box cut out, resized.

All of it is a change of camera that pose and camera matrix follow exactly, so images are resampled
once, however much is changed. Colours are interpolated linearly, and averaged where the image
shrinks to half or less; depth and labels are taken from the nearest pixel, never mixed.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, require_integer, somewhere
from posecore.cameras import crop_and_resize_intrinsics, require_intrinsics

__all__ = ["reduced_image", "require_size", "resample", "turned_crop", "widened"]

MOST_SAMPLES = 16  # each way in a pixel; a box may be far larger than the image it lies in


@array_function(K="... 3 3", box="... 4", turn="...")
def turned_crop(
    K: Array, box: Array, turn: Array, size: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """The camera of a crop out of an image whose camera was turned about its principal ray.

    The middle of the box stays the middle of the result; the image turns around it.

    Args:
        K: (..., 3, 3) camera matrix, any focal lengths and skew.
        box: (..., 4) x, y, width and height before the turn, in pixels, fractions allowed. It
            covers x - 0.5 to x + width - 0.5.
        turn: (...) radians, from x to y in the image: clockwise as one sees it.
        size: (width, height) of the result in pixels.

    Returns:
        (..., 3, 3) affine map from old to new pixels; (..., 3, 3) camera matrix of the result;
        (..., 3, 3) rotation from the old camera's frame to the new one's: `R' = Rz R`, `t' = Rz t`.

    Raises:
        ValueError: if `K` is no camera matrix, or a box or `size` is empty.
    """
    require_intrinsics("K", K)
    size = require_size("size", size)
    cosine, sine = torch.cos(turn), torch.sin(turn)
    zero, one = torch.zeros_like(turn), torch.ones_like(turn)
    entries = (cosine, -sine, zero, sine, cosine, zero, zero, zero, one)
    Rz = torch.stack(entries, -1).unflatten(-1, (3, 3))
    # The last rows of K and Rz are 0 0 1, so this map of pixels is affine.
    turned = K @ Rz @ torch.linalg.inv(K)
    middle = box[..., :2] + (box[..., 2:] - 1) / 2
    middle = (turned[..., :2, :2] @ middle[..., None])[..., 0] + turned[..., :2, 2]
    box = torch.cat([middle - (box[..., 2:] - 1) / 2, box[..., 2:].expand_as(middle)], -1)
    # The map of pixels is what happens to the camera matrix whose pixels are points at distance 1.
    cut = crop_and_resize_intrinsics(torch.eye(3, dtype=K.dtype, device=K.device), box, size)
    return cut @ turned, cut @ K, Rz


@array_function(boxes="N 4")
def widened(boxes: Array, size: tuple[int, int], margin: float) -> Array:
    """The smallest boxes with the sides' ratio of `size` that hold others, times `margin`.

    Args:
        boxes: (N, 4) x, y, width and height; their middles are kept.
        size: (width, height).
        margin: factor on the sides.

    Raises:
        ValueError: if a box is empty.
    """
    empty = (boxes[:, 2:] <= 0).any(1)
    if somewhere(empty):
        fail("boxes", "widths and heights above 0", boxes[empty][0].tolist())
    ratio = boxes.new_tensor(size)
    sides = margin * (boxes[:, 2:] / ratio).amax(1, keepdim=True) * ratio
    return torch.cat([boxes[:, :2] + boxes[:, 2:] / 2 - sides / 2, sides], 1)


def resample(
    image: np.ndarray, to_new: np.ndarray, size: tuple[int, int], fill: int | None = None
) -> np.ndarray:
    """Resample an image by an affine map.

    Args:
        image: (H, W) or (H, W, C) of uint8 or uint16.
        to_new: (3, 3) affine map from old to new pixels.
        size: (width, height) of the result.
        fill: None for colours, which go on outside the image as on its border; a number for labels
            and depth, which are taken from the nearest pixel and are `fill` outside.

    Returns:
        (height, width) or (height, width, C), of the image's dtype.
    """
    back = np.linalg.inv(to_new)
    if fill is not None:
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(image, back[:2], size, flags=flags, borderValue=fill)
    # Where a new pixel covers several old ones it is the mean of k x k samples.
    k = round(float(np.clip(np.sqrt(abs(np.linalg.det(back[:2, :2]))), 1, MOST_SAMPLES)))
    finer = np.array([[1 / k, 0, (1 - k) / (2 * k)], [0, 1 / k, (1 - k) / (2 * k)], [0, 0, 1]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    fine = cv2.warpAffine(
        image,
        (back @ finer)[:2],
        (k * size[0], k * size[1]),
        flags=flags,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return fine if k == 1 else cv2.resize(fine, size, interpolation=cv2.INTER_AREA)


def reduced_image(
    image: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """An image in the pixels of a smaller one, as `Stack.frames` reduces it, and its camera.

    Args:
        image: (H, W, C) float32, 0 to 1.
        K: (3, 3) camera matrix.
        size: (width, height) of the result.

    Returns:
        (height, width, C) float32, and (3, 3).
    """
    height, width = image.shape[:2]
    to_new, K, _ = turned_crop(K, np.array([0.0, 0.0, width, height]), 0.0, size)
    levels = np.round(image * 255).astype(np.uint8)
    return resample(levels, to_new, size).astype(np.float32) / 255, K


def require_size(name: str, size: object) -> tuple[int, int]:
    """(width, height) of a size that is one number or two.

    Raises:
        ValueError: if it is neither one nor two integers of at least 1.
    """
    if isinstance(size, int | np.integer):
        size = (size, size)
    try:
        width, height = size
    except (TypeError, ValueError):
        fail(name, "a number of pixels, or (width, height)", repr(size))
    return require_integer(name, width, 1), require_integer(name, height, 1)
