"""Figures of chapter 3 about volumes: a point in voxels, a ray, and the pull of a mask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posecore.figures import Picture, chart
from posecore.figures.style import COLOURS, house_style, new_picture

__all__ = ["eight_corners", "pulled", "ray", "reach", "turning"]


@house_style
def eight_corners(volume: np.ndarray, point: Sequence[float]) -> Picture:
    """The two slices of a small volume that a point is spread over, with the shares written in.

    Args:
        volume: (D, H, W).
        point: x, y, z in voxels.
    """
    first = int(np.floor(point[2]))
    figure = new_picture(
        6.6, 3.2,
        f"A point at {tuple(point)} is spread over eight voxels, four in each of two slices; the "
        "shares are larger the nearer the voxel's centre is, and add up to 1.",
    )  # fmt: skip
    for axes, depth in zip(figure.subplots(1, 2), (first, first + 1), strict=True):
        axes.imshow(volume[depth], cmap="Blues", vmin=0, vmax=1)
        for (row, column), value in np.ndenumerate(volume[depth]):
            if value > 0:
                axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=9)
        axes.plot(point[0], point[1], "x", color=COLOURS[1], ms=9, mew=2)
        axes.set(title=f"slice z = {depth}", xlabel="x, voxels", ylabel="y, voxels")
        axes.set_xticks(range(volume.shape[2]))
        axes.set_yticks(range(volume.shape[1]))
    return figure


def ray(occupancy: np.ndarray, left: np.ndarray, stopped: np.ndarray) -> Picture:
    """Along one ray: how full voxels are, what light is left, and where it is stopped.

    Args:
        occupancy, left, stopped: (D,) each.
    """
    depth = np.arange(len(occupancy))
    return chart(
        {"occupancy $o_i$": (depth, occupancy), "light that arrives": (depth, left),
         "stopped here $p_i$": (depth, stopped)},
        xlabel="voxel along the ray, from the camera", ylabel="share", markers=True,
        size=(6.8, 3.2), ylim=(-0.03, 1.05),
        alt="Along a ray that meets two surfaces: the light falls at each, and most of it is "
        f"stopped at the first, {stopped[: len(stopped) // 2].sum():.2f} of it.",
    )  # fmt: skip


def reach(pulls: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Picture:
    """How strongly a mask pulls at a point, against how far it is from it.

    Args:
        pulls: label -> distances in voxels, and the gradient's length as a share of its largest.
    """
    return chart(
        pulls, xlabel="distance from the mask, voxels", ylabel="pull, share of its largest",
        size=(6.6, 3.2),
        alt="The pull of a mask on a point falls to nothing within a voxel or two if nothing is "
        "blurred, and reaches several times as far with a wide blur.",
    )  # fmt: skip


@house_style
def pulled(stages: Mapping[str, np.ndarray], mask: np.ndarray) -> Picture:
    """Points in the image of one camera at several stages, over the mask that pulls them.

    Args:
        stages: title -> (N, 2) x, y in voxels.
        mask: (H, W) 0 to 1.
    """
    figure = new_picture(
        10.0, 2.4,
        "Points at first in a loose heap; step by step the masks of three views pull them together "
        f"until they fill the silhouette. Stages: {', '.join(stages)}.",
    )  # fmt: skip
    panels = figure.subplots(1, len(stages), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, points) in zip(panels, stages.items(), strict=True):
        axes.imshow(mask, cmap="gray", vmin=0, vmax=1.6)
        axes.scatter(points[:, 0], points[:, 1], s=4, color=COLOURS[4])
        axes.set(title=title, xticks=[], yticks=[])
        axes.set(xlim=(-0.5, mask.shape[1] - 0.5), ylim=(mask.shape[0] - 0.5, -0.5))
    return figure


@house_style
def turning(stages: Mapping[str, np.ndarray], most: int = 6) -> Picture:
    """A cloud at several stages of a training, each seen from a little further to the side.

    Args:
        stages: title -> (N, 3) metres, about the cloud's place, along the axes of the camera.
        most: of stages; the panels of those that are still to come stay empty.
    """
    figure = new_picture(
        1.6 * most, 2.1,
        f"The cloud of one image at {', '.join(stages)} of its training, turned further each time, "
        "from the front to the side.",
    )  # fmt: skip
    panels = np.atleast_1d(figure.subplots(1, most))
    for axes in panels:
        axes.set_axis_off()
    for number, (axes, (title, points)) in enumerate(zip(panels, stages.items(), strict=False)):
        angle = np.radians(90 * number / max(1, most - 1))
        across = np.cos(angle) * points[:, 0] + np.sin(angle) * points[:, 2]
        ahead = np.cos(angle) * points[:, 2] - np.sin(angle) * points[:, 0]
        order = np.argsort(-ahead)  # what is near is drawn last
        axes.scatter(
            100 * across[order],
            100 * points[order, 1],
            c=-ahead[order],
            s=5,
            cmap="viridis",
            vmin=-0.1,
            vmax=0.1,
        )
        axes.set(xlim=(-20, 20), ylim=(20, -20), aspect="equal", title=title)
    return figure
