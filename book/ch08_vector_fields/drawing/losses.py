"""The figures of chapter 8 on losses: what they see of a vector, and what they do to a field."""

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from posecore.figures import Picture, chart
from posecore.figures.style import COLOURS, HALO, INK, STYLES, new_picture

__all__ = ["angles", "one_angle", "planes", "projection", "schedule", "small_fields"]

# Without the brightest part, on which white arrows would be lost.
DARK = ListedColormap(colormaps["viridis"](np.linspace(0, 0.8, 256)))
ARROW = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 15}


def one_angle(distance: np.ndarray, degrees: float, miss: np.ndarray) -> Picture:
    """Rays that are off by the same angle, from pixels at several distances of one keypoint.

    Args:
        distance: (N,) from pixel to keypoint, pixels, falling.
        degrees: between each ray and the way to the keypoint.
        miss: (N,) distance of the keypoint from each ray's line, pixels.
    """
    said = ", ".join(f"from {r:g} pixels by {d:.1f}" for r, d in zip(distance, miss, strict=True))
    figure = new_picture(
        8.6,
        1.9,
        f"{len(distance)} pixels on a line with one keypoint. From each a ray starts "
        f"{degrees:g} degrees too high and passes above the keypoint: {said}.",
    )
    axes = figure.subplots()
    axes.axhline(0, color="0.75", lw=1)
    for r, d, colour, style in zip(distance, miss, COLOURS, STYLES, strict=False):
        # Where the line's nearest point is, seen from the keypoint.
        foot = d * np.array([-np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])
        end = np.array([-r, 0]) + (r + 4) * np.array([1, np.tan(np.radians(degrees))])
        axes.plot([-r, end[0]], [0, end[1]], color=colour, ls=style, lw=2)
        axes.plot([0, foot[0]], [0, foot[1]], color=colour, lw=3.2, solid_capstyle="butt")
        axes.plot(-r, 0, "s", color=colour, ms=8)
        axes.text(-r, -0.7, f"{r:g} px away", color=colour, ha="center", va="top", fontsize=10)
        axes.text(4.6, end[1], f"misses by {d:.1f} px", color=colour, va="center", fontsize=10)
    axes.plot(0, 0, "o", color=INK, ms=8)
    axes.text(0, -0.7, "keypoint", va="top", ha="center", fontsize=10)
    top = float(distance.max() * np.tan(np.radians(degrees)))
    axes.set(xlim=(-distance.max() - 4, 16), ylim=(-2.6, 1.18 * top), aspect="equal")
    axes.axis("off")
    return figure


def projection(p: np.ndarray, g: np.ndarray) -> Picture:
    """What the projection loss measures: the keypoint's distance from the line along p.

    Args:
        p: (2,) a predicted vector.
        g: (2,) from the pixel to the keypoint.
    """
    d = abs(g[0] * p[1] - g[1] * p[0]) / np.linalg.norm(p)
    figure = new_picture(
        9.2,
        2.9,
        "Two drawings of a pixel with a long arrow g to a keypoint and a short arrow p, whose "
        "line is dashed. At right angles to p stands its normal n. A thick segment d leads from "
        "the line to the keypoint. On the right p points the other way; its line and d are the "
        "same.",
    )
    panels = figure.subplots(1, 2)
    titles = ("the distance that Eq. 1 punishes", "reversed: the same line, the same distance")
    for axes, sign, title in zip(panels, (1, -1), titles, strict=True):
        along = p / np.linalg.norm(p)
        n = sign * np.array([p[1], -p[0]])
        foot = (g @ along) * along
        line = np.outer([-0.35, 1.12], along * np.linalg.norm(g))
        axes.plot(*line.T, color="0.45", ls="--", lw=1.4)
        axes.plot(*np.stack([foot, g]).T, color=COLOURS[1], lw=4, solid_capstyle="butt")
        _arrow(axes, g, "$g$", INK, 0.62, (0, -13))
        _arrow(axes, sign * p, "$p$", COLOURS[0], 1.0, (-4, 13 * sign))
        _arrow(axes, n, "$n$", COLOURS[2], 1.0, (13, 0))
        axes.annotate(f"$d$ = {d:.1f} px", (foot + g) / 2, xytext=(9, 0), va="center",
                      textcoords="offset points", color=COLOURS[1], fontsize=11)  # fmt: skip
        axes.plot(0, 0, "s", color=INK, ms=7)
        axes.plot(*g, "o", color=INK, ms=8)
        axes.annotate("keypoint", g, xytext=(2, -17), textcoords="offset points", ha="center")
        axes.set_title(title, fontsize=11)
        reach = np.abs(g[0])
        axes.set(xlim=(-0.45 * reach, 1.4 * reach), ylim=(13, -19), aspect="equal")
        axes.axis("off")
    return figure


