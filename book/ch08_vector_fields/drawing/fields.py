"""The figures of chapter 8 on the field as a picture, and on things that stand before others."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from data_tools.views import View
from posecore.figures import Picture, draw_keypoints, draw_outline, photographs
from posecore.figures.photographs import Window, bare, crop, window_around, without_grain
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "crop",
    "field",
    "fields",
    "hidden",
    "keypoints",
    "patches",
    "question",
    "show_crop",
    "window",
]

window = window_around
show_crop = partial(photographs.show_crop, grain=False)
# Colours of right, down, left and up: bright above, dark below, and no red against green.
STEPS = 12  # colours in a quarter turn; more would only make the files larger
WHEEL = np.array([[213, 94, 0], [32, 24, 96], [86, 180, 233], [250, 240, 130]]) / 255


def question(view: View, mask: np.ndarray, full: np.ndarray, x: np.ndarray) -> Picture:
    """Arrows from what is seen of an object, mask (H, W), towards a point x (2,) that is hidden."""
    figure = new_picture(
        6.4,
        4.4,
        "A crowd of things on a table. A teapot lies behind a can and an egg box, and its spout "
        "cannot be seen. From a dozen places on what is seen of it, arrows point the same way, at "
        "a question mark on the can.",
    )
    axes = figure.subplots()
    box = window(full, x, 0.25)
    show_crop(axes, view.rgb, box)
    draw_outline(axes, mask, colour=COLOURS[0])
    rows, columns = np.nonzero(mask)
    seen = np.stack([columns, rows], -1)
    far = np.full(len(seen), np.inf)
    for _ in range(12):  # spread out: each one far from those before
        start = seen[far.argmax()]
        far = np.minimum(far, np.linalg.norm(seen - start, axis=-1))
        way = 0.11 * (box[2] - box[0]) * (x - start) / np.linalg.norm(x - start)
        arrow = {"arrowstyle": "-|>", "color": INK, "lw": 2, "path_effects": HALO}
        arrow |= {"mutation_scale": 14, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", start + way, start, arrowprops=arrow)
    axes.text(*x, "?", fontsize=26, weight="bold", color=INK, ha="center", va="center",
              path_effects=HALO)  # fmt: skip
    return figure


def keypoints(
    views: Sequence[View], masks: Sequence[np.ndarray], x: Sequence[np.ndarray]
) -> Picture:
    """The keypoints (K, 2) of an object in several pictures, with their numbers."""
    figure = new_picture(
        4.4 * len(views),
        3.4,
        f"{len(views)} pictures of the same teapot, turned differently, with "
        f"{len(x[0])} numbered points: 0 at the tip of the spout, 1 at the handle, others "
        f"around belly and foot, {len(x[0]) - 1} in the middle.",
    )
    for axes, view, mask, pixels in zip(
        np.atleast_1d(figure.subplots(1, len(views))), views, masks, x, strict=True
    ):
        show_crop(axes, view.rgb, window(mask, pixels, 0.1), pale=0.25)
        draw_keypoints(axes, pixels, numbers=True)
    return figure


def fields(
    view: View, mask: np.ndarray, vectors: np.ndarray, x: np.ndarray, chosen: dict[int, str]
) -> Picture:
    """An object, and for some keypoints its field: direction as colour, with arrows.

    Args:
        view: the picture.
        mask: (H, W) bool.
        vectors: (H, W, K, 2), in any unit, 0 outside the mask.
        x: (K, 2) keypoints.
        chosen: number of a keypoint -> its name.
    """
    names = ", ".join(f"{k} ({name})" for k, name in chosen.items())
    figure = new_picture(
        9.4,
        6.0 if len(chosen) > 1 else 3.2,
        f"A teapot, and beside it its pixels coloured by the direction to a keypoint, {names}, "
        "with arrows: yellow is up, orange right, dark blue down, light blue left. For a keypoint "
        "at the rim all colours are alike; around one in the middle all colours meet, and all "
        "arrows point at it.",
    )
    panels = figure.subplots(2 if len(chosen) > 1 else 1, 2).ravel()
    box = window(mask, x, 0.08)
    show_crop(panels[0], view.rgb, box)
    draw_keypoints(panels[0], x[list(chosen)])
    for k in chosen:
        _name(panels[0], str(k), x[k])
    for axes, (k, name) in zip(panels[1:], chosen.items(), strict=True):
        field(axes, mask, vectors[:, :, k], box)
        axes.plot(*x[k], "o", mfc="white", mec=INK, ms=8, mew=1.6)
        axes.set_title(f"to keypoint {k}: {name}", fontsize=11)
    _wheel(panels[-1])
    return figure


def field(axes: Axes, mask: np.ndarray, vectors: np.ndarray, box: Window) -> None:
    """Vectors (H, W, 2) in a window, direction as colour, and some of them as arrows."""
    inside = crop(mask, box)
    colours = np.where(inside[..., None], _hue(crop(vectors, box)), 1.0)
    extent = (box[0] - 0.5, box[2] - 0.5, box[3] - 0.5, box[1] - 0.5)
    axes.imshow(colours, extent=extent, interpolation="nearest")
    axes.set_autoscale_on(False)
    bare(axes)
    step = max((box[2] - box[0]) // 15, 2)
    rows, columns = np.mgrid[box[1] + step // 2 : box[3] : step, box[0] + step // 2 : box[2] : step]
    rows, columns = (part[mask[rows, columns]] for part in (rows, columns))
    v = vectors[rows, columns]
    v = 0.8 * step * v / np.linalg.norm(v, axis=-1, keepdims=True).clip(1e-9)
    look = {"angles": "xy", "scale_units": "xy", "scale": 1, "pivot": "mid", "width": 0.006}
    axes.quiver(columns, rows, *v.T, color=INK, headwidth=4, antialiased=False, **look)


def hidden(
    view: View, mask: np.ndarray, full: np.ndarray, vectors: np.ndarray, x: np.ndarray, k: int
) -> Picture:
    """An object behind others: what is seen of it points at a keypoint that is not seen.

    Args:
        view: the picture.
        mask: (H, W) bool, what is seen.
        full: (H, W) bool, the whole silhouette.
        vectors: (H, W, K, 2), 0 where nothing is seen.
        x: (K, 2) keypoints.
        k: which of them.
    """
    figure = new_picture(
        9.4,
        4.4,
        "Left: a teapot that lies behind an egg box and a can; its outline goes on behind them, "
        f"dashed, and a ring marks keypoint {k}, the tip of the spout, which the can hides. Right: "
        "the pixels that are seen, coloured by direction, with arrows and a few rays; all meet in "
        "the ring.",
    )
    left, right = figure.subplots(1, 2)
    box = window(full, x, 0.2)
    show_crop(left, view.rgb, box)
    draw_outline(left, full, colour=COLOURS[1], style="--", label="behind other things")
    draw_outline(left, mask, colour=COLOURS[0], label="seen")
    left.legend(fontsize=8, loc="lower left")
    field(right, mask, vectors[:, :, k], box)
    draw_outline(right, full, colour="0.6", style="--")
    rows, columns = np.nonzero(mask)
    for n in np.linspace(0, len(rows) - 1, 8).astype(int):
        line = np.stack([[columns[n], rows[n]], x[k]])
        right.plot(*line.T, color="0.35", lw=0.9, ls="--", antialiased=False)
    for axes in (left, right):
        axes.plot(*x[k], "o", mfc="white", mec=INK, ms=10, mew=1.8)
        _name(axes, str(k), x[k])
    _wheel(right)
    return figure


def patches(
    views: dict[str, View], x: dict[str, np.ndarray], free: dict[str, np.ndarray]
) -> Picture:
    """What lies around each keypoint in several pictures, in windows of an eighth of the height.

    Args:
        views: by title.
        x: title -> (K, 2) keypoints.
        free: title -> (K,) bool, not behind another thing.
    """
    count = len(next(iter(x.values())))
    said = "; ".join(
        f"{title}, covered: {', '.join(str(k) for k in np.flatnonzero(~free[title])) or 'none'}"
        for title in views
    )
    figure = new_picture(
        9.4,
        2.5,
        f"Small windows around each of {count} keypoints, one row for each picture. In the first "
        "row parts of the teapot: spout, handle, lid. In the second, windows of covered keypoints, "
        f"with dashed frames, show an egg box or a can in their place. {said}.",
    )
    panels = figure.subplots(len(views), count)
    for number, (row, (title, view)) in enumerate(zip(panels, views.items(), strict=True)):
        half = max(view.shape[0] // 16, 2)
        wide = np.pad(view.rgb, ((half, half), (half, half), (0, 0)), mode="edge")
        corners = np.round(x[title]).astype(int)
        wide = without_grain(wide)
        parts = [wide[b : b + 2 * half + 1, a : a + 2 * half + 1] for a, b in corners]
        for k, (axes, part) in enumerate(zip(row, parts, strict=True)):
            axes.imshow(part, interpolation="nearest")
            axes.plot(half, half, "+", color="white", ms=9, mew=1.6, path_effects=HALO)
            axes.set(xticks=[], yticks=[])
            if not free[title][k]:
                axes.spines[:].set(color=COLOURS[1], linewidth=3, linestyle="--")
            if number == 0:
                axes.set_title(str(k), fontsize=11)
        row[0].set_ylabel(title, fontsize=10)
    return figure


def _hue(vectors: np.ndarray) -> np.ndarray:
    """Colours (..., 3) of the directions of vectors (..., 2)."""
    turn = np.arctan2(vectors[..., 1], vectors[..., 0]) / (np.pi / 2)  # 0 right, 1 down, ...
    turn = np.round(turn * STEPS) / STEPS % 4
    k = np.floor(turn).astype(int) % 4
    share = (turn - np.floor(turn))[..., None]
    return (1 - share) * WHEEL[k] + share * WHEEL[(k + 1) % 4]


def _wheel(axes: Axes) -> None:
    """The key: which colour is which direction."""
    place = axes.inset_axes((0.01, 0.02, 0.2, 0.26))
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 61)] * 2), -1)
    radius = np.linalg.norm(steps, axis=-1)
    ring = np.where(((radius > 0.45) & (radius < 1))[..., None], _hue(steps), 1.0)
    place.imshow(ring, interpolation="nearest")
    ends = [1, 0, -1, 0], [0, 1, 0, -1]
    place.quiver([30] * 4, [30] * 4, *ends, angles="xy", scale=4.6, width=0.03)
    place.axis("off")


def _name(axes: Axes, text: str, place: np.ndarray) -> None:
    look = {"textcoords": "offset points", "fontsize": 12, "path_effects": HALO}
    axes.annotate(text, place, xytext=(7, 7), **look)
