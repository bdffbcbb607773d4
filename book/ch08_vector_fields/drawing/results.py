"""The figures of chapter 8 on what was measured: refining, good and bad, real pixels, claims."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from book.ch02_small_worlds.drawing.light import quiet, thin
from book.ch08_vector_fields.drawing import fields as fields_of
from book.ch08_vector_fields.drawing.voting import draw_ellipse
from posecore import cameras, poses
from posecore.figures import Picture, draw_box, draw_outline
from posecore.figures.style import COLOURS, HALO, INK, MARKERS, STYLES, new_picture
from posecore.models import ObjectModel

__all__ = ["by_visibility", "gallery", "mended", "noise", "real", "seeds", "speed", "thresholds"]

crop, show_crop, field, window = (
    getattr(fields_of, name) for name in ("crop", "show_crop", "field", "window")
)
Pose = tuple[np.ndarray, np.ndarray]


def mended(first: np.ndarray, last: np.ndarray, overlap: np.ndarray, threshold: float) -> Picture:
    """By what factor refining changes errors (N,) in diameters, where overlap is large or not."""
    large = overlap > threshold
    names = (f"overlap above {threshold}", f"overlap at most {threshold}")
    said = "; ".join(
        f"{name}: {int((last < first)[part].sum())} of {int(part.sum())} smaller than before"
        for name, part in zip(names, (large, ~large), strict=True)
    )
    alt = "By what factor errors have changed, over the errors before, a mark for each object. "
    figure = new_picture(8.0, 3.3, f"{alt}Below 1 they are smaller now: {said}.", "")
    panels = figure.subplots(1, 2, sharey=True)
    low, high = 0.01, 1.0
    before = np.geomspace(low, high, 50)
    for axes, part, colour, name in zip(panels, (large, ~large), COLOURS, names, strict=False):
        axes.axhline(1, color="0.5", lw=1.2)
        axes.plot(before, 0.1 / before, color="0.5", lw=1, ls=":")
        axes.axvline(0.1, color="0.5", lw=1, ls=":")
        change = np.clip(last[part] / np.maximum(first[part], 1e-9), 0.1, 10)
        axes.plot(np.clip(first[part], low, high), change, ".", color=colour, ms=4.5,
                  antialiased=False)  # fmt: skip
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(0.1, 10))
        axes.xaxis.set_ticks([0.01, 0.1, 1], ["1 %", "10 %", "100 %"])
        axes.yaxis.set_ticks([0.1, 1, 10], ["/ 10", "same", "x 10"])
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("ADD(-S) before, of the diameter")
    panels[0].set_ylabel("error after refining, over before")
    return figure


def thresholds(at: np.ndarray, right: Mapping[str, np.ndarray], chosen: float) -> Picture:
    """The percentage right over the threshold of the overlap, one curve for each split."""
    said = "; ".join(
        f"{split}: {values[0]:.1f} % when all are refined, {values[-1]:.1f} % when none is, most "
        f"{values.max():.1f} % at {at[values.argmax()]:.2f}"
        for split, values in right.items()
    )
    figure = new_picture(6.0, 3.2, f"Curves over the threshold of the overlap. {said}.", "")
    axes = figure.subplots()
    for number, (split, values) in enumerate(right.items()):
        axes.plot(at, values, color=COLOURS[number], ls=STYLES[number], label=split)
    axes.axvline(chosen, color="0.5", lw=1, ls=":")
    axes.set(xlabel="refine where the overlap is above", ylabel="right, %", xlim=(0, 1))
    axes.margins(y=0.5)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, loc="center left")
    return figure


def gallery(
    rows: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray, ObjectModel, Pose, Pose | None]]],
) -> Picture:
    """Estimates beside the truth: a row for each split, a column for each kind.

    Args:
        rows: split -> title -> the picture (H, W, 3) bytes, K, the model, its true pose and the
            estimate, None where there is none.
    """
    said = "; ".join(f"{split}: {', '.join(panels)}" for split, panels in rows.items())
    wide = max(len(panels) for panels in rows.values())
    figure = new_picture(
        2.05 * wide,
        2.35 * len(rows),
        "Objects with the box of the true pose, blue, and of the estimate, orange. In the first "
        "columns they agree, in the next they part, in the last there is only the true one. "
        + said.replace("\n", " "),
        "",
    )
    panels = figure.subplots(len(rows), wide, squeeze=False)
    every = [
        (axes, title, one, around(*one[:4]))
        for line, shown in zip(panels, rows.values(), strict=True)
        for axes, (title, one) in zip(line, shown.items(), strict=False)
    ]
    parts = quiet([crop(rgb, box) for *_, (rgb, *_), box in every], 48)
    for (axes, title, (_, K, model, truth, found), box), part in zip(every, parts, strict=True):
        extent = (box[0] - 0.5, box[2] - 0.5, box[3] - 0.5, box[1] - 0.5)
        axes.imshow(part, extent=extent, interpolation="nearest")
        axes.set_autoscale_on(False)
        for pose, colour in ((truth, COLOURS[0]), (found, COLOURS[1])):
            if pose is not None:
                draw_model_box(axes, K, pose, model.points, colour)
        thin(axes)
        axes.set_title(title, fontsize=9.5)
    for axes in panels.ravel():
        axes.axis("off")
    for axes, split in zip(panels[:, 0], rows, strict=True):
        axes.text(-0.06, 0.5, split, rotation=90, transform=axes.transAxes, va="center",
                  ha="right", fontsize=11)  # fmt: skip
    return figure


def around(rgb: np.ndarray, K: np.ndarray, model: ObjectModel, truth: Pose) -> tuple[int, ...]:
    """A window of a picture around an object in its true pose."""
    middle = cameras.project(K, poses.apply(*truth, model.keypoints[-1:]))[0]
    half = 0.85 * K[0, 0] * model.diameter / truth[1][2]
    low = np.floor(middle - half).clip(0).astype(int)
    high = np.ceil(middle + half).clip(low + 2, rgb.shape[1::-1]).astype(int)
    return (*low.tolist(), *high.tolist())


def draw_model_box(axes: Axes, K: np.ndarray, pose: Pose, points: np.ndarray, colour: str) -> None:
    """The box around a model's points."""
    low, high = points.min(0), points.max(0)
    draw_box(axes, K, *pose, high - low, centre=(low + high) / 2, colour=colour)


