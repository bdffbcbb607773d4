"""The figures of chapter 8 on what a network says: windows, fields, votes, poses, a second look."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from book.ch08_vector_fields.drawing import fields as fields_of
from book.ch08_vector_fields.drawing import voting as rays
from posecore.figures import Picture, draw_axes, draw_box, draw_ellipse, draw_outline
from posecore.figures.photographs import thin_lines
from posecore.figures.style import COLOURS, HALO, INK, new_picture
from posecore.models import ObjectModel

__all__ = ["clouds", "learnt", "pose", "residuals", "seen", "shares", "windows"]

window, field = fields_of.window, fields_of.field
show_crop = fields_of.show_crop
OUTLINES = tuple(zip((COLOURS[4], COLOURS[5], COLOURS[1]), ("-", "--", "-."), strict=True))
Pose = tuple[np.ndarray, np.ndarray]


def windows(
    images: np.ndarray, labels: np.ndarray, vectors: np.ndarray, names: Sequence[str]
) -> Picture:
    """Windows of a training: images (B, h, w, 3) with outlines of labels (B, h, w), and vectors.

    Args:
        images: 0 to 1.
        labels: 0 for background, then the objects.
        vectors: (B, h, w, 2) to one keypoint of each object.
        names: of the objects.
    """
    said = "; ".join(", ".join(names[o - 1] for o in np.unique(part) if o) for part in labels)
    figure = new_picture(
        6.8,
        3.6,
        f"{len(images)} square windows with objects in them, some turned or half covered, before "
        f"other backgrounds; outlines mark the objects: {said}. Below each, the same objects "
        "coloured by direction to one of their keypoints, with arrows; the rest is white.",
    )
    panels = figure.subplots(2, len(images), squeeze=False)
    high, wide = labels.shape[1:]
    box = (0, 0, wide, high)
    for column, image, label, wanted in zip(panels.T, images, labels, vectors, strict=True):
        show_crop(column[0], np.uint8(255 * image.clip(0, 1)), box)
        outlines(column[0], label, names)
        thin_lines(column[0], 1.6)
        field(column[1], label > 0, wanted, box)
    keys = [
        Line2D([], [], color=colour, ls=style, label=name)
        for (colour, style), name in zip(OUTLINES, names, strict=False)
    ]
    figure.legend(handles=keys, ncols=len(keys), loc="outside upper center", frameon=False)
    return figure


def outlines(axes: Axes, label: np.ndarray, names: Sequence[str]) -> None:
    """The borders of the labels 1, 2, ..., each with its colour and line."""
    for number, name in enumerate(names):
        if (label == 1 + number).any():
            colour, style = OUTLINES[number % len(OUTLINES)]
            draw_outline(axes, label == 1 + number, label=name, colour=colour, style=style)


def learnt(
    rgb: np.ndarray,
    mask: np.ndarray,
    stages: Mapping[str, tuple[np.ndarray, np.ndarray]],
    ends: Sequence[str],
) -> Picture:
    """What networks say of one object: the mask as an outline, fields in the true mask.

    Args:
        rgb: (H, W, 3) bytes.
        mask: (H, W) bool, the truth.
        stages: title -> mask (H, W) bool and vectors (H, W, N, 2).
        ends: what the N fields point to.
    """
    said = "; ".join(
        f"{title}: {int((found & mask).sum())} of {int(mask.sum())} pixels in the mask, "
        f"{int((found & ~mask).sum())} beside it"
        for title, (found, _) in stages.items()
    )
    figure = new_picture(
        1.75 * len(stages),
        1.75 * (1 + len(ends)),
        "Above, a teapot with the outline of what a network takes for it; below, its pixels "
        f"coloured by the direction that the network says, {', '.join(ends)}, with arrows. The "
        f"last column is the truth. {said}.",
    )
    panels = figure.subplots(1 + len(ends), len(stages))
    box = window(mask, np.argwhere(mask)[:1, ::-1], 0.15)
    for column, (title, (found, vectors)) in zip(panels.T, stages.items(), strict=True):
        show_crop(column[0], rgb, box)
        draw_outline(column[0], found, colour=COLOURS[1])
        thin_lines(column[0])
        column[0].set_title(title, fontsize=10)
        for n, axes in enumerate(column[1:]):
            field(axes, mask, vectors[:, :, n], box)
    for axes, end in zip(panels[1:, 0], ends, strict=True):
        axes.set_ylabel(end)
    return figure


def seen(
    rgb: np.ndarray,
    label: np.ndarray,
    names: Sequence[str],
    mask: np.ndarray,
    vectors: np.ndarray,
    x: np.ndarray,
) -> Picture:
    """A whole picture with the masks that a network found, and one field of one object.

    Args:
        rgb: (H, W, 3) bytes.
        label: (H, W) 0 for background, then the objects.
        names: of the objects.
        mask, vectors: (H, W) bool and (H, W, 2) of the object.
        x: (2,) the keypoint in truth.
    """
    found = [name for number, name in enumerate(names) if (label == 1 + number).any()]
    figure = new_picture(
        7.2,
        2.9,
        "A table with things on it. Outlines mark what the network takes for its objects: "
        f"{', '.join(found) or 'nothing'}. Beside it the pixels of the teapot, coloured by the "
        "direction that the network says, with arrows, and a ring at the keypoint.",
    )
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    show_crop(left, rgb, (0, 0, rgb.shape[1], rgb.shape[0]))
    outlines(left, label, names)
    thin_lines(left, 1.6)
    if found:
        left.legend(fontsize=8, loc="lower left")
    field(right, mask, vectors, window(mask, x, 0.1))
    right.plot(*x, "o", mfc="white", mec=INK, ms=10, mew=1.8)
    return figure


def clouds(
    rgb: np.ndarray,
    mask: np.ndarray,
    x: np.ndarray,
    points: np.ndarray,
    covariances: np.ndarray,
    hypotheses: Sequence[np.ndarray],
) -> Picture:
    """The votes for all keypoints of an object.

    Args:
        rgb: (H, W, 3) bytes.
        mask: (H, W) bool, the pixels that voted.
        x: (K, 2) the truth.
        points, covariances: (K, 2) and (K, 2, 2) what was found.
        hypotheses: for each keypoint (S, 2) those that count.
    """
    off = np.linalg.norm(points - x, axis=-1)
    sure = np.sqrt(np.linalg.eigvalsh(covariances)[:, 1])
    said = ", ".join(
        f"{k} {far:.1f} px off, {deviation:.1f} px long"
        for k, (far, deviation) in enumerate(zip(off, sure, strict=True))
    )
    figure = new_picture(
        6.6,
        4.6,
        f"An object with {len(x)} clouds of little dots, each within an ellipse, a cross at its "
        f"middle and a ring at the true keypoint. Distance and longest deviation: {said}.",
    )
    axes = figure.subplots()
    box = window(_largest(mask), x, 0.22)
    show_crop(axes, rgb, box, pale=0.5)
    draw_outline(axes, mask, colour="0.45", style="--")
    for k, cloud in enumerate(hypotheses):
        point, covariance = points[k], covariances[k]
        axes.plot(*cloud.T, ".", color=COLOURS[0], ms=4, antialiased=False)
        draw_ellipse(axes, point, covariance)
        axes.plot(*x[k], **(rays.TRUTH | {"ms": 9}))
        axes.plot(*point, **(rays.POINTS["RANSAC"] | {"ms": 9}))
        away = x[k] - x.mean(0)
        away = away / max(np.linalg.norm(away), 1e-6)
        axes.annotate(str(k), x[k], xytext=(15 * away[0], -15 * away[1]), fontsize=11,
                      textcoords="offset points", ha="center", va="center",
                      path_effects=HALO)  # fmt: skip
    return figure


def pose(
    rgb: np.ndarray, K: np.ndarray, found: Sequence[tuple[ObjectModel, Pose]], said: str
) -> Picture:
    """A picture with the boxes and axes of poses.

    Args:
        rgb: (H, W, 3) bytes.
        K: (3, 3) camera matrix.
        found: of each object its model and pose.
        said: what is to be seen, for the alt text.
    """
    figure = new_picture(4.8, 3.6, f"A table with things on it, with boxes and axes. {said}")
    axes = figure.subplots()
    show_crop(axes, rgb, (0, 0, rgb.shape[1], rgb.shape[0]))
    for model, (R, t) in found:
        low, high = model.points.min(0), model.points.max(0)
        draw_box(axes, K, R, t, high - low, centre=(low + high) / 2)
        draw_axes(axes, K, R, t, 0.4 * model.diameter)
    thin_lines(axes)
    return figure


def residuals(
    rgb: np.ndarray,
    mask: np.ndarray,
    pixels: np.ndarray,
    inside: np.ndarray,
    said: np.ndarray,
    expected: np.ndarray,
    ends: np.ndarray,
) -> Picture:
    """What a refiner is given: points in a wrong pose, and where field and pose differ.

    Args:
        rgb: (H, W, 3) bytes.
        mask: (H, W) bool, where the field is.
        pixels: (N, 2) projected points of the model.
        inside: (N,) which of them lie in the mask.
        said, expected: (N, 2) unit vectors of the field and of the pose, to one keypoint.
        ends: (2, 2) that keypoint in truth and by the pose.
    """
    size = np.linalg.norm(said - expected, axis=-1)[inside]
    figure = new_picture(
        8.4,
        3.4,
        "Left: an object with dots that do not quite cover it, the points of its model in a wrong "
        f"pose, {int(inside.sum())} of {len(inside)} in the mask. Middle: at some of them two "
        "arrows, of the field and of the pose, which point at a ring and at a square not far "
        "from it. Right: their differences, which are alike among neighbours; half of all are "
        f"longer than {np.median(size) if size.size else 0:.2f}, and they are drawn twice as long.",
    )
    left, middle, right = figure.subplots(1, 3)
    box = window(_largest(mask), np.concatenate([pixels, ends]), 0.06)
    for axes in (left, middle, right):
        show_crop(axes, rgb, box, pale=0.3 if axes is left else 0.7)
        draw_outline(axes, mask, colour="0.4", style="--")
        thin_lines(axes)
    look = {"mec": INK, "mew": 0.5, "ls": "none", "antialiased": False}
    left.plot(*pixels[inside].T, "o", color=COLOURS[4], ms=3.5, label="in the mask", **look)
    left.plot(*pixels[~inside].T, "X", color=COLOURS[1], ms=6, label="outside", **look)
    some = np.flatnonzero(inside)[:: max(int(inside.sum()) // 28, 1)]
    length = 0.1 * (box[2] - box[0])
    look = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.008, "antialiased": False}
    for axes, vectors, colour, name in (
        (middle, expected, COLOURS[0], "predicted by the pose"),
        (middle, said, COLOURS[4], "said by the field"),
        (right, 2 * (said - expected), INK, "difference, x 2"),
    ):
        arrows = length * vectors[some]
        axes.quiver(*pixels[some].T, *arrows.T, color=colour, label=name, **look)
    look = {"ls": "none", "ms": 9, "mew": 1.6}
    middle.plot(*ends[1], "s", mfc=COLOURS[0], mec="white", label="the tip by the pose", **look)
    middle.plot(*ends[0], "o", mfc=COLOURS[4], mec=INK, label="the tip in truth", **look)
    for axes in (left, middle, right):
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=1)
    return figure


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected part of a mask (H, W)."""
    _, parts, statistics, _ = cv2.connectedComponentsWithStats(np.uint8(mask))
    return parts == 1 + statistics[1:, cv2.CC_STAT_AREA].argmax()


