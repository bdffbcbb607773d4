"""Photographs within figures: the part around an object, pale under lines, without its grain."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke

from posecore import cameras
from posecore.arrays import Array, fail, require_number
from posecore.figures.encoding import is_photograph
from posecore.figures.style import to_floats

__all__ = [
    "Window",
    "bare",
    "crop",
    "show_crop",
    "thin_lines",
    "window_around",
    "window_of_pose",
    "without_grain",
]

Window = tuple[int, int, int, int]
"""A part of an image: (x, y) of its first pixel, and (x, y) of the first beyond."""
RIM = (withStroke(linewidth=2.8, foreground="white"),)
COARSE = 3  # from so many times their size on, pixels of a photograph are shown as squares


def window_around(mask: Array, points: Array | None = None, margin: float = 0.12) -> Window:
    """The part of an image around a mask and points.

    Args:
        mask: (H, W) truth values, some of them true.
        points: (..., 2) pixels, which may lie outside of the image.
        margin: how much is added on each side, in parts of the longer side; at least 3 pixels.

    Raises:
        ValueError: if the mask has another shape or nothing in it.
    """
    mask = np.asarray(mask, bool)
    if mask.ndim != 2 or not mask.any():
        fail("mask", "(H, W) with something in it", f"shape {mask.shape}, {mask.sum()} pixels")
    rows, columns = np.nonzero(mask)
    places = np.stack([columns, rows], -1)
    if points is not None:
        places = np.concatenate([places, to_floats("points", points, "...", 2).reshape(-1, 2)])
    low, high = places.min(0), places.max(0)
    room = max(margin * (high - low).max(), 3)
    size = np.array(mask.shape[::-1])
    x0, y0 = np.floor(low - room).clip(0, size - 1).astype(int)
    x1, y1 = np.ceil(high + room + 1).clip([x0 + 1, y0 + 1], size).astype(int)
    return int(x0), int(y0), int(x1), int(y1)


def window_of_pose(
    shape: tuple[int, int], K: Array, middle: Array, diameter: float, margin: float = 0.85
) -> Window:
    """The part of an image around an object that is somewhere before the camera.

    Args:
        shape: (H, W) of the image.
        K: (3, 3) camera matrix.
        middle: (3,) the middle of the object in the camera's frame, metres; z above 0.
        diameter: of the object, metres.
        margin: from the middle to each side, in diameters.

    Raises:
        ValueError: on shapes that do not fit, a diameter that is not positive, or an object behind
            the camera.
    """
    K, middle = to_floats("K", K, 3, 3), to_floats("middle", middle, 3)
    pixel = cameras.project(K, middle[None])[0]
    half = margin * K[0, 0] * require_number("diameter", diameter, above=0) / middle[2]
    size = np.array(shape[::-1])
    low = np.floor(pixel - half).clip(0, size - 2).astype(int)
    high = np.ceil(pixel + half).clip(low + 2, size).astype(int)
    return (*low.tolist(), *high.tolist())


def crop(image: np.ndarray, window: Window) -> np.ndarray:
    """The part of an image (H, W, ...) in a window."""
    return image[window[1] : window[3], window[0] : window[2]]


def show_crop(
    axes: Axes,
    image: np.ndarray,
    window: Window | None = None,
    pale: float = 0.0,
    *,
    grain: bool = True,
) -> AxesImage:
    """Show a part of an image, in the coordinates of the whole, without ticks and frame.

    Args:
        axes: to draw into; what is drawn over the image later does not move its borders.
        image: (H, W, 3) colours, or (H, W) bytes or numbers in [0, 1].
        window: the part that is seen; by default all of the image.
        pale: how much white is mixed in, 0 to 1, so that lines stand out.
        grain: whether bytes keep their noise; see `without_grain`.
    """
    image = np.asarray(image)
    window = window or (0, 0, image.shape[1], image.shape[0])
    part = crop(image, window)
    if not grain:
        part = without_grain(part)
    if pale:
        white = 255 if part.dtype == np.uint8 else 1
        part = (part * (1 - pale) + white * pale).astype(part.dtype)
    extent = (window[0] - 0.5, window[2] - 0.5, window[3] - 0.5, window[1] - 0.5)
    top = 255 if part.dtype == np.uint8 else 1
    shown = axes.imshow(part, extent=extent, cmap="grey", vmin=0, vmax=top, interpolation="nearest")
    axes.set_autoscale_on(False)
    axes.axis("off")
    place = axes.get_subplotspec()
    columns = place.get_gridspec().ncols if place is not None else 1
    smooth(shown, axes.figure.get_figwidth() / columns)
    return shown


def smooth(shown: AxesImage, inches: float) -> None:
    """Let a photograph be smooth that is drawn `inches` wide, unless its pixels are to be seen.

    Squares of pixels are no part of a photograph, and their edges make a file large.
    """
    if 100 * inches < COARSE * shown.get_array().shape[1] and is_photograph(shown):
        shown.set_interpolation("bicubic")


def without_grain(image: np.ndarray) -> np.ndarray:
    """An image of bytes, (H, W, 3) or (H, W), without the noise of its camera, its edges kept.

    For pictures whose noise is not what they are about: grain takes most of the bytes of a file.
    """
    look = (5, 28, 2.5) if image.ndim == 3 else (3, 14, 1.5)  # fine things are greys of few pixels
    return cv2.bilateralFilter(np.ascontiguousarray(image), *look)


def thin_lines(axes: Axes, width: float = 1.2) -> None:
    """Make the lines over a small picture thin, with a thin light rim."""
    for line in axes.lines:
        line.set(linewidth=width, path_effects=RIM)


def bare(axes: Axes, frame: str | None = "0.7") -> None:
    """Take the ticks off, and draw the frame in a pale colour; None leaves it out."""
    axes.set(xticks=[], yticks=[])
    if frame is None:
        axes.spines[:].set_visible(False)
    else:
        axes.spines[:].set_color(frame)
