"""The figures of chapter 03."""

from __future__ import annotations

import numpy as np

from posecore.figures import Picture
from posecore.figures.style import COLOURS, INK, new_picture

__all__ = ["distances"]


def distances(z_gt: np.ndarray, z_est: np.ndarray) -> Picture:
    """True distances (N,) and estimated ones, metres."""
    off = 1000 * np.median(np.abs(z_est - z_gt))
    alt = f"Estimated over true distances in metres; half are off by less than {off:.0f} mm."
    figure = new_picture(4.6, 3.6, alt, "")
    axes = figure.subplots()
    axes.axline((1, 1), slope=1, color=INK, linewidth=1, label="right")
    axes.plot(z_gt, z_est, "o", color=COLOURS[0], markerfacecolor="none", label="estimated")
    axes.set(xlabel="true distance, m", ylabel="estimated distance, m")
    axes.legend()
    return figure