def by_visibility(
    bins: Sequence[float], right: Mapping[str, np.ndarray], counts: Sequence[int] | None = None
) -> Picture:
    """The percentage right over the visible fraction.

    Args:
        bins: (B + 1,) borders of the visible fraction.
        right: name -> (B,), or (seeds, B) whose mean is drawn with a mark for each seed.
        counts: of objects in each bin.
    """
    means = {name: np.atleast_2d(values).mean(0) for name, values in right.items()}
    said = "; ".join(
        f"{name} " + ", ".join("none" if np.isnan(v) else f"{v:.0f} %" for v in values)
        for name, values in means.items()
    )
    spans = [f"{low:.0%} to {high:.0%}" for low, high in pairwise(bins)]
    figure = new_picture(
        6.8,
        3.3,
        "The percentage right rises with the part of the object that is seen: "
        f"{', '.join(spans)}. {said}.",
        "",
    )
    axes = figure.subplots()
    for number, (name, values) in enumerate(right.items()):
        x = np.arange(len(spans)) + 0.12 * (number - (len(right) - 1) / 2)
        look = {"color": COLOURS[number], "marker": MARKERS[number % 4]}
        axes.plot(x, means[name], ls=STYLES[number % 4], ms=6, label=name, **look)
        axes.plot(x, np.atleast_2d(values).T, ls="none", ms=3, alpha=0.6, **look)
    labels = (
        spans if counts is None else [f"{s}\n({n})" for s, n in zip(spans, counts, strict=True)]
    )
    axes.set_xticks(range(len(spans)), labels)
    top = max(float(np.nanmax(values, initial=0)) for values in right.values())
    axes.set(xlabel="visible part of the object", ylabel="right, %", ylim=(0, 8 + 1.05 * top))
    axes.grid(alpha=0.3, axis="y")
    axes.legend(fontsize=9, loc="upper left")
    return figure


