"""Pictures: one image or a grid of them, and an image with the poses of its objects drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from torch import Tensor

from posecore import cameras
from posecore.arrays import Array, fail, require_integer, require_number
from posecore.figures.overlays import box_edges, draw_axes, draw_box
from posecore.figures.style import COLOURS, HALO, Picture, new_picture, to_floats

__all__ = ["picture", "picture_grid", "pose_picture"]


def picture(
    image: Array,
    *,
    title: str | None = None,
    limits: tuple[float, float] | None = None,
    colour_bar: str | None = None,
    width: float = 6.4,
    alt: str | None = None,
) -> Picture:
    """Show one image, to draw into: `draw_axes(figure.axes[0], ...)`.

    Args:
        image: (H, W, 3) colours, bytes or numbers in [0, 1]; or (H, W) bytes, truth values or
            numbers, where NaN is "no value" and is drawn as a pale grey.
        title: text over the image.
        limits: for an (H, W) image, the numbers that are drawn darkest and brightest. Default: 0
            and 255 for bytes, 0 and 1 for truth values, otherwise the smallest and the largest.
        colour_bar: what the numbers are and their unit, for example "depth, m": draws an (H, W)
            image in colours, with their scale. In grey without a scale by default.
        width: of the figure, inches.
        alt: what the figure shows, in words; by default the title and the size.

    Returns:
        A figure that belongs to no window; its first axes hold the image.

    Raises:
        ValueError: if the image has another shape or its colours are not in [0, 1].
    """
    titles = None if title is None else [title]
    if alt is None:
        height, columns = _pixels("image", image).shape[:2]
        alt = f"{title or 'Image'}, {columns} x {height} pixels"
        alt += f", colours show {colour_bar}" if colour_bar else ""
    return _grid("image", [image], titles, 1, limits, colour_bar, width, alt)


def picture_grid(
    images: Sequence[Array],
    titles: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    limits: tuple[float, float] | None = None,
    colour_bar: str | None = None,
    width: float = 8.0,
    alt: str | None = None,
) -> Picture:
    """Show several images side by side, row by row.

    Args:
        images: each as in `picture`; an array (M, H, W) or (M, H, W, 3) will do.
        titles: one for each image.
        columns: how many images in a row; by default at most 4.
        limits: as in `picture`, for all images; by default the smallest and largest of them all.
        colour_bar: as in `picture`; one scale for all images, which must be (H, W) then.
        width: of the figure, inches.
        alt: what the figure shows, in words; by default the titles.

    Returns:
        A figure that belongs to no window; `figure.axes[i]` holds image i.

    Raises:
        ValueError: if there are no images, an image is not as in `picture`, or there are not as
            many titles as images.
    """
    try:
        images = list(images)
    except TypeError:
        fail("images", "a sequence of images", repr(images))
    if not images:
        fail("images", "at least one image", "none")
    if titles is not None and (isinstance(titles, str) or len(titles) != len(images)):
        fail("titles", f"{len(images)}, one for each image", repr(titles))
    count = min(len(images), 4) if columns is None else require_integer("columns", columns, 1)
    alt = alt if alt is not None else _default_alt(len(images), titles, colour_bar)
    return _grid("images", images, titles, count, limits, colour_bar, width, alt)


def pose_picture(
    image: Array,
    K: Array,
    R: Array,
    t: Array,
    size: Array | None = None,
    *,
    centre: Array | None = None,
    axis_length: float | None = None,
    labels: Sequence[str] | None = None,
    title: str | None = None,
    width: float = 6.4,
    alt: str | None = None,
) -> Picture:
    """Show an image with the axes of its objects' poses, and their boxes where sizes are given.

    Args:
        image: (H, W, 3) or (H, W), as in `picture`.
        K: (3, 3) camera matrix.
        R, t: (..., 3, 3) and (..., 3), the poses of the objects, metres.
        size: (..., 3) edge lengths of their boxes, metres; one (3,) serves all.
        centre: (..., 3) centres of the boxes in the objects' frames, metres; the origins by
            default.
        axis_length: of the drawn axes, metres; by default half the longest edge of the box, or a
            tenth of the distance where there is no box.
        labels: one for each object, written over it.
        title: text over the image.
        width: of the figure, inches.
        alt: what the figure shows, in words; by default the labels.

    Returns:
        A figure that belongs to no window; its first axes hold the image, for more overlays.

    Raises:
        ValueError: if an argument has another shape, or `K` is no camera matrix.
    """
    R = to_floats("R", R, "...", 3, 3).reshape(-1, 3, 3)
    t = to_floats("t", t, "...", 3).reshape(-1, 3)
    if len(t) != len(R):
        fail("t", f"{len(R)} translations, one for each R", len(t))
    if labels is not None and (isinstance(labels, str) or len(labels) != len(R)):
        fail("labels", f"{len(R)}, one for each pose", repr(labels))
    sizes = None if size is None else _for_each("size", size, len(R))
    centres = _for_each("centre", np.zeros(3) if centre is None else centre, len(R))
    if axis_length is not None:
        require_number("axis_length", axis_length, above=0)
    if alt is None:
        names = ", ".join(labels) if labels is not None else f"{len(R)} object(s)"
        drawn = "axes" if sizes is None else "axes and 3D box"
        alt = f"{title or 'Image'} with the projected {drawn} of {names}"
    figure = picture(image, title=title, width=width, alt=alt)
    axes = figure.axes[0]
    for number in range(len(R)):
        pose = K, R[number], t[number]
        length = axis_length or max(0.1 * float(np.linalg.norm(t[number])), 1e-6)
        if sizes is not None:
            colour = COLOURS[number % len(COLOURS)]
            draw_box(axes, *pose, sizes[number], centre=centres[number], colour=colour)
            length = axis_length or max(0.5 * float(sizes[number].max()), 1e-6)
        draw_axes(axes, *pose, length)
        if labels is not None:
            extent = None if sizes is None else sizes[number]
            _label(axes, labels[number], *pose, extent, centres[number], number)
    return figure


def _label(axes: Axes, text: str, K: Any, R: Any, t: Any, size: Any, centre: Any, n: int) -> None:
    corners = t[None] if size is None else box_edges(R, t, size, centre)[0]
    pixels = cameras.project(K, corners, behind="inf")
    if np.isfinite(pixels).all():
        look = {"ha": "center", "va": "bottom", "fontsize": 9, "fontweight": "bold"}
        place = pixels[:, 0].mean(), pixels[:, 1].min() - 3
        if size is None:  # below the origin, where the axes of most poses are not
            look["va"], place = "top", pixels[0] + [0, 6]
        colour = COLOURS[n % len(COLOURS)]
        axes.text(*place, text, color=colour, path_effects=HALO, clip_on=True, **look)


def _grid(
    name: str,
    images: Sequence[Array],
    titles: Sequence[str] | None,
    columns: int,
    limits: tuple[float, float] | None,
    colour_bar: str | None,
    width: float,
    alt: str,
) -> Picture:
    pixels = [_pixels(name, image) for image in images]
    if colour_bar is not None and any(one.ndim == 3 for one in pixels):
        fail("colour_bar", "None, as there are images in colour", repr(colour_bar))
    low, high = _limits(pixels, limits)
    cell = require_number("width", width, above=0) / columns
    heading = 0.3 if titles is not None else 0.0
    shapes = [one.shape[0] / one.shape[1] for one in pixels]
    starts = range(0, len(pixels), columns)
    heights = [cell * max(shapes[start : start + columns]) + heading for start in starts]
    bar = 0.7 if colour_bar is not None else 0.0
    figure = new_picture(width + bar, sum(heights), alt, "")
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, wspace=0.01, hspace=0.01)
    colours = colormaps["grey" if colour_bar is None else "viridis"].with_extremes(bad="#e8e4da")
    all_axes = figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights).ravel()
    for number, (axes, one) in enumerate(zip(all_axes, pixels, strict=False)):
        shown = axes.imshow(one, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        axes.set_anchor("N")
        axes.set_autoscale_on(False)  # what is drawn over an image must not move its borders
        if titles is not None:
            axes.set_title(titles[number], fontsize=10)
    for axes in all_axes:
        axes.set_axis_off()
    if colour_bar is not None:
        figure.colorbar(shown, ax=list(all_axes), label=colour_bar, fraction=0.05, pad=0.02)
    for axes in all_axes[len(pixels) :]:
        axes.remove()
    return figure


def _pixels(name: str, image: Array) -> np.ndarray:
    image = image.detach().cpu() if isinstance(image, Tensor) else image
    try:
        array = np.asarray(image)
    except ValueError:
        fail(name, "an array", "rows of different lengths")
    if array.dtype.kind not in "fiub" or array.size == 0:
        fail(name, "pixels", f"dtype {array.dtype}, shape {array.shape}")
    if array.ndim != 2 and (array.ndim != 3 or array.shape[2] != 3):
        fail(name, "shape (H, W) or (H, W, 3)", f"shape {array.shape}")
    if array.ndim == 3 and array.dtype != np.uint8:
        if not ((array >= 0) & (array <= 1)).all():
            fail(name, "bytes, or colours between 0 and 1", f"{array.min()} to {array.max()}")
        return array.astype(np.float64)
    if np.isinf(array).any() or np.isnan(array).all():
        fail(name, "finite numbers, NaN where there is none", f"{int(np.isinf(array).sum())} inf")
    return array


def _limits(
    images: Sequence[np.ndarray], limits: tuple[float, float] | None
) -> tuple[float, float]:
    if limits is not None:
        low, high = to_floats("limits", limits, 2)
        if low >= high:
            fail("limits", "a low number before a higher one", limits)
        return low, high
    scalar = [one for one in images if one.ndim == 2]
    if all(one.dtype == np.uint8 for one in scalar):
        return 0, 255
    if all(one.dtype == bool for one in scalar):
        return 0, 1
    low = min(float(np.nanmin(one)) for one in scalar)
    high = max(float(np.nanmax(one)) for one in scalar)
    return low, high if high > low else low + 1.0


def _for_each(name: str, value: Array, count: int) -> np.ndarray:
    rows = to_floats(name, value, "...", 3).reshape(-1, 3)
    if len(rows) not in (1, count):
        fail(name, f"one or {count} rows of 3", f"shape {np.shape(value)}")
    return np.broadcast_to(rows, (count, 3))


def _default_alt(count: int, titles: Sequence[str] | None, colour_bar: str | None) -> str:
    alt = f"{count} images" + (": " + "; ".join(titles) if titles is not None else "")
    return alt + (f". Colours show {colour_bar}" if colour_bar else "")
