"""The figures of chapter 2 on the pixels of a triangle, and the door to those that follow."""

from collections.abc import Sequence

import numpy as np
from matplotlib.patches import Polygon

from book.ch02_small_worlds.drawing import between, grids, shading
from posecore.figures import Picture
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "barycentric",
    "chessboards",
    "cut_or_not",
    "edge_functions",
    "flat_and_smooth",
    "half_planes",
    "landed",
    "masks",
    "matt",
    "mesh_of",
    "of_clay",
    "shared_edge",
    "spread_beam",
    "still_life",
    "tiles",
    "two_depths",
    "wall_from_above",
    "what_a_pixel_knows",
    "what_is_added",
    "who_is_in_front",
]

NAMES, PAIRS, TINTS = grids.NAMES, grids.PAIRS, grids.TINTS
HATCHES = ("", "///", "...")

wall_from_above, two_depths = between.wall_from_above, between.two_depths
chessboards, who_is_in_front = between.chessboards, between.who_is_in_front
still_life, mesh_of, tiles = shading.still_life, shading.mesh_of, shading.tiles
of_clay, matt = shading.of_clay, shading.matt
what_a_pixel_knows, masks = shading.what_a_pixel_knows, shading.masks
spread_beam, flat_and_smooth = shading.spread_beam, shading.flat_and_smooth
cut_or_not, what_is_added = shading.cut_or_not, shading.what_is_added


def landed(corners: np.ndarray, z: np.ndarray, size: tuple[int, int]) -> Picture:
    """A triangle (3, 2) on the grid of pixels, with the depths (3,) of its corners."""
    places = ", ".join(
        f"{name} at pixel ({x:g}, {y:g})" for name, (x, y) in zip(NAMES, corners, strict=False)
    )
    figure = new_picture(
        4.6,
        3.5,
        f"A grid of {size[0]} by {size[1]} pixels, a dot at the centre of each, and a triangle "
        f"over it: {places}. The corners are {z[0]:g}, {z[1]:g} and {z[2]:g} m away.",
    )
    axes = figure.subplots()
    grids.grid(axes, size)
    axes.add_patch(Polygon(corners, fc=TINTS[0], ec=COLOURS[0], lw=2, alpha=0.7))
    axes.scatter(*grids.centres(size).T, s=5, color="0.3")
    grids.name_corners(
        axes, corners, [f"{name}, {d:g} m" for name, d in zip(NAMES, z, strict=False)]
    )
    return figure


def half_planes(corners: np.ndarray, values: np.ndarray, inside: np.ndarray) -> Picture:
    """Where each edge function is positive, with its numbers, and where all three are.

    Args:
        corners: (3, 2) pixels.
        values: (H, W, 3) edge functions of the edges across from a, b and c.
        inside: (H, W) bool.
    """
    height, width = inside.shape
    figure = new_picture(
        9.0,
        7.1,
        f"Four times a grid of {width} by {height} pixels with a triangle. In the first three, "
        "each pixel shows the number of one edge function: positive and tinted on the triangle's "
        "side of the edge, 0 on the edge, negative and white beyond it. In the last, the "
        f"{inside.sum()} pixels that are positive in all three fill the triangle.",
    )
    panels = figure.subplots(2, 2).ravel()
    for axes, k in zip(panels, (2, 0, 1), strict=False):
        start, end = PAIRS[k]
        grids.grid(axes, (width, height))
        grids.tint(axes, values[..., k] > 0, TINTS[k])
        axes.add_patch(Polygon(corners, fc="none", ec="0.55", lw=1))
        axes.annotate(
            "",
            corners[end],
            corners[start],
            arrowprops={
                "arrowstyle": "-|>",
                "color": COLOURS[1],
                "lw": 2,
                "shrinkA": 6,
                "shrinkB": 6,
            },
        )
        grids.numbers(axes, values[..., k])
        axes.set_title(f"$E_{{{NAMES[start]}{NAMES[end]}}}$", fontsize=13)
    grids.grid(panels[3], (width, height))
    grids.tint(panels[3], inside, TINTS[2])
    panels[3].add_patch(Polygon(corners, fc="none", ec=COLOURS[1], lw=2))
    x, y = grids.centres((width, height)).T
    filled = inside[y, x]
    panels[3].scatter(x[filled], y[filled], s=16, color=INK)
    panels[3].scatter(x[~filled], y[~filled], s=12, fc="white", ec="0.6", linewidths=0.7)
    panels[3].set_title("all three positive", fontsize=11)
    for axes in panels:
        grids.name_corners(axes, corners, NAMES[:3], dots=axes is panels[3])
    return figure


def shared_edge(corners: Sequence[np.ndarray], owners: np.ndarray, on_edge: np.ndarray) -> Picture:
    """Two triangles a, b, c and c, b, d, and who draws which pixel.

    Args:
        corners: a, b, c and d, each (2,).
        owners: (2, H, W) bool, the pixels that each draws.
        on_edge: (H, W) bool, pixels on an edge of the first.
    """
    height, width = on_edge.shape
    first, second = owners
    figure = new_picture(
        5.4,
        4.1,
        f"Two triangles that share the edge from b to c. The first draws {first.sum()} pixels, "
        f"tinted, with round dots, the second {second.sum()}, with square dots; no pixel is drawn "
        f"twice. Rings mark {on_edge.sum()} centres on an edge of the first: "
        f"{(on_edge & first).sum()} on its left edge are its own, {(on_edge & second).sum()} on "
        "the shared edge are the second's, the others nobody's.",
    )
    axes = figure.subplots()
    grids.grid(axes, (width, height))
    corners = np.array(corners)
    for owned, tint, marker, order in (
        (first, TINTS[0], "o", [0, 1, 2]),
        (second, TINTS[1], "s", [2, 1, 3]),
    ):
        grids.tint(axes, owned, tint)
        axes.add_patch(Polygon(corners[order], fc="none", ec="0.35", lw=1.3, zorder=3))
        y, x = np.nonzero(owned)
        axes.scatter(x, y, s=16, color=INK, marker=marker)
    y, x = np.nonzero(on_edge)
    axes.scatter(x, y, s=110, fc="none", ec=COLOURS[1], linewidths=1.6)
    grids.name_corners(axes, corners, NAMES)
    return figure


