"""Figures of chapter 3 that show images: silhouettes, masks, and what the projector makes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from torch import Tensor

from data_tools.views import View
from posecore.figures import Picture, chart, draw_axes, draw_outline, picture_grid
from posecore.figures.style import COLOURS, house_style, new_picture
from posecore.poses import compose
from posecore.rotations import axis_angle_to_matrix

__all__ = ["bright", "gallery", "li_steps", "masks", "outlines", "poses_apart", "silhouettes"]

CAMERAS = ("left", "centre", "right")


def bright(image: np.ndarray) -> np.ndarray:
    """(H, W) uint8, an infrared image so that its dark parts are seen, too."""
    values = np.asarray(image, float)
    top = max(float(np.percentile(values, 99.5)), 1.0)
    return np.round(255 * np.clip(values / top, 0, 1) ** 0.6).astype(np.uint8)


def outlines(images: Sequence[np.ndarray], shapes: Mapping[str, Sequence[np.ndarray]]) -> Picture:
    """Three infrared images, with the outlines of some masks in each.

    Args:
        images: (H, W), of the three cameras.
        shapes: label -> a mask (H, W) for each image.
    """
    said = ", ".join(f"{label} in {colour}" for label, colour in zip(shapes, _NAMES, strict=False))
    figure = picture_grid(
        [bright(image) for image in images], list(CAMERAS), columns=3, width=9.0,
        alt=f"The same instant from the left, the centre and the right; outlined: {said}.",
    )  # fmt: skip
    for number, axes in enumerate(figure.axes[: len(images)]):
        for colour, some in zip(COLOURS[1:], shapes.values(), strict=False):
            if np.asarray(some[number]).any():
                draw_outline(axes, np.asarray(some[number], bool), colour=colour)
    return figure


_NAMES = ("orange", "green", "pink")


def masks(image: np.ndarray, steps: Mapping[str, np.ndarray], columns: int = 4) -> Picture:
    """An image, and what becomes of it step by step.

    Args:
        image: (H, W) infrared.
        steps: title -> (H, W) mask, or image of bytes.
    """
    shown = [bright(image)]
    for step in steps.values():
        step = np.asarray(step)
        shown.append(step if step.dtype == bool else bright(step))
    titles = ["the image", *steps]
    return picture_grid(shown, titles, columns=columns, width=2.4 * columns, alt="; ".join(titles))


def li_steps(values: np.ndarray, thresholds: Sequence[float]) -> Picture:
    """A histogram of brightness, and the thresholds one after the other."""
    counts, edges = np.histogram(values, bins=np.arange(0, int(values.max()) + 2))
    middle = (edges[:-1] + edges[1:]) / 2
    said = ", ".join(f"{t:.1f}" for t in thresholds)
    return chart(
        {"pixels": (middle, np.maximum(counts, 0.5))},
        xlabel="brightness, 0 to 255", ylabel="pixels in the cuboid", log="y",
        upright={f"step {k}: {t:.1f}": float(t) for k, t in enumerate(thresholds)},
        size=(7.2, 3.4),
        alt=f"Histogram of brightness within the cuboid; thresholds one after the other: {said}.",
    )  # fmt: skip


def silhouettes(rows: Mapping[str, Sequence[np.ndarray | Tensor]], alt: str) -> Picture:
    """Rows of three pictures, 0 to 1, of the three cameras.

    Args:
        rows: label -> three (H, W).
        alt: what is seen.
    """
    images = [np.clip(np.asarray(one, float), 0, 1) for some in rows.values() for one in some]
    titles = [f"{label}, {camera}" for label in rows for camera in CAMERAS]
    return picture_grid(images, titles, columns=3, width=9.0, limits=(0, 1), alt=alt)


@house_style
def gallery(
    cases: Mapping[str, tuple[np.ndarray, Sequence[np.ndarray], Sequence[np.ndarray], np.ndarray]],
    alt: str,
) -> Picture:
    """Input, outlines in the three views, and the cloud from the side beside the true surface.

    Args:
        cases: title -> the input (H, W), the three images, for each of these true mask and
            silhouette as a pair of (H, W) booleans, and a pair of clouds (N, 3) and (M, 3) in the
            axes of the input's camera: predicted and true.
        alt: what is seen.
    """
    figure = new_picture(11.0, 2.1 * len(cases) + 0.2, alt)
    rows = figure.subplots(len(cases), 5, squeeze=False, width_ratios=(1.3, 1.3, 1.3, 1.3, 1))
    for row, (title, (image, views, pairs, clouds)) in zip(rows, cases.items(), strict=True):
        row[0].imshow(bright(image), cmap="gray", vmin=0, vmax=255)
        row[0].set_title(f"{title}: the input", fontsize=9)
        for axes, camera, view, (true, seen) in zip(row[1:4], CAMERAS, views, pairs, strict=True):
            axes.imshow(bright(view), cmap="gray", vmin=0, vmax=255)
            for mask, colour, line in ((true, COLOURS[2], "-"), (seen, COLOURS[1], "--")):
                if mask.any():
                    axes.contour(mask, [0.5], colors=[colour], linestyles=[line], linewidths=1.4)
            axes.set_title(camera, fontsize=9)
        from_the_side(row[4], *clouds)
        for axes in row[:4]:
            axes.set(xticks=[], yticks=[])
    return figure


def from_the_side(axes: Axes, cloud: np.ndarray, surface: np.ndarray) -> None:
    """Clouds from the side, the camera to the left: depth to the right, down is down."""
    for points, colour, size in ((surface, "#999999", 1.5), (cloud, COLOURS[1], 3)):
        axes.scatter(100 * points[:, 2], 100 * points[:, 1], s=size, color=colour)
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_xlabel("depth, cm", fontsize=8)
    axes.set_title("from the side: cloud orange", fontsize=8)
    axes.tick_params(labelsize=7)


def poses_apart(view: View, degrees: float) -> Picture:
    """The true pose of the glasses, and one that is turned by some degrees about their y axis."""
    item = view.objects[0]
    turned, t = compose(
        item.R, item.t, axis_angle_to_matrix(np.radians([0.0, degrees, 0.0])), np.zeros(3)
    )
    figure = picture_grid(
        [bright(view.ir)] * 2, ["the true pose", f"turned by {degrees:g}°"], width=8.0,
        alt=f"The axes of the glasses at their true pose, and turned by {degrees:g} degrees: the "
        "difference is small on the picture, about half a width of a lens at the tip of the axis.",
    )  # fmt: skip
    for axes, R in zip(figure.axes, (item.R, turned), strict=True):
        draw_axes(axes, view.K, R, t, 0.09)
    return figure
