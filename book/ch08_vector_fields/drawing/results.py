"""The figures of chapter 8 on what was measured: refining, good and bad, real pixels, claims."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from book.ch08_vector_fields.drawing import fields as fields_of
from posecore.figures import Picture, draw_box, draw_chart, draw_ellipse, draw_outline, results
from posecore.figures.photographs import thin_lines
from posecore.figures.style import COLOURS, HALO, INK, new_picture
from posecore.models import ObjectModel

__all__ = ["by_visibility", "gallery", "mended", "noise", "real", "seeds", "speed", "thresholds"]

field, window = fields_of.field, fields_of.window
show_crop = fields_of.show_crop
by_visibility = results.by_visibility
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
    figure = new_picture(8.0, 3.3, f"{alt}Below 1 they are smaller now: {said}.")
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
    return results.over_threshold(
        at,
        right,
        chosen,
        xlabel="refine where the overlap is above",
        alt=f"Curves over the threshold of the overlap. {said}.",
    )


def gallery(
    rows: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray, ObjectModel, Pose, Pose | None]]],
) -> Picture:
    """Estimates beside the truth: a row for each split, a column for each kind.

    Args:
        rows: split -> title -> the picture (H, W, 3) bytes, K, the model, its true pose and the
            estimate, None where there is none.
    """
    said = "; ".join(f"{split}: {', '.join(panels)}" for split, panels in rows.items())
    return results.gallery(
        {
            split: {title: _estimate(*one) for title, one in panels.items()}
            for split, panels in rows.items()
        },
        width=1.75,
        alt="Objects with the box of the true pose, blue, and of the estimate, orange. In the "
        "first columns they agree, in the next they part, in the last there is only the true one. "
        + said.replace("\n", " "),
    )


def _estimate(
    rgb: np.ndarray, K: np.ndarray, model: ObjectModel, truth: Pose, found: Pose | None
) -> results.Estimate:
    low, high = model.points.min(0), model.points.max(0)
    return results.Estimate(rgb, K, high - low, truth, found, (low + high) / 2)


def draw_model_box(axes: Axes, K: np.ndarray, pose: Pose, points: np.ndarray, colour: str) -> None:
    """The box around a model's points."""
    low, high = points.min(0), points.max(0)
    draw_box(axes, K, *pose, high - low, centre=(low + high) / 2, colour=colour)


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
        7.4,
        3.1,
        f"Left: a {photo.name}, {photo.source}, coloured by a field of arrows that are off by "
        f"{degrees:g} degrees, a ring at the keypoint. Right: the {photo.name} with its keypoints, "
        f"voted for, as crosses with ellipses, {off.mean():.1f} px from the true rings on average, "
        "and with the boxes of the true pose and of the estimate, which nearly agree.",
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
    thin_lines(right)
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
    )
    for axes, (title, curves) in zip(figure.subplots(1, len(errors)), errors.items(), strict=True):
        words = {"xlabel": "noise of the field, degrees", "ylabel": title, "ylim": (0, None)}
        draw_chart(axes, curves, x=degrees, markers=True, legend={"fontsize": 8}, **words)
    return figure


def seeds(
    groups: Mapping[str, Mapping[str, np.ndarray]], paper: Mapping[str, Mapping[str, float]]
) -> Picture:
    """Percentages right of the seeds, and the paper's on other objects, by group and name."""
    return results.over_seeds(groups, paper, others_are="the paper's, on other objects")


def speed(stages: Mapping[str, Sequence[float]], paper: Sequence[float]) -> Picture:
    """Milliseconds for one image, by stage, for one, two and three objects.

    Args:
        stages: name -> (3,) milliseconds.
        paper: (3,) images a second.
    """
    totals = np.sum(list(stages.values()), axis=0)
    said = ", ".join(f"{1 + n}: {total:.1f} ms" for n, total in enumerate(totals))
    figure = new_picture(6.4, 2.8, f"Bars of the time for an image by objects, {said}.")
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