def barycentric(corners: np.ndarray, size: tuple[int, int]) -> Picture:
    """Lines of equal barycentric coordinates, one panel for each corner."""
    figure = new_picture(
        9.0,
        2.9,
        "The triangle three times, with lines of equal barycentric coordinate. For each corner "
        "they run parallel to the edge across: 0 on that edge, then 0.25, 0.5, 0.75, and 1 at the "
        "corner; the nearer to the corner, the darker.",
    )
    x, y = np.meshgrid(np.linspace(-0.5, size[0] - 0.5, 241), np.linspace(-0.5, size[1] - 0.5, 181))
    values = grids.edges(corners, np.stack([x, y], -1)) / grids.edges(corners, corners[2])[2]
    outside = (values < -1e-3).any(-1)
    for k, axes in enumerate(figure.subplots(1, 3)):
        grids.grid(axes, size)
        beta = np.ma.array(values[..., k], mask=outside)
        levels = np.linspace(0, 1, 5)
        axes.contourf(x, y, beta, levels, colors=["#f2f2f2", "#d2d2d2", "#aaaaaa", "#828282"])
        axes.contour(x, y, beta, levels, colors=INK, linewidths=0.8)
        axes.add_patch(Polygon(corners, fc="none", ec=INK, lw=1.4))
        start, end = (corners[i] for i in PAIRS[k])
        for level in (0, 0.25, 0.5, 0.75):  # half way along the line, whatever the shape
            place = level * corners[k] + (1 - level) * (start + end) / 2
            axes.text(*place, f"{level:g}", ha="center", va="center", fontsize=8, path_effects=HALO)
        axes.set_title(rf"$\beta_{NAMES[k]}$", fontsize=13)
        grids.name_corners(axes, corners, NAMES[:3])
    return figure


def edge_functions(x: int = 6, y: int = 3, c_x: int = 4, c_y: int = 1) -> Picture:
    """The three edge functions of a pixel as areas, and its barycentric coordinates.

    Args:
        x, y: the pixel.
        c_x, c_y: the corner c; a and b stay at (1, 7) and (10, 4).
    """
    corners = np.array([[1.0, 7], [10, 4], [c_x, c_y]])
    p = np.array([x, y], float)
    values = grids.edges(corners, p)
    total = values.sum()
    where = "inside" if (values > 0).all() else "on an edge" if (values >= 0).all() else "outside"
    if total <= 0:
        where = "the triangle has no area" if total == 0 else "seen from behind: not drawn"
    names = [grids.signed(value) for value in values]
    sums = " + ".join(f"({n})" if v < 0 else n for n, v in zip(names, values, strict=True))
    title = f"pixel ({x}, {y}):  {sums} = {grids.signed(total)},  {where}"
    figure = new_picture(
        9.0,
        3.9,
        f"Left: the triangle a, b, c and pixel ({x}, {y}), joined to the corners: three smaller "
        f"triangles, whose double areas with their signs are E_bc = {values[0]:g}, "
        f"E_ca = {values[1]:g} and E_ab = {values[2]:g}; {where}. Right: bars of the barycentric "
        "coordinates" + (" " + ", ".join(f"{v / total:.2f}" for v in values) if total else ""),
    )
    figure.suptitle(title, fontsize=12)
    picture, bars = figure.subplots(1, 2, width_ratios=[1.7, 1])
    grids.grid(picture, (12, 9))
    for k, (start, end) in enumerate(PAIRS):
        part = np.stack([corners[start], corners[end], p])
        look = {"fc": TINTS[k], "ec": "0.4", "lw": 0.8, "hatch": HATCHES[k], "alpha": 0.6}
        if values[k] < 0:
            look |= {"fc": "none", "ls": "--", "hatch": ""}
        picture.add_patch(Polygon(part, **look))
        label = {"ha": "center", "va": "center", "fontsize": 11, "path_effects": HALO}
        picture.text(*part.mean(0), names[k], **label)
    picture.add_patch(Polygon(corners, fc="none", ec=INK, lw=2))
    picture.plot(*p, "o", color=INK, ms=7)
    picture.annotate("p", p, xytext=(7, -9), textcoords="offset points", path_effects=HALO)
    grids.name_corners(picture, corners, NAMES[:3])
    shares = values / total if total else np.zeros(3)
    names = [rf"$\beta_{name}$" for name in NAMES[:3]]
    drawn = bars.barh(names, shares, color=TINTS, ec="0.3")
    for bar, hatch in zip(drawn, HATCHES, strict=True):
        bar.set_hatch(hatch)
    labels = [f"{share:.2f}" for share in shares] if total else ["not defined"] * 3
    bars.bar_label(drawn, labels, padding=4)
    bars.axvline(0, color=INK, lw=1)
    low, high = min(0, shares.min()), max(1, shares.max())
    bars.set(xlim=(low - 0.3 * (high - low), high + 0.3 * (high - low)), xlabel="share")
    bars.invert_yaxis()
    bars.spines[["top", "right"]].set_visible(False)
    return figure
