"""The figures of chapter 4's exercises."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.patches import Circle

from posecore.figures import Picture
from posecore.figures.style import COLOURS, INK, MARKERS, STYLES, new_picture

__all__ = ["balls", "bins", "distances", "errors_and_draws", "pooled", "votes"]

GREY = "0.72"


def balls(points: np.ndarray, centres: np.ndarray, radius: float, found: np.ndarray) -> Picture:
    """A cloud from the front, and who is found in the balls about some centres.

    Args:
        points: (N, 3) metres, x right and y down.
        centres: (M, 3) metres.
        radius: metres.
        found: (M, count) indices into the points.
    """
    pairs = list(zip(found, centres, strict=True))
    inside = [np.linalg.norm(points[b] - c, axis=1) < radius for b, c in pairs]
    several = [len(np.unique(ball)) for ball in found]
    places = found.shape[1]
    names = [
        f"ball {i}: "
        + (f"{n} point{'s'[: n - 1]}, {places} places" if full.any() else "empty, so the nearest")
        for i, (n, full) in enumerate(zip(several, inside, strict=True))
    ]
    figure = new_picture(
        6.8,
        6.0,
        f"A cloud of {len(points)} points from the front with {len(centres)} balls of "
        f"{1000 * radius:.0f} mm, and the points that were found for them: {'; '.join(names)}.",
    )
    axes = figure.subplots()
    x, y, _ = 1000 * points.T
    axes.plot(x, y, ".", color=GREY, ms=4, label="_all")
    for i, (ball, centre) in enumerate(zip(found, 1000 * centres, strict=True)):
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        axes.add_patch(Circle(centre[:2], 1000 * radius, fill=False, ec=colour, lw=1.2))
        for j in np.unique(ball):
            axes.plot([centre[0], x[j]], [centre[1], y[j]], color=colour, lw=0.7)
        axes.plot(x[ball], y[ball], marker, color=colour, ms=5, label=names[i])
        axes.plot(*centre[:2], "+", color=INK, ms=10, mew=1.6, label="_centre")
    axes.set(xlabel="x, mm", ylabel="y, mm (down)", aspect="equal")
    axes.margins(0.06)
    axes.invert_yaxis()
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9
    )
    return figure


def pooled(
    features: np.ndarray, balls: np.ndarray, maxima: np.ndarray, means: np.ndarray
) -> Picture:
    """Features of points, balls of indices, and what each ball comes to, as tables of numbers.

    A place that does not count is crossed out: one for nobody, or one that repeats another.

    Args:
        features: (N, C).
        balls: (M, K) indices, -1 for nobody.
        maxima, means: (M, C).
    """
    (n, c), (m, k) = features.shape, balls.shape
    first = [[j for j, i in enumerate(row) if i >= 0 and i not in row[:j]] for row in balls]
    sizes = ", ".join(str(len(row)) for row in first)
    figure = new_picture(
        7.6,
        0.9 + 0.42 * max(n, m),
        f"A table of {n} points with {c} features, {m} balls of {k} places that hold {sizes} "
        f"different points, and the maximum and the mean of each ball.",
    )
    widths = [c, k, c, c]
    panels = figure.subplots(1, 4, width_ratios=widths)
    tables = (
        ("features of points", features, "point"),
        ("points of balls", balls, "ball"),
        ("maximum", maxima, "ball"),
        ("mean", means, "ball"),
    )
    largest = np.abs(features).max()
    for axes, (title, table, rows) in zip(panels, tables, strict=True):
        plain = table is balls
        axes.imshow(
            0 * table if plain else table, cmap="PuOr", vmin=-1.6 * largest, vmax=1.6 * largest
        )
        for (i, j), value in np.ndenumerate(table):
            skipped = plain and j not in first[i]
            text = f"{value:d}" if plain else f"{value:.3g}"
            axes.text(
                j, i, text, ha="center", va="center", size=9, color="0.55" if skipped else INK
            )
            if skipped:
                axes.plot([j - 0.3, j + 0.3], [i + 0.3, i - 0.3], color="0.55", lw=1, gid="skipped")
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks(range(len(table)))
        axes.set_ylabel(rows)
        axes.set_ylim(max(n, m) - 0.5, -0.5)
        axes.spines[:].set_visible(False)
    return figure


def distances(angles: np.ndarray, losses: Mapping[str, np.ndarray], ylabel: str) -> Picture:
    """Losses (N,) over the angle (N,), radians, by which a quaternion is turned too far."""
    degrees = np.rad2deg(angles)
    ends = "; ".join(
        f"{name}: {loss[0]:.2f} at {degrees[0]:.0f}°, at most {loss.max():.2f} at "
        f"{degrees[loss.argmax()]:.0f}°, {loss[-1]:.2f} at {degrees[-1]:.0f}°"
        for name, loss in losses.items()
    )
    figure = new_picture(6.4, 3.4, f"Losses over the angle of the error. {ends}.")
    axes = figure.subplots()
    for i, (name, loss) in enumerate(losses.items()):
        axes.plot(degrees, loss, STYLES[i], color=COLOURS[i], lw=2, label=name)
    axes.set(xlabel="turned too far by, degrees", ylabel=ylabel)
    axes.set_xticks(np.arange(0, degrees[-1] + 1, 90))
    axes.grid(color="0.9")
    axes.legend(fontsize=9)
    return figure


def votes(
    votes: np.ndarray, true: np.ndarray, answers: Mapping[str, np.ndarray], reach: float
) -> Picture:
    """Votes for keypoints from the front, where the keypoints are, and what the votes come to.

    Args:
        votes: (S, K, 3) metres, x right and y down.
        true: (K, 3) metres.
        answers: name -> (K, 3) metres.
        reach: metres that are drawn to each side of the true keypoints.
    """
    off = {k: 1000 * np.linalg.norm(v - true, axis=1).mean() for k, v in answers.items()}
    said = ", ".join(f"{name} {miss:.1f} mm" for name, miss in off.items())
    figure = new_picture(
        6.8,
        5.0,
        f"{len(votes)} votes for each of {len(true)} keypoints, seen from the front. Mean distance "
        f"to the true keypoints: {said}.",
    )
    axes = figure.subplots()
    for i in range(len(true)):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(*1000 * votes[:, i, :2].T, ".", color=colour, ms=5, alpha=0.55)
    axes.plot([], [], ".", color="0.4", label="votes, a colour for each keypoint")
    axes.plot(
        *1000 * true[:, :2].T, "o", mfc="none", mec=INK, ms=11, mew=1.4, label="true keypoint"
    )
    for marker, (name, places) in zip("x+", answers.items(), strict=False):
        label = f"{name}: {off[name]:.1f} mm off"
        axes.plot(*1000 * places[:, :2].T, marker, color=INK, ms=9, mew=2, label=label)
    low, high = 1000 * (true[:, :2].min(0) - reach), 1000 * (true[:, :2].max(0) + reach)
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal")
    axes.set(xlabel="x, mm", ylabel="y, mm (down)")
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9
    )
    return figure


def bins(
    estimated: np.ndarray, true: np.ndarray, width: float, counts: np.ndarray, means: np.ndarray,
    bmae: float,
) -> Picture:  # fmt: skip
    """Errors over the size of the true angle with the means of their bins, and how many they hold.

    Args:
        estimated, true: (N,) radians; their difference is an error as it is.
        width: of a bin, radians.
        counts, means: (B,) of the bins; radians, nan where there is none.
        bmae: radians.
    """
    angle, error = np.rad2deg(np.abs(true)), np.rad2deg(np.abs(estimated - true))
    used = int(np.nonzero(counts)[0].max()) + 1
    edges = np.rad2deg(width) * np.arange(used + 1)
    mean, balanced = error.mean(), np.rad2deg(bmae)
    empty = int((counts[:used] == 0).sum())
    figure = new_picture(
        6.8,
        4.4,
        f"Errors of {len(true)} poses over the size of the true angle, up to {edges[-1]:.0f} "
        f"degrees, with the mean of each bin of {np.rad2deg(width):.0f} degrees; {empty} of "
        f"{used} bins are empty. Mean error {mean:.1f}, mean of the bins {balanced:.1f} degrees. "
        f"Below, how many poses a bin holds: from {counts[0]} to {counts[used - 1]}.",
    )
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot(angle, error, ".", color="0.6", label=f"{len(true)} poses")
    above.hlines(
        np.rad2deg(means[:used]), edges[:-1], edges[1:], color=INK, lw=3, label="means of the bins"
    )
    above.axhline(balanced, color=COLOURS[0], ls="--", label=f"BMAE {balanced:.1f}°")
    above.axhline(mean, color=COLOURS[1], ls=":", lw=2, label=f"MAE {mean:.1f}°")
    above.set(ylabel="size of the error, degrees")
    above.legend(fontsize=9)
    below.bar(edges[:-1], counts[:used], np.diff(edges), align="edge", color="0.75", ec="0.4")
    below.set(
        xlabel="size of the true angle, degrees", ylabel="poses", yscale="log", ylim=(0.6, None)
    )
    return figure


def errors_and_draws(
    edges: np.ndarray,
    draws: Mapping[str, np.ndarray],
    errors: Mapping[str, np.ndarray] | None = None,
) -> Picture:
    """Which share of a training's draws has which yaw, and what the error is there.

    Args:
        edges: (B + 1,) of the bins, degrees of yaw.
        draws: name -> (B,) shares of the draws.
        errors: name -> (B,) mean errors, degrees; nan where there is none. Below, if given.
    """
    outer = np.abs(edges[:-1] + edges[1:]) / 2 > np.rad2deg(0.7)  # more than 40 degrees
    said = ", ".join(f"{share[outer].sum():.0%} with {name}" for name, share in draws.items())
    alt = f"Shares of the draws over yaw; beyond 40 degrees there are {said}."
    for name, error in (errors or {}).items():
        inner, far = np.nanmean(error[~outer]), np.nanmean(error[outer])
        alt += f" Error with {name}: {inner:.1f} degrees inside, {far:.1f} beyond."
    rows = 1 if errors is None else 2
    figure = new_picture(6.8, 0.6 + 2.3 * rows, alt)
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    looks = [{"color": COLOURS[i], "ls": STYLES[i], "lw": 2} for i in range(len(draws))]
    for look, (name, share) in zip(looks, draws.items(), strict=True):
        panels[0].stairs(100 * share, edges, label=name, **look)
    panels[0].set(ylabel="draws, %")
    middle = (edges[:-1] + edges[1:]) / 2
    for look, marker, name in zip(looks, MARKERS, errors or {}, strict=False):
        panels[1].plot(middle, errors[name], marker=marker, label=name, **look)
        panels[1].set(ylabel="mean error, degrees", ylim=(0, None))
    for axes in panels:
        for end in (-40, 40):
            axes.axvline(end, color="0.6", lw=0.8)
        axes.legend(fontsize=9)
    panels[-1].set(xlabel="true yaw, degrees")
    return figure