def planes(
    x: np.ndarray, landscapes: Mapping[str, tuple[np.ndarray, np.ndarray]], alt: str
) -> Picture:
    """Losses of one pixel as heights over the plane of what the network may say.

    Args:
        x: (n,) values of both coordinates.
        landscapes: name -> heights (n, n), the loss at (x[j], x[i]); and minus its gradient there,
            (n, n, 2).
        alt: what is seen.
    """
    figure = new_picture(3.9 * len(landscapes), 3.2, alt)
    panels = figure.subplots(1, len(landscapes), squeeze=False)[0]
    some = np.arange(len(x) // 20, len(x), len(x) // 10)
    for axes, (name, (height, downhill)) in zip(panels, landscapes.items(), strict=True):
        bands = axes.contourf(x, x, height, levels=10, cmap=DARK, antialiased=False)
        axes.contour(x, x, height, levels=10, colors="k", linewidths=0.5, antialiased=False)
        way = downhill[np.ix_(some, some)]
        way = way / np.linalg.norm(way, axis=-1, keepdims=True).clip(1e-9)
        axes.quiver(x[some], x[some], *way.transpose(2, 0, 1), color="white",
                    angles="xy", scale=16, width=0.012, pivot="mid")  # fmt: skip
        axes.plot(0, 0, "s", color="white", mec=INK, ms=6)
        axes.plot(1, 0, "o", color=COLOURS[1], mec="white", ms=9)
        axes.plot(-1, 0, "X", color=COLOURS[1], mec="white", ms=9)
        axes.annotate(r"$\hat g$", (1, 0), xytext=(8, 6), textcoords="offset points",
                      color=COLOURS[1], path_effects=HALO, fontsize=12)  # fmt: skip
        axes.set_title(name, fontsize=11)
        axes.set(aspect="equal", xlabel="$p_x$", ylabel="$p_y$", xlim=x[[0, -1]], ylim=x[[-1, 0]])
        axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1])
        figure.colorbar(bands, ax=axes, label="loss", shrink=0.85)
    return figure


def angles(degrees: np.ndarray, curves: Mapping[str, np.ndarray]) -> Picture:
    """Length of the gradient over the angle by which a unit vector is off, both axes logarithmic.

    Args:
        degrees: (n,), rising.
        curves: name -> (n,); the first two lie on each other.
    """
    at = int(np.abs(degrees - 1).argmin())
    said = "; ".join(f"{name} {curve[at]:.3g}" for name, curve in curves.items())
    looks = [("-", 5.0), ("--", 2.0), ("-", 2.0), ("-.", 2.0), (":", 2.4)]
    looks = zip(curves, looks, ("0.7", *COLOURS), strict=False)
    return chart(
        curves,
        x=degrees,
        upright={"_one degree": 1},
        looks={name: {"color": c, "ls": ls, "lw": lw} for name, (ls, lw), c in looks},
        log="xy",
        xlabel="angle between $p$ and $g$, degrees",
        ylabel="length of the gradient",
        xticks=[0.01, 0.1, 1, 10, 60],
        legend={"frameon": False, "loc": "center left", "bbox_to_anchor": (1.0, 0.5)},
        size=(6.8, 3.8),
        alt=f"Gradient over angle, from {degrees[0]:g} to {degrees[-1]:g} degrees. At one degree: "
        f"{said}. The first two fall together, in proportion to the angle. Those in pixels lie "
        "far above, flat at large angles and falling with the same slope at small ones; the "
        "farther the keypoint, the longer they stay flat.",
    )


