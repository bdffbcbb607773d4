"""The figures of chapter 8's exercises."""

from collections.abc import Mapping, Sequence

import numpy as np

from posecore.figures import Picture, chart, draw_ellipse, draw_keypoints, picture, picture_grid
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "angles",
    "crossings",
    "errors",
    "hypotheses",
    "losses",
    "overlaps",
    "rays",
    "same_look",
    "spreads",
    "votes",
]


def rays(cases: Mapping[str, np.ndarray], met: np.ndarray) -> Picture:
    """Pairs of rays (4, 2): p, u, q, v; where they meet, and None where they do not."""
    where = [title for title, point in zip(cases, met, strict=True) if np.isfinite(point).all()]
    figure = new_picture(
        8.6,
        2.6,
        f"{len(cases)} pairs of rays, each from a dot. They meet in: {', '.join(where)}. "
        "In the others nothing is marked.",
    )
    panels = figure.subplots(1, len(cases), sharex=True, sharey=True)
    for axes, (title, (p, u, q, v)), point in zip(panels, cases.items(), met, strict=True):
        for start, way, colour in ((p, u, COLOURS[0]), (q, v, COLOURS[1])):
            axes.axline(start, start + way, color=colour, lw=0.8, ls=":")
            end = start + 3 * way / np.hypot(*way)
            axes.annotate("", end, start, arrowprops={"color": colour, "width": 2, "headwidth": 8})
            axes.plot(*start, "o", color=colour, ms=7)
        meet = np.isfinite(point).all()
        if meet:
            axes.plot(*point, "*", color=INK, ms=14, zorder=3)
        axes.set_title(f"{title}:\n{'a point' if meet else 'nan, nan'}", fontsize=10)
        axes.set(xlim=(-1, 9), ylim=(9, -1), aspect="equal", xlabel="x, px")
    panels[0].set_ylabel("y, px")
    return figure


def crossings(angle: np.ndarray, off: np.ndarray) -> Picture:
    """How far crossings (N,) are off, in pixels, over the angle of their rays, in degrees."""
    order = np.argsort(angle)
    tenths = np.array_split(order, 10)
    middle = [np.median(angle[some]) for some in tenths], [np.median(off[some]) for some in tenths]
    return chart(
        {"median of a tenth of them": middle},
        marks={"a crossing": (angle, off)},
        looks={
            "median of a tenth of them": {"marker": "o", "zorder": 3},
            "a crossing": {"marker": ".", "color": "0.7", "ms": 2},
        },
        log="xy",
        xlabel="angle between the rays, degrees",
        ylabel="error, px",
        size=(6.2, 3.6),
        alt="Error of a crossing over the angle between its rays, both on log axes. The cloud "
        f"falls from a median of {np.median(off[tenths[0]]):.0f} px for the smallest angles to "
        f"{np.median(off[tenths[-1]]):.1f} px for the largest.",
    )


def votes(photo: np.ndarray, points: np.ndarray, counts: np.ndarray, winner: np.ndarray) -> Picture:
    """Hypotheses (H, 2) on the photograph, darker and larger the more votes they have."""
    figure = picture(
        photo,
        width=5.6,
        alt="Crossings lie all over the picture, small and pale. They grow darker and larger "
        f"towards the tip of the spout, where one has {counts.max()} votes.",
    )
    axes = figure.axes[0]
    order = np.argsort(counts)
    share = counts[order] / max(counts.max(), 1)
    look = {"cmap": "Greys", "vmin": 0, "vmax": 1, "edgecolors": INK, "linewidths": 0.4}
    dots = axes.scatter(*points[order].T, c=share, s=4 + 40 * share**2, **look)
    figure.colorbar(dots, label="votes, share of the most", shrink=0.8)
    draw_keypoints(axes, winner[None], marker="x")
    axes.set(xlim=(-0.5, photo.shape[1] - 0.5), ylim=(photo.shape[0] - 0.5, -0.5))
    return figure


def losses(degrees: np.ndarray, curves: Mapping[str, np.ndarray], alt: str) -> Picture:
    """Losses (N,) over the angle of a predicted vector."""
    return chart(
        curves,
        x=degrees,
        xlabel="predicted vector, degrees off",
        ylabel="loss",
        ylim=(0, None),
        legend={"loc": "lower center", "bbox_to_anchor": (0.5, 1), "ncols": 3, "frameon": False},
        size=(6.2, 3.4),
        alt=alt,
    )


def hypotheses(
    photo: np.ndarray, clouds: Sequence[np.ndarray], found: Sequence[tuple[np.ndarray, np.ndarray]]
) -> Picture:
    """Clouds of hypotheses (H, 2) on the photograph, with their means and 2-sigma ellipses."""
    figure = picture(
        photo,
        width=5.6,
        alt=f"{len(clouds)} clouds of crossings on the photograph, each in an ellipse. The "
        "ellipses are long in the direction of the teapot's body.",
    )
    axes = figure.axes[0]
    for points, (mean, covariance), colour in zip(clouds, found, COLOURS[1:], strict=False):
        axes.plot(*points.T, ".", color=colour, ms=3, zorder=2)
        draw_ellipse(axes, mean, covariance, colour=INK, rim=True)
        axes.plot(*mean, "+", color=INK, ms=9, mew=2, zorder=4, path_effects=HALO)
    axes.set(xlim=(-0.5, photo.shape[1] - 0.5), ylim=(photo.shape[0] - 0.5, -0.5))
    return figure


