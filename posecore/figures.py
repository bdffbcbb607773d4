"""Pictures that every part of the book and the command line draw alike."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from posecore.arrays import fail, require_number
from posecore.metrics import auc

__all__ = ["accuracy_curves"]

# Okabe and Ito's colours, told apart by the colour-blind; line styles tell them apart in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", "--", "-.", ":")


def accuracy_curves(
    errors: Mapping[str, np.ndarray],
    max_threshold: float = 0.1,
    *,
    name: str = "ADD",
    unit: str = "mm",
    factor: float = 1000.0,
) -> Figure:
    """Accuracy over threshold, one curve for each set of errors, its area in the legend.

    Args:
        errors: label -> (N,) errors, infinite where the estimate is missing.
        max_threshold: the right end of the axis, in the unit of the errors (0.1 m).
        name: what the errors are, for the axis.
        unit, factor: the unit that the axis shows and what takes errors to it.

    Returns:
        A figure that belongs to no window; save it or let a notebook show it.

    Raises:
        ValueError: if there is nothing to draw, or an error is negative or not a number.
    """
    limit = require_number("max_threshold", max_threshold, above=0)
    if not errors:
        fail("errors", "at least one set of errors", "none")
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for number, (label, values) in enumerate(errors.items()):
        area = 100 * auc(values, limit)  # refuses what is no error
        ordered = np.sort(np.asarray(values, dtype=np.float64))
        steps = ordered[ordered < limit]
        # Accuracy jumps at every error and stays until the next.
        x = np.concatenate([[0.0], steps, [limit]]) * factor
        y = np.concatenate([np.arange(len(steps) + 1), [len(steps)]]) / len(ordered) * 100
        axes.step(
            x,
            y,
            where="post",
            color=COLOURS[number % len(COLOURS)],
            linestyle=STYLES[number % len(STYLES)],
            linewidth=1.8,
            label=f"{label} (area {area:.1f} %)",
        )
    axes.set(
        xlim=(0, limit * factor),
        ylim=(0, 100),
        xlabel=f"threshold on {name}, {unit}",
        ylabel="poses below the threshold, %",
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", frameon=True)
    return figure
