"""The figures of chapter 8 on the network: its layers, dilation, and how far a pixel sees."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from posecore.figures import Picture, picture
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = ["dilation", "hourglass", "seen_squares"]


def hourglass(maps: Mapping[str, tuple[int, int, int]], skips: Mapping[str, str]) -> Picture:
    """The maps of a network as boxes: as high as they are, as wide as they have channels.

    Args:
        maps: name -> (channels, height, width), in the order of computation.
        skips: name of a map -> name of the later one that sees it too.
    """
    said = ", ".join(f"{name} {c} at {h} x {w}" for name, (c, h, w) in maps.items())
    figure = new_picture(
        9.6,
        3.4,
        "A row of boxes that grow lower and wider to the middle and higher and narrower again, "
        f"with arcs from the left half to the right. Channels and size: {said}.",
    )
    axes = figure.subplots()
    tallest = max(h for _, h, _ in maps.values())
    left, middles, tops = 0.0, {}, {}
    for number, (name, (channels, high, wide)) in enumerate(maps.items()):
        width, height = 0.05 + 0.115 * np.sqrt(channels), 4.0 * (high / tallest) ** 0.55
        colour = ("0.85", "#9ecae1", "#fdd0a2")[1 + (name.startswith(("stride", "coarse")))]
        colour = "0.85" if number == 0 else colour
        axes.add_patch(Rectangle((left, -height / 2), width, height, fc=colour, ec=INK, lw=1))
        middles[name], tops[name] = left + width / 2, height / 2
        axes.text(middles[name], -2.2, f"{name}\n{channels}", ha="center", va="top", fontsize=8.5)
        axes.text(middles[name], 0, f"{wide} x {high}", ha="center", va="center", fontsize=7.5,
                  rotation=90, path_effects=HALO)  # fmt: skip
        left += width + 0.72
    for start, end in skips.items():
        a, b = (middles[start], tops[start]), (middles[end], tops[end])
        style = {"arrowstyle": "-|>", "color": COLOURS[1], "lw": 1.5, "mutation_scale": 12,
                 "connectionstyle": f"arc3,rad={-0.9 / np.sqrt(b[0] - a[0]):.2f}"}  # fmt: skip
        axes.annotate("", b, a, arrowprops=style)
    axes.set(xlim=(-0.4, left - 0.3), ylim=(-3.1, 3.9))
    axes.axis("off")
    return figure


def dilation() -> Picture:
    """A 3x3 behind a stride of two, and the same nine taps without the stride."""
    figure = new_picture(
        8.6,
        3.1,
        "Three grids of pixels. Left, after a stride of two every second pixel is kept, and nine "
        "kept neighbours in a square are the taps of a 3x3. Middle, all pixels are kept, and the "
        "nine taps are the same pixels, with one pixel between them. Right, the same nine taps "
        "moved by one pixel: an output that the stride would have skipped.",
    )
    titles = ("stride 2, then 3x3", "no stride, 3x3 dilated by 2", "... and one pixel on")
    for axes, title, kept, shift in zip(
        figure.subplots(1, 3), titles, (2, 1, 1), (0, 0, 1), strict=True
    ):
        _grid(axes, kept, shift)
        axes.set_title(title, fontsize=11)
    return figure


def seen_squares(
    image: np.ndarray, centre: tuple[int, int], sides: Mapping[str, Sequence[int]]
) -> Picture:
    """How far one pixel sees: squares around it on a picture.

    Args:
        image: (H, W, 3).
        centre: x, y of the pixel.
        sides: name -> (side of the square, side without dilation), pixels, rising.
    """
    said = "; ".join(f"{n}: {a}" + (f", {b} undilated" * (a != b)) for n, (a, b) in sides.items())
    height, width = image.shape[:2]
    figure = picture(
        image,
        width=5.6,
        alt="A frame with things on a table. Squares around one pixel show what reaches it, side "
        f"in pixels after each stage. {said}. The largest goes far beyond the frame.",
    )
    axes = figure.axes[0]
    x, y = centre
    for number, (name, (side, plain)) in enumerate(sides.items()):
        colour = COLOURS[number % len(COLOURS)]
        for edge, style in ((plain, ":"), (side, "-")):
            corner = (x - edge / 2, y - edge / 2)
            axes.add_patch(Rectangle(corner, edge, edge, fc="none", ec="white", lw=3.4))
            axes.add_patch(Rectangle(corner, edge, edge, fc="none", ec=colour, lw=1.8, ls=style))
        axes.text(x, y - side / 2 - 3, f"{name}, {side} px", color=colour, ha="center",
                  va="bottom", fontsize=9, fontweight="bold", path_effects=HALO)  # fmt: skip
    axes.plot(x, y, "o", color=INK, mec="white", ms=7)
    reach = max(side for side, _ in sides.values()) / 2 + 24
    axes.set(xlim=(min(-6, x - reach), max(width + 5, x + reach)))
    axes.set(ylim=(max(height + 5, y + reach), min(-6, y - reach)))
    return figure


def _grid(axes: Axes, kept: int, shift: int) -> None:
    """Nine by nine pixels: those that are kept, and the nine taps around the middle one."""
    taps = {(4 + shift + a, 4 + b) for a in (-2, 0, 2) for b in (-2, 0, 2)}
    for x in range(9):
        for y in range(9):
            here = x % kept == 0 and y % kept == 0
            fill = COLOURS[0] if (x, y) in taps else ("0.88" if here else "white")
            edge = "0.5" if here else "0.9"
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fc=fill, ec=edge, lw=0.8))
            if (x, y) in taps:
                axes.plot(x, y, "+", color="white", ms=9, mew=2)
    axes.plot(4 + shift, 4, "o", color="white", mec=INK, ms=10)
    axes.set(xlim=(-0.6, 8.6), ylim=(8.6, -0.6), aspect="equal")
    axes.axis("off")
