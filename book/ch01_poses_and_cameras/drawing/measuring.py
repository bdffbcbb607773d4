"""The figures of chapter 1 on metrics: what each sees, and where it looks away.

True poses are drawn in blue, estimates in orange, as on the whole page.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from book.ch01_poses_and_cameras.drawing import photographs, stand_in
from posecore import cameras, metrics, poses
from posecore.figures import Picture, chart, picture_grid
from posecore.figures.style import COLOURS, HALO, INK, STYLES, new_picture

__all__ = [
    "bins_of_angles",
    "boxes_apart",
    "can",
    "cliff",
    "directions",
    "mug",
    "not_quite_rotations",
    "on_the_photograph",
    "precision_recall",
    "scoreboard",
    "seen_from_above",
    "thresholds",
]

Photograph = stand_in.Photograph
TRUTH, ESTIMATE = photographs.TRUTH, photographs.ESTIMATE


def mug() -> Photograph:
    """The drawn mug; on these pages real data never takes its place."""
    return stand_in.photograph("mug")


def can() -> Photograph:
    """The tin can of the same picture: any turn about its axis leaves its shape as it is."""
    return stand_in.photograph("can")


def on_the_photograph(
    photo: Photograph,
    estimates: Mapping[str, tuple[np.ndarray, np.ndarray]],
    *,
    columns: int | None = None,
    alt: str,
) -> Picture:
    """The outlines of the object in its true pose and in the estimated ones, a panel for each."""
    images = [photographs.pale(photo)] * len(estimates)
    width = 8.0 if len(estimates) > 1 else 4.2
    figure = picture_grid(images, list(estimates), columns=columns, width=width, alt=alt)
    for axes, (R, t) in zip(figure.axes, estimates.values(), strict=True):
        _outline(axes, photo, photo.R, photo.t, TRUTH)
        _outline(axes, photo, R, t, ESTIMATE)
        photographs.zoom(axes, photo)
    return figure


def seen_from_above(photo: Photograph, R: np.ndarray, t: np.ndarray) -> Picture:
    """A true and an estimated pose in the picture, and both clouds as seen from above."""
    away = 1000 * np.linalg.norm(t - photo.t)
    figure = new_picture(
        8.0,
        3.1,
        f"Left, in the picture: the outlines of the {photo.name} in its true and in its estimated "
        f"pose nearly coincide. Right, from above: the clouds are {away:.0f} mm apart, one behind "
        "the other as the camera sees them.",
    )
    panels = figure.subplots(1, 2, width_ratios=[1.75, 1])
    panels[0].imshow(photographs.pale(photo))
    for pose, colour in (((photo.R, photo.t), TRUTH), ((R, t), ESTIMATE)):
        _outline(panels[0], photo, *pose, colour)
        x, _, z = 1000 * poses.apply(*pose, photo.points[::2]).T
        label = "truth" if colour == TRUTH else "estimate"
        panels[1].scatter(x, z, s=2, color=colour, label=label)
    photographs.zoom(panels[0], photo)
    panels[0].set(title="as the camera sees it")
    panels[0].set_axis_off()
    panels[1].set(
        title="from above", aspect="equal", xlabel="x of the camera, mm", ylabel="depth, mm"
    )
    panels[1].legend(fontsize=8, markerscale=3, loc="lower left", bbox_to_anchor=(1, 0))
    return figure


def directions(points: np.ndarray, R: np.ndarray, t: np.ndarray) -> Picture:
    """The two directions of ADD-S on points (N, 3) of a plane, the truth at the identity."""
    estimate = poses.apply(R, t, points)
    figure = new_picture(
        8.0,
        3.3,
        "A bar of few points with a knob of many: the truth in blue lies flat, the estimate in "
        "orange stands upright, its knob on the true bar. Left, lines from each true point to the "
        "nearest estimated one: those of the whole knob are long. Right, the other way round: "
        "those of the knob are short.",
    )
    panels = figure.subplots(1, 2, sharey=True)
    clouds = {"ground truth to estimate": (points, estimate)}
    clouds["estimate to ground truth"] = (estimate, points)
    for axes, (title, (start, end)) in zip(panels, clouds.items(), strict=True):
        nearest = end[np.linalg.norm(start[:, None] - end, axis=-1).argmin(1)]
        mean = 1000 * np.linalg.norm(start - nearest, axis=-1).mean()
        lines = 1000 * np.stack([start, nearest], 1)[..., :2]
        axes.add_collection(LineCollection(lines, color="0.55", linewidths=0.8))
        axes.scatter(*1000 * points[:, :2].T, s=14, color=TRUTH, label="truth")
        axes.scatter(*1000 * estimate[:, :2].T, s=14, color=ESTIMATE, marker="s", label="estimate")
        axes.set(aspect="equal", xlabel="x, mm")
        axes.set_title(f"{title}: {mean:.1f} mm", fontsize=11)
    panels[0].set(ylabel="y, mm")
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def thresholds(errors: np.ndarray, limits: Mapping[str, float]) -> Picture:
    """Accuracy over the threshold, with the thresholds that different diameters lead to.

    Args:
        errors: (N,) ADD of many estimates, metres.
        limits: label -> threshold, metres.
    """
    x = np.linspace(0, 1.6 * max(limits.values()), 300)
    found = {label: 100 * metrics.accuracy(errors, limit) for label, limit in limits.items()}
    listed = "; ".join(f"{label}: {value:.0f} %" for label, value in found.items())
    curves = {"_accuracy": 100 * metrics.accuracy_curve(errors, x)}
    named = {f"{label}: {found[label]:.0f} %": 1000 * limit for label, limit in limits.items()}
    looks = {
        label: {"color": COLOURS[2 + n % 3], "ls": STYLES[n % 4], "lw": 1.8}
        for n, label in enumerate(named)
    }
    return chart(
        curves,
        x=1000 * x,
        upright=named,
        looks=looks | {"_accuracy": {"color": INK}},
        xlabel="threshold on ADD, mm",
        ylabel="poses below it, %",
        xlim=(0, 1000 * x[-1]),
        ylim=(0, 100),
        legend="upper left",
        size=(6.4, 3.0),
        alt="A rising curve of accuracy over the threshold, crossed by upright lines at three "
        f"thresholds. {listed}.",
    )


def cliff(
    rotation: np.ndarray, translation: np.ndarray, named: Mapping[str, tuple[float, float]]
) -> Picture:
    """Many estimates by their two errors, and the corner that "n degrees m cm" calls correct.

    Args:
        rotation, translation: (N,) radians and metres.
        named: label -> (degrees, centimetres) of single estimates.
    """
    figure = new_picture(
        6.0,
        3.4,
        "Each estimate is a dot, its rotation error to the right and its translation error up. "
        "Only dots inside the rectangle from the origin to 5 degrees and 5 cm count. Of two named "
        "ones just beside its edge, one is inside and one outside.",
    )
    axes = figure.subplots()
    axes.add_patch(Rectangle((0, 0), 5, 5, fc="#d9ecd9", ec="none"))
    axes.add_patch(Rectangle((0, 0), 10, 5, fc="none", ec="0.4", ls="--"))
    axes.add_patch(Rectangle((0, 0), 5, 5, fc="none", ec="#009E73", lw=1.8))
    axes.text(4.9, 4.85, "5° 5 cm", ha="right", va="top", color="#00634a")
    axes.text(9.9, 4.85, "10° 5 cm", ha="right", va="top", color="0.3")
    axes.scatter(np.degrees(rotation), 100 * translation, s=9, color=ESTIMATE, alpha=0.7)
    for number, (label, place) in enumerate(named.items()):
        axes.plot(*place, "D", color=INK)
        side = {"ha": "right", "xytext": (-6, 5)} if number == 0 else {"xytext": (7, 4)}
        text = axes.annotate(label, place, textcoords="offset points", **side)
        text.set_path_effects(HALO)
    axes.set(xlim=(0, 14), ylim=(0, 7), xlabel="rotation error, °", ylabel="translation error, cm")
    return figure


def bins_of_angles(true: np.ndarray, errors: Mapping[str, np.ndarray], width: float) -> Picture:
    """How often every true angle occurs, and the mean error of each method per bin of it.

    Args:
        true: (N,) radians.
        errors: label -> (N,) radians.
        width: of the bins, radians.
    """
    figure = new_picture(
        8.0,
        2.9,
        "Left: most true angles are below ten degrees, a few reach seventy. Right: the mean "
        "error in each bin of the true angle; the honest method's is level, the lazy one's climbs "
        "with the angle.",
    )
    panels = figure.subplots(1, 2)
    bins = np.floor(np.abs(true) / width).astype(int)
    edges = np.degrees(width) * np.arange(bins.max() + 2)
    panels[0].hist(np.degrees(np.abs(true)), bins=edges, color="0.55")
    panels[0].set(xlabel="true yaw, °", ylabel="pictures", title="how often")
    for number, (label, values) in enumerate(errors.items()):
        used = np.unique(bins)
        means = [np.degrees(np.abs(values[bins == b]).mean()) for b in used]
        look = {"color": (COLOURS[2], ESTIMATE)[number % 2], "marker": "os"[number % 2], "ms": 4}
        panels[1].plot(edges[used] + np.degrees(width) / 2, means, label=label, **look)
    panels[1].set(xlabel="true yaw, °", ylabel="mean error, °", title="how wrong")
    for axes in panels:
        axes.grid(alpha=0.3)
    panels[1].legend(fontsize=9)
    return figure


def boxes_apart(
    size: float,
    shifts: np.ndarray,
    true: np.ndarray,
    legacy: Mapping[str, np.ndarray],
    marked: Sequence[int],
) -> Picture:
    """Two cubes pulled apart, and two numbers that both go by the name of "3D IoU".

    Args:
        size: edge length of the cubes, metres.
        shifts: (S,) metres.
        true: (S,) the true overlap.
        legacy: direction of the shift -> (S,) legacy scores; the first is that of the drawn cubes.
        marked: which of the shifts are drawn as cubes.
    """
    first = next(iter(legacy.values()))
    shown = [f"true {true[i]:.3f}, legacy {first[i]:.3f}" for i in marked]
    apart = [
        f"{100 * shifts[i]:.0f} cm apart, {text}" for i, text in zip(marked, shown, strict=True)
    ]
    figure = new_picture(
        8.0,
        3.0,
        f"Left: pairs of cubes from above, {'; '.join(apart)}. Right: over the shift, the true "
        "overlap falls fast to 0 at the cubes' own size, the legacy scores fall slowly and stay "
        "above 0 where the cubes no longer touch.",
    )
    panels = figure.subplots(1, 2)
    edge = 100 * size
    for row, (i, text) in enumerate(zip(marked, shown, strict=True)):
        low = -1.5 * edge * row
        for start, colour in ((0, TRUTH), (100 * shifts[i], ESTIMATE)):
            look = {"fc": (*to_rgb(colour), 0.25), "ec": colour, "lw": 1.8}
            panels[0].add_patch(Rectangle((start, low), edge, edge, **look))
        panels[0].text(2.7 * edge, low + edge / 2, text.replace(", ", "\n"), va="center")
    bottom = -1.5 * edge * (len(marked) - 1)
    panels[0].set(xlim=(-1, 4.2 * edge), ylim=(bottom - 1, edge + 1), aspect="equal")
    panels[0].set(xlabel="to the side, cm, seen from above", yticks=[])
    panels[0].spines[["left", "top", "right"]].set_visible(False)
    panels[1].plot(100 * shifts, true, color=INK, lw=1.8, label="true overlap")
    for number, (label, values) in enumerate(legacy.items()):
        look = {"color": COLOURS[(3, 4)[number % 2]], "ls": STYLES[1 + number % 2], "lw": 1.8}
        panels[1].plot(100 * shifts, values, label=f"legacy, {label}", **look)
    panels[1].set(xlabel="shift, cm", ylabel="score", ylim=(-0.02, 1.02))
    panels[1].grid(alpha=0.3)
    panels[1].legend(fontsize=9, loc="upper right", bbox_to_anchor=(1, 0.72))
    return figure


def precision_recall(recall: np.ndarray, precision: np.ndarray, area: float) -> Picture:
    """Precision over recall as ever less sure estimates are let in, and the area under it."""
    best = np.maximum.accumulate(precision[::-1])[::-1]
    x, y = np.append(0, recall), np.append(best[0], best)
    envelope = f"best at this recall or beyond: {area:.3f}"
    return chart(
        {envelope: (x, y)},
        marks={"estimates, surest first": (recall, precision)},
        bands={"_area": ((x, 0 * y), (x, y))},
        looks={
            envelope: {"color": INK, "lw": 1.5, "drawstyle": "steps-pre"},
            "estimates, surest first": {"color": ESTIMATE},
            "_area": {"color": "0.88", "alpha": 1, "step": "pre"},
        },
        xlabel="recall",
        ylabel="precision",
        xlim=(0, 1.02),
        ylim=(0, 1.05),
        legend={"loc": "lower left", "fontsize": 8},
        size=(4.6, 2.8),
        alt="A staircase that falls from precision 1 as recall grows; dots mark the estimates in "
        f"the order of their scores. The area under it, the average precision, is {area:.3f}.",
    )


def scoreboard(verdicts: Mapping[str, Mapping[str, bool]]) -> Picture:
    """Which metric calls which estimate correct: estimate -> metric -> whether, a row for each."""
    cases, columns = list(verdicts), list(next(iter(verdicts.values())))
    passed = [[bool(row[column]) for column in columns] for row in verdicts.values()]
    said = "; ".join(
        f"{case}: correct by " + (", ".join(c for c in columns if row[c]) or "none")
        for case, row in verdicts.items()
    )
    figure = new_picture(8.0, 0.42 * len(cases) + 0.75, f"A table of ticks and crosses. {said}.")
    axes = figure.subplots()
    for i, row in enumerate(passed):
        for j, ok in enumerate(row):
            fill = "#cfe8df" if ok else "#f6d9c6"
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, fc=fill, ec="white", lw=2))
            axes.text(j, i, "✓" if ok else "✗", ha="center", va="center", fontsize=13)
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(cases) - 0.5, -0.5))
    axes.set_xticks(range(len(columns)), columns, fontsize=8.5)
    axes.set_yticks(range(len(cases)), cases)
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.spines[:].set_visible(False)
    return figure


def not_quite_rotations(
    defects: np.ndarray, angles: Mapping[str, np.ndarray], true: float
) -> Picture:
    """What each formula says about one and the same error, as the ground truth is scaled.

    Args:
        defects: (D,) scale of the ground truth's matrix, less one.
        angles: formula -> (D,) median angle, radians.
        true: the true median angle, radians.
    """
    looks = zip(angles, (3, 4, 0), ("--", "-.", "-"), strict=False)
    return chart(
        {label: np.degrees(values) for label, values in angles.items()},
        x=100 * defects,
        looks={label: {"color": COLOURS[k], "ls": ls, "lw": 2} for label, k, ls in looks},
        xlabel="scale of the ground truth's matrix, % off 1",
        ylabel="median angle, °",
        ylim=(0, None),
        size=(6.4, 3.2),
        alt="Three formulas for the rotation error over the scale of the ground truth's matrix, "
        f"from {100 * defects[0]:.1f} to {100 * defects[-1]:+.1f} %. They agree where the matrix "
        "is a rotation. Beside it, that with the inverse rises to the right and falls to 0 on the "
        "left, that with the transpose the other way round; the third, after projection, stays at "
        f"{np.degrees(true):.1f} degrees.",
    )


def _outline(axes: Axes, photo: Photograph, R: np.ndarray, t: np.ndarray, colour: str) -> None:
    """The border of the object's picture, to a fraction of a pixel."""
    finer, (height, width) = 4, photo.rgb.shape[:2]
    coarse = {"mug": stand_in.mug(64, 3), "can": stand_in.can(64, 1)}
    vertices, faces = coarse[photo.name]
    fine_K = cameras.resize_intrinsics(photo.K, (width, height), (finer * width, finer * height))
    corners = np.rint(cameras.project(fine_K, poses.apply(R, t, vertices))[faces]).astype(int)
    inside = np.zeros((finer * height, finer * width), np.uint8)
    for triangle in corners:
        cv2.fillConvexPoly(inside, triangle, 1)
    borders, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for border in borders:
        x, y = ((np.vstack([border, border[:1]])[:, 0] + 0.5) / finer - 0.5).T
        axes.plot(x, y, color=colour, lw=1.8, path_effects=HALO)