def overlaps(
    photo: np.ndarray,
    mask: np.ndarray,
    seen: Mapping[str, np.ndarray],
    shares: Sequence[float],
) -> Picture:
    """Projected points (N, 2) of poses over a mask (H, W): full dots inside it, hollow outside."""
    pale = np.where(mask[..., None], photo, (255 + photo.astype(int)) // 2).astype(np.uint8)
    titles = [f"{name}: {share:.2f}" for name, share in zip(seen, shares, strict=True)]
    figure = picture_grid(
        [pale] * len(seen),
        titles,
        columns=2,
        width=7.4,
        alt="The teapot's points in several poses over the part of it that is seen. Overlaps are: "
        + ", ".join(titles)
        + ".",
    )
    height, width = mask.shape
    for axes, pixels in zip(figure.axes, seen.values(), strict=False):
        column, row = np.round(np.clip(pixels, -1, 1e4)).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        inside[inside] = mask[row[inside], column[inside]]
        axes.plot(*pixels[inside].T, "o", color=COLOURS[4], mec=INK, mew=0.4, ms=3.4)
        axes.plot(*pixels[~inside].T, "o", mfc="none", mec=INK, mew=0.7, ms=3.4)
        axes.contour(mask, [0.5], colors="white", linewidths=1.2)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return figure


def spreads(share: np.ndarray, curves: Mapping[str, np.ndarray], threshold: float) -> Picture:
    """Overlaps over the hidden share of the object, and the threshold of the rule."""
    figure = chart(
        curves,
        x=share,
        level={"_threshold": threshold},
        xlabel="hidden share of the object",
        ylabel="overlap",
        ylim=(0, 1.08),
        legend="lower left",
        size=(6.2, 3.4),
        alt="Overlap over the hidden share of the object. "
        + " ".join(f"{name}: from {ys[0]:.2f} to {ys[-1]:.2f}." for name, ys in curves.items()),
    )
    figure.axes[0].text(1, threshold + 0.02, "refine above", ha="right", color="0.3")
    return figure


def same_look(
    photos: Sequence[np.ndarray], keypoints: Sequence[np.ndarray], mean: np.ndarray
) -> Picture:
    """Pictures that are the same with different keypoints (K, 2), and the mean of many of these."""
    figure = picture_grid(
        [*photos, photos[0]],
        [*(f"label {number + 1}" for number in range(len(photos))), "mean of all labels"],
        columns=len(photos) + 1,
        width=8.6,
        alt="Pictures of a vase that are the same, with keypoints on its surface that are not. In "
        "the last one the mean keypoints: all lie on the vase's axis, on one line.",
    )
    for axes, points in zip(figure.axes, [*keypoints, mean], strict=False):
        draw_keypoints(axes, points, numbers=True)
    return figure


def errors(found: Mapping[str, np.ndarray]) -> Picture:
    """The share of test poses below an ADD-S, in diameters; grey is what is asked for."""
    good = {name: (values < 0.1).mean() for name, values in found.items()}
    said = ", ".join(f"{share:.0%} with {name}" for name, share in good.items())
    curves = {
        name: (np.sort(values).clip(0.005, 20), np.arange(1, len(values) + 1) / len(values))
        for name, values in found.items()
    }
    looks = {name: {"lw": 2, "drawstyle": "steps-pre"} for name in curves}
    ends = np.array([0.005, 0.1])
    return chart(
        curves,
        bands={"expected: to pass here": ((ends, [0.95, 0.95]), (ends, [1.02, 1.02]))},
        upright={"_asked for": 0.1},
        looks=looks | {"_asked for": {"color": INK, "lw": 0.8, "ls": "-"},
                       "expected: to pass here": {"color": "0.75", "alpha": 1}},
        log="x",
        xlabel="ADD-S, diameters",
        ylabel="share of poses below",
        xlim=(0.005, 20),
        ylim=(0, 1.02),
        legend="lower right",
        size=(6.4, 3.5),
        alt=f"Share of poses over ADD-S. Below 0.1 diameters: {said}.",
    )  # fmt: skip


def angles(degrees: np.ndarray, curves: Mapping[str, np.ndarray]) -> Picture:
    """How far answers turn in one step of a walk, degrees, over where the axis points."""
    return chart(
        curves,
        x=degrees,
        log="y",
        xlabel="lean of the object, degrees",
        ylabel="step of the answer, degrees",
        ylim=(1.5, 200),
        yticks=[2, 5, 10, 20, 50, 100, 180],
        size=(6.4, 3.4),
        alt="Steps of the answers over the lean of an object that moves by 2 degrees a step. "
        + " ".join(
            f"{name}: at most {values.max():.0f} degrees." for name, values in curves.items()
        ),
    )