def schedule(beta: np.ndarray, rate: np.ndarray) -> Picture:
    """The weight of the projection loss and the learning rate, by epoch, and their product."""
    epoch = np.arange(len(beta))
    product = beta * rate
    figure = new_picture(
        8.8,
        2.9,
        f"Left, a rising staircase: the weight from {beta[0]:g} to {beta[-1]:g} over {len(beta)} "
        f"epochs. Right, on a logarithmic axis: the rate, dashed, halves every 20 epochs and ends "
        f"at 1/{rate[0] / rate[-1]:.0f} of its first value; weight times rate, solid, ends at "
        f"1/{product[0] / product[-1]:.0f}.",
    )
    left, right = figure.subplots(1, 2)
    left.step(epoch, beta, where="post", color=COLOURS[0], lw=2)
    left.set(xlabel="epoch", ylabel=r"weight $\beta$", ylim=(0, None))
    for curve, name, colour, style in (
        (product, r"$\beta$ times rate", COLOURS[0], "-"),
        (rate, "rate", COLOURS[1], "--"),
    ):
        right.step(epoch, curve / curve[0], where="post", color=colour, ls=style, lw=2, label=name)
    right.set(xlabel="epoch", ylabel="relative to epoch 0", yscale="log")
    right.legend(frameon=False)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def small_fields(
    points: np.ndarray, vectors: Mapping[str, np.ndarray], keypoint: np.ndarray, radius: float
) -> Picture:
    """The fields of one keypoint that a small network has learnt, one panel for each training.

    Args:
        points: (N, 2) pixels of a round object.
        vectors: name -> (N, 2) what the network says there.
        keypoint: (2,) in pixels.
        radius: of the object, pixels.
    """
    away = {name: ((keypoint - points) * p).sum(-1) < 0 for name, p in vectors.items()}
    said = "; ".join(f"{name}: {100 * a.mean():.0f} % point away" for name, a in away.items())
    figure = new_picture(
        2.4 * len(vectors),
        2.6,
        "Round objects full of arrows, one for each training. Blue arrows point to the keypoint, "
        f"a black dot; orange ones with a dot at their tail point away from it. {said}.",
    )
    panels = figure.subplots(1, len(vectors), squeeze=False)[0]
    turn = np.linspace(0, 2 * np.pi, 100)
    for axes, (name, p) in zip(panels, vectors.items(), strict=True):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.7", lw=1)
        way = p / np.linalg.norm(p, axis=-1, keepdims=True).clip(1e-9)
        for part, colour in ((~away[name], COLOURS[0]), (away[name], COLOURS[1])):
            if part.any():
                axes.quiver(*points[part].T, *way[part].T, color=colour, angles="xy", scale=15,
                            width=0.011, headwidth=4.5, headlength=4.5)  # fmt: skip
        axes.plot(*points[away[name]].T, ".", color=COLOURS[1], ms=6)
        axes.plot(*keypoint, "o", color=INK, mec="white", ms=9)
        axes.set_title(name, fontsize=10)
        axes.set(aspect="equal", xlim=(-1.15 * radius, 1.15 * radius))
        axes.set(ylim=(1.15 * radius, -1.15 * radius))
        axes.axis("off")
    return figure


def _arrow(
    axes: Axes, end: np.ndarray, label: str, colour: str, where: float, aside: tuple[int, int]
) -> None:
    axes.annotate("", end, (0, 0), arrowprops={**ARROW, "color": colour, "lw": 2.2})
    axes.annotate(label, where * end, xytext=aside, textcoords="offset points", color=colour,
                  ha="center", va="center", fontsize=13, path_effects=HALO)  # fmt: skip
