"""How errors are distributed: accuracy over the threshold, and histograms."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np

from posecore.arrays import Array, fail, require_choice, require_integer, require_number, to_numbers
from posecore.figures.style import COLOURS, STYLES, Picture, house_style, new_picture
from posecore.metrics import auc

__all__ = ["accuracy_curves", "error_histogram"]


@house_style
def accuracy_curves(
    errors: Mapping[str, Array],
    max_threshold: float = 0.1,
    *,
    name: str = "ADD",
    unit: str = "mm",
    factor: float = 1000.0,
    highlight: str | None = None,
    alt: str | None = None,
) -> Picture:
    """Accuracy over threshold, one curve for each set of errors, its area in the legend.

    Args:
        errors: label -> (N,) errors, infinite where the estimate is missing.
        max_threshold: the right end of the axis, in the unit of the errors (0.1 m).
        highlight: the label of a curve to be drawn thick and black, over all others; beside more
            than eight others these become thin and grey, and share a line of the legend.
        name: what the errors are, for the axis.
        unit, factor: the unit that the axis shows and what takes errors to it.
        alt: what the figure shows, in words; by default the labels and their areas.

    Returns:
        A figure that belongs to no window; save it or let a notebook show it.

    Raises:
        ValueError: if there is nothing to draw, or an error is negative or not a number.
    """
    limit = require_number("max_threshold", max_threshold, above=0)
    scale = require_number("factor", factor, above=0)
    errors = _read(errors)
    areas = {label: 100 * float(auc(values, limit)) for label, values in errors.items()}
    listed = "; ".join(f"{label}: area {area:.1f} %" for label, area in areas.items())
    default = f"Accuracy over the threshold on {name}, 0 to {limit * scale:g} {unit}. {listed}."
    if highlight is not None:
        require_choice("highlight", highlight, list(errors))
    others = [label for label in errors if label != highlight]
    crowd = highlight is not None and len(others) > 8
    outside = len(errors) > 4 and not crowd  # a long legend would cover the curves
    figure = new_picture(8.6 if outside else 6.4, 4.2, alt, default)
    axes = figure.subplots()
    for number, label in enumerate([*others, *([] if highlight is None else [highlight])]):
        if label == highlight:
            look = {"color": "black", "linewidth": 3}
        elif crowd:
            look = {"color": "0.65", "linewidth": 1}
        else:
            look = {"color": COLOURS[number % len(COLOURS)], "linewidth": 1.8}
            look["linestyle"] = STYLES[number % len(STYLES)]
        name_of = _in_lines(f"{label} (area {areas[label]:.1f} %)")
        if crowd and label != highlight:
            name_of = f"each of {len(others)} others" if number == 0 else None
        values = errors[label]
        ordered = np.sort(values)
        steps = ordered[ordered < limit]
        # Accuracy jumps at every error and stays until the next.
        x = np.concatenate([[0.0], steps, [limit]]) * scale
        y = np.concatenate([np.arange(len(steps) + 1), [len(steps)]]) / len(ordered) * 100
        # Not cut at the upper border, where the best curves run.
        axes.step(x, y, where="post", label=name_of, clip_on=False, **look)
    axes.set(
        xlim=(0, limit * scale),
        ylim=(0, 100),
        xlabel=f"threshold on {name}, {unit}",
        ylabel="poses below the threshold, %",
    )
    axes.grid(alpha=0.3)
    if outside:
        axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    else:
        axes.legend(loc="lower right", frameon=True)
    return figure


@house_style
def error_histogram(
    errors: Mapping[str, Array],
    *,
    bins: int = 30,
    log: bool = False,
    name: str = "ADD",
    unit: str = "mm",
    factor: float = 1000.0,
    alt: str | None = None,
) -> Picture:
    """How many errors are how large, one outline for each set, its median marked.

    All sets share the bins, from the smallest to the largest finite error of any set. A missing
    estimate is in no bin; the legend counts it, and the median takes it as infinitely wrong.

    Args:
        errors: label -> (N,) errors, infinite where the estimate is missing.
        bins: how many.
        log: whether the axis of errors is logarithmic, its bins equally wide there. Errors of 0
            are then counted in the first bin.
        name: what the errors are, for the axis.
        unit, factor: the unit that the axis shows and what takes errors to it.
        alt: what the figure shows, in words; by default the labels and their medians.

    Returns:
        A figure that belongs to no window.

    Raises:
        ValueError: if there is nothing to draw, or an error is negative or not a number.
    """
    count = require_integer("bins", bins, 1)
    scale = require_number("factor", factor, above=0)
    values = {label: one * scale for label, one in _read(errors).items()}
    edges = _bin_edges(np.concatenate(list(values.values())), count, log)
    legend = {label: f"{label} ({_median(one, unit)})" for label, one in values.items()}
    default = f"Histogram of {name} in {unit}{', logarithmic axis' if log else ''}. "
    figure = new_picture(6.4, 4.2, alt, default + "; ".join(legend.values()) + ".")
    axes = figure.subplots()
    for number, (label, one) in enumerate(values.items()):
        colour, style = COLOURS[number % len(COLOURS)], STYLES[number % len(STYLES)]
        finite = np.clip(one[np.isfinite(one)], edges[0], edges[-1])
        counts = np.histogram(finite, edges)[0]
        look = {"color": colour, "linestyle": style, "linewidth": 1.8}
        axes.stairs(counts, edges, label=_in_lines(legend[label]), **look)
        axes.stairs(counts, edges, fill=True, color=colour, alpha=0.12)
        median = np.median(one)
        if np.isfinite(median):
            axes.axvline(median, **look, alpha=0.6)
            top = {"transform": axes.get_xaxis_transform(), "clip_on": False}
            axes.plot(median, 1.0, "v", color=colour, **top)
    axes.set(
        xscale="log" if log else "linear",
        xlabel=f"{name}, {unit}",
        ylabel="poses",
        xlim=(edges[0], edges[-1]),
    )
    # Room over the tallest bin for the legend, whatever the bins are.
    lines = sum(_in_lines(text).count("\n") + 1 for text in legend.values())
    axes.set_ylim(0, axes.dataLim.y1 / (0.92 - 0.07 * min(lines, 7)))
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", frameon=True)
    return figure


def _read(errors: Mapping[str, Array]) -> dict[str, np.ndarray]:
    if not isinstance(errors, Mapping) or not errors:
        fail("errors", "at least one labelled set of errors", repr(errors))
    result = {}
    for label, values in errors.items():
        if str(label).startswith("_"):
            fail("errors", "labels without _ before them, which the legend leaves out", repr(label))
        auc(values, 1.0)  # refuses what is no error
        result[label] = to_numbers("errors", values)
    return result


def _bin_edges(values: np.ndarray, count: int, log: bool) -> np.ndarray:
    usable = values[np.isfinite(values) & (values > 0)] if log else values[np.isfinite(values)]
    if not len(usable):
        fail("errors", f"a finite error{' above 0' * log} at least", "none")
    low, high = usable.min(), usable.max()
    # Equal errors still need a bin of some width.
    if log:
        return np.geomspace(low, high, count + 1) if high > low * 1.001 else _around(low, count)
    return np.linspace(low, high, count + 1) if high - low > 1e-9 * high else _around(low, count)


def _around(value: float, count: int) -> np.ndarray:
    return np.linspace(0.9, 1.1, count + 1) * (value if value > 0 else 1.0)


def _in_lines(text: str) -> str:
    """A label for the legend, which must leave room for the curves."""
    return textwrap.fill(text, 32)


def _median(values: np.ndarray, unit: str) -> str:
    median, missing = np.median(values), int(np.isinf(values).sum())
    text = f"median {median:.3g} {unit}" if np.isfinite(median) else "median infinite"
    return text + (f", {missing} missing" if missing else "")
