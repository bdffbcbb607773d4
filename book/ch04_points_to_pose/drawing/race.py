"""Figures of chapter 4 about what methods err: against the true angle, and of random bins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from posecore.arrays import fail
from posecore.figures import Picture, draw_chart
from posecore.figures.style import COLOURS, house_style, new_picture, to_floats
from posecore.methods.points_to_pose.evaluation import AngleBin

__all__ = ["by_angle", "random_bins"]


@house_style
def by_angle(methods: Mapping[str, Sequence[AngleBin]], width: float = 5.0) -> Picture:
    """Mean error in every bin of the true angle, and how many poses there are in it.

    Args:
        methods: label -> bins, as by `PoseErrors.bins`; of all on the same poses.
        width: degrees, of a bin.

    Raises:
        ValueError: if there are none, or methods have other bins.
    """
    first = next(iter(methods.values()), ())
    counts = {one.low: one.count for one in first}
    if not counts:
        fail("methods", "bins of at least one method", dict(methods))
    for name, bins in methods.items():
        if {one.low: one.count for one in bins} != counts:
            fail("methods", "the same bins of all", f"others of {name}")
    figure = new_picture(
        7.4, 4.6,
        f"Above, the mean yaw error of {', '.join(methods)} in bins of {width:g} degrees of the "
        "true yaw. Below, how many views are in each bin, on a logarithmic scale: most look "
        "straight ahead, very few far to a side.",
    )  # fmt: skip
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    middles = np.array(list(counts)) + width / 2
    curves = {name: [one.error for one in bins] for name, bins in methods.items()}
    draw_chart(upper, curves, x=middles, markers=True, xlabel="", ylabel="yaw error, degrees")
    lower.bar(middles, list(counts.values()), 0.85 * width, color="0.6", log=True)
    lower.set(xlabel="size of the true yaw, degrees", ylabel="views")
    return figure


@house_style
def random_bins(classes: Tensor, probabilities: Tensor, true: float, found: float) -> Picture:
    """Sets of classes drawn at random, how likely a network finds each, and what they come to.

    Args:
        classes: (M, L) degrees, the classes' values.
        probabilities: (M, L) of each set.
        true, found: degrees, the label and the mean over all sets.

    Raises:
        ValueError: if shapes do not fit.
    """
    values = to_floats("classes", classes, "M", "L")
    shares = to_floats("probabilities", probabilities, *values.shape)
    figure = new_picture(
        7.4, 3.2,
        f"{len(values)} rows of class values drawn at random over the range of an angle; the size "
        f"of a dot is its probability. Near the true angle, {true:.0f} degrees, dots are large in "
        f"every row. The mean over all rows is {found:.1f} degrees.",
    )  # fmt: skip
    axes = figure.subplots()
    for row, (value, share) in enumerate(zip(values, shares, strict=True)):
        axes.scatter(value, np.full(len(value), row), s=4 + 900 * share, color=COLOURS[0],
                     alpha=0.7, linewidths=0)  # fmt: skip
    axes.axvline(true, color="0.35", label="true")
    axes.axvline(found, color=COLOURS[1], linestyle="--", label="mean of all sets")
    axes.set(xlabel="yaw, degrees", ylabel="set of classes", yticks=range(len(values)))
    axes.set_ylim(-0.6, len(values) - 0.4)
    axes.invert_yaxis()
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
