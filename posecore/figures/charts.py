"""One chart: curves, marks, bands and limits in one pair of axes, told apart in grey too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, NullLocator

from posecore.arrays import Array, fail, to_numbers
from posecore.figures.style import COLOURS, MARKERS, STYLES, Picture, house_style, new_picture

__all__ = ["chart", "draw_chart"]

Ticks = Sequence[float] | Mapping[float, str]
Curve = Array | tuple[Array, Array]


@house_style
def chart(
    lines: Mapping[str, Curve],
    *,
    size: tuple[float, float] = (6.4, 3.4),
    alt: str | None = None,
    **drawn: Any,
) -> Picture:
    """A figure of one pair of axes with curves; for what else it may hold see `draw_chart`.

    Args:
        lines: label -> a curve, as in `draw_chart`.
        size: width and height, inches.
        alt: what the figure shows, in words; by default where each curve begins and ends.
        drawn: further arguments of `draw_chart`, `xlabel` and `ylabel` among them.

    Returns:
        A figure that belongs to no window.

    Raises:
        ValueError: if an argument is not as there.
    """
    figure = new_picture(*size, "drawn below" if alt is None else alt)
    curves = draw_chart(figure.subplots(), lines, **drawn)
    if alt is None:
        said = "; ".join(
            f"{label.lstrip('_')} from {y[0]:.3g} to {y[-1]:.3g}"
            for label, (_, y) in curves.items()
        )
        figure.alt = f"{drawn['ylabel']} over {drawn['xlabel']}: {said}."
    return figure


def draw_chart(
    axes: Axes,
    lines: Mapping[str, Curve],
    *,
    x: Array | None = None,
    xlabel: str,
    ylabel: str,
    title: str | None = None,
    marks: Mapping[str, tuple[Array, Array]] | None = None,
    bands: Mapping[str, tuple[Array, Array]] | None = None,
    upright: Mapping[str, float] | None = None,
    level: Mapping[str, float] | None = None,
    looks: Mapping[str, Mapping[str, Any]] | None = None,
    markers: bool = False,
    log: str = "",
    xlim: tuple[float | None, float | None] | None = None,
    ylim: tuple[float | None, float | None] | None = None,
    xticks: Ticks | None = None,
    yticks: Ticks | None = None,
    grid: str = "both",
    legend: str | Mapping[str, Any] | None = "best",
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Draw curves into axes, each with a colour and a line of its own.

    A label with "_" before it is in no legend. What is not finite is a gap.

    Args:
        axes: to draw into.
        lines: label -> (N,) heights over `x`, or a pair of (N,) places and (N,) heights.
        x: (N,) places of the curves that have none of their own.
        xlabel, ylabel: what the axes are, with the unit.
        title: over the axes.
        marks: label -> (M,) places and (M,) heights of points that no line joins.
        bands: label -> (N,) lower and (N,) upper ends over `x`, shaded; a band with the label of a
            curve has its colour.
        upright, level: label -> where a thin line stands, or lies, across the whole chart.
        looks: label -> matplotlib's words (color, ls, lw, marker, ms, ...) for one of the above.
        markers: whether the curves have markers at their points.
        log: which axes are logarithmic: "", "x", "y" or "xy".
        xlim, ylim: ends of the axes; None is where the curves end.
        xticks, yticks: numbers to stand at the axes, or number -> its text; no others then.
        grid: which axes have lines across the chart: "x", "y" or "both".
        legend: its place as matplotlib has it, or a mapping of `Axes.legend`'s words; None for
            none. One curve alone has none.

    Returns:
        Label -> places and heights, as float64, of the curves.

    Raises:
        ValueError: if there is nothing to draw, lengths differ, or `log` or `grid` is none of
            these.
    """
    if log not in ("", "x", "y", "xy"):
        fail("log", "one of '', 'x', 'y', 'xy'", repr(log))
    if grid not in ("x", "y", "both"):
        fail("grid", "one of 'x', 'y', 'both'", repr(grid))
    curves = {label: _curve(f"lines[{label!r}]", one, x) for label, one in lines.items()}
    points = {label: _curve(f"marks[{label!r}]", one, None) for label, one in (marks or {}).items()}
    if not curves and not points:
        fail("lines", "at least one curve", "none, and no marks")
    looks = looks or {}
    chosen = {}
    for number, label in enumerate([*curves, *points]):
        chosen[label] = {"color": COLOURS[number % len(COLOURS)], **looks.get(label, {})}
    for number, (label, curve) in enumerate(curves.items()):
        look = {"ls": STYLES[number % len(STYLES)], "lw": 1.8, "label": label, **chosen[label]}
        if markers:
            look = {"marker": MARKERS[number % len(MARKERS)], "ms": 5, **look}
        axes.plot(*curve, **look)
    for number, (label, place) in enumerate(points.items()):
        marker = MARKERS[number % len(MARKERS)]
        axes.plot(*place, **{"ls": "none", "marker": marker, "ms": 5, "label": label}
                  | chosen[label])  # fmt: skip
    for label, ends in (bands or {}).items():
        low, high = (_curve(f"bands[{label!r}]", end, x) for end in ends)
        colour = chosen.get(label, {"color": "0.6"})["color"]
        own = {} if label in chosen else {"label": label, **looks.get(label, {})}
        axes.fill_between(low[0], low[1], high[1], **{"color": colour, "alpha": 0.2, "lw": 0} | own)
    for limits, draw in ((upright, axes.axvline), (level, axes.axhline)):
        for number, (label, place) in enumerate((limits or {}).items()):
            look = {"color": "0.4", "lw": 1.2, "ls": STYLES[(3, 1, 2, 0)[number % 4]]}
            draw(place, **look | {"label": label} | looks.get(label, {}))
    axes.set(xlabel=xlabel, ylabel=ylabel, title=title or "")
    for which, ends, ticks in (("x", xlim, xticks), ("y", ylim, yticks)):
        _scale(axes, which, which in log, ends, ticks)
    axes.grid(alpha=0.3, axis=grid)
    _legend(axes, legend)
    return curves


def _curve(name: str, given: Curve, x: Array | None) -> tuple[np.ndarray, np.ndarray]:
    pair = given if isinstance(given, tuple) and len(given) == 2 else (x, given)
    if pair[0] is None:
        fail(name, "a pair of places and heights, as there is no x", "heights")
    places, heights = (to_numbers(name, one).astype(np.float64) for one in pair)
    if places.ndim != 1 or places.shape != heights.shape or not len(places):
        fail(name, "as many heights as places", f"shapes {heights.shape} and {places.shape}")
    return places, heights


def _scale(axes: Axes, which: str, log: bool, ends: Any, ticks: Ticks | None) -> None:
    axis = getattr(axes, f"{which}axis")
    if log:
        axes.set(**{f"{which}scale": "log"})
    if ticks is not None:
        texts = list(ticks.values()) if isinstance(ticks, Mapping) else [f"{t:g}" for t in ticks]
        axis.set_ticks(list(ticks), texts)
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
    if ends is not None:
        axes.set(**{f"{which}lim": ends})


def _legend(axes: Axes, legend: str | Mapping[str, Any] | None) -> None:
    handles, _ = axes.get_legend_handles_labels()
    if legend is not None and len(handles) > 1:
        words = {"loc": legend} if isinstance(legend, str) else dict(legend)
        axes.legend(**{"fontsize": 9} | words)