def shares(
    cases: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
) -> Picture:
    """Points of models, projected, in and outside of masks.

    Args:
        cases: title -> the picture (H, W, 3) bytes, the mask (H, W) bool, pixels (N, 2) of the
            model's points, and which are in the mask (N,).
    """
    said = "; ".join(
        f"{title}: {int(inside.sum())} of {len(inside)} points in the mask"
        for title, (*_, inside) in cases.items()
    )
    figure = new_picture(
        4.0 * len(cases),
        3.4,
        "Pictures of objects, each with its mask shaded and the points of its model over it, dots "
        f"in the mask and crosses outside. {said}.",
    )
    panels = np.atleast_1d(figure.subplots(1, len(cases)))
    for axes, (title, (rgb, mask, pixels, inside)) in zip(panels, cases.items(), strict=True):
        box = window(mask, pixels.clip(0, np.subtract(mask.shape[::-1], 1)), 0.1)
        shaded = np.where(mask[..., None], 0.45 * rgb + 0.55 * np.array([204, 121, 167]), rgb)
        show_crop(axes, np.uint8(shaded), box)
        draw_outline(axes, mask, colour="white", style="-")
        axes.plot(*pixels[inside].T, ".", color="#f0e442", mec=INK, mew=0.3, ms=5, label="inside")
        axes.plot(*pixels[~inside].T, "x", color=INK, ms=5, mew=1.3, label="outside")
        axes.set_title(title, fontsize=10)
    panels[0].legend(fontsize=8, loc="lower left")
    return figure
