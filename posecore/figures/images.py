"""Pictures: one image or a grid of them, and an image with the poses of its objects drawn in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from torch import Tensor

from posecore import cameras, poses
from posecore.arrays import Array, fail, require_integer, require_number
from posecore.figures.overlays import box_edges, draw_axes, draw_box
from posecore.figures.photographs import smooth
from posecore.figures.style import (
    BOX_COLOURS,
    HALO,
    INK,
    Picture,
    house_style,
    new_picture,
    to_floats,
)

__all__ = ["picture", "picture_grid", "pose_picture"]


@house_style
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
            numbers, where NaN is "no value" and is drawn as a pale grey. A photograph is drawn
            smoothly, unless it is so small that its pixels are to be seen; all else in squares.
        title: text over the image.
        limits: for an (H, W) image, the numbers that are drawn darkest and brightest. Default: 0
            and 255 for bytes, 0 and 1 for truth values, otherwise the smallest and the largest.
            An image that is more than 3 times as high as it is wide, or 20 times as wide as high,
            has an empty border.
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


@house_style
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
        limits: as in `picture`, for all images; by default as there, the smallest and the largest
            number over all images that are neither bytes nor truth values.
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
    titles = None if titles is None else _texts("titles", titles, len(images), "image")
    count = min(len(images), 4) if columns is None else require_integer("columns", columns, 1)
    alt = alt if alt is not None else _default_alt(len(images), titles, colour_bar)
    return _grid("images", images, titles, count, limits, colour_bar, width, alt)


@house_style
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
    labels = None if labels is None else _texts("labels", labels, len(R), "pose")
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
            colour = BOX_COLOURS[number % len(BOX_COLOURS)]
            draw_box(axes, *pose, sizes[number], centre=centres[number], colour=colour)
            length = axis_length or max(0.5 * float(sizes[number].max()), 1e-6)
        draw_axes(axes, *pose, length)
        if labels is not None:
            colour = BOX_COLOURS[number % len(BOX_COLOURS)]
            if sizes is None:
                _name_axes(axes, labels[number], *pose, length)
            else:
                corners = box_edges(R[number], t[number], sizes[number], centres[number])[0]
                _name_box(axes, labels[number], K, corners, colour)
    return figure


NAME = {"ha": "center", "fontsize": 10, "fontweight": "bold", "path_effects": HALO}


def _name_box(axes: Axes, text: str, K: Array, corners: np.ndarray, colour: str) -> None:
    pixels = cameras.project(K, corners, behind="inf")
    if np.isfinite(pixels).all():
        place = pixels[:, 0].mean(), pixels[:, 1].min() - 3
        axes.text(*place, text, color=colour, clip_on=True, va="bottom", **NAME)


def _name_axes(axes: Axes, text: str, K: Array, R: Array, t: Array, length: float) -> None:
    """Beside the origin, on the side that the axes leave free."""
    ends = poses.apply(R, t, np.concatenate([np.zeros((1, 3)), length * np.eye(3)]))
    pixels = cameras.project(K, ends, behind="inf")
    if np.isfinite(pixels).all():
        away = pixels[0] - pixels[1:].mean(0)
        x, y = 13 * away / max(float(np.linalg.norm(away)), 1e-9)
        look = {"xytext": (x, -y), "textcoords": "offset points", "annotation_clip": True}
        axes.annotate(text, pixels[0], color=INK, va="center", **look, **NAME)


def _texts(name: str, texts: Sequence[str], count: int, thing: str) -> list[str]:
    if isinstance(texts, str) or not isinstance(texts, Sequence | np.ndarray):
        fail(name, f"{count}, one for each {thing}", repr(texts))
    if len(texts) != count:
        fail(name, f"{count}, one for each {thing}", repr(texts))
    return [str(text) for text in texts]  # numbers of objects are names too


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
    each = _limits(pixels, limits, together=colour_bar is not None)
    cell = require_number("width", width, above=0) / columns
    heading = 0.3 if titles is not None else 0.0
    # Of very high or very wide images more than that could not be seen on a page.
    shapes = [min(max(one.shape[0] / one.shape[1], 0.05), 3.0) for one in pixels]
    starts = range(0, len(pixels), columns)
    heights = [cell * max(shapes[start : start + columns]) + heading for start in starts]
    bar = 0.7 if colour_bar is not None else 0.0
    figure = new_picture(width + bar, sum(heights), alt)
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, wspace=0.01, hspace=0.01)
    colours = colormaps["grey" if colour_bar is None else "viridis"].with_extremes(bad="#e8e4da")
    all_axes = figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights).ravel()
    for number, (axes, one) in enumerate(zip(all_axes, pixels, strict=False)):
        low, high = each[number]
        shown = axes.imshow(one, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        smooth(shown, cell)
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
    images: Sequence[np.ndarray], limits: tuple[float, float] | None, together: bool
) -> list[tuple[float, float]]:
    """What is darkest and brightest in each image; `together`, the same in all."""
    if limits is not None:
        low, high = to_floats("limits", limits, 2)
        if low >= high:
            fail("limits", "a low number before a higher one", limits)
        return [(low, high)] * len(images)
    full = {np.dtype(np.uint8): (0.0, 255.0), np.dtype(bool): (0.0, 1.0)}
    scalar = [one for one in images if one.ndim == 2]
    kinds = {one.dtype for one in scalar}
    if together and len(kinds) == 1 and kinds <= set(full):
        return [full[kinds.pop()]] * len(images)
    rest = [one for one in scalar if together or one.dtype not in full]
    low = min((float(np.nanmin(one)) for one in rest), default=0.0)
    high = max((float(np.nanmax(one)) for one in rest), default=1.0)
    measured = low, high if high > low else low + 1.0
    return [measured if together else full.get(one.dtype, measured) for one in images]


def _for_each(name: str, value: Array, count: int) -> np.ndarray:
    rows = to_floats(name, value, "...", 3).reshape(-1, 3)
    if len(rows) not in (1, count):
        fail(name, f"one or {count} rows of 3", f"shape {np.shape(value)}")
    return np.broadcast_to(rows, (count, 3))


def _default_alt(count: int, titles: Sequence[str] | None, colour_bar: str | None) -> str:
    alt = f"{count} images" + (": " + "; ".join(titles) if titles is not None else "")
    return alt + (f". Colours show {colour_bar}" if colour_bar else "")
