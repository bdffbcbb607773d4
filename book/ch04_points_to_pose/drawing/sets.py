"""Figures of chapter 4 about sets of points: their order, centres, balls, and what a seed sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from torch import Tensor

from posecore.clouds import nearest_neighbours
from posecore.figures import Picture, draw_chart
from posecore.figures.style import COLOURS, HALO, INK, house_style, new_picture, to_floats

__all__ = ["Ball", "Surface", "balls", "centres", "from_the_front", "lent", "seen_by", "shuffles"]

CENTIMETRES = 100.0
PALE = "0.5"
"""Points that are there and not spoken of."""
FAINT = {"head": "0.87", "glasses": "0.6"}
"""The surface that they are of."""

Points = np.ndarray | Tensor


class Ball(NamedTuple):
    """A ball of a cloud.

    Attributes:
        centre: index of its centre.
        inside: indices of all points within it.
        kept: indices of those that are looked at, copies among them.
    """

    centre: int
    inside: Points
    kept: Points


class Surface(NamedTuple):
    """Many points of a head (N, 3) and of its glasses (M, 3), metres: what a cloud is of."""

    head: Points
    glasses: Points


@house_style
def shuffles(outputs: Mapping[str, Points]) -> Picture:
    """What networks say of one cloud whose points come in another order each time.

    Args:
        outputs: title -> (S, C), C numbers for each of S orders.
    """
    spreads = {
        title: float(np.ptp(np.asarray(values), 0).max()) for title, values in outputs.items()
    }
    said = "; ".join(
        f"{title}: {'all flat' if spread < 1e-4 else f'they vary by up to {spread:.2f}'}"
        for title, spread in spreads.items()
    )
    figure = new_picture(
        4.2 * len(outputs), 3.0,
        f"Curves of what a network says of one cloud, over the orders of its points. {said}.",
    )  # fmt: skip
    panels = figure.subplots(1, len(outputs), sharey=True, squeeze=False)[0]
    for axes, (title, values) in zip(panels, outputs.items(), strict=True):
        values = to_floats("outputs", values, "S", "C")
        draw_chart(
            axes, {f"number {k + 1}": column for k, column in enumerate(values.T)},
            x=np.arange(1, len(values) + 1), markers=True, title=title,
            xlabel="order of the points (each drawn anew)", ylabel="what comes out",
            legend="lower right" if axes is panels[-1] else None,
        )  # fmt: skip
    return figure


def from_the_front(axes: Axes, points: Points, **look: object) -> None:
    """Points (N, 3) of the car's frame as the centre camera looks at them, in centimetres."""
    points = to_floats("points", points, "N", 3)
    axes.scatter(*(CENTIMETRES * points[:, :2]).T, **{"linewidths": 0, **look})
    axes.set(xlabel="x, cm", ylabel="y, cm")
    axes.set_aspect("equal", adjustable="datalim")
    if not axes.yaxis_inverted():
        axes.invert_yaxis()


def _behind(axes: Axes, surface: Surface) -> None:
    for name, points in surface._asdict().items():
        if len(points):
            from_the_front(axes, points, s=3, color=FAINT[name])


@house_style
def centres(cloud: Points, choices: Mapping[str, Points], surface: Surface) -> Picture:
    """Centres that were chosen from a cloud in several ways, and the largest hole they leave.

    Args:
        cloud: (N, 3) metres.
        choices: title -> (M,) indices of centres.
        surface: what is drawn faintly behind it.
    """
    cloud = to_floats("cloud", cloud, "N", 3)
    holes = {title: _hole(cloud, cloud[np.asarray(chosen)]) for title, chosen in choices.items()}
    said = "; ".join(f"{title}: {CENTIMETRES * far:.1f} cm" for title, (_, far) in holes.items())
    figure = new_picture(
        3.9 * len(choices), 4.3,
        "A head from the front with its centres as dots. How far the worst point is from its "
        f"nearest centre: {said}.",
    )  # fmt: skip
    panels = figure.subplots(1, len(choices), squeeze=False)[0]
    for axes, (title, chosen) in zip(panels, choices.items(), strict=True):
        _behind(axes, surface)
        from_the_front(axes, cloud, s=5, color=PALE)
        from_the_front(axes, cloud[np.asarray(chosen)], s=34, color=COLOURS[0])
        worst, far = holes[title]
        from_the_front(axes, cloud[[worst]], s=70, color=COLOURS[1], marker="X", edgecolors="white",
                       linewidths=0.8)  # fmt: skip
        axes.set_title(f"{title}\nworst point (X): {CENTIMETRES * far:.1f} cm away", fontsize=10)
    return figure


def _hole(cloud: np.ndarray, chosen: np.ndarray) -> tuple[int, float]:
    """The point that is farthest from its nearest centre, and how far that is."""
    far = np.asarray(nearest_neighbours(chosen, cloud)[0])[:, 0]
    return int(far.argmax()), float(far.max())


