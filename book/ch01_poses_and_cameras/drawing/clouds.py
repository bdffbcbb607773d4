"""The figures of chapter 1 on depth and ICP."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from book.ch01_poses_and_cameras.drawing import photographs
from posecore import metrics
from posecore.figures import Picture, picture_grid
from posecore.figures.style import COLOURS, INK, new_picture

__all__ = ["before_and_after", "depth_picture", "icp_starts"]

Photograph, TRUTH, ESTIMATE = photographs.Photograph, photographs.TRUTH, photographs.ESTIMATE


def depth_picture(photo: Photograph) -> Picture:
    """The depth of every pixel, and of the object's alone."""
    depth = np.where(photo.depth > 0, photo.depth, np.nan)
    low, high = np.percentile(depth[photo.mask], [1, 99])
    limits = low - 0.1, high + 0.25
    alt = (
        f"Depth in colours, {limits[0]:.2f} to {limits[1]:.2f} m, of all pixels (left) and of "
        f"the {photo.name}'s alone (right): the near parts are dark, the far parts bright, "
        "and what is further away as bright as the farthest."
    )
    return picture_grid(
        [depth, np.where(photo.mask, depth, np.nan)],
        ["depth", f"of the {photo.name}"],
        limits=limits,
        colour_bar="depth, m",
        alt=alt,
    )


def before_and_after(
    photo: Photograph,
    measured: np.ndarray,
    steps: Sequence[tuple[np.ndarray, np.ndarray]],
    distances: Sequence[float],
) -> Picture:
    """An ICP: both clouds from above at its start and at its end, and the distance per step."""
    figure = new_picture(
        9.0,
        3.2,
        "Left, the start: measured points in blue lie askew of the model's in orange. Middle, the "
        "end: they lie on the model. Right: the distance between them falls with every step, from "
        f"{1000 * distances[0]:.1f} to {1000 * distances[-1]:.2f} mm in {len(distances)} steps.",
    )
    panels = figure.subplots(1, 3)
    _from_above(panels[0], photo, measured, *steps[0], "start, from above")
    _from_above(panels[1], photo, measured, *steps[-1], "end, from above")
    panels[2].plot(1000 * np.array(distances), color=INK, lw=1.8)
    panels[2].set(xlabel="step", ylabel="distance of the pairs, mm", title="every step")
    panels[2].set_ylim(bottom=0)
    panels[2].grid(alpha=0.3)
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower left", ncols=2, frameon=False, markerscale=3)
    return figure


def icp_starts(
    photo: Photograph,
    measured: np.ndarray,
    turns: np.ndarray,
    ends: Sequence[tuple[np.ndarray, np.ndarray]],
    distances: np.ndarray,
    shown: int,
) -> Picture:
    """Where ICP ends if it starts with the object turned about its own axis.

    Args:
        photo: with the true pose.
        measured: (M, 3) the measured points.
        turns: (S,) degrees of the starts.
        ends: (S) poses of the ends.
        distances: (S,) root mean square distances of the pairs at the end, metres.
        shown: which of the ends is drawn.
    """
    errors = np.array([np.degrees(metrics.rotation_error(R, photo.R)) for R, _ in ends])
    good = errors < 10
    figure = new_picture(
        9.0,
        3.2,
        f"Left and middle, over the turn of the start: the rotation error of the end is near 0 for "
        f"{good.sum()} starts around 0, which arrive, and up to {errors.max():.0f} degrees for the "
        "others; the distance of the clouds at the end is larger for the wrong ends. Right, from "
        "above, a wrong end: the bodies coincide, the measured handle sticks out where the model "
        "has none.",
    )
    panels = figure.subplots(1, 3)
    for axes, values, name in (
        (panels[0], errors, "rotation error of the end, °"),
        (panels[1], 1000 * distances, "distance at the end, mm"),
    ):
        axes.plot(turns, values, color="0.7", lw=1, zorder=1)
        look = {"color": COLOURS[2], "label": "arrives", "zorder": 2}
        axes.scatter(turns[good], values[good], **look)
        look = {"color": COLOURS[3], "marker": "s", "label": "stuck", "zorder": 2}
        axes.scatter(turns[~good], values[~good], **look)
        axes.set(xlabel="turn of the start, °", ylabel=name)
        axes.set_ylim(bottom=0)
        axes.set_xticks(range(-180, 181, 90))
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize=9)
    title = f"end of the start at {turns[shown]:.0f}°"
    _from_above(panels[2], photo, measured, *ends[shown], title)
    return figure


def _from_above(
    axes: Axes,
    photo: Photograph,
    measured: np.ndarray,
    R: np.ndarray,
    t: np.ndarray,
    title: str,
) -> None:
    """The model and, where the estimate places them, the measured points, along the object's z."""
    model = photo.points[:1200]
    axes.scatter(*1000 * model[:, :2].T, s=2, color=ESTIMATE, label="model")
    x, y, _ = 1000 * ((measured - t) @ R).T
    axes.scatter(x, y, s=5, color=TRUTH, label="measured")
    half = 1000 * 0.72 * photo.diameter
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", title=title)
    axes.set(xlabel="x, mm", ylabel="y, mm")
