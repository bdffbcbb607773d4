"""The figures of chapter 5 on numbers that tear, and the door to those on Procrustes."""

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.patches import Circle

from book.ch05_learnable_rotations.drawing import procrustes as more
from book.ch05_learnable_rotations.drawing import turning
from posecore import rotations
from posecore.figures import Picture, chart, draw_chart
from posecore.figures.style import COLOURS, INK, STYLES, new_picture

__all__ = [
    "autograd_fails",
    "discs",
    "errors_on_circle",
    "gram_schmidt",
    "on_a_line",
    "once_round",
    "question",
    "screws",
    "shaken",
    "slices",
    "torn_circle",
    "two_turns",
    "walks",
]

question, once_round, two_turns = turning.question, turning.once_round, turning.two_turns
gram_schmidt, on_a_line, screws = more.gram_schmidt, more.on_a_line, more.screws
autograd_fails, shaken = more.autograd_fails, more.shaken

ANGLE_AXIS = {
    "log": "y",
    "xlabel": r"angle $\theta$, degrees",
    "ylabel": "largest error nearby, degrees",
    "ylim": (1e-2, 400),
    "xticks": range(-180, 181, 90),
    "yticks": [0.01, 0.1, 1, 10, 180],
}
PLANES = (("x", "y"), ("y", "z"), ("z", "x"))


def torn_circle(theta: np.ndarray, answer: np.ndarray) -> Picture:
    """The angle as a height over the circle, and what a network says, both (8 N + 1,) radians."""
    gap = np.degrees(np.abs(np.angle(np.exp(1j * (answer - theta)))))
    figure = new_picture(
        8.6,
        3.6,
        "Left, in space: a circle on the ground, and over it a ramp, whose height is the angle. It "
        "winds up once round from -180 to 180 degrees and is torn where its ends meet, one above "
        "the other. The network's curve lies on the ramp, except at the tear, where it falls from "
        "the upper end to the lower. Right: its error over the angle, up to "
        f"{gap.max():.0f} degrees at the tear, and small elsewhere.",
    )
    grid = figure.add_gridspec(1, 2, width_ratios=[1, 1.15])
    space = figure.add_subplot(grid[0], projection="3d")
    x, y, heights = np.cos(theta), np.sin(theta), np.degrees(theta)
    space.plot(x, y, np.full(len(x), -180.0), color="0.6", lw=1)
    space.plot(x, y, heights, color=COLOURS[0], lw=5, alpha=0.55, label="the angle")
    space.plot(x, y, np.degrees(answer), color=COLOURS[1], lw=1.8, label="the network's answer")
    space.plot([-1, -1], [0, 0], [-180, 180], color=INK, lw=1, ls=":")
    space.view_init(24, -125)
    space.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], zticks=[-180, -90, 0, 90, 180])
    space.set(xlabel=r"$\cos\theta$", ylabel=r"$\sin\theta$")
    space.set_title("height: degrees", fontsize=10)
    space.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.0), fontsize=9, frameon=False)
    flat = figure.add_subplot(grid[1])
    look = {"color": COLOURS[1], "ls": "-", "lw": 1.5}
    draw_chart(flat, {"gap": _envelope(theta, gap)}, looks={"gap": look}, **ANGLE_AXIS)
    return figure


def errors_on_circle(theta: np.ndarray, errors: Mapping[str, np.ndarray]) -> Picture:
    """Errors (8 N + 1,) in degrees over the circle, one line each: the largest of 8 neighbours."""
    worst = ", ".join(f"{name} {gap.max():.1f}" for name, gap in errors.items())
    return chart(
        {name: _envelope(theta, gap) for name, gap in errors.items()},
        **ANGLE_AXIS,
        legend={"loc": "upper center", "frameon": False},
        size=(7.0, 2.9),
        alt="Errors of networks over the angle, on a log axis, low except in a narrow peak where "
        f"there is one. The largest, in degrees: {worst}.",
    )


def slices(n: int) -> np.ndarray:
    """Rotations (3, n, n, 3, 3) whose axis-angle vectors fill squares around three discs.

    Args:
        n: even, as `discs` shows the worst of 2 x 2.
    """
    return rotations.axis_angle_to_matrix(_vectors(n))