def real(
    photo: object,
    vectors: np.ndarray,
    x: np.ndarray,
    points: np.ndarray,
    covariances: np.ndarray,
    found: Pose,
    degrees: float,
) -> Picture:
    """A photograph with a noisy field, the votes and the pose.

    Args:
        photo: a `Photograph` of chapter 1.
        vectors: (H, W, 2) towards keypoint 0.
        x, points, covariances: (K, 2) and (K, 2, 2) true keypoints, and what was voted for.
        found: the pose.
        degrees: the noise.
    """
    off = np.linalg.norm(points - x, axis=-1)
    figure = new_picture(
        8.4,
        3.5,
        f"Left: a {photo.name}, {photo.source}, coloured by a field of arrows that are off by "
        f"{degrees:g} degrees, a ring at the keypoint. Right: the {photo.name} with its keypoints, "
        f"voted for, as crosses with ellipses, {off.mean():.1f} px from the true rings on average, "
        "and with the boxes of the true pose and of the estimate, which nearly agree.",
        "",
    )
    left, right = figure.subplots(1, 2)
    box = window(photo.mask, x, 0.12)
    coarse = np.ix_(*(np.arange(side) // 3 * 3 for side in photo.mask.shape))  # a smaller file
    field(left, photo.mask, vectors[coarse], box)
    left.plot(*x[0], "o", mfc="white", mec=INK, ms=10, mew=1.8)
    show_crop(right, photo.rgb, box, pale=0.3)
    draw_outline(right, photo.mask, colour="0.4", style="--")
    corners = photo.centre + np.array([[-1], [1]]) * photo.size / 2
    for pose, colour in (((photo.R, photo.t), COLOURS[0]), (found, COLOURS[1])):
        draw_model_box(right, photo.K, pose, corners, colour)
    thin(right)
    for k, (point, covariance) in enumerate(zip(points, covariances, strict=True)):
        draw_ellipse(right, point, covariance)
        right.plot(*x[k], "o", mfc="none", mec=INK, ms=8, mew=1.4)
        right.plot(*point, "X", color=COLOURS[2], mec="white", ms=8)
    return figure


def noise(degrees: np.ndarray, errors: Mapping[str, Mapping[str, np.ndarray]]) -> Picture:
    """Errors over the noise of a field.

    Args:
        degrees: (N,) the noise.
        errors: what is measured, with its unit -> name of the curve -> (N,).
    """
    said = "; ".join(
        f"{title}, {name}: {values[0]:.2g} to {values[-1]:.2g}"
        for title, curves in errors.items()
        for name, values in curves.items()
    )
    figure = new_picture(
        7.8,
        2.7,
        f"Errors over the noise of the field from {degrees[0]:g} to {degrees[-1]:g} degrees, "
        f"rising on the whole. {said}.",
        "",
    )
    for axes, (title, curves) in zip(figure.subplots(1, len(errors)), errors.items(), strict=True):
        for number, (name, values) in enumerate(curves.items()):
            axes.plot(degrees, values, color=COLOURS[number], ls=STYLES[number], ms=5,
                      marker=MARKERS[number], label=name)  # fmt: skip
        axes.set(xlabel="noise of the field, degrees", ylabel=title, ylim=(0, None))
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def seeds(
    groups: Mapping[str, Mapping[str, np.ndarray]], paper: Mapping[str, Mapping[str, float]]
) -> Picture:
    """Percentages right: a panel for each group, a column for each name, a mark for each seed.

    Args:
        groups: title -> name -> (seeds,).
        paper: title -> name -> the paper's number, on other objects.
    """
    said = "; ".join(
        f"{title}, {name} {values.mean():.1f} %"
        for title, table in groups.items()
        for name, values in table.items()
    )
    figure = new_picture(9.0, 3.2, f"A mark for each seed. Means: {said}.", "")
    panels = np.atleast_1d(figure.subplots(1, len(groups)))
    for number, (axes, (title, table)) in enumerate(zip(panels, groups.items(), strict=True)):
        for place, (name, values) in enumerate(table.items()):
            where = place + np.linspace(-0.12, 0.12, len(values))
            axes.plot(where, values, MARKERS[number % 4], color=COLOURS[number], ms=6)
            axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
            if name in paper.get(title, {}):
                axes.plot(place + 0.3, paper[title][name], "x", color="0.4", ms=8, mew=1.8)
        axes.set_xticks(range(len(table)), [name.replace(", ", "\n") for name in table], fontsize=9)
        axes.set(title=title, xlim=(-0.5, len(table) - 0.5), ylabel="right, %")
        axes.grid(alpha=0.3, axis="y")
    if paper:
        axes.plot([], [], "x", color="0.4", ms=8, mew=1.8, label="the paper's, on other objects")
        figure.legend(fontsize=9, loc="outside upper center", frameon=False)
    return figure


def speed(stages: Mapping[str, Sequence[float]], paper: Sequence[float]) -> Picture:
    """Milliseconds for one image, by stage, for one, two and three objects.

    Args:
        stages: name -> (3,) milliseconds.
        paper: (3,) images a second.
    """
    totals = np.sum(list(stages.values()), axis=0)
    said = ", ".join(f"{1 + n}: {total:.1f} ms" for n, total in enumerate(totals))
    figure = new_picture(6.4, 2.8, f"Bars of the time for an image by objects, {said}.", "")
    axes = figure.subplots()
    left = np.zeros(len(totals))
    for number, (name, values) in enumerate(stages.items()):
        axes.barh(range(len(totals)), values, left=left, color=COLOURS[number], label=name,
                  hatch=("", "//", "..", "xx")[number % 4], ec="white")  # fmt: skip
        left += values
    for n, total in enumerate(totals):
        axes.text(total, n, f" {1000 / total:.0f} a second (paper {paper[n]:g})", va="center",
                  fontsize=9, path_effects=HALO)  # fmt: skip
    axes.set_yticks(range(len(totals)), ["1 object", "2 objects", "3 objects"][: len(totals)])
    axes.set(xlabel="milliseconds for one image", xlim=(0, 1.45 * totals.max()))
    axes.invert_yaxis()
    figure.legend(fontsize=9, loc="outside upper center", ncols=len(stages), frameon=False)
    return figure
