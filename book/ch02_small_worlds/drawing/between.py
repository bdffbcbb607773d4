"""The figures of chapter 2 on what is between the corners of a triangle, and who is in front."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.patches import Polygon

from book.ch02_small_worlds.drawing import grids
from posecore.figures import Picture, picture_grid
from posecore.figures.style import COLOURS, INK, new_picture

__all__ = ["chessboards", "two_depths", "wall_from_above", "who_is_in_front"]


def wall_from_above() -> Picture:
    """A slanted wall from above: even steps in the image are uneven ones on the wall."""
    near, far, f = np.array([-0.55, 1.0]), np.array([0.9, 3.2]), 0.5
    x = np.linspace(f * near[0] / near[1], f * far[0] / far[1], 9)
    slope = (far[0] - near[0]) / (far[1] - near[1])  # X = near_x + slope (Z - near_z) = x Z / f
    z = (near[0] - slope * near[1]) / (x / f - slope)
    middle = (near + far) / 2
    figure = new_picture(
        6.6,
        3.3,
        "Seen from above: nine rays leave the camera through evenly spaced points of the image and "
        "meet a slanted wall. The nearer ones meet it close together, the farther ones wide "
        f"apart. The middle ray sees a depth of {z[4]:.2f} m; the wall's middle is at "
        f"{middle[1]:.2f} m.",
    )
    axes = figure.subplots()
    axes.plot([near[1], far[1]], [near[0], far[0]], color="0.75", lw=6, solid_capstyle="butt")
    axes.plot([f, f], [x[0] - 0.08, x[-1] + 0.08], color="0.5", lw=3)
    for k, (column, depth) in enumerate(zip(x, z, strict=True)):
        look = {"color": COLOURS[0], "lw": 2.4} if k == 4 else {"color": "0.6", "lw": 0.8}
        axes.plot([0, depth], [0, column * depth / f], **look, zorder=2)
        axes.plot([f, depth], [column, column * depth / f], "o", color=INK, ms=4, zorder=3)
    axes.plot(*middle[::-1], "D", color=COLOURS[1], ms=9, zorder=4)
    axes.plot(z[4], x[4] * z[4] / f, "o", color=COLOURS[0], ms=9, zorder=4)
    look = {"textcoords": "offset points", "fontsize": 10}
    axes.annotate("middle of the wall", middle[::-1], xytext=(12, 5), **look)
    spot = (z[4], x[4] * z[4] / f)
    axes.annotate("seen in the middle of the image", spot, xytext=(12, 9), **look)
    axes.text(0, -0.08, "camera", ha="center", va="bottom")
    axes.text(f, x[-1] + 0.12, "image", ha="center", va="top", color="0.4")
    axes.set(xlabel="depth z, m", ylabel="x, m", aspect="equal", ylim=(1.05, -0.85))
    axes.set(xlim=(-0.3, 3.4))
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def two_depths(
    corners: np.ndarray, linear: np.ndarray, true: np.ndarray, inside: np.ndarray
) -> Picture:
    """Both depths (H, W) in the pixels of the triangle, as numbers."""
    height, width = inside.shape
    worst = 1000 * np.abs(linear - true)[inside].max()
    figure = new_picture(
        9.0,
        3.7,
        "The triangle twice, with a depth in metres in each of its pixels. Left, the depths of the "
        "corners mixed linearly in the image; right, the true depths. "
        f"All are larger on the left, by up to {worst:.0f} mm.",
    )
    limits = true[inside].min(), linear[inside].max()
    titles = "linear in the image: wrong", "with the weights of the surface"
    for axes, depth, title in zip(figure.subplots(1, 2), (linear, true), titles, strict=True):
        grids.grid(axes, (width, height))
        shown = np.where(inside, depth, np.nan)
        axes.imshow(shown, cmap="Greys", vmin=limits[0] - 0.5, vmax=1.6 * limits[1], zorder=0.5)
        for y, x in np.argwhere(inside):
            axes.text(x, y, f"{depth[y, x]:.1f}", ha="center", va="center", fontsize=8.5)
        axes.add_patch(Polygon(corners, fc="none", ec=COLOURS[1], lw=1.6))
        grids.name_corners(axes, corners, grids.NAMES[:3])
        axes.set_title(f"{title}; depth, m", fontsize=11)
    return figure


def chessboards(seen: Mapping[str, np.ndarray]) -> Picture:
    """A board of 25 cm squares on the ground, from the places (H, W, 3) that pixels see."""
    images = []
    for places in seen.values():
        odd = np.floor(4 * places[..., [0, 2]] + 1e-4).sum(-1) % 2
        images.append(np.where(np.isnan(odd), 255, np.where(odd == 1, 60, 205)).astype(np.uint8))
    titles = [*seen]
    return picture_grid(
        images,
        titles,
        columns=3,
        width=9.0,
        alt="A chessboard on the ground, seen from its front, three times. Linear: its lines break "
        "at the diagonal where its two triangles meet, and its squares do not shrink evenly. "
        "Perspective: straight lines stay straight, squares shrink with distance. Library: the "
        "same.",
    )


def who_is_in_front(owners: Sequence[np.ndarray], titles: Sequence[str]) -> Picture:
    """Which of two triangles each pixel shows, (H, W) of 0, 1 or -1 for none."""
    greys = np.array([90, 200, 255], np.uint8)
    return picture_grid(
        [greys[owner] for owner in owners],
        titles,
        columns=3,
        width=9.0,
        alt="Two triangles that pass through each other, one dark, one light. Left, the light one "
        "is painted over the dark; middle, the dark one over the light; right, with the z-buffer, "
        "each is in front on its own side, and they meet in a line from top to bottom.",
    )
