"""What chapter 2's figures of single pixels share: a grid, a triangle's letters, edge functions."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from posecore.figures.style import COLOURS, HALO, INK

__all__ = [
    "NAMES",
    "PAIRS",
    "TINTS",
    "centres",
    "edges",
    "grid",
    "name_corners",
    "numbers",
    "signed",
    "tint",
]

NAMES = ("a", "b", "c", "d")
PAIRS = ((1, 2), (2, 0), (0, 1))  # the edges across from a, b and c
TINTS = ("#8fc1e3", "#f6c28b", "#d9d9d9")  # of the half planes of these edges


def edges(corners: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(..., 3) edge functions across from a, b and c."""
    values = []
    for start, end in PAIRS:
        (x0, y0), (x1, y1) = corners[start], corners[end]
        values.append((y1 - y0) * (p[..., 0] - x0) - (x1 - x0) * (p[..., 1] - y0))
    return np.stack(values, -1)


def centres(size: tuple[int, int]) -> np.ndarray:
    """(P, 2) centres of all pixels of an image of (width, height)."""
    return np.stack(np.meshgrid(*map(np.arange, size)), -1).reshape(-1, 2)


def grid(axes: Axes, size: tuple[int, int]) -> None:
    """The borders of the pixels, with their numbers at the sides."""
    width, height = size
    axes.vlines(np.arange(width + 1) - 0.5, -0.5, height - 0.5, color="0.85", lw=0.7, zorder=0.6)
    axes.hlines(np.arange(height + 1) - 0.5, -0.5, width - 0.5, color="0.85", lw=0.7, zorder=0.6)
    axes.set(xlim=(-0.9, width - 0.1), ylim=(height - 0.1, -0.9), aspect="equal")
    axes.set(xticks=range(width), yticks=range(height))
    axes.set_xlabel("x, px", fontsize=9)
    axes.set_ylabel("y, px", fontsize=9)
    axes.tick_params(length=0, labelsize=8)
    axes.spines[:].set_visible(False)


def tint(axes: Axes, wanted: np.ndarray, colour: str) -> None:
    """Fill the pixels that are True in `wanted` (H, W)."""
    for y, x in np.argwhere(wanted):
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fc=colour, ec="0.85", lw=0.7))


def numbers(axes: Axes, values: np.ndarray) -> None:
    """Write each pixel's number (H, W) into it; zeros stand out."""
    for (y, x), value in np.ndenumerate(values):
        look = {"color": INK if value >= 0 else "0.45", "fontsize": 8, "zorder": 7}
        if value == 0:
            look |= {"fontsize": 10, "fontweight": "bold", "path_effects": HALO}
        axes.text(x, y, signed(value), ha="center", va="center", **look)


def name_corners(axes: Axes, corners: np.ndarray, names: Sequence[str], dots: bool = True) -> None:
    """Letters outside the polygon that the corners span."""
    middle = np.mean(corners, axis=0)
    for corner, name in zip(corners, names, strict=True):
        away = (corner - middle) / max(np.linalg.norm(corner - middle), 1e-9)
        look = {"ha": "center", "va": "center", "fontsize": 12, "fontweight": "bold"}
        reach = 13 + 3 * (len(name) - 1)
        place = {"xytext": (reach * away[0], -reach * away[1]), "textcoords": "offset points"}
        if dots:
            axes.plot(*corner, "o", color=COLOURS[1], ms=5, zorder=5)
        axes.annotate(name, corner, **place, **look, path_effects=HALO, zorder=6)


def signed(value: float) -> str:
    """A whole number with a proper minus sign, as the axes have it."""
    return f"{value + 0.0:.0f}".replace("-", "\N{MINUS SIGN}")
