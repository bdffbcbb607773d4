"""Results of a method: by visibility, over a threshold, over seeds, and a gallery of estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from posecore.arrays import Array, fail, to_numbers
from posecore.figures.charts import draw_chart
from posecore.figures.overlays import draw_box
from posecore.figures.photographs import show_crop, thin_lines, window_of_pose
from posecore.figures.style import (
    COLOURS,
    INK,
    MARKERS,
    Picture,
    house_style,
    new_picture,
    to_floats,
)

__all__ = [
    "Estimate",
    "best_median_worst",
    "by_visibility",
    "gallery",
    "over_seeds",
    "over_threshold",
]

Pose = tuple[np.ndarray, np.ndarray]


class Estimate(NamedTuple):
    """One object of one picture, for the gallery.

    Attributes:
        image: (H, W, 3) bytes.
        K: (3, 3) camera matrix.
        size: (3,) edge lengths of the object's box, metres.
        truth: R (3, 3) and t (3,), metres.
        found: the estimated pose, None where there is none.
        centre: (3,) of the box in the object's frame, metres; None is its origin.
    """

    image: np.ndarray
    K: np.ndarray
    size: np.ndarray
    truth: Pose
    found: Pose | None = None
    centre: np.ndarray | None = None


def best_median_worst(errors: Array) -> dict[str, int]:
    """Which estimate is the best, which the middle one, and which the worst.

    Args:
        errors: (N,), infinite where an estimate is missing; of those one is the worst.

    Returns:
        "best", "median" and "worst" -> its number; the first among equals.

    Raises:
        ValueError: if there is none, or one is not a number.
    """
    values = to_numbers("errors", errors)
    if values.ndim != 1 or not len(values) or np.isnan(values).any():
        fail("errors", "(N,) numbers, infinite for a missing estimate", f"shape {values.shape}")
    order = np.argsort(values, kind="stable")
    worst = int(np.flatnonzero(values == values.max())[0])
    return {"best": int(order[0]), "median": int(order[(len(order) - 1) // 2]), "worst": worst}


@house_style
def gallery(
    rows: Mapping[str, Mapping[str, Estimate]], *, width: float = 2.05, alt: str | None = None
) -> Picture:
    """Estimates beside the truth: the box of the true pose blue, that of the estimate orange.

    Args:
        rows: title of the row -> title of the panel -> what it shows.
        width: of a panel, inches.
        alt: what the figure shows, in words; by default the titles.

    Raises:
        ValueError: if there is nothing to show, or a pose, a size or a camera is none.
    """
    if not rows or not all(rows.values()):
        fail("rows", "panels in every row", {name: len(row) for name, row in rows.items()})
    said = "; ".join(f"{row}: {', '.join(panels)}" for row, panels in rows.items())
    default = "Objects with the box of the true pose, blue, and of the estimate, orange, where "
    default += "there is one. " + said.replace("\n", " ")
    wide = max(len(panels) for panels in rows.values())
    figure = new_picture(width * wide, (width + 0.3) * len(rows), alt, default)
    panels = figure.subplots(len(rows), wide, squeeze=False)
    for line, (name, shown) in zip(panels, rows.items(), strict=True):
        for axes, (title, estimate) in zip(line, shown.items(), strict=False):
            _draw_estimate(axes, estimate)
            axes.set_title(title, fontsize=9.5)
        for axes in line:
            axes.axis("off")
        look = {"rotation": 90, "va": "center", "ha": "right", "fontsize": 11}
        line[0].text(-0.06, 0.5, name, transform=line[0].transAxes, **look)
    return figure


def _draw_estimate(axes: Axes, one: Estimate) -> None:
    size = to_floats("size", one.size, 3)
    centre = np.zeros(3) if one.centre is None else to_floats("centre", one.centre, 3)
    R, t = to_floats("truth", one.truth[0], 3, 3), to_floats("truth", one.truth[1], 3)
    diameter = float(np.linalg.norm(size))
    window = window_of_pose(one.image.shape[:2], one.K, R @ centre + t, diameter, 0.8)
    show_crop(axes, one.image, window, grain=False)
    for pose, colour in ((one.truth, COLOURS[0]), (one.found, COLOURS[1])):
        if pose is not None:
            draw_box(axes, one.K, *pose, size, centre=centre, colour=colour)
    thin_lines(axes)


@house_style
def by_visibility(
    borders: Sequence[float],
    right: Mapping[str, Array],
    counts: Sequence[int] | None = None,
    *,
    ylabel: str = "right, %",
    alt: str | None = None,
) -> Picture:
    """Recall over the visible fraction of the object, in bins.

    Args:
        borders: (B + 1,) of the bins, parts from 0 to 1, rising.
        right: label -> (B,) percentages, or (seeds, B), whose mean is drawn with a mark for each
            seed; NaN for an empty bin.
        counts: (B,) how many objects are in each bin.
        ylabel: what is right, with the unit.
        alt: what the figure shows, in words; by default all means.

    Raises:
        ValueError: if there is nothing to draw, or there are not as many numbers as bins.
    """
    spans = [f"{low:.0%} to {high:.0%}" for low, high in pairwise(borders)]
    every = {name: np.atleast_2d(to_numbers("right", values)) for name, values in right.items()}
    if not every or any(values.shape[1:] != (len(spans),) for values in every.values()):
        shapes = {name: values.shape for name, values in every.items()}
        fail("right", f"(..., {len(spans)}), a number for each bin", shapes)
    means = {name: values.mean(0) for name, values in every.items()}
    said = "; ".join(
        f"{name} " + ", ".join("none" if np.isnan(v) else f"{v:.0f} %" for v in values)
        for name, values in means.items()
    )
    default = f"Over the part of the object that is seen, {', '.join(spans)}: {said}."
    curves, seeds, looks = {}, {}, {}
    for number, (name, values) in enumerate(every.items()):
        x = np.arange(len(spans)) + 0.12 * (number - (len(every) - 1) / 2)
        look = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % 4]}
        curves[name], looks[name] = (x, means[name]), look | {"lw": 1.5, "ms": 6}
        if len(values) > 1:
            seeds[f"_{name}"] = np.tile(x, len(values)), values.ravel()
            looks[f"_{name}"] = look | {"ms": 3, "alpha": 0.6}
    if counts is not None:
        spans = [f"{span}\n({count})" for span, count in zip(spans, counts, strict=True)]
    top = max(float(np.nanmax(values, initial=0)) for values in every.values())
    figure = new_picture(6.8, 3.3, alt, default)
    draw_chart(
        figure.subplots(),
        curves,
        marks=seeds,
        looks=looks,
        xlabel="visible part of the object",
        ylabel=ylabel,
        xticks=dict(enumerate(spans)),
        ylim=(0, 8 + 1.05 * top),
        grid="y",
        legend="upper left",
    )
    return figure


@house_style
def over_threshold(
    at: Array,
    right: Mapping[str, Array],
    chosen: float,
    *,
    xlabel: str,
    ylabel: str = "right, %",
    alt: str | None = None,
) -> Picture:
    """Recall over a threshold of a method, and the chosen threshold.

    Args:
        at: (N,) thresholds, rising.
        right: label -> (N,) percentages.
        chosen: where a dotted line stands.
        xlabel, ylabel: what the axes are.
        alt: what the figure shows, in words; by default the ends of the curves and their highest.

    Raises:
        ValueError: if there is nothing to draw, or there are not as many numbers as thresholds.
    """
    places = to_numbers("at", at)
    figure = new_picture(6.0, 3.2, "drawn below" if alt is None else alt)
    axes = figure.subplots()
    look = {"color": "0.5", "lw": 1, "ls": ":"}
    words = {"xlabel": xlabel, "ylabel": ylabel, "xlim": (places[0], places[-1])}
    place = {"loc": "center left"}
    curves = draw_chart(axes, right, x=places, upright={"_chosen": chosen},
                        looks={"_chosen": look}, legend=place, **words)  # fmt: skip
    axes.margins(y=0.5)
    if alt is None:
        said = "; ".join(
            f"{name}: {y[0]:.1f} at {places[0]:g}, {y[-1]:.1f} at {places[-1]:g}, most "
            f"{y.max():.1f} at {places[y.argmax()]:.2f}"
            for name, (_, y) in curves.items()
        )
        figure.alt = f"{ylabel} over the threshold: {xlabel}. Chosen: {chosen:g}. {said}."
    return figure


@house_style
def over_seeds(
    groups: Mapping[str, Mapping[str, Array]],
    others: Mapping[str, Mapping[str, float]] | None = None,
    *,
    others_are: str = "the paper's",
    ylabel: str = "right, %",
    alt: str | None = None,
) -> Picture:
    """A panel for each group, a column for each method, a mark for each seed, a bar at the mean.

    Args:
        groups: title of the panel -> label -> (seeds,) numbers.
        others: title -> label -> a number to compare with, drawn as a cross.
        others_are: what those are, for the legend.
        ylabel: what the numbers are, with the unit.
        alt: what the figure shows, in words; by default the means.

    Raises:
        ValueError: if there is nothing to draw.
    """
    if not groups or not all(groups.values()):
        fail("groups", "numbers in every group", {name: len(g) for name, g in groups.items()})
    tables = {
        title: {name: np.atleast_1d(to_numbers("groups", one)) for name, one in table.items()}
        for title, table in groups.items()
    }
    said = "; ".join(
        f"{title}, {name} {values.mean():.1f}"
        for title, table in tables.items()
        for name, values in table.items()
    )
    figure = new_picture(9.0, 3.2, alt, f"A mark for each seed. Means, {ylabel}: {said}.")
    panels = np.atleast_1d(figure.subplots(1, len(tables)))
    for number, (axes, (title, table)) in enumerate(zip(panels, tables.items(), strict=True)):
        look = {"marker": MARKERS[number % 4], "color": COLOURS[number % len(COLOURS)]}
        for place, (name, values) in enumerate(table.items()):
            where = place + np.linspace(-0.12, 0.12, len(values))
            axes.plot(where, values, ls="none", ms=6, **look)
            axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
            if name in (others or {}).get(title, {}):
                axes.plot(place + 0.3, others[title][name], "x", color="0.4", ms=8, mew=1.8)
        axes.set_xticks(range(len(table)), [name.replace(", ", "\n") for name in table], fontsize=9)
        axes.set(title=title, xlim=(-0.5, len(table) - 0.5), ylabel=ylabel)
        axes.grid(alpha=0.3, axis="y")
    if others:
        axes.plot([], [], "x", color="0.4", ms=8, mew=1.8, label=others_are)
        figure.legend(fontsize=9, loc="outside upper center", frameon=False)
    return figure
