"""The figures of chapter 5 on what was measured: Table IV, the teapot, representation and loss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import NullFormatter

from book.tools.keys import Key, select
from data_tools.renderer import Ambient, Light, render_colour
from data_tools.sensors import rgb_sensor
from data_tools.worlds.tabletop_scenes import prepared
from posecore import cameras
from posecore.figures import Picture, chart
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "SAME_K",
    "crossed",
    "looks",
    "same_rotation",
    "seen",
    "table_iv",
    "tails",
]

# Mean and largest error, degrees.
PAPER = {
    "quaternion": (1.52, 71.24),
    "6d": (0.49, 1.78),
    "procrustes": (0.38, 1.11),
    "learnable": (0.68, 1.70),
}
LOSSES = ("output", "chordal", "geodesic")
SPLITS = ("easy", "occluded")
TEAPOT = 5
SAME_K = np.array([[260.0, 0, 279.5], [0, 260.0, 74.5], [0, 0, 1]])
"""The wide camera of `same_rotation`, 560 x 150 pixels."""


def tails(errors: Mapping[str, np.ndarray]) -> Picture:
    """The whole distribution of errors in degrees: how many are larger, both axes logarithmic."""
    worst = ", ".join(f"{name} {gap.max():.3g}°" for name, gap in errors.items())
    curves, ends, looks = {}, {}, {}
    for number, (name, gap) in enumerate(errors.items()):
        gap = np.sort(gap)
        share = 1 - np.arange(len(gap)) / len(gap)
        # A line needs few of many thousand points, but all of the last.
        keep = len(gap) - np.unique(np.geomspace(1, len(gap), 200).astype(int))[::-1]
        curves[name] = gap[keep], share[keep]
        ends[f"_{name}"] = gap[-1:], share[-1:]
        looks[name] = {"lw": 1.8 if number < 4 else 1.2}
        looks[f"_{name}"] = {"color": COLOURS[number], "ms": 6}
    return chart(
        curves,
        marks=ends,
        looks=looks,
        log="xy",
        xlabel="error, degrees",
        ylabel="share of rotations with\na larger error",
        xlim=(0.01, 200),
        xticks=[0.01, 0.1, 1, 10, 100],
        legend={"loc": "lower left", "ncols": 2},
        size=(7.2, 3.6),
        alt="Curves of the share of rotations whose error is larger than what the axis below says. "
        "All fall from left to right; where they end is the worst rotation of all: " + worst + ".",
    )


def table_iv(numbers: Mapping[Key, np.ndarray]) -> Picture:
    """Mean and largest errors, a mark for each seed, and the paper's beside them.

    Args:
        numbers: key -> (seeds,), of the metrics "rotation", the mean, and "rotation largest".
    """
    means, largest = (
        {key.method: values for key, values in select(numbers, metric=metric).items()}
        for metric in ("rotation", "rotation largest")
    )
    names = list(means or PAPER)
    said = "; ".join(
        f"{name} {means[name].mean():.2f}° and {largest[name].mean():.3g}°" for name in means
    )
    marks, looks, paper = {}, {}, []
    for k, (label, table) in enumerate((("mean", means), ("largest", largest))):
        place = {name: number - 0.12 + 0.24 * k for number, name in enumerate(names)}
        seeds = [(place[n] + np.linspace(-0.05, 0.05, len(v)), v) for n, v in table.items()]
        if seeds:
            marks[label] = tuple(np.concatenate(part) for part in zip(*seeds, strict=True))
        looks[label] = {"color": COLOURS[k], "marker": "os"[k]}
        paper += [(place[n], PAPER[n][k]) for n in names if n in PAPER]
    marks["the paper's"] = tuple(np.transpose(paper))
    looks["the paper's"] = {"color": INK, "marker": "x", "ms": 9, "mew": 1.8}
    return chart(
        {},
        marks=marks,
        looks=looks,
        log="y",
        xlabel="",
        ylabel="error, degrees",
        xticks=dict(enumerate(names)),
        yticks=[0.3, 1, 3, 10, 30, 100, 180],
        grid="y",
        legend="upper left",
        size=(7.4, 3.1),
        alt="Mean and largest errors of the representations on a logarithmic axis, a dot for each "
        f"seed, crosses for the paper's. Mean and largest: {said or 'not measured yet'}.",
    )


def same_rotation(R: np.ndarray, places: np.ndarray) -> Picture:
    """The teapot at several places (N, 3) of one picture, turned alike in the camera's frame.

    The camera is `SAME_K`.
    """
    picture = render_colour(
        [prepared(TEAPOT)] * len(places),
        [(R, t) for t in places],
        SAME_K,
        (560, 150),
        [Light(np.array([-0.8, -2.0, -0.5]), 1.2, radius=0.0, shadows=False)],
        ambient=Ambient((0.5, 0.5, 0.5), (0.3, 0.3, 0.3), up=np.array([0.0, -1, 0])),
        background=0.75,
    )
    image = rgb_sensor(picture, np.random.default_rng(0), exposure=0.9,
                       shot_noise=0.0, read_noise=0.0, blur=0.0)  # fmt: skip
    figure = new_picture(
        8.4,
        2.6,
        f"{len(places)} teapots side by side in one wide picture. All have the same rotation in "
        "the camera's frame, and each shows another side of itself: the camera sees them from "
        "different directions.",
    )
    axes = figure.subplots()
    axes.imshow(image)
    for (u, v), t in zip(cameras.project(SAME_K, places), places, strict=True):
        angle = np.degrees(np.arctan2(np.hypot(t[0], t[1]), t[2]))
        axes.text(u, v + 56, f"ray {angle:.0f}° off the axis", ha="center", fontsize=9)
    axes.axis("off")
    return figure


def looks(images: np.ndarray, R: np.ndarray, columns: int = 6) -> Picture:
    """Crops (N, H, W, 3), with the object's axes as R (N, 3, 3) turns them drawn at the middle."""
    rows = -(-len(images) // columns)
    figure = new_picture(
        8.4,
        1.45 * rows,
        f"{len(images)} small pictures of the teapot: cut out, turned, recoloured, before other "
        "backgrounds, some half hidden. Three axes drawn over each turn with the teapot.",
    )
    panels = np.reshape(figure.subplots(rows, columns), -1)
    for axes, image, turned in zip(panels, images, R, strict=False):
        axes.imshow(image, interpolation="nearest")  # a smaller file than a smooth one
        middle = (np.array(image.shape[1::-1]) - 1) / 2
        for k, colour in enumerate((COLOURS[1], COLOURS[2], COLOURS[0])):
            tip = middle + 0.42 * len(image) * turned[:2, k]
            (line,) = axes.plot(*np.transpose([middle, tip]), color=colour, lw=2.2)
            line.set_path_effects(HALO)
    for axes in panels:
        axes.axis("off")
    return figure


def seen(tables: Mapping[str, Mapping[Key, np.ndarray]], names: Sequence[str]) -> Picture:
    """Mean errors on the teapot by representation, a mark for each seed.

    Args:
        tables: "image" or "points" -> key -> (seeds,), with the splits "easy" and "occluded".
        names: of the methods.
    """
    said = "; ".join(
        f"from its {kind}, {name} "
        + " and ".join(f"{table[_mean(name, split)].mean():.0f}°" for split in SPLITS)
        for kind, table in tables.items()
        for name in names
        if _mean(name, "easy") in table
    )
    figure = new_picture(
        8.4,
        3.0,
        "Mean errors on the teapot, a mark for each seed, for the four representations, easy and "
        f"occluded. {said or 'Not measured yet'}.",
    )
    panels = figure.subplots(1, len(tables), sharey=True)
    for axes, (kind, table) in zip(np.atleast_1d(panels), tables.items(), strict=True):
        for place, name in enumerate(names):
            for k, split in enumerate(SPLITS):
                values = table.get(_mean(name, split), np.array([]))
                where = place - 0.14 + 0.28 * k + np.linspace(-0.05, 0.05, len(values))
                label = split if place == 0 else None
                axes.plot(where, values, "os"[k], color=COLOURS[k], ms=6, label=label)
        axes.set_xticks(range(len(names)), [name.replace(", ", "\n") for name in names], fontsize=8)
        axes.set(title=f"from its {kind}", xlim=(-0.5, len(names) - 0.5))
        axes.grid(alpha=0.3, axis="y")
    # The panels share their axis: its end is known once all of them have been drawn.
    np.atleast_1d(panels)[0].set_ylim(bottom=0)
    np.atleast_1d(panels)[0].set_ylabel("mean error, degrees")
    np.atleast_1d(panels)[-1].legend(fontsize=9, loc="lower right")
    return figure


def crossed(tables: Mapping[str, Mapping[Key, np.ndarray]], splits: Mapping[str, str]) -> Picture:
    """Representation (rows) and loss (columns) crossed: mean ± deviation over seeds.

    Args:
        tables: title -> key -> (seeds,), with methods such as "6d, chordal".
        splits: title -> the split, where there is one.
    """
    names = ("quaternion", "6d", "procrustes", "learnable")
    figure = new_picture(
        8.8,
        2.9,
        "Tables of mean errors, representation by loss. "
        + " ".join(_best(title, table, splits.get(title, "")) for title, table in tables.items()),
    )
    panels = figure.subplots(1, len(tables), sharey=True)
    for axes, (title, table) in zip(np.atleast_1d(panels), tables.items(), strict=True):
        means = np.full((len(names), len(LOSSES)), np.nan)
        for i, name in enumerate(names):
            for j, loss in enumerate(LOSSES):
                values = table.get(_mean(f"{name}, {loss}", splits.get(title, "")))
                if values is None:
                    same = "as\nprocrustes" if name == "learnable" and loss != "output" else "–"
                    axes.text(j, i, same, ha="center", va="center", fontsize=8, color="0.4")
                    continue
                means[i, j] = values.mean()
                digits = 2 if values.mean() < 10 else 1
                text = f"{values.mean():.{digits}f}\n± {values.std(ddof=1):.{digits}f}"
                axes.text(j, i, text, ha="center", va="center", fontsize=9, linespacing=0.95)
        if np.isfinite(means).any():
            limits = LogNorm(np.nanmin(means), 6 * np.nanmax(means))
            axes.imshow(means, cmap="Greys", norm=limits, aspect="auto")
        axes.set_xticks(range(len(LOSSES)), LOSSES)
        axes.set_yticks(range(len(names)), names)
        axes.set(xlim=(-0.5, 2.5), ylim=(3.5, -0.5), xlabel="loss")
        axes.set_title(title, fontsize=10)
    return figure


def _mean(method: str, split: str) -> Key:
    return Key(method, split, "rotation")


def _best(title: str, table: Mapping[Key, np.ndarray], split: str) -> str:
    sides = {
        key.method: values.mean()
        for key, values in select(table, split=split, metric="rotation").items()
        if key.method.rpartition(", ")[2] in LOSSES
    }
    if not sides:
        return f"{title}: not measured yet."
    order = sorted(sides, key=sides.__getitem__)
    return (
        f"{title}: least for {order[0]}, {sides[order[0]]:.2g}°, and most for {order[-1]}, "
        f"{sides[order[-1]]:.2g}°."
    )


def _degrees(axes: Axes, which: str, ticks: Sequence[float]) -> None:
    axes.set(**{f"{which}scale": "log", f"{which}label": "error, degrees"})
    axis = getattr(axes, f"{which}axis")
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3, axis=which)
