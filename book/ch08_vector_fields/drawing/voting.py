"""The figures of chapter 8 on rays and votes, and the door to those on fields."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from book.ch08_vector_fields.drawing import fields as fields_of
from data_tools.views import View
from posecore.figures import Picture, chart, draw_ellipse, draw_outline
from posecore.figures.photographs import Window, bare, crop
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "crop",
    "ellipses",
    "errors_of_crossings",
    "field",
    "fields",
    "found",
    "hidden",
    "keypoints",
    "patches",
    "question",
    "rays",
    "scores",
    "two_pixels",
    "window",
]

field, fields, hidden = fields_of.field, fields_of.fields, fields_of.hidden
keypoints, patches, question = fields_of.keypoints, fields_of.patches, fields_of.question
window = fields_of.window
show_crop = fields_of.show_crop
TRUTH = {"marker": "o", "ms": 13, "mfc": "none", "mec": INK, "mew": 1.8, "ls": "none"}
POINTS = {  # a marker for each way to find a point, whatever comes after a comma in its name
    "least squares": {"marker": "D", "color": COLOURS[1], "ms": 9, "mec": "white"},
    "RANSAC": {"marker": "X", "color": COLOURS[2], "ms": 11, "mec": "white"},
}


def two_pixels(
    view: View, mask: np.ndarray, p: np.ndarray, u: np.ndarray, x: np.ndarray
) -> Picture:
    """Two pixels p (2, 2) that point along u (2, 2), and x (2,) where their rays cross."""
    said = " and ".join(f"({a:.0f}, {b:.0f})" for a, b in p)
    figure = new_picture(
        6.4,
        4.1,
        f"A teapot cut out of a picture of a table. From two of its pixels, at {said}, one on top "
        "and one at the foot, arrows start towards the tip of the spout. Dashed, they go on and "
        f"cross at ({x[0]:.1f}, {x[1]:.1f}), at the tip.",
    )
    axes = figure.subplots()
    box = window(mask, x)
    show_crop(axes, view.rgb, box, pale=0.35)
    length = 0.3 * (box[2] - box[0])
    for k in (0, 1):
        end = p[k] + length * u[k]
        far = x + 0.12 * (x - p[k])
        axes.plot(*np.stack([p[k], far]).T, color=INK, lw=1.3, ls="--", path_effects=HALO)
        arrow = {"arrowstyle": "-|>", "color": COLOURS[k], "lw": 2.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, p[k], arrowprops=arrow)
        axes.plot(*p[k], "s", color=COLOURS[k], ms=8, mec="white")
        for text, place, offset in (("p", p[k], (-11, 0)), ("u", (p[k] + end) / 2, (0, 9))):
            axes.annotate(f"${text}_{k + 1}$", place, xytext=offset, textcoords="offset points",
                          ha="center", va="center", fontsize=13, path_effects=HALO)  # fmt: skip
    axes.plot(*x, **TRUTH)
    axes.annotate("$x$", x, xytext=(10, 12), textcoords="offset points", fontsize=14,
                  path_effects=HALO)  # fmt: skip
    return figure


def errors_of_crossings(angle: np.ndarray, measured: np.ndarray, formula: np.ndarray) -> Picture:
    """How far crossings of noisy rays are off over the angle between the two rays, degrees."""
    low = int(measured.argmin())
    return chart(
        {"formula": formula},
        x=angle,
        marks={"measured": (angle, measured)},
        looks={"formula": {"color": COLOURS[1], "lw": 1.5}, "measured": {"color": COLOURS[0]}},
        xlabel="angle between the two rays, degrees",
        ylabel="error of the crossing, px",
        xlim=(0, 180),
        ylim=(0, None),
        xticks=range(0, 181, 30),
        legend={"frameon": False},
        size=(6.0, 3.2),
        alt="Error of a crossing over the angle between its two rays, "
        f"{measured[0]:.1f} pixels at {angle[0]:.0f} degrees, {measured[low]:.1f} at "
        f"{angle[low]:.0f} and {measured[-1]:.1f} at {angle[-1]:.0f}. Points measured, and a line, "
        "the formula, which agree.",
    )


def rays(
    mask: np.ndarray,
    x: np.ndarray,
    cases: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray, Mapping[str, np.ndarray]]],
    solid: str = "points well",
    dashed: str = "lost",
) -> Picture:
    """Rays over a silhouette, and what is made of them.

    Args:
        mask: (H, W) bool, the object.
        x: (2,) where the rays should meet.
        cases: title -> pixels (N, 2), directions (N, 2), which are drawn solid (N,), and points
            (2,) by name.
        solid, dashed: what solid and dashed rays are.
    """
    said = "; ".join(
        f"{title}: {len(p)} rays, {int((~good).sum())} of them dashed ({dashed}), "
        + " and ".join(f"{n} {np.linalg.norm(v - x):.1f} px from the tip" for n, v in found.items())
        for title, (p, _, good, found) in cases.items()
    )
    figure = new_picture(
        4.9 * len(cases) if len(cases) > 1 else 6.4,
        3.9 if len(cases) > 1 else 4.3,
        f"Rays from pixels of a teapot's silhouette towards the tip of its spout. {said}.",
    )
    box = window(mask, x, 0.22)
    panels = np.atleast_1d(figure.subplots(1, len(cases)))
    for axes, (title, (p, u, good, found)) in zip(panels, cases.items(), strict=True):
        show_silhouette(axes, mask, box)
        reach = 2.0 * (box[2] - box[0])
        for part, look in ((~good, {"colors": COLOURS[4], "linestyles": "--"}),
                           (good, {"colors": COLOURS[0], "linestyles": "-"})):  # fmt: skip
            ends = np.stack([p[part], p[part] + reach * u[part]], 1)
            axes.add_collection(LineCollection(ends, linewidths=0.6, antialiased=False, **look))
        axes.plot(*p.T, ".", color="0.25", ms=2.5, antialiased=False)
        look = {"lw": 1.5}
        axes.plot([], [], color=COLOURS[0], label=solid, **look)
        if not good.all():
            axes.plot([], [], color=COLOURS[4], ls="--", label=dashed, **look)
        for name, place in found.items():
            # A point outside is drawn on the border, with its distance in the legend all the same.
            inside = np.clip(place, np.add(box[:2], 1), np.subtract(box[2:], 2))
            off = np.linalg.norm(place - x)
            mark = POINTS[name.partition(",")[0]]
            axes.plot(*inside, ls="none", label=f"{name}: {off:.1f} px off", **mark)
        axes.plot(*x, **TRUTH, label="the tip")
        axes.set_title(title, fontsize=11)
        axes.legend(fontsize=8, loc="lower right", framealpha=0.95)
    return figure


def scores(
    mask: np.ndarray, score: np.ndarray, box: Window, x: np.ndarray, tried: np.ndarray
) -> Picture:
    """How many rays point at each pixel of a window, and the crossings that RANSAC tries.

    Args:
        mask: (H, W) bool, the object.
        score: (h, w) counts in the pixels of `box`.
        box: the window, (x, y) of its first pixel and of the first beyond.
        x: (2,) the truth.
        tried: (N, 2) points.
    """
    top = np.unravel_index(score.argmax(), score.shape)
    off = np.linalg.norm(np.add(top[::-1], box[:2]) - x)
    inside = ((tried >= box[:2]) & (tried <= np.subtract(box[2:], 1))).all(-1)
    figure = new_picture(
        9.4,
        3.6,
        "Twice the number of rays that point at each pixel, as brightness. Beams leave the teapot "
        "to all sides, and where most of them overlap is one bright spot, at the tip of the spout: "
        f"{score.max()} rays, {off:.1f} pixels from the truth. On the right, "
        f"{int(inside.sum())} of {len(tried)} crossings of two rays as dots; many lie in the "
        "bright spot.",
    )
    panels = figure.subplots(1, 2)
    extent = (box[0] - 0.5, box[2] - 0.5, box[3] - 0.5, box[1] - 0.5)
    for axes, title in zip(panels, ("try every pixel", "try crossings of two rays"), strict=True):
        shown = axes.imshow(score, extent=extent, cmap="viridis", interpolation="nearest")
        axes.set_autoscale_on(False)
        draw_outline(axes, mask, colour="white", style=":")
        for line in axes.lines:
            line.set(path_effects=[], linewidth=1.0)
        axes.plot(*x, **(TRUTH | {"mec": "white", "ms": 16}))
        axes.set_title(title, fontsize=11)
        axes.axis("off")
    look = {"ms": 4, "mec": "black", "mew": 0.5, "antialiased": False}
    panels[1].plot(*tried[inside].T, "o", color=COLOURS[4], **look)
    figure.colorbar(shown, ax=list(panels), label="rays that point there", fraction=0.03, pad=0.01)
    return figure


Votes = tuple[np.ndarray, np.ndarray, np.ndarray]


def ellipses(
    mask: np.ndarray,
    cases: Mapping[str, Mapping[str, Votes]],
    truth: Mapping[str, np.ndarray],
) -> Picture:
    """Clouds of hypotheses with their ellipses: a row for each keypoint, a column for each noise.

    Args:
        mask: (H, W) bool, the object.
        cases: keypoint -> noise -> hypotheses (N, 2), their mean (2,) and covariance (2, 2).
        truth: (2,) by keypoint.
    """
    deviations = {
        f"{row}, {column}": np.sqrt(np.linalg.eigvalsh(covariance)[1])
        for row, columns in cases.items()
        for column, (_, _, covariance) in columns.items()
    }
    said = "; ".join(f"{name}: {value:.1f} px" for name, value in deviations.items())
    wide, high = len(next(iter(cases.values()))), len(cases)
    figure = new_picture(
        3.2 * wide,
        2.35 * high,
        "A teapot's silhouette with clouds of hypotheses and their ellipses of two standard "
        "deviations. They grow with the noise from left to right, and are longer for the far "
        f"keypoint, along the direction to the teapot. Longest standard deviation, {said}.",
    )
    panels = figure.subplots(high, wide, squeeze=False)
    box = window(mask, np.array(list(truth.values())), 0.16)
    for line, (row, columns) in zip(panels, cases.items(), strict=True):
        for axes, (column, (h, mean, covariance)) in zip(line, columns.items(), strict=True):
            show_silhouette(axes, mask, box)
            axes.plot(*h.T, ".", color=COLOURS[0], ms=2.5, antialiased=False)
            draw_ellipse(axes, mean, covariance)
            axes.plot(*truth[row], "+", color=INK, ms=9, mew=1.6)
            axes.set_title(
                f"{row}, {column}: {deviations[f'{row}, {column}']:.1f} px", fontsize=9.5
            )
    return figure


def found(
    view: View,
    full: np.ndarray,
    mask: np.ndarray,
    x: np.ndarray,
    points: np.ndarray,
    covariances: np.ndarray,
) -> Picture:
    """Keypoints (K, 2) of an object that is partly hidden, as they were voted for.

    Args:
        view: the picture.
        full, mask: (H, W) bool, the whole silhouette and what is seen of it.
        x: (K, 2) the truth.
        points, covariances: (K, 2) and (K, 2, 2) the votes.
    """
    off = np.linalg.norm(points - x, axis=-1)
    figure = new_picture(
        6.4,
        4.6,
        f"The teapot behind other things, with the {len(x)} keypoints that were voted for as "
        "crosses, an ellipse of two standard deviations around each, and rings at the true "
        "places. Crosses lie in or beside their rings, "
        + ", ".join(f"{k} {value:.1f} px" for k, value in enumerate(off))
        + ". The ellipses of those far from what is seen are the longest.",
    )
    axes = figure.subplots()
    box = window(full, x, 0.2)
    show_crop(axes, view.rgb, box, pale=0.45)
    draw_outline(axes, full, colour="0.45", style="--")
    draw_outline(axes, mask, colour=COLOURS[0])
    for k, (point, covariance) in enumerate(zip(points, covariances, strict=True)):
        draw_ellipse(axes, point, covariance)
        axes.plot(*x[k], **(TRUTH | {"ms": 10}))
        axes.plot(*point, **POINTS["RANSAC"])
        axes.annotate(str(k), x[k], xytext=(8, 6), textcoords="offset points", fontsize=11,
                      path_effects=HALO)  # fmt: skip
    return figure


def show_silhouette(axes: Axes, mask: np.ndarray, box: Window, inside: float = 0.86) -> None:
    """A mask as a grey shape in a window."""
    grey = np.where(crop(mask, box), inside, 1.0)
    extent = (box[0] - 0.5, box[2] - 0.5, box[3] - 0.5, box[1] - 0.5)
    axes.imshow(grey, extent=extent, cmap="grey", vmin=0, vmax=1, interpolation="nearest")
    axes.set_autoscale_on(False)
    bare(axes)