def discs(errors: Mapping[str, np.ndarray], planes: int = 3) -> Picture:
    """Errors (3, n, n) in degrees at the rotations of `slices`, in discs through the ball.

    Args:
        errors: name of the network -> its errors. A pixel shows the largest of 2 x 2.
        planes: how many discs of each; with 1, all stand in one row.
    """
    errors = {
        name: gap.reshape(3, gap.shape[1] // 2, 2, -1, 2).max((2, 4))
        for name, gap in errors.items()
    }
    n = next(iter(errors.values())).shape[-1]
    inside = np.linalg.norm(_vectors(n)[0], axis=-1) <= np.pi
    worst = {name: gap[:planes, inside].max() for name, gap in errors.items()}
    look = {name: "a bright band from rim to rim" if worst[name] > 90 else "none" for name in worst}
    bands = "; ".join(f"{name}: {look[name]}, up to {worst[name]:.0f} degrees" for name in worst)
    rows, columns = (len(errors), 3) if planes == 3 else (1, len(errors))
    figure = new_picture(
        9.0 if planes == 3 else 10.0,
        2.75 * rows if planes == 3 else 2.5,
        "Discs cut through the ball of axis-angle vectors, coloured by the error of a network at "
        f"each rotation, dark where small, bright where large. {bands}.",
    )
    panels = np.reshape(figure.subplots(rows, columns), -1)
    shown = [(name, plane) for name in errors for plane in range(planes)]
    for axes, (name, plane) in zip(panels, shown, strict=True):
        picture = np.ma.array(np.clip(errors[name][plane], 0.3, 180), mask=~inside)
        image = axes.imshow(
            picture,
            norm=LogNorm(0.3, 180),
            cmap=colormaps["inferno"].resampled(12),  # few colours make a small file
            extent=(-180, 180, -180, 180),
            origin="lower",
            interpolation="nearest",
        )
        axes.add_patch(Circle((0, 0), 180, fc="none", ec="0.4", lw=1))
        axes.set(xlim=(-190, 190), ylim=(-190, 190), xticks=[-180, 0, 180], yticks=[-180, 0, 180])
        axes.spines[:].set_visible(False)
        axes.set_title(name, fontsize=10)
        axes.set_xlabel(rf"$\omega_{PLANES[plane][0]}$, degrees", fontsize=9, labelpad=0)
        axes.set_ylabel(rf"$\omega_{PLANES[plane][1]}$", fontsize=9, labelpad=-12)
    bar = figure.colorbar(image, ax=panels, shrink=0.8, pad=0.01, label="error, degrees")
    bar.set_ticks([0.3, 1, 3, 10, 30, 180], labels=["0.3", "1", "3", "10", "30", "180"])
    bar.minorticks_off()
    return figure


def walks(turn: np.ndarray, along: Mapping[str, np.ndarray]) -> Picture:
    """Inner products (axes, N) of carried quaternions along full turns, one panel each network."""
    figure = new_picture(
        9.0,
        3.0,
        "One panel each for " + ", ".join(along) + ". Each curve is a full turn about another "
        "axis. It changes over steeply, once or more often, between a height and its opposite, and "
        "ends at the opposite of where it began. Rings mark the passages through zero.",
    )
    panels = figure.subplots(1, len(along), sharey=True)
    for axes, (name, inner) in zip(np.atleast_1d(panels), along.items(), strict=True):
        for curve, colour, style in zip(inner, COLOURS, STYLES * 2, strict=False):
            axes.plot(np.degrees(turn), curve, color=colour, ls=style, lw=1.3)
            k = np.flatnonzero(curve[:-1] * curve[1:] <= 0)
            axes.plot(np.degrees(turn[k]), 0 * k, "o", mfc="none", color=INK, ms=8)
        axes.axhline(0, color=INK, lw=0.7)
        axes.set(xlabel="turned by, degrees", xticks=np.arange(0, 361, 90), title=name)
    np.atleast_1d(panels)[0].set_ylabel(r"$q_{net}\cdot q$")
    return figure


def _vectors(n: int) -> np.ndarray:
    side = np.pi * (2 * (np.arange(n) + 0.5) / n - 1)
    across, up = np.meshgrid(side, side)
    flat = np.stack([across, up, np.zeros_like(up)], -1)
    return np.stack([flat, np.roll(flat, 1, -1), np.roll(flat, 2, -1)])


def _envelope(theta: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle, in degrees, and largest error of each 8 neighbours: the peaks without the noise."""
    middle = np.degrees(theta[:-1].reshape(-1, 8).mean(1))
    return middle, np.maximum(gap[:-1].reshape(-1, 8).max(1), 1e-2)
