"""The figures of chapter 2 on how often what occurs in the three worlds."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from posecore.figures import Picture, chart
from posecore.figures.style import COLOURS, INK, new_picture

__all__ = ["angles_of_heads", "missing_depth", "sizes", "viewpoints", "visible_fractions"]

HATCHES = ("", "///")


def angles_of_heads(angles: np.ndarray, width: float) -> Picture:
    """How often the angles (N, 3) of heads occur, in bins of `width` radians, on a log axis."""
    figure = new_picture(
        8.0,
        2.8,
        "Three histograms of the size of yaw, pitch and roll, with a logarithmic axis of counts: "
        "most pictures are in the first bins, the last bins hold one or a few.",
    )
    panels = figure.subplots(1, 3, sharey=True)
    for axes, name, values in zip(panels, ("yaw", "pitch", "roll"), angles.T, strict=True):
        bins = np.degrees(width) * np.arange(np.ceil(np.abs(values).max() / width) + 1)
        counts, _, bars = axes.hist(np.degrees(np.abs(values)), bins, color="0.6", ec="white")
        for bar, count in zip(bars, counts, strict=True):
            if count < 10:
                bar.set(facecolor=COLOURS[1], hatch="///")
        axes.set(yscale="log", xlabel=f"size of {name}, °", xlim=(0, bins[-1]))
        axes.grid(alpha=0.3, axis="y")
    panels[0].set_ylabel("pictures in a bin of 5°")
    rare = Patch(fc=COLOURS[1], hatch="///", ec="white", label="fewer than ten")
    panels[2].legend(handles=[rare], fontsize=9)
    return figure


def visible_fractions(fractions: Mapping[str, np.ndarray]) -> Picture:
    """Shares of objects by how much of them is seen, for each split."""
    named = ", ".join(f"{name} {100 * np.mean(f < 0.5):.0f} %" for name, f in fractions.items())
    figure = new_picture(
        6.0,
        2.9,
        f"Histograms of the visible fraction. Objects that are less than half visible: {named}.",
    )
    axes = figure.subplots()
    edges = np.linspace(0, 1, 11)
    shares = {
        f"{name}, {len(values)} objects": 100 * np.histogram(values, edges)[0] / len(values)
        for name, values in fractions.items()
    }
    _pairs_of_bars(axes, edges[:-1] + 0.05, shares, 0.037)
    axes.set(xlabel="visible fraction", ylabel="objects of the split, %", xlim=(0, 1))
    axes.legend(fontsize=9, loc="upper left")
    return figure


def viewpoints(directions: Mapping[str, np.ndarray]) -> Picture:
    """From where objects are seen: unit vectors (N, 3) to the camera in the object's frame.

    The height is drawn by its sine, so that equal areas are equal parts of the sphere.
    """
    figure = new_picture(
        8.0,
        2.8,
        "Maps of the sphere of viewpoints, a dot for each object. All azimuths occur. "
        + "; ".join(
            f"{name}: {100 * np.mean(d[:, 2] < 0):.0f} % from below the object's middle"
            for name, d in directions.items()
        ),
    )
    panels = figure.subplots(1, len(directions), sharey=True)
    for axes, (name, d) in zip(panels, directions.items(), strict=True):
        azimuth = np.degrees(np.arctan2(d[:, 1], d[:, 0]))
        axes.scatter(azimuth, d[:, 2], s=4, marker="s", color=COLOURS[0], lw=0, antialiased=False)
        axes.set_title(f"{name}: {len(d)} objects", fontsize=10)
        axes.set(xlim=(-180, 180), ylim=(-1, 1), xlabel="azimuth on the object, °")
        axes.set_xticks([-180, -90, 0, 90, 180])
        heights = np.array([-90, -45, -20, 0, 20, 45, 90])
        axes.set_yticks(np.sin(np.radians(heights)), heights)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("height above the object, °")
    return figure


def missing_depth(names: Sequence[str], shares: Mapping[str, np.ndarray]) -> Picture:
    """Per object the share of its visible pixels without depth, for each split."""
    worst = names[int(np.argmax(sum(shares.values())))]
    figure = new_picture(
        6.4,
        2.9,
        f"Bars of the share of visible pixels without depth for each object; the {worst} loses "
        "most. In the occluded split all lose more than in the easy one.",
    )
    axes = figure.subplots()
    percent = {split: 100 * values for split, values in shares.items()}
    _pairs_of_bars(axes, np.arange(len(names)), percent, 0.38)
    axes.set_xticks(range(len(names)), names)
    axes.set(ylabel="visible pixels\nwithout depth, %")
    axes.legend(fontsize=9)
    return figure


def sizes(extent: Mapping[str, np.ndarray]) -> Picture:
    """The extents (N, 3) of instances along their axes, by category."""
    columns = range(len(extent))
    count = [len(values) for values in extent.values()]
    inside = np.concatenate([np.linspace(-0.06, 0.06, one) for one in count])
    everything = 100 * np.concatenate(list(extent.values()))
    marks, looks = {}, {}
    for number, name in enumerate(("x: width", "y: height", "z: depth")):
        places = np.repeat(columns, count) + 0.22 * (number - 1) + inside
        marks[name] = places, everything[:, number]
        looks[name] = {"color": COLOURS[(4, 0, 2)[number]], "mec": INK, "mew": 0.5, "ms": 3}
    return chart(
        {},
        marks=marks,
        looks=looks,
        xlabel="",
        ylabel="extent, cm",
        xticks=dict(zip(columns, extent, strict=True)),
        ylim=(0, None),
        grid="y",
        size=(7.2, 3.0),
        alt="For each category the width, height and depth of its instances in centimetres; "
        + ", ".join(
            f"{name} {100 * e[:, 1].min():.0f} to {100 * e[:, 1].max():.0f} cm high"
            for name, e in extent.items()
        ),
    )


def _pairs_of_bars(
    axes: Axes, places: np.ndarray, bars: Mapping[str, np.ndarray], width: float
) -> None:
    """Two bars side by side at each of the places (N,): label -> (N,) heights."""
    for number, (label, heights) in enumerate(bars.items()):
        shift = 1.06 * width * (number - 0.5)
        axes.bar(places + shift, heights, width, color=(COLOURS[0], COLOURS[4])[number], ec=INK,
                 lw=0.6, hatch=HATCHES[number], label=label)  # fmt: skip
    axes.grid(alpha=0.3, axis="y")
