"""The figures of the landing page."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from posecore.figures import Picture
from posecore.figures.style import COLOURS

__all__ = ["COLUMNS", "ROADS", "Road", "map_of_the_book"]


@dataclass(frozen=True)
class Road:
    """One paper: what comes in, what its network says, and how that becomes a pose."""

    paper: str
    chapters: str
    comes_in: str
    says: str
    becomes: str


COLUMNS = ("what comes in", "what the network says", "how that becomes a pose")
ROADS = (
    Road(
        "From IR images to\nclouds to pose",
        "chapters 3, 4",
        "one infrared\nimage",
        "a point cloud,\nthen a quaternion",
        "read off, or vote\nfor keypoints",
    ),
    Road(
        "CIPE",
        "chapters 5, 6",
        "a colour image\nwith boxes",
        "a set of poses, a\nlearned rotation code",
        "decode the code",
    ),
    Road(
        "Rotation-invariant\nfeatures",
        "chapter 7",
        "a cloud of\none object",
        "canonical coordinates\nof every point",
        "align two clouds\n(Umeyama)",
    ),
    Road(
        "PVNet with\nprojection loss",
        "chapter 8",
        "a colour image",
        "a vector to every\nkeypoint, per pixel",
        "vote, solve PnP,\nrefine if needed",
    ),
    Road(
        "DenseFusion with\ncolour refinement",
        "chapter 9",
        "colour and depth\nof one object",
        "a pose and a\nconfidence per point",
        "take the best,\nrefine by colour",
    ),
)


def map_of_the_book() -> Picture:
    """Five papers as five roads from what a camera sees to a pose."""
    figure = Picture(figsize=(9.2, 5.6), layout="constrained")
    steps = "; ".join(
        f"{road.paper} ({road.chapters}): {road.comes_in}, {road.says}, {road.becomes}"
        for road in ROADS
    ).replace("\n", " ")
    figure.alt = f"Five roads from what a camera sees to a pose. {steps}."
    axes = figure.add_subplot()
    axes.set(xlim=(-0.05, 10.3), ylim=(-0.8, 4.5))
    axes.invert_yaxis()
    axes.set_axis_off()
    places = (3.2, 5.7, 8.3)
    for x, name in zip(places, COLUMNS, strict=True):
        axes.text(x, -0.62, name, ha="center", va="center", style="italic", fontsize=11)
    for row, (road, colour) in enumerate(zip(ROADS, COLOURS, strict=False)):
        axes.text(0, row - 0.12, road.paper, va="center", weight="bold", fontsize=10.5)
        axes.text(0, row + 0.29, road.chapters, va="center", fontsize=9.5, color="#444444")
        # The last station is the same for all five: a pose.
        axes.plot([places[0], 9.55], [row, row], color=colour, linewidth=3, zorder=1)
        axes.plot([9.55, 9.95], [row, 2], color=colour, linewidth=3, zorder=1)
        stations = (road.comes_in, road.says, road.becomes)
        for x, text in zip(places, stations, strict=True):
            _station(axes, x, row, text, colour)
    axes.plot([9.95], [2], "o", markersize=34, color="white", markeredgecolor="black", zorder=3)
    axes.text(9.95, 2, "R, t", ha="center", va="center", fontsize=11, weight="bold", zorder=4)
    return figure


def _station(axes: Axes, x: float, y: float, text: str, colour: str) -> None:
    box = FancyBboxPatch(
        (x - 1.05, y - 0.33),
        2.1,
        0.66,
        boxstyle="round,pad=0.02,rounding_size=0.12",
        facecolor="white",
        edgecolor=colour,
        linewidth=1.8,
        zorder=2,
    )
    axes.add_patch(box)
    axes.text(x, y, text, ha="center", va="center", fontsize=9.5, zorder=3)