@house_style
def balls(cloud: Points, drawn: Mapping[str, Ball], radius: float, surface: Surface) -> Picture:
    """Balls of a cloud from the front: what is in them, and what of it is looked at.

    Args:
        cloud: (N, 3) metres.
        drawn: title -> a ball.
        radius: of all, metres.
        surface: what is drawn faintly behind it.
    """
    cloud = to_floats("cloud", cloud, "N", 3)
    counts = {title: (len(b.inside), len(np.unique(b.kept))) for title, b in drawn.items()}
    said = "; ".join(f"{title}: {n} points, {k} kept" for title, (n, k) in counts.items())
    figure = new_picture(
        3.9 * len(drawn), 4.5,
        f"A head from the front, with balls of {CENTIMETRES * radius:g} cm about some centres. "
        f"{said}.",
    )  # fmt: skip
    panels = figure.subplots(1, len(drawn), squeeze=False)[0]
    for axes, (title, ball) in zip(panels, drawn.items(), strict=True):
        kept = np.unique(np.asarray(ball.kept))
        dropped = np.setdiff1d(np.asarray(ball.inside), kept)
        _behind(axes, surface)
        from_the_front(axes, cloud, s=6, color=PALE)
        if len(dropped):
            from_the_front(axes, cloud[dropped], s=26, facecolors="white", edgecolors=COLOURS[1],
                           linewidths=1.3, label="in the ball, left out")  # fmt: skip
        from_the_front(axes, cloud[kept], s=30, color=COLOURS[0], label="kept")
        centre = cloud[ball.centre]
        cross = {"color": INK, "marker": "+", "linewidths": 2}
        from_the_front(axes, centre[None], s=80, label="centre", **cross)
        ring = {"fill": False, "edgecolor": INK, "linewidth": 1.2, "linestyle": "--"}
        axes.add_patch(Circle(CENTIMETRES * centre[:2], CENTIMETRES * radius, **ring))
        axes.set_title(f"{title}\n{counts[title][0]} in the ball, {len(kept)} kept", fontsize=10)
        axes.autoscale_view()
    figure.legend(*_all_labels(panels), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _all_labels(panels: np.ndarray) -> tuple[list, list]:
    found: dict[str, object] = {}
    for axes in panels:
        handles, names = axes.get_legend_handles_labels()
        found |= dict(zip(names, handles, strict=True))
    return list(found.values()), list(found)


@house_style
def seen_by(cloud: Points, seeds: Mapping[str, tuple[Points, Points]], surface: Surface) -> Picture:
    """What points of a cloud the features of some seeds depend on, from the front.

    Args:
        cloud: (N, 3) metres.
        seeds: title -> where the seed is (3,), and which points it knows of, (N,) bool.
        surface: what is drawn faintly behind it.
    """
    cloud = to_floats("cloud", cloud, "N", 3)
    shares = {title: float(np.mean(np.asarray(mask))) for title, (_, mask) in seeds.items()}
    said = ", ".join(f"{title}: {share:.0%}" for title, share in shares.items())
    figure = new_picture(
        3.1 * len(seeds), 3.9,
        "A head from the front; coloured are the points that one seed depends on, a larger part "
        f"at every level. {said}.",
    )  # fmt: skip
    panels = figure.subplots(1, len(seeds), squeeze=False)[0]
    for axes, (title, (place, mask)) in zip(panels, seeds.items(), strict=True):
        mask = np.asarray(mask, bool)
        _behind(axes, surface)
        from_the_front(axes, cloud, s=6, color=PALE)
        if mask.any():
            from_the_front(axes, cloud[mask], s=20, color=COLOURS[0])
        from_the_front(axes, to_floats("seed", place, 3)[None], s=130, color=COLOURS[1], marker="*",
                       edgecolors="white", linewidths=0.7)  # fmt: skip
        axes.set_title(f"{title}\n{mask.sum()} of {len(cloud)} points", fontsize=10)
    return figure


@house_style
def lent(point: Points, coarse: Points, near: Points, weights: Points, surface: Surface) -> Picture:
    """A point, the coarse points about it, and the three that lend it their features.

    Args:
        point: (3,) metres.
        coarse: (S, 3) metres.
        near: (3,) indices of those that lend.
        weights: (3,) their shares.
        surface: what is drawn faintly behind it.
    """
    point, coarse = to_floats("point", point, 3), to_floats("coarse", coarse, "S", 3)
    weights = to_floats("weights", weights, "K")
    shares = ", ".join(f"{weight:.2f}" for weight in weights)
    figure = new_picture(
        4.8, 4.2,
        f"A point between coarse ones; the three nearest lend it their features with shares "
        f"{shares}, the nearest most.",
    )  # fmt: skip
    axes = figure.subplots()
    _behind(axes, surface)
    from_the_front(axes, coarse, s=40, color=PALE)
    for index, weight in zip(np.asarray(near), weights, strict=True):
        ends = CENTIMETRES * np.stack([point, coarse[index]])
        axes.plot(*ends.T[:2], color=COLOURS[0], lw=1 + 8 * weight, zorder=1)
        middle = ends.mean(0)
        text = axes.text(*middle[:2], f"{weight:.2f}", ha="center", va="center", zorder=4)
        text.set_path_effects(HALO)
    from_the_front(axes, coarse[np.asarray(near)], s=60, color=COLOURS[0])
    from_the_front(axes, point[None], s=110, color=COLOURS[1], marker="X", edgecolors="white",
                   linewidths=0.8, zorder=3)  # fmt: skip
    axes.set_title("X takes a share of each of its three nearest", fontsize=10)
    return figure
