"""The figures of chapter 3's exercises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posecore.figures import Picture, draw_outline, picture_grid
from posecore.figures.style import COLOURS, INK, new_picture

__all__ = ["brightness", "clouds", "outlines", "sections", "shares", "slices"]

PAPER = "0.92"  # of what is empty


def brightness(values: np.ndarray, threshold: float, after: float) -> Picture:
    """How often each brightness comes, a threshold with the means of its sides, and the next one.

    Args:
        values: of any shape, 0 to 255.
        threshold, after: the threshold and the one that follows on it.
    """
    means = values[values <= threshold].mean(), values[values > threshold].mean()
    figure = new_picture(
        6.8,
        3.2,
        f"Histogram of brightness from {values.min():.0f} to {values.max():.0f}. The threshold "
        f"{threshold:.1f} has the means {means[0]:.1f} and {means[1]:.1f} on its two sides; the "
        f"next threshold is {after:.1f}.",
    )
    axes = figure.subplots()
    axes.hist(values.ravel(), np.arange(0, 262, 4), color="0.75", edgecolor="0.55", linewidth=0.4)
    for value, name, colour, style in (
        (threshold, f"threshold: {threshold:.1f}", INK, ":"),
        (means[0], f"mean of the dark side: {means[0]:.1f}", COLOURS[0], "--"),
        (means[1], f"mean of the bright side: {means[1]:.1f}", COLOURS[1], "-."),
        (after, f"next threshold: {after:.1f}", INK, "-"),
    ):
        axes.axvline(value, color=colour, linestyle=style, linewidth=2, label=name)
    axes.set(xlabel="brightness, 0 to 255", ylabel="pixels", xlim=(0, 256))
    axes.legend(fontsize=9)
    return figure


def outlines(
    photos: Sequence[np.ndarray], masks: Mapping[str, np.ndarray], columns: int | None = None
) -> Picture:
    """Pictures (H, W), each with the border of its mask (H, W); the masks' keys are the titles."""
    shares = [f"{name}, {mask.mean():.0%} of the picture" for name, mask in masks.items()]
    figure = picture_grid(
        photos,
        list(masks),
        columns=columns or len(photos),
        width=8.6,
        alt=f"Infrared pictures with an outline each: {'; '.join(shares)}.",
    )
    for axes, mask in zip(figure.axes, masks.values(), strict=False):
        draw_outline(axes, mask)
    return figure


def shares(volumes: Mapping[str, np.ndarray]) -> Picture:
    """Volumes (D, H, W), a row each and their slices side by side; the numbers are written in."""
    depth, height, width = next(iter(volumes.values())).shape
    sums = ", ".join(f"{volume.sum():.2f} {title}" for title, volume in volumes.items())
    figure = new_picture(
        1.1 + 0.44 * depth * (width + 1),
        0.3 + len(volumes) * (0.55 + 0.44 * height),
        f"The slices of {len(volumes)} volumes with the shares of one point each. Shares add up "
        f"to: {sums}.",
    )
    panels = figure.subplots(len(volumes), depth, squeeze=False, sharex=True, sharey=True)
    for row, (title, volume) in zip(panels, volumes.items(), strict=True):
        for number, (axes, plane) in enumerate(zip(row, volume, strict=True)):
            axes.imshow(plane, cmap="Greys", vmin=0, vmax=1.3)
            for (y, x), share in np.ndenumerate(plane):
                if share > 0:
                    look = {"color": "white" if share > 0.6 else INK, "size": 9}
                    axes.text(x, y, f"{share:.2f}", ha="center", va="center", **look)
            axes.set_title(f"{title}\nz = {number}" if not number else f"z = {number}", fontsize=9)
            axes.set_xticks(range(width))
            axes.set_yticks(range(height))
            axes.set_xticks(np.arange(width + 1) - 0.5, minor=True)
            axes.set_yticks(np.arange(height + 1) - 0.5, minor=True)
            axes.grid(which="minor", color="0.8", linewidth=0.6)
            axes.tick_params(which="minor", length=0)
    for axes in panels[-1]:
        axes.set_xlabel("x, voxels")
    for axes in panels[:, 0]:
        axes.set_ylabel("y, voxels")
    return figure


def slices(
    occupancy: np.ndarray, intensity: np.ndarray, silhouette: np.ndarray, picture: np.ndarray
) -> Picture:
    """Both volumes (D, H, W), their slices from the nearest on, and what is seen of them (H, W)."""
    names = [f"slice {number}" for number in range(len(occupancy))]
    alt = (
        f"{len(occupancy)} slices, above their occupancy and below their intensity; on the right "
        f"what is seen: a silhouette of up to {silhouette.max():.2f}, and a picture of up to "
        f"{picture.max():.2f}."
    )
    images = [*occupancy, silhouette, *intensity, picture]
    titles = [f"{name}: occupancy" for name in names] + ["seen: silhouette"]
    titles += [f"{name}: intensity" for name in names] + ["seen: picture"]
    return picture_grid(
        images, titles, columns=len(occupancy) + 1, limits=(0, 1), width=7.4, alt=alt
    )


def clouds(photo: np.ndarray, silhouette: np.ndarray, picture: np.ndarray) -> Picture:
    """A photograph (H, W) beside a cloud's silhouette and picture, both in larger pixels."""
    return picture_grid(
        [photo / 255.0, silhouette, picture],
        ["photograph", "silhouette of the cloud", "picture of the cloud"],
        limits=(0, 1),
        width=8.6,
        alt="An infrared photograph of a head with glasses, the silhouette of a cloud of points "
        "on its surface, and the cloud's picture: in large pixels the same head.",
    )


def sections(volumes: Mapping[str, np.ndarray], row: int, millimetres: float) -> Picture:
    """Volumes (D, H, W), a column each: seen from the front and the side, and cut at a row.

    Args:
        volumes: title -> bool, the first slice in front.
        row: where they are cut, from the top.
        millimetres: side of a voxel.
    """
    counts = ", ".join(f"{volume.sum()} in {title}" for title, volume in volumes.items())
    cut = ", ".join(f"{volume[:, row].sum()} in {title}" for title, volume in volumes.items())
    figure = new_picture(
        2.7 * len(volumes),
        7.6,
        f"Volumes with the same silhouettes from the front and the side. Voxels: {counts}. In the "
        f"cut they differ: {cut}.",
    )
    panels = figure.subplots(3, len(volumes), squeeze=False)
    for column, (title, volume) in zip(panels.T, volumes.items(), strict=True):
        views = (
            (volume.any(0), "x", "y", "from the front"),
            (volume.any(2).T, "z", "y", "from the side"),
            (volume[:, row], "x", "z", "cut through the eyes"),
        )
        for axes, (image, across, down, name) in zip(column, views, strict=True):
            size = np.array(image.shape[::-1]) * millimetres
            axes.imshow(image, cmap="Greys", vmin=0, vmax=1.4, extent=(0, size[0], size[1], 0))
            axes.set(xlabel=f"{across}, mm", ylabel=f"{down}, mm", title=name, facecolor=PAPER)
            axes.title.set_fontsize(9)
        for axes in column[:2]:
            middle = (row + 0.5) * millimetres
            axes.axhline(middle, color=COLOURS[1], linestyle="--", linewidth=1)
        column[0].set_title(f"{title}\n{volume.sum()} voxels\nfrom the front", fontsize=9)
    return figure
